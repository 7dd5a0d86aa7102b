"""Times reading against others' work on the same bytes, in turns: medians in seconds.

pip install numpy imagecodecs
cargo build --release -p holovol_volume --example read_speed
python speed.py path/to/target/release/examples/read_speed path/to/data/volumes [RUNS]

Uncompressed: `cat FILES >/dev/shm/...` (a process), and a read of one thread into memory that was
touched before. gzip: libdeflate, and zlib-ng on the same deflate stream in zlib's wrapper; both on
one thread, from memory into memory that was touched before, with their check sums.
"""

import gzip
import os
import pathlib
import statistics
import subprocess
import sys
import time
import zlib

import imagecodecs
import numpy as np

binary, folder = sys.argv[1], pathlib.Path(sys.argv[2])
runs = int(sys.argv[3]) if len(sys.argv) > 3 else 31
reader = subprocess.Popen([binary, "-"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def ours(path):
    reader.stdin.write(f"{path}\n")
    reader.stdin.flush()
    return float(reader.stdout.readline())


def timed(work):
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def cat(files):
    subprocess.run(["sh", "-c", 'exec cat "$@" >/dev/shm/holovol_cat', "sh", *map(str, files)], check=True)


def single(files, buffer):
    at = 0
    for file in files:
        with open(file, "rb", buffering=0) as stream:
            at += stream.readinto(buffer[at:])


def report(name, columns):
    """Takes turns; prints the median of each, of the ratios of each turn, and the ratio of bests."""
    times = {column: [] for column in columns}
    for _ in range(runs):
        for column, work in columns.items():
            times[column].append(work())
    own = times["ours"]
    parts = [f"{name}: ours {statistics.median(own):.4f}"]
    for column in list(columns)[1:]:
        ratio = statistics.median(other / mine for other, mine in zip(times[column], own))
        best = min(times[column]) / min(own)
        parts.append(
            f"{column} {statistics.median(times[column]):.4f} ({ratio:.2f}, best {best:.2f})"
        )
    print(", ".join(parts), flush=True)


def uncompressed(name, volume, files):
    buffer = memoryview(bytearray(sum(os.path.getsize(file) for file in files)))
    columns = {
        "ours": lambda: ours(volume),
        "cat": lambda: timed(lambda: cat(files)),
        "one thread": lambda: timed(lambda: single(files, buffer)),
    }
    report(name, columns)


thorax = folder / "lidc-idri-0314_ct_thorax_dicom"
print("load", os.getloadavg(), "cores", os.cpu_count(), "runs", runs)
uncompressed("thorax", thorax, sorted(thorax.iterdir()))
for header in ("mouse_brain_microscopy.mhd", "tooth.nhdr"):
    path = folder / header
    uncompressed(header, path, [path.with_suffix(".raw")])
for path in sorted(folder.glob("*.nii.gz")):
    packed = path.read_bytes()
    plain = gzip.decompress(packed)
    out = np.empty(len(plain), np.uint8)
    columns = {
        "ours": lambda: ours(path),
        "libdeflate": lambda: timed(lambda: imagecodecs.gzip_decode(packed, out=out)),
        "zlib-ng": lambda: timed(lambda: imagecodecs.zlibng_decode(zlib_wrapped, out=out)),
    }
    # Ten bytes, and perhaps a name, come before the stream; eight after.
    start = packed.index(0, 10) + 1 if packed[3] == 8 else 10
    assert packed[3] in (0, 8)
    zlib_wrapped = b"\x78\x9c" + packed[start:-8] + zlib.adler32(plain).to_bytes(4, "big")
    imagecodecs.gzip_decode(packed, out=out)
    assert out.tobytes() == plain
    report(path.name, columns)
reader.stdin.close()
os.unlink("/dev/shm/holovol_cat")

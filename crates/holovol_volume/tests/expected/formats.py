"""Writes ../phantoms/formats/* and formats.json: where their marks must appear.

The same asymmetric field as phantoms.py (three marked corners, distinct spacings, oblique axes),
written by libraries that share nothing with holovol: SimpleITK (MetaImage, NRRD, NIfTI), pydicom
and imagecodecs (DICOM), tifffile (TIFF), OpenVDB's own Python module (OpenVDB).

pip install numpy SimpleITK pydicom pylibjpeg pylibjpeg-libjpeg imagecodecs tifffile
python formats.py
python formats.py --vdb     (with an interpreter that has pyopenvdb, such as Debian's)

OpenVDB's module writes no ZIP: that file is put together by hand here, and read back by OpenVDB.
"""

import json
import pathlib
import shutil
import struct
import sys
import zlib

import numpy as np

here = pathlib.Path(__file__).parent
folder = here.parent / "phantoms/formats"
folder.mkdir(exist_ok=True)
facts_path = here / "formats.json"

DIMS = (5, 4, 3)
MARKS = {101: (0, 0, 0), 102: (4, 0, 0), 103: (0, 3, 0)}
ORIGIN = np.array([-388.5, 81.25, 405.0])
# The same for lossy compression.
FAR_APART = {101: 60, 102: 120, 103: 180}
RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0])


def rotation(a, b, c):
    (ca, sa), (cb, sb), (cc, sc) = ((np.cos(t), np.sin(t)) for t in (a, b, c))
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return z @ y @ x


SPACING = np.array([0.7, 1.9, 3.1])
ROTATION = rotation(0.3, -0.5, 0.8)
STEPS = ROTATION @ np.diag(SPACING)


def field(dtype="int16"):
    """x first; 7 everywhere but at the marks."""
    values = np.full(DIMS, 7, dtype)
    for mark, index in MARKS.items():
        values[index] = mark
    return values


def marks(steps_lps_mm, oriented=True, scale=1e-3, mirrored=False):
    """Places of the marks in the world, from the columns of a step along i, j, k."""
    centre = (np.array(DIMS) - 1) / 2
    places = []
    for mark, index in MARKS.items():
        if mirrored:
            index = (*index[:2], DIMS[2] - 1 - index[2])
        place = np.asarray(steps_lps_mm) @ (np.array(index) - centre) * scale
        if oriented:
            right, anterior, superior = RAS_FROM_LPS @ place
            place = (-right, superior, anterior)
        places.append([mark, *map(float, place)])
    return places


facts = json.loads(facts_path.read_text()) if facts_path.exists() else {}


def simple_itk():
    import SimpleITK as sitk

    image = sitk.GetImageFromArray(np.ascontiguousarray(field().transpose(2, 1, 0)))
    image.SetSpacing(SPACING.tolist())
    image.SetDirection(ROTATION.flatten().tolist())
    image.SetOrigin(ORIGIN.tolist())
    for name, compressed in (
        ("itk.mhd", False),
        ("itk.mha", True),
        ("itk.nrrd", True),
        ("itk.nii", False),
        ("itk.hdr", False),
    ):
        sitk.WriteImage(image, str(folder / name), useCompression=compressed)
        facts[name] = {"marks": marks(STEPS)}
    # Big-endian by hand: ITK reads it, but writes the machine's order only.
    text = (folder / "itk.mhd").read_text().replace("MSB = False", "MSB = True")
    (folder / "big.mhd").write_text(text.replace("itk.raw", "big.raw"))
    (folder / "big.raw").write_bytes(field().astype(">i2").tobytes(order="F"))
    again = sitk.ReadImage(str(folder / "big.mhd"))
    assert (sitk.GetArrayFromImage(again).transpose(2, 1, 0) == field()).all()
    facts["big.mhd"] = facts["itk.mhd"]
    # A file per slice, by a list, a pattern, and one that counts down.
    for k in range(DIMS[2]):
        (folder / f"slice{k + 8:02d}.raw").write_bytes(field()[:, :, k].tobytes(order="F"))
    text = (folder / "itk.mhd").read_text()
    names = "\n".join(f"slice{k + 8:02d}.raw" for k in range(DIMS[2]))
    (folder / "list.mhd").write_text(text.replace("itk.raw", "LIST\n" + names))
    (folder / "numbered.mhd").write_text(text.replace("itk.raw", "slice%02d.raw 8 10 1"))
    for name in ("list.mhd", "numbered.mhd"):
        facts[name] = facts["itk.mhd"]
    again = sitk.ReadImage(str(folder / "numbered.mhd"))
    assert (sitk.GetArrayFromImage(again).transpose(2, 1, 0) == field()).all()
    vectors = " ".join("(" + ",".join(f"{n:.12g}" for n in step) + ")" for step in STEPS.T)
    lines = [
        "NRRD0005",
        "type: int16",
        "dimension: 3",
        "sizes: 5 4 3",
        "space: left-posterior-superior",
        f"space directions: {vectors}",
        "endian: little",
        "encoding: raw",
    ]
    for name, data in (
        ("list.nhdr", "LIST\n" + names),
        ("numbered.nhdr", "slice%02d.raw 8 10 1"),
    ):
        (folder / name).write_text("\n".join([*lines, f"data file: {data}", ""]))
        facts[name] = {"marks": marks(STEPS)}
    (folder / "down.nhdr").write_text("\n".join([*lines, "data file: slice%02d.raw 10 8 -1", ""]))
    # Slices the other way round are the phantom with its third axis mirrored.
    facts["down.nhdr"] = {"marks": marks(STEPS, mirrored=True)}


def dataset(number, syntax):
    import pydicom
    from pydicom.dataset import FileDataset, FileMetaDataset

    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2"
    meta.MediaStorageSOPInstanceUID = f"1.2.826.0.1.3680043.8.498.1.{number}"
    meta.TransferSyntaxUID = syntax
    d = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    d.SOPClassUID = meta.MediaStorageSOPClassUID
    d.SOPInstanceUID = meta.MediaStorageSOPInstanceUID
    d.SeriesInstanceUID = "1.2.826.0.1.3680043.8.498.2"
    d.StudyInstanceUID = "1.2.826.0.1.3680043.8.498.3"
    d.PatientName = "SECRET^PATIENT"
    d.PatientID = "SECRET-ID"
    d.PatientBirthDate = "19010203"
    d.Modality = "CT"
    d.SeriesDescription = "phantom"
    d.SeriesNumber = 3
    d.InstanceNumber = number
    d.SamplesPerPixel = 1
    d.PhotometricInterpretation = "MONOCHROME2"
    d.BitsAllocated = 16
    d.BitsStored = 16
    d.HighBit = 15
    d.PixelRepresentation = 1
    d.RescaleSlope = 1
    d.RescaleIntercept = 0
    return d


def image_of(d, pixels):
    """Pixels as rows of columns."""
    d.Rows, d.Columns = pixels.shape[-2:]
    d.PixelData = pixels.tobytes()
    d["PixelData"].VR = "OW"
    return d


def text(numbers):
    return [f"{n:.12g}"[:16] for n in numbers]


def save(d, path):
    import pydicom
    from pydicom.uid import ExplicitVRBigEndian, ImplicitVRLittleEndian

    syntax = d.file_meta.TransferSyntaxUID
    path.parent.mkdir(exist_ok=True)
    pydicom.dcmwrite(
        path,
        d,
        implicit_vr=syntax == ImplicitVRLittleEndian,
        little_endian=syntax != ExplicitVRBigEndian,
        force_encoding=True,
    )


def compressions():
    """Name, transfer syntax and encoder of one frame for each codec."""
    import imagecodecs

    def baseline(pixels):
        return imagecodecs.jpeg8_encode(pixels.astype("u1"), level=100)

    return [
        ("jpeg", "1.2.840.10008.1.2.4.50", baseline),
        ("jpeg_lossless", "1.2.840.10008.1.2.4.70", lambda p: imagecodecs.ljpeg_encode(p, bitspersample=16)),
        ("jpegls", "1.2.840.10008.1.2.4.80", lambda p: imagecodecs.jpegls_encode(p, level=0)),
        (
            "jpeg2000",
            "1.2.840.10008.1.2.4.90",
            lambda p: imagecodecs.jpeg2k_encode(p, level=0, reversible=True, codecformat="J2K"),
        ),
        ("rle", "1.2.840.10008.1.2.5", None),
    ]


def slices(name, syntax, steps, order=(2, 0, 1), dtype="<i2", pack=False):
    """A folder of slices whose names are not in their order."""
    target = folder / name
    shutil.rmtree(target, ignore_errors=True)
    is_lossy = syntax.endswith("4.50")
    for place, k in enumerate(order):
        d = dataset(k + 1, syntax)
        unit = steps / np.linalg.norm(steps, axis=0)
        # i runs along a row, that is from column to column.
        d.ImageOrientationPatient = text([*unit[:, 0], *unit[:, 1]])
        d.ImagePositionPatient = text(ORIGIN + steps[:, 2] * k)
        d.PixelSpacing = text([SPACING[1], SPACING[0]])
        d.SliceThickness = "9"
        values = field()
        if is_lossy:
            values = np.select([values == mark for mark in FAR_APART], FAR_APART.values(), values)
        image_of(d, np.ascontiguousarray(values[:, :, k].T.astype(dtype)))
        if pack is not False:
            compress(d, syntax, pack)
        save(d, target / f"{place}.dcm")
    (target / "readme.txt").write_text("no image\n")
    facts[name] = {"marks": marks(steps)}
    if is_lossy:
        for mark in facts[name]["marks"]:
            mark[0] = FAR_APART[mark[0]]
        facts[name]["tolerance"] = 2


def compress(d, syntax, pack):
    """Packs the pixels, which are unsigned, of 8 bits for JPEG baseline."""
    from pydicom.encaps import encapsulate
    from pydicom.uid import ExplicitVRLittleEndian

    pixels = np.frombuffer(d.PixelData, "<u2").reshape(d.Rows, d.Columns)
    d.PixelRepresentation = 0
    if pack is None:
        d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        d.compress(syntax, generate_instance_uid=False)
        return
    if syntax.endswith("4.50"):
        d.BitsAllocated, d.BitsStored, d.HighBit = 8, 8, 7
    d.PixelData = encapsulate([bytes(pack(pixels))])
    d["PixelData"].VR = "OB"
    d["PixelData"].is_undefined_length = True


def dicom():
    from pydicom.dataset import Dataset
    from pydicom.sequence import Sequence
    from pydicom.uid import (
        DeflatedExplicitVRLittleEndian,
        ExplicitVRBigEndian,
        ExplicitVRLittleEndian,
        ImplicitVRLittleEndian,
    )

    slices("dicom_implicit", ImplicitVRLittleEndian, STEPS)
    slices("dicom_explicit", ExplicitVRLittleEndian, STEPS)
    slices("dicom_big", ExplicitVRBigEndian, STEPS, dtype=">i2")
    slices("dicom_deflated", DeflatedExplicitVRLittleEndian, STEPS)
    # A tilted gantry: slices shifted along their columns.
    tilted = STEPS.copy()
    tilted[:, 2] += STEPS[:, 1] * 0.4
    slices("dicom_tilted", ExplicitVRLittleEndian, tilted)
    for name, syntax, pack in compressions():
        slices(f"dicom_{name}", syntax, STEPS, pack=pack)
    for archive in ("dicom_zip",):
        shutil.make_archive(str(folder / archive), "zip", folder / "dicom_explicit")
        facts[archive + ".zip"] = {"marks": marks(STEPS)}

    # Enhanced CT: one file, positions and orientation in functional groups, frames upside down.
    d = dataset(1, ExplicitVRLittleEndian)
    d.SOPClassUID = d.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2.1"
    unit = STEPS / np.linalg.norm(STEPS, axis=0)
    shared, measures, orientation, values = Dataset(), Dataset(), Dataset(), Dataset()
    measures.PixelSpacing = text([SPACING[1], SPACING[0]])
    measures.SliceThickness = "9"
    orientation.ImageOrientationPatient = text([*unit[:, 0], *unit[:, 1]])
    values.RescaleSlope, values.RescaleIntercept = "1", "0"
    values.RescaleType = "HU"
    shared.PixelMeasuresSequence = Sequence([measures])
    shared.PlaneOrientationSequence = Sequence([orientation])
    shared.PixelValueTransformationSequence = Sequence([values])
    d.SharedFunctionalGroupsSequence = Sequence([shared])
    frames = []
    for k in (2, 1, 0):
        frame, position = Dataset(), Dataset()
        position.ImagePositionPatient = text(ORIGIN + STEPS[:, 2] * k)
        frame.PlanePositionSequence = Sequence([position])
        frames.append(frame)
    d.PerFrameFunctionalGroupsSequence = Sequence(frames)
    d.NumberOfFrames = 3
    del d.RescaleSlope, d.RescaleIntercept
    image_of(d, np.ascontiguousarray(field().transpose(2, 1, 0)[::-1].astype("<i2")))
    save(d, folder / "dicom_enhanced.dcm")
    facts["dicom_enhanced.dcm"] = {"marks": marks(STEPS)}


def codecs():
    """Compressed images beside `plain.dcm`, which holds what they must decode to."""
    import imagecodecs
    from pydicom import dcmread
    from pydicom.encaps import encapsulate
    from pydicom.uid import ExplicitVRLittleEndian

    target = folder / "codecs"
    shutil.rmtree(target, ignore_errors=True)
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:37, 0:53]
    smooth = 900 + 800 * np.sin(x / 9) * np.cos(y / 7) + rng.normal(0, 12, x.shape)
    smooth[:12, 20:] = 100
    smooth[30:, :] = 4000 * (rng.random((7, 53)) < 0.02)
    images = {
        "u12": (np.clip(smooth, 0, 4095).astype("<u2"), 12, 0),
        "s16": ((smooth * 7 - 9000).astype("<i2"), 16, 1),
        "u8": (np.clip(smooth / 16, 0, 255).astype("u1"), 8, 0),
    }

    def write(name, uid, pixels, bits, signed, packed=None):
        d = dataset(1, uid)
        image_of(d, pixels)
        d.BitsAllocated, d.BitsStored, d.HighBit = 8 if bits == 8 else 16, bits, bits - 1
        d.PixelRepresentation = signed
        if bits == 8:
            d["PixelData"].VR = "OB"
        if packed is not None:
            d.PixelData = encapsulate([bytes(packed)])
            d["PixelData"].VR = "OB"
            d["PixelData"].is_undefined_length = True
        save(d, target / name)

    for kind, (pixels, bits, signed) in images.items():
        plain = f"{kind}_plain.dcm"
        write(plain, ExplicitVRLittleEndian, pixels, bits, signed)
        bare = pixels.view("u2") & ((1 << bits) - 1) if bits > 8 else pixels
        d = dcmread(target / plain)
        d.compress("1.2.840.10008.1.2.5")
        save(d, target / f"{kind}_rle.dcm")
        write(
            f"{kind}_jpegls.dcm",
            "1.2.840.10008.1.2.4.80",
            pixels,
            bits,
            signed,
            imagecodecs.jpegls_encode(bare, level=0),
        )
        write(
            f"{kind}_jpeg2000.dcm",
            "1.2.840.10008.1.2.4.90",
            pixels,
            bits,
            signed,
            imagecodecs.jpeg2k_encode(
                pixels, level=0, reversible=True, codecformat="J2K", bitspersample=bits
            ),
        )
        write(
            f"{kind}_jpeg_lossless.dcm",
            "1.2.840.10008.1.2.4.70",
            pixels,
            bits,
            signed,
            imagecodecs.ljpeg_encode(bare, bitspersample=bits),
        )
    # Lossy ones: what independent decoders make of them.
    u8, u12 = images["u8"][0], images["u12"][0]
    baseline = imagecodecs.jpeg8_encode(u8, level=90)
    write("lossy_jpeg.dcm", "1.2.840.10008.1.2.4.50", u8, 8, 0, baseline)
    write("lossy_jpeg_plain.dcm", ExplicitVRLittleEndian, imagecodecs.jpeg8_decode(baseline), 8, 0)
    near = imagecodecs.jpegls_encode(u12, level=3)
    write("lossy_jpegls.dcm", "1.2.840.10008.1.2.4.81", u12, 12, 0, near)
    write("lossy_jpegls_plain.dcm", ExplicitVRLittleEndian, imagecodecs.jpegls_decode(near), 12, 0)
    lossy = imagecodecs.jpeg2k_encode(u12, level=40, codecformat="J2K", bitspersample=12)
    write("lossy_jpeg2000.dcm", "1.2.840.10008.1.2.4.91", u12, 12, 0, lossy)
    write(
        "lossy_jpeg2000_plain.dcm",
        ExplicitVRLittleEndian,
        imagecodecs.jpeg2k_decode(lossy).astype("<u2"),
        12,
        0,
    )


def tiff():
    import tifffile

    pages = np.ascontiguousarray(field("uint16").transpose(2, 1, 0))
    diagonal = {"marks": marks(np.diag(SPACING), oriented=False, scale=1e-6)}
    ome = {
        "axes": "ZYX",
        "PhysicalSizeX": 0.7,
        "PhysicalSizeXUnit": "µm",
        "PhysicalSizeY": 1.9,
        "PhysicalSizeYUnit": "µm",
        "PhysicalSizeZ": 3.1,
        "PhysicalSizeZUnit": "µm",
    }
    tifffile.imwrite(folder / "ome.ome.tif", pages, ome=True, metadata=ome, compression="zlib")
    tifffile.imwrite(folder / "ome_tiled.ome.tif", pages, ome=True, metadata=ome, tile=(16, 16))
    imagej = {"axes": "ZYX", "spacing": 3.1, "unit": "um"}
    resolution = (1 / 0.7, 1 / 1.9)
    tifffile.imwrite(
        folder / "imagej.tif", pages, imagej=True, metadata=imagej, resolution=resolution
    )
    tifffile.imwrite(
        folder / "big.ome.tif", pages.astype("f4"), ome=True, metadata=ome, byteorder=">", bigtiff=True
    )
    for name in ("ome.ome.tif", "ome_tiled.ome.tif", "imagej.tif", "big.ome.tif"):
        facts[name] = diagonal
    # Two channels; the marks are in the second.
    both = np.stack([np.zeros_like(pages), pages], axis=1)
    tifffile.imwrite(
        folder / "channels.ome.tif",
        both,
        ome=True,
        metadata={**ome, "axes": "ZCYX", "Channel": {"Name": ["empty", "marked"]}},
    )
    # Low values are to be bright, but are the same numbers: to tifffile as to ITK.
    tifffile.imwrite(folder / "white.tif", pages, photometric="miniswhite")
    assert (tifffile.imread(folder / "white.tif") == pages).all()
    facts["white.tif"] = {"marks": marks(np.eye(3), oriented=False)}
    facts["channels.ome.tif"] = {**diagonal, "choice": "marked"}


def raw():
    (folder / "sidecar.raw").write_bytes(b"head" + field(">f4").tobytes(order="F"))
    sidecar = {"dims": DIMS, "type": "f32", "endian": "big", "offset": 4, "spacing_mm": [0.7, 1.9, 3.1]}
    (folder / "sidecar.raw.json").write_text(json.dumps(sidecar))
    facts["sidecar.raw"] = {"marks": marks(np.diag(SPACING), oriented=False)}


def vdb():
    import pyopenvdb

    def grid(values, name):
        g = pyopenvdb.FloatGrid(-1.0)
        g.name = name
        g.copyFromArray(values, ijk=(-7, 20, 1000))
        # Row vectors: the steps are rows, the translation is the last one.
        matrix = np.eye(4)
        matrix[:3, :3] = STEPS.T
        matrix[3, :3] = ORIGIN
        g.transform = pyopenvdb.createLinearTransform(matrix.tolist())
        return g

    values = field("float32")
    marked = grid(values, "marked")
    other = grid(np.zeros_like(values), "other")
    half = grid(values, "marked")
    half.saveFloatAsHalf = True
    pyopenvdb.write(str(folder / "float.vdb"), [marked])
    pyopenvdb.write(str(folder / "half.vdb"), [half])
    pyopenvdb.write(str(folder / "several.vdb"), [other, marked])
    for name in ("float.vdb", "half.vdb", "several.vdb"):
        facts[name] = {"marks": marks(STEPS, oriented=False, scale=1)}
    facts["several.vdb"]["choice"] = "marked"

    # ZIP and active-mask compression, one leaf.
    def string(text):
        return struct.pack("<I", len(text)) + text.encode()

    def packed(numbers):
        plain = np.asarray(numbers, "<f4").tobytes()
        small = zlib.compress(plain)
        # What doesn't shrink is stored as it is, with a negative length.
        return struct.pack("<q", len(small)) + small if len(small) < len(plain) else struct.pack("<q", -len(plain)) + plain

    def node(side, origin, size, first):
        """Masks of a node with one child, no tiles: which child holds the voxel `first`."""
        x, y, z = ((f - o) // size for f, o in zip(first, origin))
        child = np.zeros(side**3, bool)
        child[(x * side + y) * side + z] = True
        none = bytes(side**3 // 8)
        # No inactive values to tell; an empty block.
        return np.packbits(child, bitorder="little").tobytes() + none + b"\0" + packed([])

    first = (-7, 20, 1000)
    leaf = (-8, 16, 1000)
    active = np.zeros((8, 8, 8), bool)
    inside = tuple(slice(f - l, f - l + n) for f, l, n in zip(first, leaf, DIMS))
    active[inside] = True
    mask = np.packbits(active.ravel(), bitorder="little").tobytes()
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = STEPS.T, ORIGIN
    grid_bytes = struct.pack("<II", 1 | 2, 0) + string("AffineMap") + matrix.astype("<f8").tobytes()
    grid_bytes += struct.pack("<IfII", 1, -1.0, 0, 1) + struct.pack("<3i", -4096, 0, 0)
    grid_bytes += node(32, (-4096, 0, 0), 128, first) + node(16, (-128, 0, 896), 8, first) + mask
    blocks = mask + b"\0" + packed(field("float32")[:].ravel())
    head = b" BDV\0\0\0\0" + struct.pack("<IIIB", 224, 10, 0, 1) + b"b2a8f8a6-6c0e-4c34-9d6a-5d5e0c1f7a10" + struct.pack("<II", 0, 1)
    head += string("marked") + string("Tree_float_5_4_3") + string("")
    start = len(head) + 24
    head += struct.pack("<3q", start, start + len(grid_bytes), start + len(grid_bytes) + len(blocks))
    (folder / "zip.vdb").write_bytes(head + grid_bytes + blocks)
    again = pyopenvdb.read(str(folder / "zip.vdb"), "marked")
    read = np.zeros(DIMS, np.float32)
    again.copyToArray(read, ijk=first)
    assert (read == values).all() and again.background == -1.0
    assert again.evalActiveVoxelBoundingBox()[0] == first
    facts["zip.vdb"] = facts["float.vdb"]


if "--vdb" in sys.argv:
    vdb()
else:
    simple_itk()
    dicom()
    codecs()
    tiff()
    raw()
facts_path.write_text(json.dumps(facts, indent=1, sort_keys=True) + "\n")

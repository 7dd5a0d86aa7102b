#!/usr/bin/env python3
"""Renders a holovol scene with Mitsuba 3 and measures its speed and error.

Only scenes that Mitsuba's own grid volume expresses exactly: one volume inside its window,
sigma_t linear in s from 0, one albedo, no emission, no surface term, an environment map.
See README.md here for what is measured and how the conventions map.
"""

import argparse
import ctypes.util
import glob
import json
import math
import os
import platform
import re
import shlex
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path

# A module of this name would hide the package; this folder comes first on the path.
sys.path[:] = [p for p in sys.path if Path(p or ".").resolve() != Path(__file__).resolve().parent]

MIN_LLVM = 16
BLOCKS = 16
ENVIRONMENT_AXIS = 180.0  # degrees: our image centre looks along -z, Mitsuba's along +z
# Mitsuba restarts a ray that crossed the cube's face 9e-5 (1 + |position|) along the face's normal.
# In metres that is 0.1 mm, which moved oblique rays by 0.07 pixels; in millimetres it is 0.013 mm.
UNITS_PER_METRE = 1000.0


class Refused(Exception):
    """The scene or the machine is outside what this comparison can say."""


def point_drjit_at_llvm():
    """Dr.Jit takes the first libLLVM it finds, which on Debian 12 is too old."""
    if os.environ.get("DRJIT_LIBLLVM_PATH"):
        return
    found = {}
    for path in glob.glob("/usr/lib/*/libLLVM*.so*") + glob.glob("/usr/lib/llvm-*/lib/libLLVM*.so*"):
        version = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path)
        if version:
            found[int(version.group(1))] = path
    newest = max(found, default=0)
    if newest >= MIN_LLVM:
        os.environ["DRJIT_LIBLLVM_PATH"] = found[newest]
    elif not ctypes.util.find_library("LLVM"):
        raise Refused(
            f"needs a shared LLVM >= {MIN_LLVM}, newest here is {newest or 'none'}: "
            "apt-get install libllvm19 (or set DRJIT_LIBLLVM_PATH)"
        )


def read_volume(path):
    """Voxel values after the header's scale, indexed [z, y, x] with x the file's fastest axis."""
    import numpy as np

    if path.name.endswith((".nii", ".nii.gz")):
        import nibabel

        values = nibabel.load(path).dataobj[...]
    elif path.suffix in (".nrrd", ".nhdr"):
        import nrrd

        values, _ = nrrd.read(str(path), index_order="F")
    else:
        raise Refused(f"{path}: reads NIfTI and NRRD only")
    if values.ndim != 3:
        raise Refused(f"{path}: expected 3 axes, found {values.ndim}")
    return np.asarray(values, dtype=np.float64).T


def check_scene(scene):
    """Refuses what Mitsuba's grid volume, one phase function and one albedo cannot say."""
    points = scene["transfer_function"]["points"]
    first, last = points[0], points[-1]
    span = last["s"] - first["s"]
    if span <= 0 or (first["s"], first["sigma_t"]) != (0, 0) or last["s"] != 1:
        raise Refused("transfer_function: needs points from s = 0, sigma_t = 0 to s = 1")
    for i, point in enumerate(points):
        if point["albedo"] != first["albedo"]:
            raise Refused(f"transfer_function.points[{i}].albedo: differs from the first; only one can be expressed")
        if not math.isclose(point["sigma_t"], last["sigma_t"] * point["s"], rel_tol=1e-6):
            raise Refused(f"transfer_function.points[{i}].sigma_t: not on a line through s = 0")
        if any(point.get("emission", [0])):
            raise Refused(f"transfer_function.points[{i}].emission: not supported here")
    if scene.get("gradient_factor", 0.0) != 0.0:
        raise Refused("gradient_factor: Mitsuba has no gradient-blended surface term")
    if "path" not in scene["environment"]:
        raise Refused("environment.path: only environment maps are set up here")
    for key in ("volumes", "clip", "labels", "animation", "stereo"):
        if key in scene:
            raise Refused(f"{key}: not supported here")


def environment_bitmap(mi, path):
    """The map with 2H + 1 rows, on which Mitsuba's interpolation equals ours exactly.

    Ours has row j at v = (j + 1/2)/H, clamped beyond the outer rows; Mitsuba's row k lies at
    v = k/(rows - 1). With 2H + 1 rows each of our rows, each middle between two, and both
    poles are rows of Mitsuba's. Columns follow the same half-texel rule in both.
    """
    import numpy as np

    bitmap = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    rows = np.array(bitmap, dtype=np.float32)
    fine = np.empty((2 * rows.shape[0] + 1, *rows.shape[1:]), dtype=np.float32)
    fine[0], fine[-1] = rows[0], rows[-1]
    fine[1::2] = rows
    fine[2:-1:2] = 0.5 * (rows[:-1] + rows[1:])
    return mi.Bitmap(fine), float(rows.max())


def load_scene(mi, path, integrator):
    """Mitsuba's scene for ours, and facts about it for the report."""
    import numpy as np

    scene = json.loads(path.read_text())
    check_scene(scene)
    folder = path.parent

    volume = scene["volume"]
    if "world_from_unit_cube" not in volume:
        raise Refused("volume.world_from_unit_cube: must be given, headers are not interpreted here")
    values = read_volume(folder / volume["path"])
    lo, hi = volume.get("window", (values.min(), values.max()))
    s = (values - lo) / (hi - lo)
    if s.min() < 0 or s.max() > 1:
        raise Refused(
            f"volume.window: s runs over [{s.min():.3g}, {s.max():.3g}]; outside [0, 1] the transfer "
            "function bends, and clamping voxels before interpolation would give another field"
        )
    metres_to_units = np.diag([UNITS_PER_METRE] * 3 + [1.0])
    world_from_unit_cube = metres_to_units @ np.array(volume["world_from_unit_cube"], dtype=np.float64)
    unit_cube_from_shape = np.diag([0.5, 0.5, 0.5, 1.0])
    unit_cube_from_shape[:3, 3] = 0.5

    point = scene["transfer_function"]["points"][-1]
    camera = scene["camera"]
    eye, target = (list(UNITS_PER_METRE * np.array(camera[key], dtype=np.float64)) for key in ("eye", "target"))
    environment = scene["environment"]
    bitmap, peak = environment_bitmap(mi, folder / environment["path"])
    max_scatters = scene["integrator"]["max_scatters"]
    transform = mi.ScalarTransform4f

    loaded = mi.load_dict(
        {
            "type": "scene",
            "integrator": {
                "type": integrator,
                # Mitsuba counts segments that end in a collision or a light: one more than scatterings.
                "max_depth": -1 if max_scatters is None else max_scatters + 1,
                "rr_depth": 1_000_000 if max_scatters is not None else 5,
                "hide_emitters": True,
            },
            "sensor": {
                "type": "perspective",
                "fov": camera["fov_y_deg"],
                "fov_axis": "y",
                "near_clip": 1e-4 * UNITS_PER_METRE,
                "far_clip": 1e3 * UNITS_PER_METRE,
                "to_world": transform().look_at(eye, target, camera["up"]),
                "film": {
                    "type": "hdrfilm",
                    "width": camera["width"],
                    "height": camera["height"],
                    "pixel_format": "rgba",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent"},
            },
            "emitter": {
                "type": "envmap",
                "bitmap": bitmap,
                "scale": environment.get("scale", 1.0),
                "to_world": transform().rotate(
                    [0, 1, 0], environment.get("rotation_y_deg", 0.0) + ENVIRONMENT_AXIS
                ),
            },
            "volume": {
                "type": "cube",
                "to_world": transform(world_from_unit_cube @ unit_cube_from_shape),
                "bsdf": {"type": "null"},
                "interior": {
                    "type": "heterogeneous",
                    "sigma_t": {
                        "type": "gridvolume",
                        "grid": mi.VolumeGrid(s.astype(np.float32)[..., None]),
                        "to_world": transform(world_from_unit_cube),
                        "filter_type": "trilinear",
                        "wrap_mode": "clamp",
                    },
                    "albedo": {"type": "constvolume", "value": {"type": "rgb", "value": point["albedo"]}},
                    "scale": point["sigma_t"] / UNITS_PER_METRE,
                    "has_spectral_extinction": False,
                    "phase": {"type": "hg", "g": scene.get("phase_g", 0.0)},
                },
            },
        }
    )
    facts = {"voxels": list(values.shape[::-1]), "s_range": [float(s.min()), float(s.max())], "environment_peak": peak}
    return loaded, (camera["width"], camera["height"]), facts


def relmse(image, reference):
    import numpy as np

    a, b = image[..., :3].astype(np.float64), reference[..., :3].astype(np.float64)
    return float(np.mean((a - b) ** 2 / (b**2 + 0.01)))


def block_means(image):
    """Means over a grid of BLOCKS x BLOCKS blocks, RGBA."""
    height, width, channels = image.shape
    h, w = height // BLOCKS, width // BLOCKS
    cut = image[: h * BLOCKS, : w * BLOCKS].astype("float64")
    return cut.reshape(BLOCKS, h, BLOCKS, w, channels).mean(axis=(1, 3))


def agreement(images, reference, error, floor):
    """z-scores of the block means of all seeds together against the reference's.

    The reference's own block variance is not stored; it is taken as ours scaled by the two images'
    errors, since both come from unbiased samplers of the same scene.
    """
    import numpy as np

    mean = np.mean(images, axis=0)
    blocks = np.stack([block_means(image) for image in images])
    variance = blocks.var(axis=0, ddof=1)
    sigma = np.sqrt(variance * (1.0 / len(images) + floor / error))
    seen = sigma > 0
    z = (block_means(mean) - block_means(reference))[seen] / sigma[seen]
    own = error / len(images)
    return {
        "relmse_of_mean": relmse(mean, reference),
        "relmse_expected_of_mean": own + floor,
        "extrapolated_bias_relmse": relmse(mean, reference) - own - floor,
        "mean_rgb_ratio": (mean[..., :3].mean(axis=(0, 1)) / reference[..., :3].mean(axis=(0, 1))).tolist(),
        "mean_opacity_ratio": float(mean[..., 3].mean() / reference[..., 3].mean()),
        "block_z": {"count": int(z.size), "mean": float(z.mean()), "rms": float(np.sqrt(np.mean(z**2))), "max": float(np.abs(z).max())},
    }


def pool_seeds(images):
    """Per-render relMSE of independent seeds without any reference: from the variance between them."""
    import numpy as np

    stack = np.stack(images)[..., :3].astype(np.float64)
    return float(np.mean(stack.var(axis=0, ddof=1) / (stack.mean(axis=0) ** 2 + 0.01)))


def render(mi, dr, scene, spp, seed):
    """One finished image as an array, the seconds it took, and those that all threads spent on it."""
    import numpy as np

    start, cpu_start = time.perf_counter(), time.process_time()
    image = mi.render(scene, spp=spp, seed=seed)
    dr.eval(image)
    dr.sync_thread()
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    return np.array(image, dtype=np.float32), seconds, cpu_seconds


def cpu_name():
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:
            return re.search(r"model name\s*: (.*)", info.read()).group(1)
    except (OSError, AttributeError):
        return platform.processor() or "unknown"


def provenance():
    """When, of which commit, and how: what every report under docs/benchmarks opens with."""
    here = Path(__file__).resolve().parent
    described = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=12"]
    commit = subprocess.run(described, check=False, capture_output=True, text=True).stdout.strip()
    words = [Path(sys.argv[0]).name, *sys.argv[1:]]
    # An absolute path as seen from the checkout: a report names no machine's folders.
    words = [os.path.relpath(word, here.parent.parent) if word.startswith("/") else word for word in words]
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "commit": commit or "unknown",
        "command": shlex.join([f"bench/peers/{words[0]}", *words[1:]]),
    }


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="scene file; X.ref.exr and X.ref.json are looked for beside X.json")
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel of each render (default 64)")
    parser.add_argument("--seeds", type=int, default=3, help="timed renders, each with its own seed (default 3)")
    parser.add_argument("--seconds", type=float, help="render further seeds until this much time was measured")
    parser.add_argument("--first-seed", type=int, default=1, help="seed of the first timed render (default 1)")
    parser.add_argument("--integrator", choices=("volpath", "volpathmis"), default="volpath")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (default llvm_ad_rgb)")
    parser.add_argument("--threads", type=int, help="CPU threads (default: all)")
    parser.add_argument("--json", type=Path, help="write the results here as well as to stdout")
    parser.add_argument("--exr", type=Path, help="write the mean image here, 32-bit float RGBA")
    return parser.parse_args()


def main():
    args = parse_arguments()
    if args.spp < 1 or args.seeds < 1:
        raise Refused("--spp and --seeds must be at least 1")
    if not args.scene.is_file():
        raise Refused(f"{args.scene}: no such scene file")
    point_drjit_at_llvm()
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    if args.threads:
        dr.set_thread_count(args.threads)
    mi.set_variant(args.variant)
    mi.set_log_level(mi.LogLevel.Error)

    start = time.perf_counter()
    scene, (width, height), facts = load_scene(mi, args.scene, args.integrator)
    load_seconds = time.perf_counter() - start
    _, compile_seconds, _ = render(mi, dr, scene, args.spp, args.first_seed + 1_000_000)

    images, seconds, cpu_seconds = [], [], []
    while len(images) < args.seeds or (args.seconds and sum(seconds) < args.seconds):
        image, took, cpu_took = render(mi, dr, scene, args.spp, args.first_seed + len(images))
        images.append(image)
        seconds.append(took)
        cpu_seconds.append(cpu_took)
    mean = np.mean(images, axis=0)
    per_render = sum(seconds) / len(seconds)

    report = {
        **provenance(),
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "renderer": f"Mitsuba {mi.__version__} {args.variant} {args.integrator}",
        "scene": args.scene.stem,
        "cpu": cpu_name(),
        "threads": dr.thread_count(),
        "llvm": os.path.basename(os.environ.get("DRJIT_LIBLLVM_PATH", "")),
        **facts,
        "spp": args.spp,
        "seeds": len(images),
        "load_seconds": load_seconds,
        "first_render_seconds": compile_seconds,
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "seconds_per_render": per_render,
        "samples_per_second": width * height * args.spp / per_render,
        # What an idle machine would reach: on a busy one, wall time is others' time too.
        "samples_per_cpu_second": width * height * args.spp * len(images) / sum(cpu_seconds),
        "mean_rgb": mean[..., :3].mean(axis=(0, 1)).tolist(),
        "mean_opacity": float(mean[..., 3].mean()),
    }
    reference_path = args.scene.with_suffix(".ref.exr")
    floor_path = args.scene.with_suffix(".ref.json")
    if reference_path.is_file() and floor_path.is_file():
        reference = np.array(mi.Bitmap(str(reference_path)).convert(mi.Bitmap.PixelFormat.RGBA, mi.Struct.Type.Float32, False))
        floor = json.loads(floor_path.read_text())["error_floor_relmse"]
        error = float(np.mean([relmse(image, reference) for image in images])) - floor
        report |= {
            "reference_floor_relmse": floor,
            "relmse": error,
            "relmse_times_spp": error * args.spp,
            "efficiency": 1.0 / (error * per_render),
        }
        if len(images) > 1:
            report["relmse_from_seed_variance"] = pool_seeds(images)
            report["agreement"] = agreement(images, reference, error, floor)

    text = json.dumps(report, indent=2)
    print(text)
    if args.json:
        args.json.write_text(text + "\n")
    if args.exr:
        mi.Bitmap(mean).write(str(args.exr))


if __name__ == "__main__":
    try:
        main()
    except Refused as refusal:
        sys.exit(f"mitsuba.py: {refusal}")

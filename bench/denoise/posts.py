#!/usr/bin/env python3
"""Writes posts.nrrd and posts.json: what `holovol bench denoise` is also run on.

Four posts, a beam and a thin shell over a floor, hard edges and shadows a pixel wide, which took no
part in tuning the denoiser.

    bench/denoise/posts.py FOLDER PANORAMA.hdr
"""

import argparse
import json
import os
from pathlib import Path

SIDE = 128
# Middle (x, z) and radius, in sides of the cube.
POSTS = [(0.25, 0.3, 0.04), (0.7, 0.25, 0.025), (0.75, 0.7, 0.02), (0.35, 0.75, 0.015)]
# Middle and radius of a shell of two voxels.
SHELL = ((0.5, 0.35, 0.5), 0.15)


def is_full(x: float, y: float, z: float) -> bool:
    """Whether a place of the unit cube is in one of them."""
    if y < 0.1:
        return True
    if y < 0.85 and any((x - a) ** 2 + (z - b) ** 2 < r**2 for a, b, r in POSTS):
        return True
    if (y - 0.7) ** 2 + (z - 0.5) ** 2 < 0.02**2:
        return True
    middle, radius = SHELL
    distance = sum((a - b) ** 2 for a, b in zip((x, y, z), middle)) ** 0.5
    return abs(distance - radius) < 1 / SIDE


def main() -> None:
    """Writes both files into the folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("environment", type=Path, help="an HDR panorama with a sun")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    places = [(i + 0.5) / SIDE for i in range(SIDE)]
    voxels = bytes(255 * is_full(x, y, z) for z in places for y in places for x in places)
    header = f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: {SIDE} {SIDE} {SIDE}\nencoding: raw\n\n"
    (args.folder / "posts.nrrd").write_bytes(header.encode() + voxels)
    side = 0.2
    rows = [[side * (i == j) for j in range(3)] + [-0.5 * side] for i in range(3)]
    scene = {
        "version": 1,
        "volume": {
            "path": "posts.nrrd",
            "window": [0, 255],
            "world_from_unit_cube": [*rows, [0, 0, 0, 1]],
        },
        "transfer_function": {
            "points": [
                {"s": 0.3, "sigma_t": 0, "albedo": [0.8, 0.7, 0.6]},
                {"s": 0.7, "sigma_t": 1500, "albedo": [0.8, 0.7, 0.6]},
            ]
        },
        "phase_g": 0.2,
        "gradient_factor": 1.0,
        "environment": {
            "path": os.path.relpath(args.environment, args.folder),
            "rotation_y_deg": 0,
            "scale": 1,
        },
        "camera": {
            "eye": [0.25, 0.22, 0.42],
            "target": [0, -0.01, 0],
            "up": [0, 1, 0],
            "fov_y_deg": 28,
            "width": 256,
            "height": 256,
        },
        "integrator": {"max_scatters": 1},
    }
    (args.folder / "posts.json").write_text(json.dumps(scene, indent=1) + "\n")


if __name__ == "__main__":
    main()

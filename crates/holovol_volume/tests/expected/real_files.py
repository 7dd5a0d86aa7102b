"""Writes real_files.json: what nibabel and pynrrd say of the volumes in ../shared/data/volumes.

pip install nibabel pynrrd numpy; python real_files.py path/to/data/volumes
"""

import json
import pathlib
import sys

import nibabel
import nrrd
import numpy as np

folder = pathlib.Path(sys.argv[1])
PERCENTILES = [1, 50, 99, 99.9]
facts = {}
for name in sorted(p.name for p in folder.iterdir()):
    if name.endswith(".nii.gz"):
        image = nibabel.load(folder / name)
        values = np.asarray(image.dataobj)
        stored = np.asarray(image.dataobj.get_unscaled())
        affine = image.affine
        codes = "".join(nibabel.aff2axcodes(affine))
        spacing = np.linalg.norm(affine[:3, :3], axis=0)
    elif name.endswith((".nrrd", ".nhdr")):
        values, header = nrrd.read(str(folder / name))
        stored, codes = values, None
        affine = np.diag([*header["spacings"], 1.0])
        spacing = header["spacings"]
    else:
        continue
    rng = np.random.default_rng(1)
    indices = rng.integers(0, values.shape, (24, 3))
    facts[name] = {
        "dims": list(values.shape),
        "stored_type": stored.dtype.newbyteorder("=").name,
        "spacing_mm": [float(s) for s in spacing],
        "affine_mm": [[float(x) for x in row] for row in affine],
        "axis_codes": codes,
        "range": [float(values.min()), float(values.max())],
        "mean": float(values.mean(dtype=np.float64)),
        "percentiles": [[p, float(np.percentile(values, p))] for p in PERCENTILES],
        "voxels": [[*map(int, i), float(values[tuple(i)])] for i in indices],
    }
out = pathlib.Path(__file__).with_name("real_files.json")
out.write_text(json.dumps(facts, indent=1) + "\n")

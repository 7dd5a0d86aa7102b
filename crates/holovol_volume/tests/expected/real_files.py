"""Writes real_files.json: what other readers say of the volumes in ../shared/data/volumes.

nibabel (NIfTI), pynrrd (NRRD), pydicom (DICOM), NumPy (MetaImage's raw file); each compared here
with what SimpleITK says. The cloud is read by OpenVDB's own module and, with code of its own, by
the crate vdb-rs (vdb_rs/): every voxel, tiles filled, and the voxels' size must be the same.

pip install nibabel pynrrd numpy pydicom SimpleITK
python real_files.py path/to/data/volumes
(cd vdb_rs && cargo run --release -- path/to/cloud.vdb density) >cloud.f32
python real_files.py path/to/data/volumes --vdb cloud.f32     (an interpreter that has pyopenvdb)
"""

import json
import pathlib
import sys

import numpy as np

is_vdb = "--vdb" in sys.argv
if not is_vdb:
    import nibabel
    import nrrd
    import pydicom
    import SimpleITK as sitk

folder = pathlib.Path(sys.argv[1])
PERCENTILES = [1, 50, 99, 99.9]
out = pathlib.Path(__file__).with_name("real_files.json")
facts = json.loads(out.read_text()) if is_vdb else {}
RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def read_dicom(path):
    """Stored values, values, affine in RAS, from pydicom alone."""
    slices = [pydicom.dcmread(file) for file in path.iterdir()]
    row, column = np.array(slices[0].ImageOrientationPatient, float).reshape(2, 3)
    normal = np.cross(row, column)
    slices.sort(key=lambda s: np.dot(normal, np.array(s.ImagePositionPatient, float)))
    first, last = (np.array(slices[i].ImagePositionPatient, float) for i in (0, -1))
    affine = np.eye(4)
    affine[:3, 0] = row * float(slices[0].PixelSpacing[1])
    affine[:3, 1] = column * float(slices[0].PixelSpacing[0])
    affine[:3, 2] = (last - first) / (len(slices) - 1)
    affine[:3, 3] = first
    stored = np.stack([s.pixel_array for s in slices]).transpose(2, 1, 0)
    scaled = [
        s.pixel_array * float(s.RescaleSlope) + float(s.RescaleIntercept) for s in slices
    ]
    return stored, np.stack(scaled).transpose(2, 1, 0), RAS_FROM_LPS @ affine


def check_vdb_rs(path, low, values, voxel_size):
    """Whether vdb-rs sees the same active tiles and voxels, and nothing else."""
    numbers = np.fromfile(path, np.float32)
    assert (numbers[:3] == np.float32(voxel_size)).all(), numbers[:3]
    filled = np.zeros_like(values)
    for x, y, z, side, value in numbers[3:].reshape(-1, 5):
        x, y, z = (int(n) for n in np.array([x, y, z]) - low)
        side = int(side)
        assert min(x, y, z) >= 0 and (np.array([x, y, z]) + side <= values.shape).all()
        filled[x : x + side, y : y + side, z : z + side] = value
    assert (filled == values).all()


def read_itk(path):
    """Values and affine in RAS, from SimpleITK alone."""
    if path.is_dir():
        path = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(path))
        image = sitk.ReadImage(path)
    else:
        image = sitk.ReadImage(str(path))
    affine = np.eye(4)
    affine[:3, :3] = np.array(image.GetDirection()).reshape(3, 3) @ np.diag(image.GetSpacing())
    affine[:3, 3] = image.GetOrigin()
    return sitk.GetArrayFromImage(image).transpose(2, 1, 0), RAS_FROM_LPS @ affine


for name in sorted(p.name for p in folder.iterdir()):
    percentiles = PERCENTILES
    if is_vdb != name.endswith(".vdb"):
        continue
    if is_vdb:
        import pyopenvdb

        grid = pyopenvdb.read(str(folder / name), "density")
        low, high = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
        stored = values = np.zeros(high - low + 1, np.float32)
        grid.copyToArray(stored, ijk=tuple(map(int, low)))
        check_vdb_rs(sys.argv[3], low, values, grid.transform.voxelSize())
        spacing = np.array(grid.transform.voxelSize()) * 1e3
        affine, codes = np.diag([*spacing, 1.0]), None
        affine[:3, 3] = spacing * low
        # Between two floats NumPy interpolates.
        percentiles = []
    elif (folder / name).is_dir():
        stored, values, affine = read_dicom(folder / name)
        codes = "".join(nibabel.aff2axcodes(affine))
        spacing = np.linalg.norm(affine[:3, :3], axis=0)
    elif name.endswith(".mhd"):
        raw = np.fromfile(folder / name.replace(".mhd", ".raw"), "<u2")
        stored = values = raw.reshape((271, 193, 270), order="F")
        _, affine = read_itk(folder / name)
        codes = "".join(nibabel.aff2axcodes(affine))
        spacing = np.linalg.norm(affine[:3, :3], axis=0)
    elif name.endswith(".nii.gz"):
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
    if not is_vdb:
        itk_values, itk_affine = read_itk(folder / name)
        assert np.allclose(itk_values, values, rtol=1e-6, atol=1e-6), name
        if codes:
            assert np.allclose(itk_affine, affine, atol=1e-4), (name, itk_affine, affine)
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
        "percentiles": [[p, float(np.percentile(values, p))] for p in percentiles],
        "voxels": [[*map(int, i), float(values[tuple(i)])] for i in indices],
    }
out.write_text(json.dumps(facts, indent=1) + "\n")

"""Writes ../phantoms/* with nibabel and pynrrd, and phantoms.json: where their marks must appear.

The field is 0 but for three marked corners, not in a plane with the centre, so that no two ways of
placing it look alike. World:
metres, the volume's centre at the origin, the patient's left to +x, superior to +y, anterior to +z.

pip install nibabel pynrrd numpy; python phantoms.py
"""

import json
import pathlib

import nibabel
import nrrd
import numpy as np

here = pathlib.Path(__file__).parent
folder = here.parent / "phantoms"
folder.mkdir(exist_ok=True)

DIMS = (5, 4, 3)
MARKS = {101: (0, 0, 0), 102: (4, 0, 0), 103: (0, 3, 0)}


def field(dtype):
    values = np.zeros(DIMS, dtype)
    for mark, index in MARKS.items():
        values[index] = mark
    return values


def rotation(a, b, c):
    (ca, sa), (cb, sb), (cc, sc) = ((np.cos(t), np.sin(t)) for t in (a, b, c))
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return z @ y @ x


SPACING = np.diag([0.7, 1.9, 3.1])
OBLIQUE = rotation(0.3, -0.5, 0.8) @ SPACING
MIRRORED = OBLIQUE @ np.diag([1, 1, -1])
SHEARED = OBLIQUE @ np.array([[1, 0.2, 0], [0, 1, -0.1], [0, 0, 1]])


def affine(directions):
    matrix = np.eye(4)
    matrix[:3, :3] = directions
    matrix[:3, 3] = [-388.5, 81.25, 405.0]
    return matrix


facts = {}


def expect(name, directions_ras_mm, oriented=True):
    """Marks in the world, from the columns of directions in RAS and mm (NumPy, f64)."""
    centre = (np.array(DIMS) - 1) / 2
    marks = []
    for mark, index in MARKS.items():
        x, y, z = directions_ras_mm @ (np.array(index) - centre) * 1e-3
        marks.append([mark, *((-x, z, y) if oriented else (x, y, z))])
    codes = "".join(nibabel.aff2axcodes(affine(directions_ras_mm))) if oriented else None
    facts[name] = {"marks": marks, "axis_codes": codes}


def nifti(name, kind, directions, sform, qform, dtype="uint8", big_endian=False, xyzt=None):
    image = kind(field(dtype), affine(directions))
    if big_endian:
        header = kind.header_class(endianness=">")
        header.set_data_dtype(np.dtype(dtype).newbyteorder(">"))
        image = kind(field(dtype), affine(directions), header)
    image.set_sform(affine(directions) if sform else None, sform)
    image.set_qform(affine(directions) if qform else None, qform)
    if xyzt:
        image.header.set_xyzt_units(xyzt)
    nibabel.save(image, folder / name)
    again = nibabel.load(folder / name)
    assert again.get_data_dtype() == np.dtype(dtype).newbyteorder("><"[not big_endian])
    assert again.header.endianness == "><"[not big_endian]
    directions = again.affine[:3, :3]
    if not sform and not qform:
        expect(name, np.diag(again.header.get_zooms()[:3]), oriented=False)
    else:
        expect(name, directions * {None: 1, "meter": 1e3, "micron": 1e-3}[xyzt])


one, two = nibabel.Nifti1Image, nibabel.Nifti2Image
nifti("sform.nii", one, OBLIQUE, 2, 0)
nifti("sform_mirrored.nii.gz", one, MIRRORED, 1, 1)
nifti("sform_sheared.nii", one, SHEARED, 4, 0, "float32")
nifti("qform.nii", one, OBLIQUE, 0, 1, "int16")
nifti("qform_mirrored_big.nii", one, MIRRORED, 0, 1, "uint16", big_endian=True)
nifti("nifti2_sform.nii.gz", two, OBLIQUE, 2, 1, "float64")
nifti("nifti2_qform_big.nii", two, MIRRORED, 0, 3, "int32", big_endian=True)
nifti("metres.nii", one, OBLIQUE * 1e-3, 1, 0, xyzt="meter")
nifti("microns.nii", one, OBLIQUE * 1e3, 1, 0, xyzt="micron")
nifti("no_orientation.nii", one, OBLIQUE, 0, 0)


def nrrd_file(name, directions, space, dtype="uint16", **header):
    """`directions` are in the frame of `space`, columns per axis."""
    header = {
        "space": space,
        "space directions": directions.T,
        "space origin": np.array([12.5, -3.0, 7.25]),
        **header,
    }
    nrrd.write(str(folder / name), field(dtype), header, detached_header=name.endswith("nhdr"))
    values, again = nrrd.read(str(folder / name))
    assert (values == field(dtype)).all()
    frame = {
        "right-anterior-superior": np.diag([1, 1, 1]),
        "left-posterior-superior": np.diag([-1, -1, 1]),
        "LPS": np.diag([-1, -1, 1]),
        "left-anterior-superior": np.diag([-1, 1, 1]),
    }[again["space"]]
    unit = {"mm": 1, "um": 1e-3}[again.get("space units", ["mm"])[0]]
    expect(name, frame @ again["space directions"].T * unit)


nrrd_file("lps_gzip.nrrd", OBLIQUE, "left-posterior-superior")
nrrd_file("lps_mirrored_raw.nrrd", MIRRORED, "LPS", encoding="raw", endian="big")
nrrd_file("ras_ascii.nrrd", SHEARED, "right-anterior-superior", "float32", encoding="ascii")
nrrd_file("las_detached.nhdr", OBLIQUE, "left-anterior-superior", "int16", encoding="raw")
nrrd_file(
    "ras_microns.nrrd",
    OBLIQUE * 1e3,
    "right-anterior-superior",
    **{"space units": ["um", "um", "um"]},
)

(here / "phantoms.json").write_text(json.dumps(facts, indent=1) + "\n")

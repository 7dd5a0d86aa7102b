"""Makes the seeds of small real files: a few voxels of scans whose licences allow it (the aorta:
Apache-2.0; the head and the tooth: MIT; the stent: public domain), phantoms, reference scenes.

pip install nibabel pynrrd numpy; python seeds.py path/to/shared
"""

import pathlib
import shutil
import sys

import nibabel
import nrrd
import numpy as np

here = pathlib.Path(__file__).parent
shared = pathlib.Path(sys.argv[1])
volumes = shared / "data/volumes"
for target in ("nifti", "nrrd", "metaimage", "dicom", "openvdb", "tiff", "archive", "scene"):
    (here / "seeds" / target).mkdir(parents=True, exist_ok=True)

SIDE = 6
for name in ("cta_thoracic_aorta", "mr_head_t1_seg3d"):
    path = volumes / f"{name}.nii.gz"
    image = nibabel.load(path)
    middle = tuple(slice(n // 2, n // 2 + SIDE) for n in image.shape)
    stored = np.asarray(image.dataobj.get_unscaled())[middle]
    for kind, end in ((nibabel.Nifti1Image, ".nii"), (nibabel.Nifti2Image, ".nii.gz")):
        part = kind(stored, image.affine)
        part.header.set_slope_inter(*image.header.get_slope_inter())
        nibabel.save(part, here / "seeds/nifti" / (name + end))

tooth, _ = nrrd.read(str(volumes / "tooth.nhdr"))
stent, header = nrrd.read(str(volumes / "stent_aorta_ct.nrrd"))
for name, field, space in (("tooth", tooth, False), ("stent", stent, True)):
    part = field[tuple(slice(n // 2, n // 2 + SIDE) for n in field.shape)]
    for encoding in ("raw", "gzip", "ascii"):
        header = {"encoding": encoding, "endian": "big" if encoding == "raw" else "little"}
        if space:
            header |= {
                "space": "left-posterior-superior",
                "space directions": np.diag([0.7, 0.7, 1.5]),
                "space origin": np.zeros(3),
                "space units": ["mm", "mm", "mm"],
                "kinds": ["domain"] * 3,
            }
        else:
            header |= {"spacings": [1, 1, 1]}
        nrrd.write(str(here / "seeds/nrrd" / f"{name}_{encoding}.nrrd"), part, header)

phantoms = here.parent / "crates/holovol_volume/tests/phantoms"
for path in (path for path in phantoms.iterdir() if path.is_file()):
    target = "nifti" if ".nii" in path.name else "nrrd"
    if path.suffix != ".raw":
        shutil.copy(path, here / "seeds" / target / f"phantom_{path.name}")

for path in (shared / "reference").glob("*.json"):
    if not path.name.endswith(".ref.json"):
        shutil.copy(path, here / "seeds/scene" / path.name)

# Phantoms of tests/expected/formats.py: one slice of each syntax, all codecs, all packings.
formats = phantoms / "formats"
seeds = here / "seeds"
for path in formats.iterdir():
    target = {
        ".mha": "metaimage",
        ".vdb": "openvdb",
        ".tif": "tiff",
        ".zip": "archive",
        ".dcm": "dicom",
        ".nrrd": "nrrd",
    }.get(path.suffix)
    if target:
        shutil.copy(path, seeds / target / f"phantom_{path.name}")
for path in [*formats.glob("dicom_*/0.dcm"), *formats.glob("codecs/*.dcm")]:
    if "plain" not in path.name:
        shutil.copy(path, seeds / "dicom" / f"{path.parent.name}_{path.name}")

# The bytes of scans: a corner of a thorax slice (CC BY 3.0, LIDC-IDRI) and of the mouse brain (BSD).
import pydicom  # noqa: E402

slice_ = pydicom.dcmread(volumes / "lidc-idri-0314_ct_thorax_dicom/000145.dcm")
pixels = slice_.pixel_array[250:262, 250:262].copy()
slice_.Rows, slice_.Columns = pixels.shape
slice_.PixelData = pixels.tobytes()
slice_.save_as(seeds / "dicom/thorax.dcm")
text = (volumes / "mouse_brain_microscopy.mhd").read_text()
text = text.replace("271 193 270", "6 6 6").replace("mouse_brain_microscopy.raw", "LOCAL")
with open(volumes / "mouse_brain_microscopy.raw", "rb") as file:
    file.seek(2 * (130 + 271 * (90 + 193 * 130)))
    (seeds / "metaimage/mouse.mha").write_bytes(text.encode() + file.read(6 * 6 * 6 * 2))

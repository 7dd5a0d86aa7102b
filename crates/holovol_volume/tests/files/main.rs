//! Volumes from files: every header feature, real files, and damage.

mod bytes;
mod changing;
mod damaged;
mod dicom;
mod formats;
mod many;
mod nifti;
mod nrrd;
mod open;
mod phantoms;
mod real;
mod writing;

//! DICOM files: elements, RLE, JPEG, JPEG-LS, JPEG 2000.

#![no_main]

use holovol_fuzz::read_volume;
use holovol_volume::DicomReader;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| read_volume(&DicomReader, bytes));

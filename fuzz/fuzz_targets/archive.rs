//! ZIP archives of DICOM, or of one volume file.

#![no_main]

use holovol_fuzz::read_volume;
use holovol_volume::ZipReader;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| read_volume(&ZipReader, bytes));

//! NRRD with attached data.

#![no_main]

use holovol_fuzz::read_volume;
use holovol_volume::NrrdReader;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| read_volume(&NrrdReader, bytes));

//! NIfTI-1 and NIfTI-2, plain or packed.

#![no_main]

use holovol_fuzz::read_volume;
use holovol_volume::NiftiReader;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| read_volume(&NiftiReader, bytes));

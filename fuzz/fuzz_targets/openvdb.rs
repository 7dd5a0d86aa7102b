//! OpenVDB.

#![no_main]

use holovol_fuzz::read_volume;
use holovol_volume::VdbReader;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| read_volume(&VdbReader, bytes));

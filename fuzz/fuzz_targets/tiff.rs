//! TIFF, OME-TIFF and ImageJ stacks.

#![no_main]

use holovol_fuzz::read_volume;
use holovol_volume::TiffReader;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| read_volume(&TiffReader, bytes));

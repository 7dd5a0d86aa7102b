//! MetaImage with its data after the header.

#![no_main]

use holovol_fuzz::read_volume;
use holovol_volume::MetaImageReader;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| read_volume(&MetaImageReader, bytes));

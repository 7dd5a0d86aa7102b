//! Whether a JPEG is whole: decoders show what there is of one that breaks off, and fill the rest.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Every JPEG begins so.
const START: [u8; 2] = [0xff, 0xd8];
/// The marker that comes before the picture itself, and the one that ends a file.
const SCAN: u8 = 0xda;
const END: [u8; 2] = [0xff, 0xd9];

/// What is wrong with a JPEG's data; `None` for whole ones, for other files, and where the header
/// is such that a decoder should have the say.
pub(super) fn flaw(bytes: &[u8]) -> Option<String> {
    let scan = scan(bytes)?;
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX);
    let mut strict = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    strict.decode_headers().ok()?;
    if let Err(error) = strict.decode() {
        return Some(error.to_string());
    }
    let ends = bytes[scan..].windows(2).any(|pair| pair == END);
    (!ends).then(|| "it has no end marker".into())
}

/// Where a JPEG's first scan begins: behind its segments, one of which may hold a thumbnail.
fn scan(bytes: &[u8]) -> Option<usize> {
    let mut at = bytes.starts_with(&START).then_some(START.len())?;
    loop {
        let &[0xff, marker, high, low] = bytes.get(at..)?.first_chunk()? else {
            return None;
        };
        if marker == SCAN {
            return Some(at);
        }
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
    }
}

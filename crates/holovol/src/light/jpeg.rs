//! Whether a JPEG is whole, since decoders show what there is of one that breaks off and fill the
//! rest; and what of it had clipped before it was coded.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Every JPEG begins so.
const START: [u8; 2] = [0xff, 0xd8];
/// The marker that comes before the picture itself, and the one that ends a file.
const SCAN: u8 = 0xda;
const END: [u8; 2] = [0xff, 0xd9];

/// Codes from here on, 0 … 1, had clipped: a coder's ringing takes some of what is below 253.
const CLIPPED: f32 = 249.0 / 255.0;

/// Whether a file is a JPEG.
pub(super) fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&START)
}

/// Sets codes that had clipped to 1: colour is coded at half the resolution, so that brightness
/// alone tells of a light of few pixels.
pub(super) fn restore_clipped(texel: &mut [f32; 3]) {
    let luma = 0.299 * texel[0] + 0.587 * texel[1] + 0.114 * texel[2];
    let is_white = luma >= CLIPPED;
    for code in texel {
        if is_white || *code >= CLIPPED {
            *code = 1.0;
        }
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_coding_took_of_white_is_restored_and_colours_stay() {
        let restored = |codes: [u8; 3]| {
            let mut texel = codes.map(|code| f32::from(code) / 255.0);
            restore_clipped(&mut texel);
            texel.map(|code| (255.0 * code).round() as u8)
        };
        // A white light of one pixel whose colour is its surroundings' by half.
        assert_eq!(restored([255, 251, 227]), [255; 3]);
        assert_eq!(restored([250, 249, 252]), [255; 3]);
        assert_eq!(restored([251, 180, 60]), [255, 180, 60]);
        assert_eq!(restored([248, 248, 248]), [248; 3]);
    }
}

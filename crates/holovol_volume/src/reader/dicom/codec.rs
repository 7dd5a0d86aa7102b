//! From a frame's compressed bytes to its numbers.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::header::Pixels;
use super::syntax::Codec;
use super::{jpeg_ls, rle};

/// The numbers of a frame, before masking.
pub(super) enum Numbers {
    /// As in an uncompressed file, little-endian.
    Bytes(Vec<u8>),
    Words(Vec<u16>),
}

/// JPEG 2000 says in a few bytes that a tile is empty: pixels that need no bytes, and those that a
/// byte may stand for beyond.
const JPEG_2000_FREE: u64 = 4 << 20;
const JPEG_2000_RATIO: u64 = 1024;

/// How many pixels so many bytes may hold at most.
pub(super) fn most_pixels(codec: Codec, pixels: &Pixels, bytes: u64) -> u64 {
    match codec {
        // What is in a file is counted when the header is read.
        Codec::Native => u64::MAX,
        // A run of 128 takes two bytes.
        Codec::Rle => bytes.saturating_mul(64) / u64::from(pixels.bits_allocated / 8).max(1),
        // Two bits for a block of 8 × 8.
        Codec::Jpeg => bytes.saturating_mul(256),
        // A bit for a line, or for 32768 of its pixels.
        Codec::JpegLs => bytes
            .saturating_mul(8)
            .saturating_mul(u64::from(pixels.columns).min(1 << 15)),
        Codec::Jpeg2000 => bytes
            .saturating_mul(JPEG_2000_RATIO)
            .saturating_add(JPEG_2000_FREE),
    }
}

/// Decodes a frame. `Err` says what is wrong with it.
pub(super) fn decode(codec: Codec, bytes: &[u8], pixels: &Pixels) -> Result<Numbers, String> {
    let count = pixels.count() as usize;
    if pixels.float || pixels.bits_allocated > 16 && codec != Codec::Rle {
        return Err("numbers of this type are never compressed so".into());
    }
    match codec {
        Codec::Native => Ok(Numbers::Bytes(bytes.to_vec())),
        Codec::Rle => rle::decode(bytes, count, usize::from(pixels.bits_allocated / 8))
            .map(Numbers::Bytes)
            .map_err(str::to_owned),
        Codec::JpegLs => jpeg_ls::decode(bytes, pixels.columns.into(), pixels.rows.into())
            .map(|image| {
                debug_assert!(image.precision <= 16);
                Numbers::Words(image.samples)
            })
            .map_err(str::to_owned),
        // The decoders are others' work: what they didn't expect must not end the program.
        Codec::Jpeg => guarded(|| jpeg(bytes, pixels)),
        Codec::Jpeg2000 => guarded(|| jpeg_2000(bytes, pixels)),
    }
}

fn guarded(decode: impl FnOnce() -> Result<Numbers, String>) -> Result<Numbers, String> {
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| Err("its decoder failed".into()))
}

fn jpeg(bytes: &[u8], pixels: &Pixels) -> Result<Numbers, String> {
    let mut decoder = jpeg_decoder::Decoder::new(bytes);
    decoder.set_max_decoding_buffer_size(pixels.count() as usize * 2);
    decoder.read_info().map_err(|error| error.to_string())?;
    let info = decoder.info().ok_or("it has no frame header")?;
    if (info.width, info.height) != (pixels.columns, pixels.rows) {
        return Err(format!(
            "it has {} × {} pixels, not {} × {}",
            info.width, info.height, pixels.columns, pixels.rows
        ));
    }
    // A pixel takes a bit at least; of 8 × 8 blocks, two bits in 64.
    let lossless = matches!(info.pixel_format, jpeg_decoder::PixelFormat::L16);
    if pixels.count() > (bytes.len() as u64).saturating_mul(if lossless { 8 } else { 256 }) {
        return Err("it is too short for its pixels".into());
    }
    let decoded = decoder.decode().map_err(|error| error.to_string())?;
    match info.pixel_format {
        jpeg_decoder::PixelFormat::L8 => {
            Ok(Numbers::Words(decoded.into_iter().map(u16::from).collect()))
        }
        // In the machine's byte order.
        jpeg_decoder::PixelFormat::L16 => Ok(Numbers::Words(
            decoded
                .as_chunks::<2>()
                .0
                .iter()
                .map(|&pair| u16::from_ne_bytes(pair))
                .collect(),
        )),
        _ => Err("it is in colour".into()),
    }
}

fn jpeg_2000(bytes: &[u8], pixels: &Pixels) -> Result<Numbers, String> {
    let size = Jpeg2000Size::find(bytes).ok_or("its size segment is missing")?;
    if size.components != 1 {
        return Err("it is in colour".into());
    }
    if (size.width, size.height) != (pixels.columns.into(), pixels.rows.into()) {
        return Err(format!(
            "it has {} × {} pixels, not {} × {}",
            size.width, size.height, pixels.columns, pixels.rows
        ));
    }
    if size.precision > 16 {
        return Err(format!("its numbers have {} bits", size.precision));
    }
    let settings = hayro_jpeg2000::DecodeSettings {
        resolve_palette_indices: false,
        strict: true,
        target_resolution: None,
    };
    let image = hayro_jpeg2000::Image::new(bytes, &settings).map_err(|e| e.to_string())?;
    let mut context = hayro_jpeg2000::DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(|e| e.to_string())?;
    let [component] = decoded.components() else {
        return Err("it is in colour".into());
    };
    // The crate takes all numbers for unsigned ones and adds half their range.
    let half = 1i32 << (size.precision - 1);
    let (offset, low, high) = if size.signed {
        (half, -half, half - 1)
    } else {
        (0, 0, 2 * half - 1)
    };
    let number = |&sample: &f32| (sample.round() as i32 - offset).clamp(low, high) as u16;
    Ok(Numbers::Words(
        component.samples().iter().map(number).collect(),
    ))
}

/// What the SIZ segment of a codestream says.
struct Jpeg2000Size {
    width: u32,
    height: u32,
    components: u16,
    precision: u8,
    signed: bool,
}

impl Jpeg2000Size {
    /// In a bare codestream the segment comes first; in a JP2 file after some boxes.
    fn find(bytes: &[u8]) -> Option<Self> {
        let start = bytes
            .windows(4)
            .take(4096)
            .position(|window| window == [0xff, 0x4f, 0xff, 0x51])?;
        let segment = bytes.get(start + 4..)?;
        let word = |at: usize| {
            let bytes = segment.get(at..)?.first_chunk()?;
            Some(u32::from_be_bytes(*bytes))
        };
        let depth = *segment.get(38)?;
        Some(Self {
            width: word(4)?.checked_sub(word(12)?)?,
            height: word(8)?.checked_sub(word(16)?)?,
            components: u16::from_be_bytes(*segment.get(36..)?.first_chunk()?),
            precision: (depth & 0x7f) + 1,
            signed: depth & 0x80 != 0,
        })
    }
}

//! Blosc 1 chunks, as OpenVDB writes them: LZ4 or zlib, bytes shuffled or not.
//!
//! Own code: the crates are bindings to the C library. LZ4 itself is `lz4_flex`'s.

use std::io::Read;

use flate2::read::ZlibDecoder;

const HEADER_BYTES: usize = 16;

/// Flags of the header.
const SHUFFLED: u8 = 1;
const COPIED: u8 = 2;
const BIT_SHUFFLED: u8 = 4;
const NOT_SPLIT: u8 = 0x10;

/// A block is split into one stream per byte of its numbers if these have at most so many bytes
/// and each stream would have at least so many.
const SPLITS_MAX: usize = 16;
const SPLIT_BYTES_MIN: usize = 128;

/// Unpacks a chunk that must give `length` bytes.
pub(super) fn decompress(chunk: &[u8], length: usize) -> Result<Vec<u8>, String> {
    let word = |at: usize| {
        let bytes = chunk.get(at..).and_then(|rest| rest.first_chunk());
        bytes.map(|bytes| u32::from_le_bytes(*bytes) as usize)
    };
    let Some(&[_, _, flags, type_size]) = chunk.first_chunk() else {
        return Err("no header".into());
    };
    let (Some(bytes), Some(block_size)) = (word(4), word(8)) else {
        return Err("no header".into());
    };
    if bytes != length {
        return Err(format!("{bytes} bytes instead of {length}"));
    }
    if flags & BIT_SHUFFLED != 0 {
        return Err("shuffled by bits, which OpenVDB does not do".into());
    }
    let content = chunk.get(HEADER_BYTES..).ok_or("no header")?;
    if flags & COPIED != 0 {
        return content.get(..length).map(Vec::from).ok_or("cut off".into());
    }
    if block_size == 0 || block_size > length.max(1) {
        return Err(format!("blocks of {block_size} bytes"));
    }
    let type_size = usize::from(type_size).max(1);
    let mut unpacked = vec![0; length];
    let mut block = vec![0; block_size];
    for (index, out) in unpacked.chunks_mut(block_size).enumerate() {
        let mut at = word(HEADER_BYTES + 4 * index).ok_or("cut off")?;
        let is_whole = out.len() == block_size;
        let is_split = flags & NOT_SPLIT == 0
            && type_size <= SPLITS_MAX
            && block_size / type_size >= SPLIT_BYTES_MIN
            && is_whole;
        let splits = if is_split { type_size } else { 1 };
        let block = block.get_mut(..out.len()).ok_or("a block is too long")?;
        if out.len() % splits != 0 {
            return Err("blocks that can't be split".into());
        }
        for stream in block.chunks_mut(out.len() / splits) {
            let packed = word(at).ok_or("cut off")?;
            let packed = chunk
                .get(at + 4..)
                .and_then(|rest| rest.get(..packed))
                .ok_or("cut off")?;
            at += 4 + packed.len();
            if packed.len() == stream.len() {
                stream.copy_from_slice(packed);
            } else {
                unpack(flags >> 5, packed, stream)?;
            }
        }
        if flags & SHUFFLED != 0 && type_size > 1 {
            unshuffle(block, type_size, out);
        } else {
            out.copy_from_slice(block);
        }
    }
    Ok(unpacked)
}

fn unpack(codec: u8, packed: &[u8], out: &mut [u8]) -> Result<(), String> {
    let count = match codec {
        1 => lz4_flex::block::decompress_into(packed, out).map_err(|error| error.to_string())?,
        3 => {
            let mut decoder = ZlibDecoder::new(packed);
            decoder.read_exact(out).map_err(|error| error.to_string())?;
            out.len()
        }
        0 => return Err("packed with BloscLZ, which OpenVDB does not do".into()),
        other => {
            return Err(format!(
                "packed with codec {other}, which OpenVDB does not do"
            ));
        }
    };
    if count == out.len() {
        Ok(())
    } else {
        Err(format!("a block of {count} bytes instead of {}", out.len()))
    }
}

/// First bytes of all numbers, then second ones: back to numbers. What is left over is as it was.
fn unshuffle(block: &[u8], type_size: usize, out: &mut [u8]) {
    let numbers = block.len() / type_size;
    let whole = numbers * type_size;
    for (byte, plane) in block
        .chunks_exact(numbers.max(1))
        .take(type_size)
        .enumerate()
    {
        for (to, from) in out.iter_mut().skip(byte).step_by(type_size).zip(plane) {
            *to = *from;
        }
    }
    for (to, from) in out.iter_mut().zip(block).skip(whole) {
        *to = *from;
    }
}

//! OpenEXR pictures: the first flat layer with R, G and B at full resolution.

use std::io::{BufRead, Seek};

use exr::block::UncompressedBlock;
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock, CompressedTileBlock};
use exr::block::lines::LineRef;
use exr::block::reader::ChunksReader;
use exr::compression::Compression;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::f16;

use super::{DecodeError, check_size};

/// Bytes per pixel of a layer: bounds what one block of it can take.
const MAX_PIXEL_BYTES: usize = 128;

/// Width, height and row-major texels, top row first. `file_len` is the file's length in bytes.
pub(super) fn read(
    reader: impl BufRead + Seek,
    file_len: u64,
) -> Result<(usize, usize, Vec<[f32; 3]>), DecodeError> {
    let reader = exr::block::read(reader, false)?;
    // Each block has its place in a table of 8-byte offsets: a file can't have more than fit.
    let blocks = reader
        .headers()
        .iter()
        .map(|header| header.chunk_count as u64);
    if blocks.fold(0, u64::saturating_add) > file_len / 8 {
        return Err("the file is shorter than its own table of blocks".into());
    }
    let (layer, channels) = find_rgb(reader.headers())?;
    let header = reader.headers().get(layer).ok_or("no layer")?.clone();
    let (width, height) = (header.layer_size.0, header.layer_size.1);
    check_size(width, height)?;
    let display = header.shared_attributes.display_window.size;
    if display != header.layer_size {
        return Err(format!(
            "the data window ({width} × {height}) is not the display window ({} × {}); save it uncropped",
            display.0, display.1
        )
        .into());
    }
    // The crate's B44 decoder overflows on damaged blocks, and 4 bits of mantissa suit no light.
    if matches!(header.compression, Compression::B44 | Compression::B44A) {
        return Err("B44 compression is not read; save with ZIP, PIZ or RLE".into());
    }
    if header.channels.bytes_per_pixel > MAX_PIXEL_BYTES {
        return Err(format!(
            "the layer has {} bytes per pixel, expected at most {MAX_PIXEL_BYTES}; save R, G, B only",
            header.channels.bytes_per_pixel
        )
        .into());
    }

    // Rows are made as their blocks are decoded: a header alone allocates nothing.
    let mut rows: Vec<Vec<[f32; 3]>> = vec![Vec::new(); height];
    let mut pixels = 0;
    let chunks = reader.filter_chunks(false, |_, tile, block| {
        block.layer == layer && tile.level_index.0 == 0 && tile.level_index.1 == 0
    })?;
    let meta_data = chunks.meta_data().clone();
    for chunk in chunks {
        let chunk = chunk?;
        check_dwa(&chunk, &header)?;
        let block = UncompressedBlock::decompress_chunk(chunk, &meta_data, false)?;
        let area = block.index.pixel_size.area();
        if block.index.layer != layer || block.data.len() != area * header.channels.bytes_per_pixel
        {
            return Err("a block is not of the size that the header says".into());
        }
        for line in block.lines(&header.channels) {
            if let Some(channel) = channels.iter().position(|&c| c == line.location.channel) {
                let sample_type = header.channels.list[line.location.channel].sample_type;
                put_line(&mut rows, width, channel, sample_type, &line)?;
            }
        }
        pixels += area;
    }
    if pixels != width * height || rows.iter().any(Vec::is_empty) {
        return Err(format!("holds {pixels} pixels, expected {}", width * height).into());
    }
    Ok((width, height, rows.concat()))
}

/// Checks the sizes that a DWA block claims: the crate allocates them unseen.
fn check_dwa(chunk: &Chunk, header: &Header) -> Result<(), DecodeError> {
    /// Counters of sizes and counts at the head of a block, after its version.
    const SIZES: std::ops::Range<usize> = 1..10;
    if !matches!(
        header.compression,
        Compression::DWAA(_) | Compression::DWAB(_)
    ) {
        return Ok(());
    }
    let (CompressedBlock::ScanLine(CompressedScanLineBlock {
        compressed_pixels_le: bytes,
        ..
    })
    | CompressedBlock::Tile(CompressedTileBlock {
        compressed_pixels_le: bytes,
        ..
    })) = &chunk.compressed_block
    else {
        return Err("deep data".into());
    };
    let block_bytes = header.max_block_byte_size() as u64;
    // No part is larger than the whole, but for 8 × 8 blocks that reach over the border.
    let limit = block_bytes.saturating_mul(8).saturating_add(1 << 16);
    let (counters, _) = bytes.as_chunks::<8>();
    let mut sizes = counters.iter().take(SIZES.end).skip(SIZES.start);
    if sizes.any(|&size| u64::from_le_bytes(size) > limit) {
        return Err("a block claims more than a block can hold".into());
    }
    Ok(())
}

fn put_line(
    rows: &mut [Vec<[f32; 3]>],
    width: usize,
    channel: usize,
    sample_type: SampleType,
    line: &LineRef<'_>,
) -> Result<(), DecodeError> {
    let (x, y) = (line.location.position.0, line.location.position.1);
    let outside = "a block lies outside of the picture";
    let row = rows.get_mut(y).ok_or(outside)?;
    row.resize(width, [0.0; 3]);
    let span = row
        .get_mut(x..)
        .and_then(|rest| rest.get_mut(..line.location.sample_count))
        .ok_or(outside)?;
    match sample_type {
        SampleType::F16 => {
            for (texel, sample) in span.iter_mut().zip(line.read_samples::<f16>()) {
                texel[channel] = sample?.to_f32();
            }
        }
        SampleType::F32 => {
            for (texel, sample) in span.iter_mut().zip(line.read_samples::<f32>()) {
                texel[channel] = sample?;
            }
        }
        SampleType::U32 => {
            for (texel, sample) in span.iter_mut().zip(line.read_samples::<u32>()) {
                texel[channel] = sample? as f32;
            }
        }
    }
    Ok(())
}

/// The first layer with plain or prefixed (`diffuse.R`) channels R, G, B, and their indices.
fn find_rgb(headers: &[Header]) -> Result<(usize, [usize; 3]), DecodeError> {
    let usable = |header: &Header| {
        let whole = |channel: &exr::meta::attribute::ChannelDescription| {
            channel.sampling.0 == 1 && channel.sampling.1 == 1
        };
        !header.deep && header.channels.list.iter().all(whole)
    };
    for (layer, header) in headers.iter().enumerate().filter(|(_, h)| usable(h)) {
        let names: Vec<String> = header
            .channels
            .list
            .iter()
            .map(|channel| channel.name.to_string())
            .collect();
        let prefixes = names.iter().filter_map(|name| name.strip_suffix('R'));
        let mut prefixes: Vec<&str> = prefixes
            .filter(|prefix| prefix.is_empty() || prefix.ends_with('.'))
            .collect();
        prefixes.sort_by_key(|prefix| prefix.len());
        for prefix in prefixes {
            let find = |letter| names.iter().position(|n| *n == format!("{prefix}{letter}"));
            if let (Some(r), Some(g), Some(b)) = (find('R'), find('G'), find('B')) {
                return Ok((layer, [r, g, b]));
            }
        }
    }
    let names: Vec<String> = headers
        .iter()
        .flat_map(|header| header.channels.list.iter().map(|c| c.name.to_string()))
        .take(16)
        .collect();
    Err(format!(
        "no flat layer without subsampling has channels R, G and B; it has {}",
        names.join(", ")
    )
    .into())
}

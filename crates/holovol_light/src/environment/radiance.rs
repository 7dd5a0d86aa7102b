//! Radiance pictures (`.hdr`): RGBE pixels in run-length coded scanlines (Ward, Graphics Gems II).

use std::io::{BufRead, Read};

use super::{DecodeError, check_size};

/// Longest header line, and most header lines: far more than any writer needs.
const MAX_LINE: u64 = 64 * 1024;
const MAX_LINES: usize = 4096;

/// Width, height and row-major texels, top row first, divided by `EXPOSURE` and `COLORCORR`.
pub(super) fn read(mut reader: impl BufRead) -> Result<(usize, usize, Vec<[f32; 3]>), DecodeError> {
    let divisor = read_header(&mut reader)?;
    let (width, height, bottom_up, right_to_left) = parse_resolution(&read_line(&mut reader)?)?;
    check_size(width, height)?;
    // Rows join as they are decoded: a header alone allocates nothing.
    let mut texels = Vec::new();
    let mut scanline = Vec::new();
    for row in 0..height {
        read_scanline(&mut reader, width, &mut scanline).map_err(|reason| {
            DecodeError::Reason(format!("scanline {row} of {height}: {reason}"))
        })?;
        texels.extend(scanline.iter().map(|&rgbe| decode(rgbe, divisor)));
    }
    if right_to_left {
        texels.chunks_mut(width).for_each(<[_]>::reverse);
    }
    if bottom_up {
        texels = texels.rchunks(width).flatten().copied().collect();
    }
    Ok((width, height, texels))
}

fn decode([r, g, b, exponent]: [u8; 4], divisor: [f64; 3]) -> [f32; 3] {
    if exponent == 0 {
        return [0.0; 3];
    }
    let scale = f64::exp2(f64::from(exponent) - (128.0 + 8.0));
    let [r, g, b] = [r, g, b].map(|mantissa| f64::from(mantissa) * scale);
    [r / divisor[0], g / divisor[1], b / divisor[2]].map(|c| c as f32)
}

/// Reads up to the blank line; gives what pixels are to be divided by.
fn read_header(reader: &mut impl BufRead) -> Result<[f64; 3], DecodeError> {
    let magic = read_line(reader)?;
    if !magic.starts_with("#?") {
        return Err("the first line is not `#?RADIANCE`".into());
    }
    let mut divisor = [1.0; 3];
    for _ in 0..MAX_LINES {
        let line = read_line(reader)?;
        if line.is_empty() {
            return if divisor.iter().all(|d: &f64| d.is_normal() && *d > 0.0) {
                Ok(divisor)
            } else {
                Err(format!(
                    "EXPOSURE and COLORCORR multiply to {divisor:?}, expected positive numbers"
                )
                .into())
            };
        }
        // Comments, a second `#?RADIANCE`, commands, and variables that don't change pixels.
        let Some((name, value)) = line.split_once('=').filter(|_| !line.starts_with('#')) else {
            continue;
        };
        let numbers = || -> Result<Vec<f64>, DecodeError> {
            value
                .split_whitespace()
                .map(|word| {
                    word.parse::<f64>()
                        .map_err(|_| format!("{name} holds `{word}`, expected a number").into())
                })
                .collect()
        };
        match name.trim() {
            "FORMAT" if value.trim() != "32-bit_rle_rgbe" => {
                return Err(
                    format!("FORMAT is `{}`, expected `32-bit_rle_rgbe`", value.trim()).into(),
                );
            }
            // Both may occur repeatedly; each use multiplies.
            "EXPOSURE" => match numbers()?.as_slice() {
                &[exposure] => divisor = divisor.map(|d| d * exposure),
                _ => return Err("EXPOSURE holds not just one number".into()),
            },
            "COLORCORR" => match numbers()?.as_slice() {
                &[r, g, b] => divisor = [divisor[0] * r, divisor[1] * g, divisor[2] * b],
                _ => return Err("COLORCORR holds not just three numbers".into()),
            },
            _ => {}
        }
    }
    Err(format!("the header has no end within {MAX_LINES} lines").into())
}

fn read_line(reader: &mut impl BufRead) -> Result<String, DecodeError> {
    let mut line = Vec::new();
    reader.take(MAX_LINE).read_until(b'\n', &mut line)?;
    if line.pop() != Some(b'\n') {
        return Err("the header breaks off".into());
    }
    if line.last() == Some(&b'\r') {
        line.pop();
    }
    Ok(String::from_utf8_lossy(&line).into_owned())
}

/// Width, height, bottom row first, right column first from a line such as `-Y 512 +X 1024`.
fn parse_resolution(line: &str) -> Result<(usize, usize, bool, bool), DecodeError> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let unreadable = || -> DecodeError {
        format!("the resolution line is `{line}`, expected a form of `-Y height +X width`").into()
    };
    let &[y @ ("-Y" | "+Y"), height, x @ ("-X" | "+X"), width] = words.as_slice() else {
        return Err(unreadable());
    };
    let number = |word: &str| word.parse::<usize>().map_err(|_| unreadable());
    Ok((number(width)?, number(height)?, y == "+Y", x == "-X"))
}

fn read_scanline(
    reader: &mut impl Read,
    width: usize,
    scanline: &mut Vec<[u8; 4]>,
) -> Result<(), DecodeError> {
    /// Widths that the newer coding can express.
    const NEW_WIDTHS: std::ops::RangeInclusive<usize> = 8..=0x7fff;
    let mut first = [0; 4];
    reader.read_exact(&mut first)?;
    scanline.clear();
    let is_new = first[0] == 2 && first[1] == 2 && first[2] < 128 && NEW_WIDTHS.contains(&width);
    if !is_new {
        return read_old_scanline(reader, width, first, scanline);
    }
    let coded = usize::from(first[2]) << 8 | usize::from(first[3]);
    if coded != width {
        return Err(format!("is {coded} pixels wide, expected {width}").into());
    }
    scanline.resize(width, [0; 4]);
    for channel in 0..4 {
        let mut rest = scanline.as_mut_slice();
        while !rest.is_empty() {
            let count = usize::from(read_byte(reader)?);
            let (length, run) = if count > 128 {
                (count - 128, Some(read_byte(reader)?))
            } else {
                (count, None)
            };
            if length == 0 || length > rest.len() {
                return Err(
                    format!("a run of {length} where {} pixels are left", rest.len()).into(),
                );
            }
            let (span, after) = rest.split_at_mut(length);
            for pixel in span {
                pixel[channel] = match run {
                    Some(byte) => byte,
                    None => read_byte(reader)?,
                };
            }
            rest = after;
        }
    }
    Ok(())
}

/// Flat pixels, or the older coding, in which (1, 1, 1, n) repeats the pixel before n times.
fn read_old_scanline(
    reader: &mut impl Read,
    width: usize,
    first: [u8; 4],
    scanline: &mut Vec<[u8; 4]>,
) -> Result<(), DecodeError> {
    let mut pixel = first;
    let mut shift = 0;
    loop {
        if let [1, 1, 1, count] = pixel {
            let before = *scanline.last().ok_or("begins with a repetition")?;
            // Repetitions in a row are the bytes of one count, lowest first.
            let length = usize::from(count).checked_shl(shift).unwrap_or(usize::MAX);
            if shift > 16 || length > width - scanline.len() {
                return Err(format!("a repetition runs past {width} pixels").into());
            }
            scanline.extend(std::iter::repeat_n(before, length));
            shift += 8;
        } else {
            scanline.push(pixel);
            shift = 0;
        }
        if scanline.len() == width {
            return Ok(());
        }
        reader.read_exact(&mut pixel)?;
    }
}

fn read_byte(reader: &mut impl Read) -> Result<u8, DecodeError> {
    let mut byte = [0];
    reader.read_exact(&mut byte)?;
    Ok(byte[0])
}

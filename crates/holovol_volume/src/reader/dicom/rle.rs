//! DICOM's run-length encoding (PS3.5, annex G): PackBits, one segment per byte of the numbers.

/// Bytes of the table that says where the segments begin.
const HEADER_BYTES: usize = 64;

/// Unpacks a frame of `count` numbers with `bytes` bytes each, little-endian.
pub(super) fn decode(packed: &[u8], count: usize, bytes: usize) -> Result<Vec<u8>, &'static str> {
    let word = |index: usize| {
        let word = packed.get(4 * index..)?.first_chunk()?;
        Some(u32::from_le_bytes(*word) as usize)
    };
    if packed.len() < HEADER_BYTES {
        return Err("the run-length header is cut off");
    }
    if word(0) != Some(bytes) {
        return Err("the run-length header has another number of segments");
    }
    // A run of 128 takes two bytes.
    if count.saturating_mul(bytes) > packed.len().saturating_mul(64) {
        return Err("there are fewer runs than pixels");
    }
    let mut unpacked = vec![0; count * bytes];
    for segment in 0..bytes {
        let start = word(1 + segment).unwrap_or(usize::MAX).max(HEADER_BYTES);
        let end = if segment + 1 < bytes {
            word(2 + segment).unwrap_or(0)
        } else {
            packed.len()
        };
        let runs = packed.get(start..end.min(packed.len())).unwrap_or_default();
        // The highest byte comes first.
        let places = unpacked.iter_mut().skip(bytes - 1 - segment).step_by(bytes);
        unpack(runs, places)?;
    }
    Ok(unpacked)
}

fn unpack<'a>(
    mut runs: &[u8],
    mut places: impl ExactSizeIterator<Item = &'a mut u8>,
) -> Result<(), &'static str> {
    while places.len() > 0 {
        let [control, rest @ ..] = runs else {
            return Err("the runs end before the last pixel");
        };
        runs = rest;
        match *control {
            length @ 0..=127 => {
                let length = usize::from(length) + 1;
                let literal = runs.get(..length).ok_or("a run is cut off")?;
                for (to, from) in (&mut places).take(literal.len()).zip(literal) {
                    *to = *from;
                }
                runs = runs.get(length..).unwrap_or_default();
            }
            128 => {}
            length => {
                let [value, rest @ ..] = runs else {
                    return Err("a run is cut off");
                };
                runs = rest;
                for to in (&mut places).take(257 - usize::from(length)) {
                    *to = *value;
                }
            }
        }
    }
    Ok(())
}

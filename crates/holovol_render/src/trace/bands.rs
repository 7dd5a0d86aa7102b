//! Images larger than what a shader can bind: 4 Mpx on some devices.

use std::ops::Range;

use super::{GUIDE_BYTES, PIXEL_BYTES};

/// Rows of the image that are bound together.
pub(super) struct Band {
    pub(super) rows: Range<u32>,
    pub(super) bind_groups: [wgpu::BindGroup; 2],
}

/// Splits an image into as few bands as the device's `limit` of bytes in a binding allows.
pub(super) fn rows_of_bands(
    [width, height]: [u32; 2],
    limit: u64,
    guides: bool,
) -> impl Iterator<Item = Range<u32>> {
    /// Whole workgroups, and bytes that are a multiple of every device's alignment.
    const STEP: u32 = 16;
    let bytes = if guides { GUIDE_BYTES } else { PIXEL_BYTES };
    let rows = limit / (bytes * u64::from(width));
    let rows = if rows >= u64::from(height) {
        height
    } else {
        (rows as u32 / STEP * STEP).max(STEP)
    };
    (0..height)
        .step_by(rows as usize)
        .map(move |top| top..height.min(top + rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_cover_the_image_within_the_limit() {
        let limit = 128 << 20;
        for (size, guides, count) in [
            ([512, 512], false, 1),
            ([2048, 2048], false, 1),
            ([2048, 2049], false, 2),
            ([3840, 2160], false, 2),
            ([3840, 2160], true, 3),
            ([30_000, 7], true, 1),
            ([16_384, 16_384], false, 64),
        ] {
            let [width, height] = size;
            let bands: Vec<_> = rows_of_bands(size, limit, guides).collect();
            assert_eq!(bands.len(), count, "{size:?}");
            assert_eq!((bands[0].start, bands[count - 1].end), (0, height));
            let bytes = if guides { GUIDE_BYTES } else { PIXEL_BYTES };
            for (i, band) in bands.iter().enumerate() {
                let row = bytes * u64::from(width);
                assert_eq!(row * u64::from(band.start) % 256, 0, "aligned");
                assert!(row * u64::from(band.end - band.start) <= limit);
                assert!(i == 0 || band.start == bands[i - 1].end);
            }
        }
    }
}

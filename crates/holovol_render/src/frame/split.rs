//! Large frames in parts: a dispatch that runs for seconds trips the driver's watchdog.

/// Samples of one dispatch: some tens of milliseconds where a device makes 100 million of them in a
/// second, and enough lanes that the large ones stay busy.
pub(super) const SAMPLES_PER_DISPATCH: u64 = 1 << 22;
/// A lane that has several samples of a pixel to make idles less, as long as there are so many lanes.
const LANES_WANTED: u64 = 1 << 18;
/// Pixels along a side of a workgroup.
const GROUP: u32 = 8;

/// How a frame's samples are split: all rows of tiles for each batch of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Split {
    area: [u32; 4],
    /// In a tile, a multiple of the workgroup's.
    rows: u32,
    samples: u32,
    /// In a batch.
    batch: u32,
}

impl Split {
    /// Of `samples` samples for each pixel of [left, top, right, bottom] in each of `views` images.
    /// A tile has at least one row of workgroups, and a batch one sample.
    pub(super) fn new(
        area: [u32; 4],
        views: u32,
        samples: u32,
        keeps_samples_together: bool,
        most: u64,
    ) -> Self {
        let [left, top, right, bottom] = area;
        let [width, height] = [right.saturating_sub(left), bottom.saturating_sub(top)];
        let per_row = u64::from(width.max(1)) * u64::from(views.max(1));
        let whole = per_row * u64::from(height) * u64::from(samples);
        let (rows, batch) = if whole <= most {
            (height, samples)
        } else {
            let lanes = LANES_WANTED.min(per_row * u64::from(height)).max(1);
            let batch = match keeps_samples_together {
                true => samples,
                false => ((most / lanes).max(1).min(u64::from(samples))) as u32,
            };
            let fits = most / (per_row * u64::from(batch.max(1)));
            (even_rows(height, fits), batch)
        };
        Self {
            area,
            rows: rows.max(GROUP),
            samples,
            batch: batch.max(1),
        }
    }

    /// Origin and size of each tile, pixels, all but the last of one height; none where there is nothing to trace.
    pub(super) fn tiles(&self) -> impl Iterator<Item = [[u32; 2]; 2]> + use<> {
        let [left, top, right, bottom] = self.area;
        let rows = self.rows;
        let end = if right > left { bottom } else { top };
        (top..end)
            .step_by(rows as usize)
            .map(move |y| [[left, y], [right - left, rows.min(bottom - y)]])
    }

    /// Offsets from an image's first sample to the first of each batch, and to that after its last.
    pub(super) fn batches(&self) -> impl Iterator<Item = [u32; 2]> + use<> {
        let (samples, batch) = (self.samples, self.batch);
        (0..samples)
            .step_by(batch as usize)
            .map(move |first| [first, samples.min(first.saturating_add(batch))])
    }
}

/// As many rows of a tile, whole workgroups, that as few tiles as can be are about equally high:
/// each costs dispatches of its own, and waits for its longest path.
fn even_rows(height: u32, fits: u64) -> u32 {
    if fits >= u64::from(height) {
        return height;
    }
    let most = (fits as u32 / GROUP * GROUP).max(GROUP);
    let tiles = height.div_ceil(most);
    height.div_ceil(tiles).next_multiple_of(GROUP)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: u64 = SAMPLES_PER_DISPATCH;

    #[test]
    fn what_fits_is_one_dispatch() {
        let split = Split::new([3, 5, 1920, 1080], 2, 1, false, MOST);
        assert_eq!(split.tiles().collect::<Vec<_>>(), [[[3, 5], [1917, 1075]]]);
        assert_eq!(split.batches().collect::<Vec<_>>(), [[0, 1]]);
    }

    #[test]
    fn parts_cover_everything_once_within_the_bound() {
        for (area, views, samples, together) in [
            ([0, 0, 3840, 2160], 1, 1, false),
            ([0, 0, 3840, 2160], 2, 64, false),
            ([8, 16, 7680, 4320], 2, 64, true),
            ([0, 0, 100, 100], 1, 1024, false),
            ([0, 7, 16_384, 9], 8, 1000, false),
            ([0, 0, 500, 500], 1, 1024, false),
            ([0, 0, 1440, 936], 2, 2, false),
        ] {
            let split = Split::new(area, views, samples, together, MOST);
            let heights: Vec<u32> = split.tiles().map(|[_, [_, height]]| height).collect();
            if let [first, .., last] = heights[..] {
                let slack = 8 * heights.len() as u32;
                assert!(last + slack >= first, "no slivers: {heights:?}");
            }
            let mut next = area[1];
            let mut largest = 0;
            for [[x, y], [width, height]] in split.tiles() {
                assert_eq!([x, y, x + width], [area[0], next, area[2]]);
                next += height;
                largest = largest.max(u64::from(width) * u64::from(height) * u64::from(views));
                assert!(next == area[3] || height % 8 == 0, "whole workgroups");
            }
            assert_eq!(next, area[3]);
            let mut next = 0;
            for [first, end] in split.batches() {
                assert_eq!(first, next);
                assert!(end > first);
                next = end;
                let smallest = u64::from(area[2] - area[0]) * 8 * u64::from(views);
                let part = largest * u64::from(end - first);
                let allowed = match together {
                    true => MOST.max(smallest * u64::from(samples)),
                    false => MOST.max(smallest * 16),
                };
                assert!(part <= allowed, "{area:?}: {part} samples");
            }
            assert_eq!(next, samples);
        }
    }

    #[test]
    fn nothing_is_no_tile() {
        let split = Split::new([u32::MAX, u32::MAX, 0, 0], 1, 4, false, MOST);
        assert_eq!(split.tiles().count(), 0);
    }
}

//! Editing of transfer functions, apart from how it is drawn: axes, points, histogram.

use holovol_volume::{Histogram, TransferFunction, TransferPoint};

/// How values and extinctions become places in the editor.
///
/// Extinctions range over powers of ten, and 0 must have its place: their cube root is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axes {
    /// s at the left and the right end.
    pub(crate) s: [f64; 2],
    /// The extinction at the top.
    pub(crate) top: f64,
}

impl Axes {
    /// All points with some room; if `range` is given (s of the least and the greatest value),
    /// that too.
    pub(crate) fn of(points: &[TransferPoint], range: Option<[f64; 2]>) -> Self {
        let range = range.map_or([0.0, 1.0], |[a, b]| [a.min(b), a.max(b)]);
        let low = points.iter().map(|p| p.s).fold(range[0].min(0.0), f64::min);
        let high = points.iter().map(|p| p.s).fold(range[1].max(1.0), f64::max);
        let room = 0.03 * (high - low).max(1e-9);
        let most = points.iter().map(|p| p.sigma_t).fold(0.0, f64::max);
        Self {
            s: [low - room, high + room],
            top: nice_top(most),
        }
    }

    /// Place of a point: 0 … 1 to the right and upwards.
    pub(crate) fn place(&self, s: f64, sigma_t: f64) -> [f64; 2] {
        let [low, high] = self.s;
        [
            (s - low) / (high - low),
            (sigma_t / self.top).max(0.0).cbrt(),
        ]
    }

    /// s and extinction at a place.
    pub(crate) fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [low, high] = self.s;
        let y = y.clamp(0.0, 1.0);
        [low + (high - low) * x.clamp(0.0, 1.0), self.top * y * y * y]
    }
}

/// The least of 1, 2, 5, 10, … that is greater.
fn nice_top(most: f64) -> f64 {
    if most <= 0.0 || !most.is_finite() {
        return 1.0;
    }
    let decade = 10f64.powf(most.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0, 20.0];
    let found = steps.map(|step| step * decade);
    found
        .into_iter()
        .find(|&top| top > 1.001 * most)
        .unwrap_or(20.0 * decade)
}

/// Moves a point between its neighbours.
pub(crate) fn move_point(points: &mut [TransferPoint], index: usize, [s, sigma_t]: [f64; 2]) {
    let low = index
        .checked_sub(1)
        .and_then(|i| points.get(i))
        .map(|p| p.s);
    let high = points.get(index + 1).map(|p| p.s);
    if let Some(point) = points.get_mut(index)
        && s.is_finite()
        && sigma_t.is_finite()
    {
        let s = low.map_or(s, |low| s.max(low));
        point.s = high.map_or(s, |high| s.min(high));
        point.sigma_t = sigma_t.max(0.0);
    }
}

/// Puts a point in its place, coloured as the function is there; gives its index.
pub(crate) fn insert_point(
    points: &mut Vec<TransferPoint>,
    [s, sigma_t]: [f64; 2],
) -> Option<usize> {
    let material = TransferFunction::new(points.clone()).ok()?.eval(s);
    let index = points.partition_point(|point| point.s <= s);
    points.insert(
        index,
        TransferPoint {
            s,
            sigma_t: sigma_t.max(0.0),
            albedo: material.albedo,
            emission: material.emission,
            roughness: material.roughness,
            specular: material.specular,
        },
    );
    Some(index)
}

/// Takes a point away, but not the last one.
pub(crate) fn remove_point(points: &mut Vec<TransferPoint>, index: usize) {
    if points.len() > 1 && index < points.len() {
        points.remove(index);
    }
}

/// Heights (0 … 1) of `count` bars over the values from `low` to `high`, as logarithms: air and
/// background would hide everything else.
pub(crate) fn bars(histogram: &Histogram, [low, high]: [f64; 2], count: usize) -> Vec<f32> {
    let mut sums = vec![0.0_f64; count];
    let width = histogram.bin_width();
    let per_unit = count as f64 / (high - low);
    for (bin, &voxels) in histogram.counts.iter().enumerate() {
        if voxels == 0 {
            continue;
        }
        // A bin may be wider than a bar, or narrower.
        let from = (histogram.low + bin as f64 * width - low) * per_unit;
        let to = from + width * per_unit;
        let (from, to) = (from.min(to), from.max(to));
        let first = from.floor().max(0.0) as usize;
        let last = (to.ceil().max(0.0) as usize).min(count);
        for (bar, sum) in sums.iter_mut().enumerate().take(last).skip(first) {
            let part = (to.min(bar as f64 + 1.0) - from.max(bar as f64)).max(0.0);
            *sum += voxels as f64 * part / (to - from);
        }
    }
    let most = sums.iter().copied().fold(0.0, f64::max).ln_1p().max(1e-9);
    sums.iter().map(|sum| (sum.ln_1p() / most) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(places: &[[f64; 2]]) -> Vec<TransferPoint> {
        let point = |&[s, sigma_t]: &[f64; 2]| TransferPoint {
            s,
            sigma_t,
            albedo: [s.clamp(0.0, 1.0); 3],
            emission: [0.0; 3],
            roughness: 0.5,
            specular: 0.0,
        };
        places.iter().map(point).collect()
    }

    #[test]
    fn places_and_points_are_inverse() {
        let points = ramp(&[[-3.0, 0.0], [0.4, 700.0]]);
        let axes = Axes::of(&points, Some([1.5, -0.5]));
        assert!(axes.s[0] < -3.0 && axes.s[1] > 1.5, "{axes:?}");
        assert_eq!(axes.top, 1000.0);
        for at in [[-2.0, 0.0], [0.0, 1.0], [1.0, 900.0]] {
            let [s, sigma_t] = axes.point(axes.place(at[0], at[1]));
            assert!((s - at[0]).abs() < 1e-9 && (sigma_t - at[1]).abs() < 1e-9);
        }
        let [s, sigma_t] = axes.point([7.0, -2.0]);
        assert!((s - axes.s[1]).abs() < 1e-9, "dragged out of the editor");
        assert_eq!(sigma_t, 0.0);
    }

    #[test]
    fn the_top_is_just_above_and_stands_still_within_a_drag() {
        for (most, top) in [(0.0, 1.0), (60.0, 100.0), (1.0, 2.0), (4000.0, 5000.0)] {
            assert_eq!(nice_top(most), top, "{most}");
        }
        assert!(nice_top(f64::MAX / 1e3).is_finite());
        assert!(nice_top(5e-7) < 1.1e-6);
    }

    #[test]
    fn points_stay_in_order_and_the_last_stays() {
        let mut points = ramp(&[[0.0, 0.0], [0.5, 1.0], [1.0, 2.0]]);
        move_point(&mut points, 1, [1.7, -3.0]);
        assert_eq!((points[1].s, points[1].sigma_t), (1.0, 0.0));
        move_point(&mut points, 1, [f64::NAN, 1.0]);
        assert_eq!(points[1].s, 1.0);
        let index = insert_point(&mut points, [0.25, 5.0]).unwrap();
        // A quarter of the way to the moved point, whose colour is 0.5.
        assert_eq!(
            (index, points[1].sigma_t, points[1].albedo[0]),
            (1, 5.0, 0.125)
        );
        assert!(TransferFunction::new(points.clone()).is_ok());
        for _ in 0..9 {
            remove_point(&mut points, 0);
        }
        assert_eq!(points.len(), 1);
    }

    #[test]
    fn bars_hold_all_voxels_whatever_the_widths() {
        let histogram = Histogram {
            low: -0.5,
            high: 3.5,
            counts: vec![0, 1000, 10, 0],
        };
        for count in [2, 4, 40] {
            let bars = bars(&histogram, [-0.5, 3.5], count);
            assert_eq!(bars.len(), count);
            assert_eq!(bars.iter().copied().fold(0.0, f32::max), 1.0);
        }
        let four = bars(&histogram, [-0.5, 3.5], 4);
        assert_eq!((four[0], four[3]), (0.0, 0.0));
        // A third of the fullest bin is in the first of three bars, the rest in the second.
        let three = bars(&histogram, [-0.5, 3.5], 3);
        let expected = (1000.0_f32 / 3.0).ln_1p() / (2010.0_f32 / 3.0 + 10.0 / 3.0).ln_1p();
        assert!((three[0] - expected).abs() < 2e-3, "{three:?}, {expected}");
        assert!(four[2] > 0.3 && four[2] < 0.4, "{four:?}");
        assert!(bars(&histogram, [10.0, 20.0], 4).iter().all(|&b| b == 0.0));
    }
}

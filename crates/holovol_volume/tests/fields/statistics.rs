use holovol_volume::{Volume, Voxels};
use proptest::prelude::*;

use crate::row;

/// Linear between neighbours in order of value, NumPy's default.
fn plain_percentile(volume: &Volume, percent: f64) -> f64 {
    let mut values: Vec<f64> = (0..volume.voxels().len())
        .map(|i| volume.slope() * volume.voxels().stored(i) + volume.intercept())
        .collect();
    values.sort_by(f64::total_cmp);
    let rank = percent / 100.0 * (values.len() - 1) as f64;
    let below = values[rank.floor() as usize];
    below + (values[rank.ceil() as usize] - below) * rank.fract()
}

fn check(voxels: Voxels, slope: f64, percents: &[f64]) {
    let volume = row(voxels, slope, -3.5);
    for (&percent, found) in percents.iter().zip(volume.percentiles(percents)) {
        let expected = plain_percentile(&volume, percent);
        let scale = volume.range()[1].abs().max(volume.range()[0].abs());
        assert!(
            (found - expected).abs() <= 1e-9 * scale,
            "{percent} %: {found} {expected}"
        );
    }
    let count = volume.voxels().len();
    let mean = (0..count)
        .map(|i| (volume.slope() * volume.voxels().stored(i) + volume.intercept()) / count as f64)
        .sum::<f64>();
    assert!(
        (volume.mean() - mean).abs() <= 1e-9 * volume.range()[1].abs().max(volume.range()[0].abs())
    );
    let histogram = volume.histogram();
    assert_eq!(histogram.counts.iter().sum::<u64>(), count as u64);
    assert!(histogram.low <= volume.range()[0] && volume.range()[1] <= histogram.high);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn percentiles_are_those_of_sorted_values(
        bits in prop::collection::vec(any::<u32>(), 1..400),
        slope in prop::sample::select(vec![1.0, 0.25, -2.0]),
        percent in 0.0..100.0f64,
    ) {
        let percents = [0.0, percent, 50.0, 99.9, 100.0];
        check(Voxels::U8(bits.iter().map(|&n| n as u8).collect()), slope, &percents);
        check(Voxels::I8(bits.iter().map(|&n| n as i8).collect()), slope, &percents);
        check(Voxels::U16(bits.iter().map(|&n| n as u16).collect()), slope, &percents);
        check(Voxels::I16(bits.iter().map(|&n| n as i16).collect()), slope, &percents);
        // Of any size, both signs, many equal ones.
        let floats = bits.iter().map(|&n| f32::from_bits(n & 0xbf00_7f0f) * 1e-3);
        check(Voxels::F32(floats.collect()), slope, &percents);
    }
}

#[test]
fn integer_histogram_has_a_bin_per_value() {
    let histogram = row(Voxels::I16(vec![-2, 1, 1, 2]), 10.0, 5.0).histogram();
    assert_eq!(histogram.counts, [1, 0, 0, 2, 1]);
    assert_eq!([histogram.low, histogram.high], [-20.0, 30.0]);
    assert_eq!(histogram.bin_centre(3), 15.0);
    let reversed = row(Voxels::U8(vec![7, 8, 8, 8]), -1.0, 0.0).histogram();
    assert_eq!(reversed.counts, [3, 1]);
    assert_eq!((reversed.bin_centre(0), reversed.bin_width()), (-8.0, 1.0));
}

#[test]
fn float_histogram_spans_the_range() {
    let histogram = row(Voxels::F32(vec![0.5, 1.0, 1.5, 1.5]), 1.0, 0.0).histogram();
    assert_eq!([histogram.low, histogram.high], [0.5, 1.5]);
    let last = histogram.counts.len() - 1;
    assert_eq!((histogram.counts[0], histogram.counts[last]), (1, 2));
    let constant = row(Voxels::F32(vec![3.5; 5]), 1.0, 0.0).histogram();
    assert_eq!(
        (constant.counts[0], constant.high > constant.low),
        (5, true)
    );
}

#[test]
fn constant_volumes_get_a_window() {
    assert_eq!(
        row(Voxels::U8(vec![7; 9]), 2.0, 1.0).auto_window(),
        [15.0, 16.0]
    );
    assert_eq!(
        row(Voxels::F32(vec![-0.5]), 1.0, 0.0).auto_window(),
        [-0.5, 0.5]
    );
    let [low, high] = row(Voxels::F32(vec![1e30]), 1.0, 0.0).auto_window();
    assert!(high as f32 > low as f32);
}

#[test]
fn labels_get_their_whole_range() {
    let labels = (0..10_000u32).map(|i| if i % 10 == 0 { (i / 10 % 5) as u8 } else { 0 });
    assert_eq!(
        row(Voxels::U8(labels.collect()), 1.0, 0.0).auto_window(),
        [0.0, 4.0]
    );
}

/// 80 % background of one value, a ramp of 1000 … 1999, and a few bright specks.
fn ramp_with_spike(background: f64) -> Vec<f64> {
    let mut values = vec![background; 80_000];
    values.extend((0..20_000).map(|i| 1000.0 + f64::from(i % 1000)));
    values.extend([30_000.0; 5]);
    values
}

#[test]
fn window_leaves_out_background_and_specks() {
    for background in [0.0, 1500.0, -2000.0] {
        let values = ramp_with_spike(background);
        let integers = row(
            Voxels::I16(values.iter().map(|&v| v as i16).collect()),
            1.0,
            0.0,
        );
        // Not integers, so that they stay floats.
        let floats = row(
            Voxels::F32(values.iter().map(|&v| v as f32 * 0.1).collect()),
            10.0,
            0.0,
        );
        let reversed = row(
            Voxels::I16(values.iter().map(|&v| -v as i16).collect()),
            -1.0,
            0.0,
        );
        for volume in [integers, floats, reversed] {
            let [low, high] = volume.auto_window();
            assert!((1005.0..1015.0).contains(&low), "{background}: {low}");
            assert!((1990.0..2000.0).contains(&high), "{background}: {high}");
        }
    }
}

#[test]
fn frequent_values_among_like_ones_are_no_background() {
    // A narrow bell: its middle value has more than 5 % of the voxels, but so have its neighbours.
    let values: Vec<u8> = (0..200_000u32)
        .map(|i| {
            (0..8)
                .map(|bit| (i.wrapping_mul(2_654_435_761) >> (bit * 4) & 7) as u8)
                .sum()
        })
        .collect();
    let [low, high] = row(Voxels::U8(values.clone()), 1.0, 0.0).auto_window();
    let whole = row(Voxels::U8(values), 1.0, 0.0);
    assert_eq!([low, high], [whole.percentile(1.0), whole.percentile(99.8)]);
}

//! The tests of significance raise false alarms as rarely as they say, and notice what they
//! should.

use crate::rng::Rng;
use crate::statistics::{BlockStatistics, agreement, block_means};
use crate::{Image, special};

fn normal(rng: &mut Rng) -> f64 {
    let radius = (2.0 * rng.exponential()).sqrt();
    radius * (std::f64::consts::TAU * rng.uniform()).cos()
}

const SIZE: u32 = 64;

/// A lit disc whose pixels have noise in proportion to their value.
fn noisy(rng: &mut Rng, noise: f64, factor: f64) -> Image {
    let pixels = (0..SIZE * SIZE).map(|i| {
        let (x, y) = (f64::from(i % SIZE) - 31.5, f64::from(i / SIZE) - 31.5);
        let value = (1.0 - (x * x + y * y) / 1500.0).max(0.0);
        let mut draw = || (factor * value * (1.0 + noise * normal(rng))) as f32;
        [draw(), draw(), draw(), value as f32]
    });
    Image::new(SIZE, SIZE, pixels.collect())
}

fn seeds(rng: &mut Rng, count: usize, noise: f64, factor: f64) -> BlockStatistics {
    let images: Vec<Image> = (0..count).map(|_| noisy(rng, noise, factor)).collect();
    BlockStatistics::from_seeds(&images, 16).expect("same size")
}

/// relMSE of one picture's noise.
fn floor(rng: &mut Rng, reference: &Image, noise: f64) -> f64 {
    let clean = noisy(rng, 0.0, 1.0);
    let _ = noise;
    crate::measures::relmse(reference, &clean).expect("same size")
}

#[test]
fn false_alarms_are_as_rare_as_stated() {
    let mut rng = Rng::new(1, 0, 0);
    let mut low = 0;
    for _ in 0..150 {
        let reference = noisy(&mut rng, 0.2, 1.0);
        let error = floor(&mut rng, &reference, 0.2);
        // Few seeds: the estimated variances are rough, and Student's t has to know.
        let ours = seeds(&mut rng, 4, 0.5, 1.0);
        let theirs = BlockStatistics::from_reference(&reference, error, 100, &ours);
        let verdict = agreement(&ours, &theirs.expect("same size")).expect("same size");
        low += u32::from(verdict.p_value < 0.05);
        assert!(verdict.p_value > 1e-5, "{verdict}");
    }
    // Bonferroni is on the safe side: at most 5 % of 150, plus chance.
    assert!(low <= 18, "{low} of 150 below 5 %");
}

#[test]
fn a_bias_far_below_the_pixels_noise_is_noticed() {
    let mut rng = Rng::new(2, 0, 0);
    let reference = noisy(&mut rng, 0.1, 1.0);
    let error = floor(&mut rng, &reference, 0.1);
    let p_of = |rng: &mut Rng, factor: f64| {
        let ours = seeds(rng, 16, 0.5, factor);
        let theirs = BlockStatistics::from_reference(&reference, error, 100, &ours);
        agreement(&ours, &theirs.expect("same size"))
            .expect("same size")
            .p_value
    };
    let fair = p_of(&mut rng, 1.0);
    assert!(fair > 1e-4, "p = {fair:e}");
    let dim = p_of(&mut rng, 0.98);
    assert!(dim < 1e-6, "2 % too dark: p = {dim:e}");
}

#[test]
fn one_wrong_block_is_noticed_and_named() {
    let mut rng = Rng::new(3, 0, 0);
    let images: Vec<Image> = (0..16)
        .map(|_| {
            let image = noisy(&mut rng, 0.5, 1.0);
            let mut pixels = image.pixels().to_vec();
            for y in 32..48 {
                for x in 16..32 {
                    pixels[y * SIZE as usize + x][1] *= 1.2;
                }
            }
            Image::new(SIZE, SIZE, pixels)
        })
        .collect();
    let ours = BlockStatistics::from_seeds(&images, 16).expect("same size");
    let right = seeds(&mut rng, 16, 0.5, 1.0);
    let verdict = agreement(&ours, &right).expect("same size");
    assert!(verdict.p_value < 1e-6, "{verdict}");
    assert_eq!(verdict.worst, ([1, 2], 1), "{verdict}");
    assert!(verdict.to_string().contains("channel G"));
}

/// Pictures whose paths meet the volume with a chance of `opacity`, 16 samples each.
fn sparse(rng: &mut Rng, count: usize, opacity: f64) -> BlockStatistics {
    let mut picture = |_| {
        let pixels = (0..SIZE * SIZE).map(|_| {
            let hit = f32::from(u8::from(rng.uniform() < 16.0 * opacity)) / 16.0;
            [hit, 2.0 * hit, hit, hit]
        });
        Image::new(SIZE, SIZE, pixels.collect())
    };
    let images: Vec<Image> = (0..count).map(&mut picture).collect();
    BlockStatistics::from_seeds(&images, 16).expect("same size")
}

#[test]
fn blocks_that_few_paths_meet_raise_no_alarm() {
    let mut rng = Rng::new(4, 0, 0);
    // Next to nothing, half a hit per block, and enough in all blocks taken together.
    for opacity in [1e-6, 3e-5, 2e-3] {
        for _ in 0..20 {
            let (a, b) = (sparse(&mut rng, 4, opacity), sparse(&mut rng, 4, opacity));
            let verdict = agreement(&a, &b).expect("same size");
            assert!(verdict.p_value > 1e-4, "opacity {opacity}: {verdict}");
        }
    }
    let (a, b) = (sparse(&mut rng, 16, 2e-3), sparse(&mut rng, 16, 3e-3));
    let verdict = agreement(&a, &b).expect("same size");
    assert!(verdict.p_value < 1e-6, "half as much again: {verdict}");
}

#[test]
fn block_means_are_means_of_blocks() {
    let pixels = (0..40 * 20).map(|i| [(i % 40 / 16) as f32, (i / 40 / 16) as f32, 1.0, 0.5]);
    let means = block_means(&Image::new(40, 20, pixels.collect()));
    let expected: Vec<[f64; 4]> = (0..6)
        .map(|i| [f64::from(i % 3), f64::from(i / 3), 1.0, 0.5])
        .collect();
    assert_eq!(means, expected);
}

#[test]
fn equal_pictures_without_noise_agree_and_unequal_ones_do_not() {
    let flat = |value: f32| vec![Image::new(32, 32, vec![[value, value, value, 1.0]; 1024]); 2];
    let statistics = |value| BlockStatistics::from_seeds(&flat(value), 1000).expect("same size");
    let same = agreement(&statistics(0.5), &statistics(0.500_000_1)).expect("same size");
    assert!(same.holds(0.5), "{same}");
    let other = agreement(&statistics(0.5), &statistics(0.51)).expect("same size");
    assert!(!other.holds(1e-6), "{other}");
    assert!(other.max_z <= special::MAX_Z);
}

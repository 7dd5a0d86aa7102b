//! Times one update of 512 × 256 and the stitching of two pictures of 1440².
//!
//! `RAYON_NUM_THREADS=2 cargo run --release -p holovol_light --example speed`
use std::time::Instant;

use glam::DMat3;
use holovol_light::change::ChangeDetector;
use holovol_light::estimate::{Estimator, Evidence, Exposure, Prior};
use holovol_light::lens::{Calibration, FisheyePair, Stitcher};
use holovol_light::measure::{add_to_spherical_harmonics, spherical_harmonics};
use holovol_light::response::Response;
use holovol_light::temporal::TemporalFilter;
use holovol_light::{EnvironmentMap, EnvironmentSampler, Grid};

const SIZE: [usize; 2] = [512, 256];

/// Median and least of the milliseconds that something takes.
fn time(what: &str, mut run: impl FnMut()) {
    let mut all: Vec<f64> = (0..300)
        .map(|_| {
            let started = Instant::now();
            run();
            started.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    all.sort_by(f64::total_cmp);
    println!(
        "{what:40} median {:.2} ms, least {:.2} ms",
        all[150], all[0]
    );
}

fn main() {
    let grid = Grid::new(SIZE[0], SIZE[1]);
    // Sky with a sun, windows and texture: as much to find as in a room.
    let scene = |ev: f32| -> Vec<[u8; 3]> {
        (0..grid.len())
            .map(|i| {
                let (x, y) = (i % SIZE[0], i / SIZE[0]);
                let window = (x / 32) % 4 == 0 && (60..120).contains(&y);
                let sun = (300..303).contains(&x) && (70..73).contains(&y);
                let l = 0.1 + 0.05 * ((x * 7 + y * 13) % 11) as f32;
                let l = l + if sun {
                    1e5
                } else if window {
                    4.0
                } else {
                    0.0
                };
                let code = (l * ev.exp2()).min(1.0).powf(1.0 / 2.2) * 255.0;
                [
                    code as u8,
                    (0.95 * code) as u8,
                    (code * 1.02).min(255.0) as u8,
                ]
            })
            .collect()
    };
    let table = Response::Srgb.table();
    let codes = [scene(0.0), scene(-6.0)];
    let mut linear = [vec![[0.0_f32; 3]; grid.len()], vec![[0.0; 3]; grid.len()]];
    let mut estimator = Estimator::new(SIZE[0], SIZE[1], Prior::default());
    let mut filter = TemporalFilter::new(SIZE[0], SIZE[1]);
    let mut change = ChangeDetector::new();
    let decode = |linear: &mut [Vec<[f32; 3]>; 2]| {
        for (linear, codes) in linear.iter_mut().zip(&codes) {
            for (out, code) in linear.iter_mut().zip(codes) {
                for c in 0..3 {
                    out[c] = table[c][usize::from(code[c])];
                }
            }
        }
    };
    time("response of two frames", || decode(&mut linear));
    fn frames(linear: &[Vec<[f32; 3]>; 2]) -> [Exposure<'_>; 2] {
        [
            Exposure {
                ev: 0.0,
                radiance: &linear[0],
            },
            Exposure {
                ev: -6.0,
                radiance: &linear[1],
            },
        ]
    }
    time("estimate", || {
        let frames = frames(&linear);
        estimator.estimate(&Evidence {
            frames: &frames,
            ..Default::default()
        });
    });
    time("temporal filter", || {
        filter.update(estimator.radiance(), estimator.lights(), 1.0 / 30.0, 0.0);
    });
    time("T", || {
        std::hint::black_box(change.update(&grid, filter.radiance(), filter.lights()));
    });
    time("spherical harmonics", || {
        std::hint::black_box(spherical_harmonics(&grid, filter.radiance()));
    });
    time("all of these", || {
        decode(&mut linear);
        let frames = frames(&linear);
        estimator.estimate(&Evidence {
            frames: &frames,
            ..Default::default()
        });
        filter.update(estimator.radiance(), estimator.lights(), 1.0 / 30.0, 0.0);
        let t = change.update(&grid, filter.radiance(), filter.lights());
        let mut sh = spherical_harmonics(&grid, filter.radiance());
        for light in filter.lights() {
            add_to_spherical_harmonics(&mut sh, light.direction, light.irradiance);
        }
        std::hint::black_box((t, sh));
    });
    let map = EnvironmentMap::new(SIZE[0], SIZE[1], filter.radiance().to_vec());
    time("sampling table (only after a change)", || {
        std::hint::black_box(EnvironmentSampler::new(&map));
    });
    let side = 1440;
    let calibration = Calibration::nominal([side; 2], 195.0);
    let mut stitcher =
        Stitcher::new(&calibration, SIZE[0], SIZE[1], DMat3::IDENTITY).expect("possible");
    let picture: Vec<[u8; 3]> = (0..side * side).map(|i| [(i % 251) as u8; 3]).collect();
    let mut out = vec![[0.0; 3]; grid.len()];
    time("stitch 2 × 1440² to 512 × 256", || {
        let pair = FisheyePair {
            pictures: [&picture, &picture],
        };
        stitcher.stitch(&pair, &mut out).expect("fits");
    });
}

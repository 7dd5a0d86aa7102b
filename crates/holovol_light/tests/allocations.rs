//! Frame after frame, the chain takes no memory.

use glam::DMat3;
use holovol_light::chain::LightChain;
use holovol_light::estimate::Prior;
use holovol_light::lens::{Calibration, FisheyePair, Stitcher};

const WIDTH: usize = 128;
const HEIGHT: usize = 64;

fn frame(ev: f64) -> Vec<[f32; 3]> {
    let scale = ev.exp2() as f32;
    (0..WIDTH * HEIGHT)
        .map(|i| {
            let (x, y) = (i % WIDTH, i / WIDTH);
            let lamp = (60..62).contains(&x) && (20..22).contains(&y);
            let window = (90..110).contains(&x) && (20..40).contains(&y);
            let level = if lamp {
                5000.0
            } else if window {
                3.0
            } else {
                0.2
            };
            [(scale * level).min(1.0); 3]
        })
        .collect()
}

#[test]
fn the_steady_state_allocates_nothing() {
    let mut chain = LightChain::new(WIDTH, HEIGHT, Prior::default());
    let frames = [(0.0, frame(0.0)), (-6.0, frame(-6.0))];
    for i in 0..40 {
        let (ev, frame) = &frames[i % 2];
        chain.update(frame, *ev, 1.0 / 30.0, None);
    }
    let info = allocation_counter::measure(|| {
        for i in 0..10 {
            let (ev, frame) = &frames[i % 2];
            let update = chain.update(frame, *ev, 1.0 / 30.0, None);
            assert!(!update.published, "{update:?}");
        }
    });
    assert_eq!(info.count_total, 0, "{info:?}");
}

#[test]
fn stitching_allocates_nothing_on_one_thread() {
    let calibration = Calibration::nominal([200, 200], 195.0);
    let mut stitcher = Stitcher::new(&calibration, 64, 32, DMat3::IDENTITY).expect("possible");
    let picture = vec![[100_u8; 3]; 200 * 200];
    let mut out = vec![[0.0; 3]; 64 * 32];
    let pair = FisheyePair {
        pictures: [&picture, &picture],
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a pool");
    let info = pool.install(|| {
        stitcher.stitch(&pair, &mut out).expect("fits");
        allocation_counter::measure(|| stitcher.stitch(&pair, &mut out).expect("fits"))
    });
    assert_eq!(info.count_total, 0, "{info:?}");
}

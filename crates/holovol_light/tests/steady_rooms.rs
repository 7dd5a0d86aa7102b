//! Real rooms in which nothing happens, as a noisy camera that brackets sees them.

use std::path::Path;

use holovol_light::EnvironmentMap;
use holovol_light::chain::LightChain;
use holovol_light::estimate::Prior;

const WIDTH: usize = 256;
const HEIGHT: usize = 128;

/// Uniform, −1 … 1.
fn noise(seed: u64) -> f64 {
    let mut x = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x1234_5678;
    for _ in 0..3 {
        x ^= x >> 31;
        x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    x as f64 / u64::MAX as f64 * 2.0 - 1.0
}

/// What a camera with shot noise and eight bits (a square root in place of sRGB) makes of the room.
fn frame(room: &[[f32; 3]], ev: f64, shot: u64) -> Vec<[f32; 3]> {
    let code = |i: usize, c: usize| {
        let light = f64::from(room[i][c]) * ev.exp2();
        let spread = (light / 3000.0 + 1e-6).sqrt() * 1.7;
        let seen = light + spread * noise(3 * (i as u64 + 65_536 * shot) + c as u64);
        let code = (255.0 * seen.clamp(0.0, 1.0).sqrt()).round() / 255.0;
        (code * code) as f32
    };
    (0..room.len())
        .map(|i| [0, 1, 2].map(|c| code(i, c)))
        .collect()
}

/// Another upload of the light makes a renderer begin its image anew.
#[test]
fn noise_hardly_publishes_anything() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/hdri");
    let Ok(files) = std::fs::read_dir(&folder) else {
        eprintln!("ignored: there is no {}", folder.display());
        return;
    };
    let mut files: Vec<_> = files.flatten().map(|file| file.path()).collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", folder.display());
    let mut restless = Vec::new();
    for file in files {
        let map = EnvironmentMap::load(&file).expect("a map");
        let uv = |i: usize| {
            [
                ((i % WIDTH) as f64 + 0.5) / WIDTH as f64,
                ((i / WIDTH) as f64 + 0.5) / HEIGHT as f64,
            ]
        };
        let room: Vec<[f32; 3]> = (0..WIDTH * HEIGHT)
            .map(|i| map.radiance_at_uv(uv(i)).map(|c| c as f32))
            .collect();
        let mean = room.iter().map(|texel| f64::from(texel[1])).sum::<f64>() / room.len() as f64;
        // Mid-grey, and six stops less.
        let metered = (0.2 / mean).log2();
        for salt in 0..3 {
            let mut chain = LightChain::new(WIDTH, HEIGHT, Prior::default());
            let mut changes = Vec::new();
            for shot in 0..120 {
                let ev = metered - 6.0 * (shot % 2) as f64;
                let frame = frame(&room, ev, shot + 1000 * salt);
                let update = chain.update(&frame, ev, 1.0 / 30.0, None);
                // It settles within a second and a half.
                if update.published && shot >= 45 {
                    changes.push(update.change_since_published);
                }
            }
            // Once in 75 frames a sun that is guessed may have drifted far enough.
            if changes.len() > 1 || changes.iter().any(|&change| change > 0.1) {
                restless.push(format!("{}: {changes:.3?}", file.display()));
            }
        }
    }
    assert!(restless.is_empty(), "published again: {restless:#?}");
}

//! Tables of any calibration that is accepted.

use proptest::prelude::*;
use serde_json::{Value, json};

use super::*;

/// A camera whose lenses have each number of each model.
fn camera(models: [usize; 2]) -> Value {
    let model = |i: usize| match i {
        0 => json!({ "model": "equidistant", "focal": 13.0, "centre": [24.0, 24.0],
            "fov_deg": 195.0 }),
        1 => json!({ "model": "kannala_brandt", "focal": [13.0, 13.1], "centre": [24.0, 24.0],
            "k": [0.01, -0.001, 0.0, 0.0], "fov_deg": 195.0 }),
        2 => json!({ "model": "mei", "xi": 1.5, "focal": [30.0, 30.0], "centre": [24.0, 24.0],
            "k": [0.01, 0.0, 0.0], "p": [0.001, 0.001], "fov_deg": 195.0 }),
        _ => json!({ "model": "o_cam", "polynomial": [0.0, 13.0, 0.1], "centre": [24.0, 24.0],
            "affine": [1.0, 0.001, 0.001], "fov_deg": 195.0 }),
    };
    let lens = |i: usize, rotation: [f64; 4]| {
        json!({ "size": [48, 48], "projection": model(i), "lens_from_camera": rotation,
            "vignetting": [-0.1, -0.1, 0.01], "gain": 1.0 })
    };
    let front = lens(models[0], [1.0, 0.0, 0.0, 0.0]);
    let back = lens(models[1], [0.0, 0.0, 1.0, 0.0]);
    json!({ "version": 1, "lenses": [front, back], "response": { "gamma": 2.2 } })
}

/// All numbers of a JSON value.
fn numbers<'a>(value: &'a mut Value, out: &mut Vec<&'a mut Value>) {
    match value {
        Value::Number(_) => out.push(value),
        Value::Array(entries) => entries.iter_mut().for_each(|v| numbers(v, out)),
        Value::Object(fields) => fields.values_mut().for_each(|v| numbers(v, out)),
        _ => {}
    }
}

/// What a file may have in place of `number`.
fn hostile(number: &Value, (kind, x): (u8, f64)) -> Value {
    let was = number.as_f64().unwrap_or(0.0);
    match kind {
        // Near the number, so that many calibrations are accepted; a size stays whole.
        0..=2 if number.is_u64() => json!((was * (1.0 + x)).max(0.0) as u64),
        0..=2 => json!(was * (1.0 + 0.6 * x) + 0.05 * x),
        3 => json!(-was),
        4 | 5 => json!(10_f64.powf(300.0 * x)),
        6 => json!(-10_f64.powf(300.0 * x)),
        7 => json!((x.abs() * 1e5) as u64),
        8 => json!(10.0 * x),
        _ => json!(0),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn calibrations_of_any_numbers_are_refused_or_give_sound_tables(
        models in [0..4_usize, 0..4],
        changes in prop::collection::vec((any::<prop::sample::Index>(), (0..10_u8, -1.0..1.0_f64)), 0..5),
    ) {
        let mut value = camera(models);
        let mut all = Vec::new();
        numbers(&mut value, &mut all);
        for (place, change) in changes {
            let number = place.get_mut(&mut all);
            **number = hostile(number, change);
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), value.to_string()).unwrap();
        let Ok(calibration) = Calibration::load(file.path()) else {
            return Ok(());
        };
        let Ok(mut stitcher) = Stitcher::new(&calibration, 32, 16, DMat3::IDENTITY) else {
            return Ok(());
        };
        prop_assert!((0.0..1.0).contains(&stitcher.unseen()));
        for part in stitcher.rows.iter().flat_map(|row| &row.parts) {
            prop_assert!(part.weight.is_finite() && part.weight >= 0.0, "{part:?}");
            prop_assert!((0.0..=1.0).contains(&part.blend), "{part:?}");
        }
        for row in &stitcher.rows {
            // Both lenses' shares of a texel that is seen are the whole of it.
            for texel in row.parts.chunk_by(|a, b| a.column == b.column) {
                let sum: f32 = texel.iter().map(|part| part.blend).sum();
                prop_assert!((sum - 1.0).abs() < 1e-5, "{texel:?}");
            }
        }
        let lengths = stitcher.lengths;
        if lengths.iter().any(|&n| n > 1 << 16) {
            return Ok(());
        }
        let white = lengths.map(|n| vec![[255; 3]; n]);
        let mut out = vec![[0.0; 3]; 32 * 16];
        stitcher.stitch(&FisheyePair { pictures: white.each_ref().map(Vec::as_slice) }, &mut out).unwrap();
        prop_assert!(out.iter().flatten().all(|l| l.is_finite() && *l >= 0.0));
    }
}

/// The sphere that neither lens sees is measured: a band of 80°, or none.
#[test]
fn what_no_lens_sees_is_counted() {
    let unseen = |fov: f64| {
        let calibration = Calibration::nominal([200, 200], fov);
        let stitcher = Stitcher::new(&calibration, 256, 128, DMat3::IDENTITY).unwrap();
        stitcher.unseen()
    };
    assert_eq!(unseen(195.0), 0.0);
    // Lenses end 1° before their edge.
    let band = 49.0_f64.to_radians().cos();
    assert!((unseen(100.0) - band).abs() < 0.01, "{}", unseen(100.0));
    let point = Calibration::nominal([1, 1], 195.0);
    let message = Stitcher::new(&point, 64, 32, DMat3::IDENTITY)
        .unwrap_err()
        .to_string();
    assert!(message.contains("2 × 2"), "{message}");
}

/// A picture that is cut at the top still leaves the seam there as bright as the other lens has it.
#[test]
fn a_cut_picture_is_filled_by_the_other_lens() {
    let mut calibration = Calibration::nominal([200, 200], 210.0);
    calibration.lenses[0].size[1] = 180;
    if let crate::lens::LensModel::Equidistant { centre, .. } =
        &mut calibration.lenses[0].projection
    {
        centre[1] = 85.0;
    }
    let mut stitcher = Stitcher::new(&calibration, 128, 64, DMat3::IDENTITY).unwrap();
    let grey = [vec![[128; 3]; 200 * 180], vec![[128; 3]; 200 * 200]];
    let mut out = vec![[0.0; 3]; 128 * 64];
    let pictures = grey.each_ref().map(Vec::as_slice);
    stitcher
        .stitch(&FisheyePair { pictures }, &mut out)
        .unwrap();
    let level = out[32 * 128 + 64][0];
    let dark = out
        .iter()
        .filter(|texel| (texel[0] - level).abs() > 0.01 * level);
    assert_eq!(dark.count(), 0, "unseen {}", stitcher.unseen());
}

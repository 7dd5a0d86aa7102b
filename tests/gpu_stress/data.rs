//! Voxels of any type, number and value.

use glam::DVec3;
use holovol_render::{Interpolation, RenderError, TraceOptions, Tracer};
use holovol_volume::{VoxelKind, Voxels};

use crate::fields::*;
use crate::gpu::{
    Test, assert_agree, assert_mean, effort, gpu, options, picture, reference, statistics, tracer,
};

const ROUNDING: f64 = 1e-4;

pub fn tests() -> Vec<Test> {
    vec![
        (
            "thin_volumes_are_seen_from_all_sides",
            thin_volumes_are_seen_from_all_sides,
        ),
        (
            "nan_and_infinite_voxels_are_replaced",
            nan_and_infinite_voxels_are_replaced,
        ),
        ("number_types_agree", number_types_agree),
        ("values_of_any_size_agree", values_of_any_size_agree),
        (
            "constant_volumes_meet_no_rounding",
            constant_volumes_meet_no_rounding,
        ),
        (
            "constants_on_a_falling_ramp_keep_their_majorant",
            constants_on_a_falling_ramp_keep_their_majorant,
        ),
        (
            "long_volumes_are_reduced_or_refused",
            long_volumes_are_reduced_or_refused,
        ),
    ]
}

fn thin_volumes_are_seen_from_all_sides() {
    for dims in [[1, 1, 1], [1, 1, 9], [17, 1, 1], [1, 12, 13], [2, 1, 300]] {
        for eye in [DVec3::X, DVec3::Y, DVec3::Z] {
            let mut scene = scene(volume(dims, |_| 1.0), vec![point(0.0, 1.0, 0.5)]);
            scene.camera = beam(3.0 * eye, DVec3::ZERO);
            let image = picture(&scene, &options(), effort(64));
            let what = format!("{dims:?} from {eye}");
            assert_mean(&what, &image, 3, -f64::exp_m1(-1.0), ROUNDING);
        }
    }
}

fn nan_and_infinite_voxels_are_replaced() {
    // NaN and −∞ become the finite minimum 0, ∞ the finite maximum 1: two of four voxels are full.
    let voxels = vec![
        0.0,
        f32::NAN,
        f32::INFINITY,
        1.0,
        f32::NEG_INFINITY,
        0.0,
        1.0,
        1.0,
    ];
    let volume = volume_of(Voxels::F32(voxels), [8, 1, 1], 1.0, 0.0);
    let mut scene = scene(volume, vec![point(0.0, 0.0, 0.5), point(1.0, 2.0, 0.5)]);
    scene.camera = beam(DVec3::new(3.0, 0.0, 0.0), DVec3::ZERO);
    // The trapezoids between 0 0 1 1 0 0 1 1 (halves at both ends) sum to 4 of 8.
    let image = picture(&scene, &options(), effort(256));
    assert_mean("damaged voxels", &image, 3, -f64::exp_m1(-1.0), ROUNDING);
    scene.volume = volume_of(Voxels::F32(vec![f32::NAN; 8]), [2, 2, 2], 1.0, 0.0);
    let image = picture(&scene, &options(), 4);
    assert!(image.pixels().iter().flatten().all(|c| c.is_finite()));
}

fn number_types_agree() {
    let dims = [19, 21, 18];
    let steps: Vec<u8> = values(dims, blobs)
        .iter()
        .map(|&v| (v * 100.0).clamp(0.0, 255.0) as u8)
        .collect();
    let mut scene = blob_scene();
    scene.gradient_factor = 0.5;
    scene.window = [0.0, 100.0];
    scene.volume = volume_of(Voxels::U8(steps.clone()), dims, 1.0, 0.0);
    let spp = effort(512);
    let expected = reference(&scene, spp);
    let shifted = |by: i16| steps.iter().map(move |&v| i16::from(v) - by);
    for (voxels, slope, intercept) in [
        (Voxels::U8(steps.clone()), 1.0, 0.0),
        (
            Voxels::I8(shifted(128).map(|v| v as i8).collect()),
            1.0,
            128.0,
        ),
        (
            Voxels::U16(steps.iter().map(|&v| u16::from(v) * 257).collect()),
            1.0 / 257.0,
            0.0,
        ),
        (
            Voxels::I16(shifted(50).map(|v| v * 100).collect()),
            0.01,
            50.0,
        ),
        (
            Voxels::F32(steps.iter().map(|&v| -f32::from(v)).collect()),
            -1.0,
            0.0,
        ),
    ] {
        let kind = voxels.kind();
        scene.volume = volume_of(voxels, dims, slope, intercept);
        let what = format!("{kind:?}");
        assert_agree(
            &what,
            &statistics(&what, &scene, &options(), spp / 16),
            &expected,
        );
        let hardware = TraceOptions {
            interpolation: Interpolation::Hardware,
            ..options()
        };
        let tracer = tracer(&scene, &hardware);
        let told = !tracer.notices().is_empty();
        let is_half = tracer.volume().format() == holovol_render::wgpu::TextureFormat::R16Float;
        assert_eq!(
            told,
            is_half && kind != VoxelKind::U8,
            "{kind:?}: {:?}",
            tracer.notices()
        );
    }
}

/// Data units are the file's own: only s counts.
fn values_of_any_size_agree() {
    let dims = [19, 21, 18];
    let mut scene = blob_scene();
    let spp = effort(512);
    let expected = reference(&scene, spp);
    for (scale, offset) in [(1e30, 0.0), (1e-30, 0.0), (1.0, 4096.0)] {
        let voxels = values(dims, blobs)
            .iter()
            .map(|&v| (v * scale + offset) as f32)
            .collect();
        scene.volume = volume_of(Voxels::F32(voxels), dims, 1.0, 0.0);
        scene.window = [offset, offset + scale];
        let what = format!("values of {scale:e} + {offset}");
        assert_agree(
            &what,
            &statistics(&what, &scene, &options(), spp / 16),
            &expected,
        );
    }
}

fn constant_volumes_meet_no_rounding() {
    // A step right at the value, which no binary fraction is: one way or the other, but wholly.
    for value in [0.1f32, 0.3, 0.7, 123.456] {
        for dims in [[1, 1, 1], [9, 8, 7]] {
            let count = dims.iter().product::<u32>() as usize;
            let volume = volume_of(Voxels::F32(vec![value; count]), dims, 1.0, 0.0);
            let s = f64::from(value);
            let mut scene = scene(volume, vec![point(s, 0.0, 0.5), point(s, 2.0, 0.5)]);
            scene.window = [0.0, 1.0];
            let image = picture(&scene, &options(), effort(64));
            assert_mean("constant", &image, 3, -f64::exp_m1(-2.0), ROUNDING);
        }
    }
}

fn constants_on_a_falling_ramp_keep_their_majorant() {
    // Layers of three cells: the middle one of each sees one value, so that majorant and lookup
    // are the same number reached on two ways. `picture` fails if the lookup comes out above.
    const LAYERS: u32 = 80;
    for round in 0..4u32 {
        let value = |layer: u32| 0.3 + 0.6 * f64::from(4 * layer + round) / f64::from(4 * LAYERS);
        let mut scene = scene(
            volume([1, 1, 24 * LAYERS], |at| {
                value((at.z * f64::from(LAYERS)) as u32)
            }),
            vec![point(0.3, 2.0, 0.5), point(0.9, 0.0, 0.5)],
        );
        let image = picture(&scene, &options(), 64);
        // Steps are symmetric, so that the mean over the layers is all that counts.
        let mean = (0..LAYERS).map(value).sum::<f64>() / f64::from(LAYERS);
        let depth = 2.0 * (0.9 - mean) / 0.6;
        assert_mean("falling ramp", &image, 3, -f64::exp_m1(-depth), 2e-4);
        scene.transfer_function =
            transfer_function(vec![point(0.1, 500.0, 0.5), point(0.9, 1e-3, 0.5)]);
        picture(&scene, &options(), 16);
    }
}

fn long_volumes_are_reduced_or_refused() {
    let limits = gpu().device.limits();
    // Exact interpolation may keep slices in layers, of which there are fewer.
    for axis in 0..3 {
        let longest = limits.max_texture_dimension_3d;
        let mut dims = [1, 1, 1];
        dims[axis] = longest + 1;
        let mut scene = scene(volume(dims, |_| 1.0), vec![point(0.0, 1.0, 0.5)]);
        let eye = [DVec3::X, DVec3::Y, DVec3::Z][axis];
        scene.camera = beam(3.0 * eye, DVec3::ZERO);
        let exact = TraceOptions {
            exact_volume: true,
            ..options()
        };
        match Tracer::new(gpu(), &scene, &exact).err() {
            Some(RenderError::VolumeTooLarge {
                dims: told, limit, ..
            }) => {
                assert_eq!((told, limit), (dims, longest));
            }
            other => panic!("{other:?}"),
        }
        let reduced = tracer(&scene, &options());
        let notices = reduced.notices().join("\n");
        assert!(notices.contains("averaged"), "{notices:?}");
        let mut texels = [1, 1, 1];
        texels[axis] = longest / 2 + 1;
        assert_eq!(reduced.volume().texels(), texels);
        let image = picture(&scene, &options(), effort(64));
        assert_mean("reduced", &image, 3, -f64::exp_m1(-1.0), ROUNDING);

        // The longest that fits is kept.
        dims[axis] = longest;
        scene.volume = volume(dims, |_| 1.0);
        let image = picture(&scene, &exact, effort(64));
        assert_mean("longest", &image, 3, -f64::exp_m1(-1.0), ROUNDING);
    }
}

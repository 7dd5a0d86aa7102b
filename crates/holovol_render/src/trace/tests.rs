use holovol_volume::{TransferFunction, TransferPoint};

use super::uniforms::{GpuTransferPoint, SceneUniform, transfer_points};
use super::variant::SAVED_PATH_VECTORS;
use super::*;
use crate::shader::tests::{assert_same_layout, plain, struct_layout};

/// What is bound to the kernel, in the order of their layout; the guides come last.
pub(crate) const BINDINGS: &[&str] = &[
    "scene",
    "dispatch",
    "field_texture",
    "field_sampler",
    "majorant_texture",
    "occupied",
    "transfer_points",
    "environment_texture",
    "environment_alias",
    "accumulators",
    "counters",
    "resumed",
    "saved",
    "guides",
    "views",
    "mesh_depth_texture",
    "shares_texture",
    "fresh_light",
];

#[test]
fn structs_lie_in_memory_as_the_kernel_reads_them() {
    let defs = plain();
    assert_same_layout!(
        &TRACE,
        &defs,
        "Scene",
        SceneUniform {
            texel_from_world_x,
            texel_from_world_y,
            texel_from_world_z,
            dims,
            extent,
            cells,
            field,
            environment,
            environment_size,
            transfer_density,
            clip,
        }
    );
    assert_same_layout!(
        &TRACE,
        &defs,
        "View",
        ViewUniform {
            ray_origin,
            ray_origin_dx,
            ray_origin_dy,
            ray_texel,
            ray_texel_dx,
            ray_texel_dy,
            ray_world,
            ray_world_dx,
            ray_world_dy,
            forward,
            image,
            samples,
            mesh_depth,
        }
    );
    assert_same_layout!(
        &TRACE,
        &defs,
        "Dispatch",
        DispatchUniform {
            tile_origin,
            tile_size,
            seed,
            budget,
            resumed_paths,
            queue_capacity,
        }
    );
    assert_same_layout!(
        &TRACE,
        &defs,
        "TransferPoint",
        GpuTransferPoint {
            density,
            albedo,
            emission,
        }
    );
    assert_same_layout!(
        &TRACE,
        &defs,
        "Counters",
        GpuCounters {
            saved_paths,
            majorant_violations,
            nonfinite_samples,
            lookups,
            cells,
            covered_samples,
            resumed_paths,
            unlimited,
        }
    );
}

#[test]
fn saved_paths_fill_their_slots() {
    for picks in 1..=4 {
        let mut defs = plain();
        for def in &mut defs {
            match def.0 {
                "PICKS" => def.1 = picks,
                "SAVED_PATH_VECTORS" => def.1 = SAVED_PATH_VECTORS + picks,
                _ => {}
            }
        }
        let (_, size) = struct_layout(&TRACE, &defs, "SavedPath");
        assert_eq!(size, 16 * (SAVED_PATH_VECTORS + picks));
    }
    // The last fixed word written is just before those of the picks.
    let last = format!("words[{}]", SAVED_PATH_VECTORS - 1);
    assert_eq!(
        PATH.source.matches(&last).count(),
        2,
        "written and read once"
    );
    assert!(
        PATH.source
            .contains(&format!("words[{SAVED_PATH_VECTORS}u + k]"))
    );
}

fn point(s: f64, sigma_t: f64) -> TransferPoint {
    TransferPoint {
        s,
        sigma_t,
        albedo: [0.25, 0.5, 0.75],
        emission: [1.0, 2.0, 3.0],
        roughness: 0.4,
        specular: 0.04,
    }
}

#[test]
fn steps_and_last_points_have_no_slope() {
    let points = [
        (0.0, 1.0),
        (0.5, 3.0),
        (0.5, 8.0),
        (0.5 + 1e-12, 9.0),
        (1.0, 9.0),
    ];
    let points = points.map(|(s, sigma_t)| point(s, sigma_t));
    let function = TransferFunction::new(points.to_vec()).unwrap();
    let uploaded = transfer_points(&function);
    assert_eq!(uploaded[0].density, [0.0, 1.0, 2.0, 2.0]);
    for i in [1, 2, 4] {
        assert_eq!(uploaded[i].density[3], 0.0, "point {i}");
    }
    assert!(
        uploaded
            .iter()
            .flat_map(|point| point.density)
            .all(f32::is_finite)
    );
    assert_eq!(uploaded[3].albedo, [0.25, 0.5, 0.75, 0.4]);
    assert_eq!(uploaded[3].emission, [1.0, 2.0, 3.0, 0.04]);
}

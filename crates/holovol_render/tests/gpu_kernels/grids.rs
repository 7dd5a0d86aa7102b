//! Cell ranges and majorants.

use glam::{DVec3, UVec3};
use holovol_render::testing::majorants::Majorants;
use holovol_render::testing::twins::field::texels;
use holovol_render::testing::{Contract, read_cell_ranges};
use holovol_render::{Gpu, GpuVolume, Interpolation, MajorantGrid, TraceOptions};
use holovol_scene::Scene;
use holovol_volume::{CellRanges, TransferFunction, Volume, Voxels};

use super::scenes::{self, numbers};

fn gpu_ranges(gpu: &Gpu, volume: &Volume) -> Result<Vec<[f32; 2]>, String> {
    GpuVolume::new(gpu, volume, Interpolation::Exact, true)
        .and_then(|volume| MajorantGrid::new(gpu, &volume, 8))
        .and_then(|grid| read_cell_ranges(gpu, &grid))
        .map_err(|error| error.to_string())
}

pub fn cell_ranges(gpu: &Gpu) -> Result<(), String> {
    for dims in [[1, 1, 1], [1, 1, 37], [8, 8, 8], [9, 7, 17], [33, 16, 5]] {
        let count: u32 = dims.iter().product();
        let number = |i| numbers(i, 3)[0];
        for voxels in [
            Voxels::U8((0..count).map(|i| (255.0 * number(i)) as u8).collect()),
            Voxels::I8(
                (0..count)
                    .map(|i| (255.0 * number(i) - 128.0) as i8)
                    .collect(),
            ),
            Voxels::U16((0..count).map(|i| (65535.0 * number(i)) as u16).collect()),
            Voxels::I16(
                (0..count)
                    .map(|i| (65535.0 * number(i) - 32768.0) as i16)
                    .collect(),
            ),
            Voxels::F32((0..count).map(|i| 3e4 * number(i) - 1e4).collect()),
        ] {
            let volume = scenes::volume(voxels, dims);
            let held = GpuVolume::new(gpu, &volume, Interpolation::Exact, true)
                .map_err(|error| error.to_string())?;
            let (_, scale, offset) = texels(&volume, held.format());
            let found = gpu_ranges(gpu, &volume)?;
            let expected = CellRanges::new(&volume).ranges;
            // Stored numbers, whole ones exactly.
            let stored = |texel: f32| {
                let stored = scale * f64::from(texel) + offset;
                if scale == 1.0 { stored } else { stored.round() }
            };
            let found: Vec<_> = found.iter().map(|range| range.map(stored)).collect();
            let expected: Vec<_> = expected.iter().map(|range| range.map(f64::from)).collect();
            if found != expected {
                return Err(format!(
                    "{dims:?}, {:?}: {found:?} not {expected:?}",
                    held.format()
                ));
            }
        }
    }
    Ok(())
}

/// Majorants on the device, lowest occupied cell, and one past the highest.
type Grid = (Vec<f32>, [[i32; 3]; 2]);

fn gpu_majorants(gpu: &Gpu, scene: &Scene) -> Result<Grid, String> {
    let cells = UVec3::from_array(CellRanges::dims_for(scene.volume.dims()));
    let count = cells.element_product();
    let inputs: Vec<_> = (0..count)
        .map(|i| {
            let cell = [i % cells.x, i / cells.x % cells.y, i / (cells.x * cells.y)];
            let [x, y, z] = cell.map(|n| n as f32);
            [[x, y, z, 0.0], [0.0; 4], [0.0; 4], [0.0; 4]]
        })
        .collect();
    let outputs = Contract::new(gpu, scene, &TraceOptions::default(), count)
        .and_then(|mut contract| contract.call("majorant", &inputs))
        .map_err(|error| error.to_string())?;
    let cell = |v: [f32; 4]| [v[0], v[1], v[2]].map(|x| x.to_bits() as i32);
    let occupied = [cell(outputs[0][1]), cell(outputs[0][2])];
    Ok((outputs.iter().map(|out| out[0][0]).collect(), occupied))
}

fn transfer_functions() -> Vec<TransferFunction> {
    let of = |points: &[(f64, f64)]| {
        let points = points.iter().map(|&(s, sigma_t)| scenes::point(s, sigma_t));
        TransferFunction::new(points.collect()).expect("a transfer function")
    };
    vec![
        of(&[(0.5, 70.0)]),
        of(&[(0.4, 0.0), (0.4, 500.0), (0.6, 0.0)]),
        of(&[(0.2, 0.0), (0.5, 1.0), (0.5, 9e6), (0.5, 2.0), (0.9, 0.0)]),
        scenes::random_transfer_function(6, 21),
        scenes::random_transfer_function(1000, 22),
    ]
}

pub fn majorants(gpu: &Gpu) -> Result<(), String> {
    let dims = [19, 9, 12];
    for (case, transfer_function) in transfer_functions().into_iter().enumerate() {
        for window in [[0.0, 1.0], [0.9, 0.2]] {
            // Odd cases are nearly flat: a margin that is too wide shows.
            let contrast = if case % 2 == 0 { 1.0 } else { 0.01 };
            let volume = scenes::random_volume(dims, case as u32, contrast);
            let scene = Scene {
                volume,
                window,
                transfer_function: transfer_function.clone(),
                ..scenes::scene()
            };
            let (found, occupied) = gpu_majorants(gpu, &scene)?;
            let [low, high] = window;
            let s_from_texel = [low as f32, (1.0 / (high - low)) as f32];
            let ranges = CellRanges::new(&scene.volume).ranges;
            let twin = Majorants::new(&ranges, dims, 8, &scene.transfer_function, s_from_texel);
            for (i, (&found, &twin)) in found.iter().zip(&twin.sigma_maj).enumerate() {
                if (found - twin).abs() > 4e-6 * twin {
                    return Err(format!("case {case}, cell {i}: {found} not {twin}"));
                }
            }
            if occupied != twin.occupied.map(|cell| cell.to_array()) {
                return Err(format!(
                    "case {case}: {occupied:?} is occupied, not {:?}",
                    twin.occupied
                ));
            }
            bound(&scene, &found).map_err(|error| format!("case {case}: {error}"))?;
        }
    }
    Ok(())
}

/// Dense samples of the field, none above its cell's majorant.
fn bound(scene: &Scene, majorants: &[f32]) -> Result<(), String> {
    let dims = UVec3::from_array(scene.volume.dims());
    let cells = UVec3::from_array(CellRanges::dims_for(scene.volume.dims()));
    for i in 0..40_000 {
        let mut texel = DVec3::from(numbers(i, 31).map(f64::from)) * dims.as_dvec3();
        if i % 3 == 0 {
            // Voxel centres, where the extremes are.
            texel = texel.floor() + 0.5;
        }
        let value = scene.volume.sample(texel / dims.as_dvec3());
        let sigma_t = scene
            .transfer_function
            .eval(scene.s_from_value(value))
            .sigma_t;
        let cell = texel.as_uvec3() / 8;
        let majorant = majorants[(cell.x + cells.x * (cell.y + cells.y * cell.z)) as usize];
        if sigma_t > f64::from(majorant) {
            return Err(format!(
                "{sigma_t} at {texel}, above the majorant {majorant}"
            ));
        }
    }
    Ok(())
}

/// Constant air at the foot of a ramp, rounding or not, is no medium.
pub fn empty_cells(gpu: &Gpu) -> Result<(), String> {
    let dims = [32u32, 16, 8];
    let air = -1000i16;
    let mut voxels = vec![air; (dims[0] * dims[1] * dims[2]) as usize];
    // Inside the last cell, out of reach of its neighbours'.
    voxels[(30 + dims[0] * (12 + dims[1] * 4)) as usize] = 700;
    for window in [[-1000.0, 1000.0], [-993.7, 311.3]] {
        let volume = scenes::volume(Voxels::I16(voxels.clone()), dims);
        let foot = (f64::from(air) - window[0]) / (window[1] - window[0]);
        let points = vec![scenes::point(foot, 0.0), scenes::point(foot + 0.5, 400.0)];
        let transfer_function = TransferFunction::new(points).expect("a ramp");
        let scene = Scene {
            volume,
            window,
            transfer_function,
            ..scenes::scene()
        };
        let (found, occupied) = gpu_majorants(gpu, &scene)?;
        let (last, others) = found.split_last().expect("cells");
        if *last <= 0.0 {
            return Err(format!("the cell that is not empty has majorant {last}"));
        }
        if others.iter().any(|&sigma_maj| sigma_maj != 0.0) || occupied != [[3, 1, 0], [4, 2, 1]] {
            return Err(format!(
                "window {window:?}: {found:?}, occupied {occupied:?}"
            ));
        }
    }
    Ok(())
}

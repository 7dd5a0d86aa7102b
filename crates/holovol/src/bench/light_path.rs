//! `holovol bench light` through the virtual camera.

use glam::{DMat3, DQuat, DVec2, DVec3};
use holovol_camera::{Exposure as Shutter, Sensor, VirtualCamera, VirtualLens};
use holovol_light::estimate::{Estimator, Evidence, Exposure, Prior};
use holovol_light::evaluate::{CLIPPED_SHARES, Case, Given, cells_of};
use holovol_light::lens::{Calibration, FisheyePair, Lens, LensModel, Stitcher};
use holovol_light::measure::{FluxCells, LightError512, normals};
use holovol_light::{EnvironmentMap, Grid, luminance};
use rayon::prelude::*;
use serde::Serialize;

use super::light::Figures;
use super::median;

/// Pixels across of each fisheye picture.
const PICTURE: usize = 720;
/// Size of the stitched panorama.
const PANORAMA: [usize; 2] = [512, 256];
/// Half the field of view, degrees.
const EDGE_DEG: f64 = 97.5;
/// Mei's model as a factory would calibrate it.
const MEI: (f64, f64, [f64; 3], [f64; 2]) = (2.0, 1.62, [0.04, -0.01, 0.0], [1e-3, -5e-4]);

/// What the virtual camera leaves of the −6 EV figures.
#[derive(Serialize)]
pub(super) struct EndToEnd {
    pub(super) all: PathError,
    pub(super) panoramas: Vec<PathError>,
    /// Largest deviation of irradiance from its mean in a uniform room.
    pub(super) seam: f64,
    /// The median of stitching alone, two threads.
    pub(super) stitch_milliseconds_1440: f64,
}

/// Errors of the same cases without and with a camera between.
#[derive(Serialize)]
pub(super) struct PathError {
    pub(super) direct: Figures,
    pub(super) camera: Figures,
}

impl PathError {
    fn of(errors: &[[LightError512; 2]]) -> Self {
        let figures = |way: usize| {
            let errors: Vec<LightError512> = errors.iter().map(|pair| pair[way]).collect();
            Figures::of(&errors)
        };
        Self {
            direct: figures(0),
            camera: figures(1),
        }
    }
}

fn camera(pose: DQuat) -> VirtualCamera {
    let (xi, focal, k, p) = MEI;
    let edge = EDGE_DEG.to_radians();
    VirtualCamera {
        size: PICTURE,
        lenses: [0, 1].map(|_| VirtualLens::Mei {
            xi,
            focal,
            k,
            p,
            edge,
        }),
        tilts: [
            DQuat::from_euler(glam::EulerRot::XYZ, 0.01, -0.02, 0.015),
            DQuat::from_euler(glam::EulerRot::XYZ, -0.015, 0.01, -0.02),
        ],
        shifts: [DVec2::new(0.01, -0.005), DVec2::new(-0.008, 0.012)],
        world_from_camera: pose,
        glare: 0.01,
        ..VirtualCamera::default()
    }
}

/// What a factory would write down of that camera.
fn calibration(camera: &VirtualCamera, size: usize) -> Calibration {
    let (xi, focal, k, p) = MEI;
    let half = 0.5 * size as f64;
    let mut out = Calibration::nominal([size; 2], 2.0 * EDGE_DEG);
    for (i, entry) in out.lenses.iter_mut().enumerate() {
        let nominal = DQuat::from_array(entry.lens_from_camera);
        *entry = Lens {
            size: [size; 2],
            projection: LensModel::Mei {
                xi,
                focal: [focal * half; 2],
                centre: [
                    half * (1.0 + camera.shifts[i].x),
                    half * (1.0 + camera.shifts[i].y),
                ],
                k,
                p,
                fov_deg: 2.0 * EDGE_DEG,
            },
            lens_from_camera: (camera.tilts[i].inverse() * nominal).to_array(),
            vignetting: vignetting(camera),
            gain: 1.0,
        };
    }
    out
}

/// The camera's falloff goes with the angle, the calibration's with the radius: refitted.
fn vignetting(camera: &VirtualCamera) -> [f64; 3] {
    let (xi, focal, k, p) = MEI;
    let lens = LensModel::Mei {
        xi,
        focal: [focal; 2],
        centre: [0.0; 2],
        k,
        p,
        fov_deg: 2.0 * EDGE_DEG,
    };
    let radius = |angle: f64| {
        use holovol_light::lens::Projection;
        let at = lens.project(DVec3::new(angle.sin(), 0.0, angle.cos()));
        at.map_or(0.0, DVec2::length)
    };
    let edge = EDGE_DEG.to_radians() - 1e-6;
    // Three points fix the three factors.
    let rows = [0.4, 0.75, 1.0].map(|share: f64| {
        let rho2 = (radius(share * edge) / radius(edge)).powi(2);
        let t2 = share * share;
        let falloff = t2 * (camera.vignetting[0] + camera.vignetting[1] * t2);
        (DVec3::new(rho2, rho2 * rho2, rho2 * rho2 * rho2), falloff)
    });
    let matrix = DMat3::from_cols(rows[0].0, rows[1].0, rows[2].0).transpose();
    (matrix.inverse() * DVec3::new(rows[0].1, rows[1].1, rows[2].1)).to_array()
}

/// Takes a panorama through camera, compression, stitching and pose, with a −6 EV frame.
fn through_camera(case: &Case, prior: Prior, seed: u64) -> Result<LightError512, String> {
    let pose = DQuat::from_euler(glam::EulerRot::YXZ, 0.7 + seed as f64, 0.15, -0.1);
    let camera = camera(pose);
    let shots = camera
        .shoot(
            &case.map,
            &[Shutter::Fixed(0.0), Shutter::Fixed(-6.0)],
            seed,
        )
        .map_err(|error| error.to_string())?;
    let calibration = calibration(&camera, PICTURE);
    // One stitcher, as a camera's: a dark frame's overlap says nothing of the lenses' gains.
    let mut stitcher = Stitcher::new(
        &calibration,
        PANORAMA[0],
        PANORAMA[1],
        DMat3::from_quat(pose),
    )
    .map_err(|error| error.to_string())?;
    let mut panoramas = Vec::new();
    for shot in &shots {
        let mut out = vec![[0.0; 3]; PANORAMA[0] * PANORAMA[1]];
        let pictures = [&shot.pictures[0][..], &shot.pictures[1][..]];
        stitcher
            .stitch(&FisheyePair { pictures }, &mut out)
            .map_err(|error| error.to_string())?;
        panoramas.push(out);
    }
    let frames = [(0.0, &panoramas[0]), (-6.0, &panoramas[1])];
    let frames = frames.map(|(ev, radiance)| Exposure { ev, radiance });
    let mut estimator = Estimator::new(PANORAMA[0], PANORAMA[1], prior);
    estimator.estimate(&Evidence {
        frames: &frames,
        ..Evidence::default()
    });
    Ok(case.error(&cells_of(&estimator)))
}

/// Measures the way through the virtual camera, in every turn and exposure of each panorama;
/// `priors[i]` was fitted without panorama i.
pub(super) fn end_to_end(
    maps: &[EnvironmentMap],
    priors: &[Prior],
    rotations: usize,
) -> Result<EndToEnd, String> {
    let per_map = rotations * CLIPPED_SHARES.len();
    let cases = (0..maps.len() * per_map).into_par_iter();
    let errors: Vec<[LightError512; 2]> = cases
        .map(|i| {
            let (map, turn) = (i / per_map, i % per_map / CLIPPED_SHARES.len());
            let share = CLIPPED_SHARES[i % CLIPPED_SHARES.len()];
            let case = Case::new(map, &maps[map], turn, share);
            let mut estimator = Estimator::new(maps[map].width(), maps[map].height(), priors[map]);
            case.estimate(&mut estimator, Given::Minus6);
            let direct = case.error(&cells_of(&estimator));
            // Another pose of the camera for each.
            Ok([direct, through_camera(&case, priors[map], i as u64)?])
        })
        .collect::<Result<_, String>>()?;
    Ok(EndToEnd {
        panoramas: errors.chunks_exact(per_map).map(PathError::of).collect(),
        all: PathError::of(&errors),
        seam: seam()?,
        stitch_milliseconds_1440: time_stitch()?,
    })
}

/// A uniform room seen by lenses of different brightness: what is left of the difference.
fn seam() -> Result<f64, String> {
    let camera = VirtualCamera {
        sensor: Sensor {
            full_well: 0.0,
            quantiser: 0.0,
            ..Sensor::default()
        },
        ..camera(DQuat::IDENTITY)
    };
    let shot = camera
        .shoot(
            &EnvironmentMap::constant([0.4; 3]),
            &[Shutter::Fixed(0.0)],
            1,
        )
        .map_err(|error| error.to_string())?
        .remove(0);
    let calibration = calibration(&camera, PICTURE);
    let mut stitcher = Stitcher::new(&calibration, PANORAMA[0], PANORAMA[1], DMat3::IDENTITY)
        .map_err(|error| error.to_string())?;
    let mut out = vec![[0.0; 3]; PANORAMA[0] * PANORAMA[1]];
    let pictures = [&shot.pictures[0][..], &shot.pictures[1][..]];
    stitcher
        .stitch(&FisheyePair { pictures }, &mut out)
        .map_err(|error| error.to_string())?;
    let cells = FluxCells::from_texels(&Grid::new(PANORAMA[0], PANORAMA[1]), &out);
    let all: Vec<f64> = normals(512)
        .map(|n| luminance(cells.irradiance(n)))
        .collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    Ok(all
        .iter()
        .map(|e| (e / mean - 1.0).abs())
        .fold(0.0, f64::max))
}

/// Milliseconds to stitch a pair of 1440² pictures.
fn time_stitch() -> Result<f64, String> {
    const SIZE: usize = 1440;
    let calibration = calibration(&camera(DQuat::IDENTITY), SIZE);
    let mut stitcher = Stitcher::new(&calibration, PANORAMA[0], PANORAMA[1], DMat3::IDENTITY)
        .map_err(|error| error.to_string())?;
    let picture: Vec<[u8; 3]> = (0..SIZE * SIZE).map(|i| [(i % 251) as u8; 3]).collect();
    let mut out = vec![[0.0; 3]; PANORAMA[0] * PANORAMA[1]];
    let mut times = Vec::new();
    for _ in 0..40 {
        let started = std::time::Instant::now();
        stitcher
            .stitch(
                &FisheyePair {
                    pictures: [&picture, &picture],
                },
                &mut out,
            )
            .map_err(|error| error.to_string())?;
        times.push(started.elapsed().as_secs_f64() * 1e3);
    }
    Ok(median(times))
}

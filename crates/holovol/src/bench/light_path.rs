//! The rest of `holovol bench light`: through the virtual camera, and the change of illumination.

use glam::{DMat3, DQuat, DVec2, DVec3};
use holovol_camera::{Exposure as Shutter, Sensor, VirtualCamera, VirtualLens};
use holovol_light::change::ChangeDetector;
use holovol_light::estimate::{Estimator, Evidence, Exposure, Prior};
use holovol_light::evaluate::{Case, Given, cells_of};
use holovol_light::lens::{Calibration, FisheyePair, Lens, LensModel, Stitcher};
use holovol_light::measure::{FluxCells, LightError512, normals};
use holovol_light::{EnvironmentMap, Grid, luminance};
use serde::Serialize;

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
    pub(super) direct_rmse: f64,
    pub(super) direct_ev_bias: f64,
    pub(super) camera_rmse: f64,
    pub(super) camera_ev_bias: f64,
    /// Largest deviation of irradiance from its mean in a uniform room.
    pub(super) seam: f64,
    /// The median of stitching alone, two threads.
    pub(super) stitch_milliseconds_1440: f64,
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
    let mut panoramas = Vec::new();
    for shot in &shots {
        let mut stitcher = Stitcher::new(
            &calibration,
            PANORAMA[0],
            PANORAMA[1],
            DMat3::from_quat(pose),
        )
        .map_err(|error| error.to_string())?;
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

/// Measures the way through the virtual camera; `priors[i]` was fitted without panorama i.
pub(super) fn end_to_end(maps: &[EnvironmentMap], priors: &[Prior]) -> Result<EndToEnd, String> {
    let (mut direct, mut through) = (Vec::new(), Vec::new());
    for (i, (map, &prior)) in maps.iter().zip(priors).enumerate() {
        let case = Case::new(i, map, 0, 0.02);
        let mut estimator = Estimator::new(map.width(), map.height(), prior);
        case.estimate(&mut estimator, Given::Minus6);
        direct.push(case.error(&cells_of(&estimator)));
        through.push(through_camera(&case, prior, i as u64)?);
    }
    let rmse =
        |errors: &[LightError512]| median(errors.iter().map(|e| e.irradiance_rmse).collect());
    let bias = |errors: &[LightError512]| median(errors.iter().map(|e| e.ev_bias.abs()).collect());
    Ok(EndToEnd {
        direct_rmse: rmse(&direct),
        direct_ev_bias: bias(&direct),
        camera_rmse: rmse(&through),
        camera_ev_bias: bias(&through),
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

/// T of one event over all panoramas.
#[derive(Serialize)]
pub(super) struct Change {
    pub(super) event: &'static str,
    pub(super) expected: &'static str,
    pub(super) least: f64,
    pub(super) median: f64,
    pub(super) most: f64,
}

/// Measures T (DESIGN §6) for what may happen between two frames of each panorama.
pub(super) fn changes(maps: &[EnvironmentMap]) -> Vec<Change> {
    let events: [(&'static str, &'static str, Happening); 6] = [
        ("nothing", "0", |texels, _| Some(texels.to_vec())),
        ("sensor noise", "< 0.05", |texels, _| Some(noisy(texels))),
        (
            "exposure change, compensated to 2 %",
            "< 0.05",
            |texels, _| Some(texels.iter().map(|t| t.map(|c| c * 1.02)).collect()),
        ),
        ("a person walks by", "0.05 … 0.5", |texels, size| {
            Some(person(texels, size, 13))
        }),
        ("the sun moves by 10°", "> 0.5", moved_sun),
        ("a lamp goes on", "> 0.8", |texels, size| {
            Some(lamp(texels, size))
        }),
    ];
    events
        .into_iter()
        .map(|(event, expected, after)| {
            let mut all: Vec<f64> = maps
                .iter()
                .filter_map(|map| {
                    let size = [map.width(), map.height()];
                    let grid = Grid::new(size[0], size[1]);
                    let mut before = map.texels().to_vec();
                    if event == "a person walks by" {
                        before = person(&before, size, 0);
                    } else if event == "sensor noise" {
                        before = noisy(&before.iter().rev().copied().collect::<Vec<_>>());
                        before.reverse();
                    }
                    let after = after(map.texels(), size)?;
                    let mut detector = ChangeDetector::new();
                    detector.update(&grid, &before, &[]);
                    Some(detector.update(&grid, &after, &[]))
                })
                .collect();
            all.sort_by(f64::total_cmp);
            Change {
                event,
                expected,
                least: all.first().copied().unwrap_or(0.0),
                median: median(all.clone()),
                most: all.last().copied().unwrap_or(0.0),
            }
        })
        .collect()
}

/// Width and height.
type Grid2 = [usize; 2];

/// What happens to a map; `None` where it can't.
type Happening = fn(&[[f32; 3]], Grid2) -> Option<Vec<[f32; 3]>>;

/// 2 % of noise, and what a sensor has in the dark.
fn noisy(texels: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut state = 0x1234_5678_9abc_def1_u64;
    let mut uniform = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
    };
    let mean = texels.iter().map(|t| t[1].min(1.0)).sum::<f32>() / texels.len() as f32;
    let noise = |c: f32, u: f32| (c * (1.0 + 0.07 * u) + 0.02 * mean * u).max(0.0);
    texels
        .iter()
        .map(|t| t.map(|c| noise(c, uniform())))
        .collect()
}

/// A dark figure, 20° wide and 60° tall, `step` texels of 1024 along.
fn person(texels: &[[f32; 3]], [width, height]: Grid2, step: usize) -> Vec<[f32; 3]> {
    let left = width / 3 + step * width / 1024;
    let mut out = texels.to_vec();
    for y in height * 37 / 100..height * 70 / 100 {
        for x in left..left + width / 18 {
            out[(x % width) + width * y] = [0.05; 3];
        }
    }
    out
}

/// The map's brightest 3° move by 10° along their row; `None` where they are no sun.
fn moved_sun(texels: &[[f32; 3]], [width, height]: Grid2) -> Option<Vec<[f32; 3]>> {
    let grid = Grid::new(width, height);
    let l = |i: usize| luminance(texels[i].map(f64::from));
    let brightest = (0..texels.len()).max_by(|&a, &b| l(a).total_cmp(&l(b)))?;
    let (sun_x, sun_y) = (brightest % width, brightest / width);
    let centre = DVec3::from_array(grid.direction(sun_x, sun_y).map(f64::from));
    let shift = (10.0 / 360.0 * width as f64 / f64::from(grid.row(sun_y)[0])).round() as usize;
    let mut out = texels.to_vec();
    let (mut moved, mut all) = (0.0, 0.0);
    let level = texels[(sun_x + width / 2) % width + width * sun_y];
    let near = |x: usize, y: usize| {
        let at = DVec3::from_array(grid.direction(x, y).map(f64::from));
        at.angle_between(centre) < 3.0_f64.to_radians()
    };
    for (i, texel) in out.iter_mut().enumerate() {
        let (x, y) = (i % width, i / width);
        let flux = l(i) * f64::from(grid.solid_angle(y));
        all += flux;
        if near(x, y) {
            moved += flux;
            *texel = level;
        }
    }
    for (i, texel) in texels.iter().enumerate() {
        let (x, y) = (i % width, i / width);
        if near(x, y) {
            out[(x + shift) % width + width * y] = *texel;
        }
    }
    (moved > 0.2 * all).then_some(out)
}

/// A lamp of half of all light, 5° wide, above the horizon.
fn lamp(texels: &[[f32; 3]], [width, height]: Grid2) -> Vec<[f32; 3]> {
    let grid = Grid::new(width, height);
    let direction = DVec3::new(0.5, 0.6, 0.62).normalize();
    let all: f64 = texels
        .iter()
        .enumerate()
        .map(|(i, t)| luminance(t.map(f64::from)) * f64::from(grid.solid_angle(i / width)))
        .sum();
    let mut out = texels.to_vec();
    let angle = 2.5_f64.to_radians();
    let add = (0.5 * all / (std::f64::consts::PI * angle * angle)) as f32;
    grid.visit_cap(direction, angle, |y, start, count| {
        for k in start..start + count as i64 {
            let texel = &mut out[k.rem_euclid(width as i64) as usize + width * y];
            *texel = texel.map(|c| c + add);
        }
    });
    out
}

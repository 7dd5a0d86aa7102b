//! The virtual camera as a whole.

use glam::{DMat3, DQuat, DVec2, DVec3};
use holovol_light::EnvironmentMap;
use rayon::prelude::*;

use crate::{Sensor, VirtualLens};

/// Why a camera can't take a picture.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// The picture has no pixels, or too many.
    #[error("pictures of {0} pixels across; expected 8 to 8192")]
    Size(usize),
    /// The room does not hold the camera.
    #[error("the room's walls must be further away than the lenses, {0} m")]
    Room(f64),
}

/// How long light is gathered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// Radiance is multiplied by 2^EV; 1 clips.
    Fixed(f64),
    /// So that the mean of both pictures' codes in linear light is this.
    Automatic(f64),
}

/// A dual-fisheye camera that looks at a radiance map.
#[derive(Clone, Debug, PartialEq)]
pub struct VirtualCamera {
    /// Width and height of each picture, pixels.
    pub size: usize,
    /// Front and back lens.
    pub lenses: [VirtualLens; 2],
    /// What turns each lens off its nominal direction: a rotation in its own frame.
    pub tilts: [DQuat; 2],
    /// Where the axis meets the picture, off its middle, in units of half the picture.
    pub shifts: [DVec2; 2],
    /// Distance between the lenses' pupils, m.
    pub baseline: f64,
    /// Half the room's size, m: the map is what its walls send, seen from the middle.
    pub room: DVec3,
    /// Rotation from the camera's frame (−z ahead, y up) to the map's.
    pub world_from_camera: DQuat,
    /// Falloff toward the edge: 1 + a·ρ² + b·ρ⁴.
    pub vignetting: [f64; 2],
    /// Brightness of each lens.
    pub gains: [f64; 2],
    /// Share of the mean light of a picture that veils all of it.
    pub glare: f64,
    /// Noise and coding.
    pub sensor: Sensor,
    /// Samples across and down a pixel.
    pub oversampling: usize,
}

impl Default for VirtualCamera {
    /// 1440² pixels, 195°, 3 cm baseline in a room of 8 × 3 × 8 m, with mild faults.
    fn default() -> Self {
        let edge = 97.5_f64.to_radians();
        Self {
            size: 1440,
            lenses: [0, 1].map(|_| VirtualLens::Equidistant { edge }),
            tilts: [DQuat::IDENTITY; 2],
            shifts: [DVec2::ZERO; 2],
            baseline: 0.03,
            room: DVec3::new(4.0, 1.5, 4.0),
            world_from_camera: DQuat::IDENTITY,
            vignetting: [-0.15, -0.1],
            gains: [1.05, 0.95],
            glare: 0.01,
            sensor: Sensor::default(),
            oversampling: 2,
        }
    }
}

/// Two pictures taken at once.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Front and back, row-major.
    pub pictures: [Vec<[u8; 3]>; 2],
    /// Exposure, EV.
    pub ev: f64,
}

impl VirtualCamera {
    /// Takes a picture of each lens at each exposure, as a bracket does. The seed changes the noise
    /// only.
    ///
    /// # Errors
    /// If the picture's size or the room make no sense.
    pub fn shoot(
        &self,
        map: &EnvironmentMap,
        exposures: &[Exposure],
        seed: u64,
    ) -> Result<Vec<Shot>, CameraError> {
        if !(8..=8192).contains(&self.size) {
            return Err(CameraError::Size(self.size));
        }
        let wall = self.room.min_element();
        if wall.is_nan() || wall <= 0.5 * self.baseline {
            return Err(CameraError::Room(0.5 * self.baseline));
        }
        let light = [0, 1].map(|lens| self.expose(lens, map));
        let shots = exposures.iter().enumerate().map(|(i, exposure)| {
            let ev = match exposure {
                Exposure::Fixed(ev) => *ev,
                Exposure::Automatic(target) => meter(&light, *target),
            };
            let scale = ev.exp2();
            let pictures = [0, 1].map(|lens: usize| {
                let scaled: Vec<[f64; 3]> =
                    light[lens].iter().map(|l| l.map(|c| c * scale)).collect();
                let seed = seed.wrapping_mul(31).wrapping_add((2 * i + lens) as u64);
                self.sensor.develop(self.size, self.size, &scaled, seed)
            });
            Shot { pictures, ev }
        });
        Ok(shots.collect())
    }

    /// Linear light on a lens's sensor.
    fn expose(&self, lens: usize, map: &EnvironmentMap) -> Vec<[f64; 3]> {
        let size = self.size;
        // The lens frame has y down; the front axis is −z, the back's +z.
        let nominal = if lens == 0 {
            DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z)
        } else {
            DMat3::from_cols(DVec3::NEG_X, DVec3::NEG_Y, DVec3::Z)
        };
        let camera_from_lens = nominal * DMat3::from_quat(self.tilts[lens]);
        let world_from_lens = DMat3::from_quat(self.world_from_camera) * camera_from_lens;
        let pupil = DMat3::from_quat(self.world_from_camera)
            * nominal
            * DVec3::new(0.0, 0.0, 0.5 * self.baseline);
        let n = self.oversampling.max(1);
        let mut light = vec![[0.0; 3]; size * size];
        light.par_chunks_mut(size).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                for s in 0..n * n {
                    let inner = DVec2::new((s % n) as f64 + 0.5, (s / n) as f64 + 0.5) / n as f64;
                    let place =
                        (DVec2::new(x as f64, y as f64) + inner) * (2.0 / size as f64) - 1.0;
                    let place = place - self.shifts[lens];
                    let Some(ray) = self.lenses[lens].ray(place) else {
                        continue;
                    };
                    let rho = ray.truncate().length().atan2(ray.z) / self.lenses[lens].edge();
                    let falloff =
                        1.0 + rho * rho * (self.vignetting[0] + self.vignetting[1] * rho * rho);
                    let seen = self.radiance(map, pupil, world_from_lens * ray);
                    for c in 0..3 {
                        pixel[c] += seen[c] * falloff * self.gains[lens] / (n * n) as f64;
                    }
                }
            }
        });
        if self.glare > 0.0 {
            let mean = light.iter().fold([0.0; 3], |sum, l| {
                std::array::from_fn(|c| sum[c] + l[c] / (size * size) as f64)
            });
            for pixel in &mut light {
                for c in 0..3 {
                    pixel[c] = (1.0 - self.glare) * pixel[c] + self.glare * mean[c];
                }
            }
        }
        light
    }

    /// What arrives at `pupil` along a ray from the room's walls.
    fn radiance(&self, map: &EnvironmentMap, pupil: DVec3, direction: DVec3) -> [f64; 3] {
        let mut distance = f64::INFINITY;
        for axis in 0..3 {
            if direction[axis] != 0.0 {
                let wall = self.room[axis].copysign(direction[axis]);
                distance = distance.min((wall - pupil[axis]) / direction[axis]);
            }
        }
        map.radiance(pupil + direction * distance)
    }
}

/// EV at which the mean of the clipped light is `target`, by bisection.
fn meter(light: &[Vec<[f64; 3]>; 2], target: f64) -> f64 {
    let mean = |ev: f64| {
        let scale = ev.exp2();
        let pixels = light.iter().flatten().step_by(97);
        let (sum, count) = pixels.fold((0.0, 0.0), |(sum, count), l| {
            (sum + (l[1] * scale).min(1.0), count + 1.0)
        });
        sum / count
    };
    let (mut low, mut high) = (-40.0, 40.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if mean(middle) < target {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holovol_light::lens::{Calibration, FisheyePair, LensModel, Stitcher, refine};

    const SIZE: usize = 360;

    fn camera() -> VirtualCamera {
        VirtualCamera {
            size: SIZE,
            baseline: 0.0,
            vignetting: [0.0; 2],
            gains: [1.0; 2],
            glare: 0.0,
            sensor: Sensor {
                full_well: 0.0,
                half_colour: false,
                quantiser: 0.0,
                ..Sensor::default()
            },
            ..VirtualCamera::default()
        }
    }

    /// Waves over the whole sphere, between 0.1 and 0.7.
    fn waves() -> EnvironmentMap {
        let (width, height) = (256, 128);
        let texels = (0..width * height).map(|i| {
            let uv = [
                ((i % width) as f64 + 0.5) / width as f64,
                ((i / width) as f64 + 0.5) / height as f64,
            ];
            let d = EnvironmentMap::direction_from_uv(uv);
            let l =
                0.4 + 0.15 * (7.0 * d.x + 2.0 * d.y).sin() + 0.15 * (9.0 * d.z - 5.0 * d.y).sin();
            [l as f32, (0.9 * l) as f32, (0.6 + 0.2 * d.y) as f32]
        });
        EnvironmentMap::new(width, height, texels.collect())
    }

    fn stitched(
        camera: &VirtualCamera,
        calibration: &Calibration,
        map: &EnvironmentMap,
    ) -> Vec<[f32; 3]> {
        let shot = camera
            .shoot(map, &[Exposure::Fixed(0.0)], 1)
            .unwrap()
            .remove(0);
        let pose = DMat3::from_quat(camera.world_from_camera);
        let mut stitcher = Stitcher::new(calibration, 256, 128, pose).unwrap();
        let mut out = vec![[0.0; 3]; 256 * 128];
        let pictures = [&shot.pictures[0][..], &shot.pictures[1][..]];
        stitcher
            .stitch(&FisheyePair { pictures }, &mut out)
            .unwrap();
        out
    }

    fn rms(a: &[[f32; 3]], b: &EnvironmentMap) -> f64 {
        let sum: f64 = a
            .iter()
            .flatten()
            .zip(b.texels().iter().flatten())
            .map(|(a, b)| f64::from(a - b).powi(2))
            .sum();
        (sum / (3.0 * a.len() as f64)).sqrt()
    }

    #[test]
    fn a_clean_camera_is_stitched_back_to_its_map_in_any_pose() {
        let map = waves();
        for pose in [
            DQuat::IDENTITY,
            DQuat::from_euler(glam::EulerRot::YXZ, 2.0, 0.5, -0.3),
        ] {
            let camera = VirtualCamera {
                world_from_camera: pose,
                ..camera()
            };
            let error = rms(
                &stitched(&camera, &Calibration::nominal([SIZE; 2], 195.0), &map),
                &map,
            );
            assert!(error < 0.006, "{pose}: {error}");
        }
    }

    #[test]
    fn gains_and_vignetting_are_undone_without_a_seam() {
        let map = waves();
        let camera = VirtualCamera {
            gains: [1.1, 0.9],
            vignetting: [-0.15, -0.1],
            ..camera()
        };
        let mut calibration = Calibration::nominal([SIZE; 2], 195.0);
        for lens in &mut calibration.lenses {
            lens.vignetting = [-0.15, -0.1, 0.0];
        }
        let out = stitched(&camera, &calibration, &map);
        let error = rms(&out, &map);
        assert!(error < 0.012, "{error}");
        let uncorrected = stitched(&camera, &Calibration::nominal([SIZE; 2], 195.0), &map);
        assert!(rms(&uncorrected, &map) > 2.0 * error);
    }

    #[test]
    fn a_tilted_lens_is_found_from_the_overlap() {
        let map = waves();
        let camera = VirtualCamera {
            tilts: [
                DQuat::IDENTITY,
                DQuat::from_euler(glam::EulerRot::XYZ, 0.012, -0.009, 0.02),
            ],
            ..camera()
        };
        let start = Calibration::nominal([SIZE; 2], 195.0);
        let before = rms(&stitched(&camera, &start, &map), &map);
        let shot = camera
            .shoot(&map, &[Exposure::Fixed(0.0)], 1)
            .unwrap()
            .remove(0);
        let pictures = [&shot.pictures[0][..], &shot.pictures[1][..]];
        let refined = refine(&start, &FisheyePair { pictures }).unwrap();
        assert!(
            refined.disagreement[1] < 0.3 * refined.disagreement[0],
            "{:?}",
            refined.disagreement
        );
        assert!(refined.agreement > 0.95, "{}", refined.agreement);
        let after = rms(&stitched(&camera, &refined.calibration, &map), &map);
        assert!(after < 0.6 * before, "{before} {after}");
        let LensModel::Equidistant { .. } = refined.calibration.lenses[0].projection else {
            panic!("the model stays");
        };
    }

    /// Another room with as bright a top and as dark a bottom has as much in common with this one
    /// as any two places have; it tells nothing of the lenses.
    #[test]
    fn pictures_that_show_no_common_seam_are_refused() {
        let map = |seed: f64| {
            let texel = |i: usize| {
                let uv = [
                    ((i % 256) as f64 + 0.5) / 256.0,
                    ((i / 256) as f64 + 0.5) / 128.0,
                ];
                let d = EnvironmentMap::direction_from_uv(uv);
                let waves = holovol_light::measure::normals(8).zip(1..);
                let texture: f64 = waves
                    .map(|(n, i)| {
                        ((8.0 + 2.0 * f64::from(i)) * n.dot(d) + seed * f64::from(i)).sin()
                    })
                    .sum();
                [(0.35 + 0.2 * d.y + 0.04 * texture).max(0.02) as f32; 3]
            };
            EnvironmentMap::new(256, 128, (0..256 * 128).map(texel).collect())
        };
        let shoot = |map: &EnvironmentMap| {
            let shots = camera().shoot(map, &[Exposure::Fixed(0.0)], 1).unwrap();
            shots[0].pictures.clone()
        };
        let start = Calibration::nominal([SIZE; 2], 195.0);
        let judge = |pictures: [&[[u8; 3]]; 2]| refine(&start, &FisheyePair { pictures });
        let here = shoot(&map(0.0));
        let there = shoot(&map(1.0));
        let black = vec![[0; 3]; SIZE * SIZE];
        let mut nearly_black = black.clone();
        nearly_black[0] = [1; 3];
        for pictures in [[&here[0], &there[1]], [&nearly_black, &black]] {
            let refused = judge(pictures.map(Vec::as_slice)).unwrap_err().to_string();
            assert!(refused.contains("nothing in the overlap"), "{refused}");
        }
        let same = judge([&here[0], &here[0]]).unwrap_err().to_string();
        assert!(same.contains("same picture"), "{same}");
        let narrow = Calibration::nominal([SIZE; 2], 175.0);
        let pictures = here.each_ref().map(Vec::as_slice);
        let apart = refine(&narrow, &FisheyePair { pictures });
        let apart = apart.unwrap_err().to_string();
        assert!(apart.contains("182°") && apart.contains("--fov"), "{apart}");
    }

    #[test]
    fn exposures_and_meter_do_what_they_say() {
        let camera = VirtualCamera {
            size: 64,
            ..camera()
        };
        let map = EnvironmentMap::constant([0.25, 0.25, 0.25]);
        let shots = camera
            .shoot(
                &map,
                &[
                    Exposure::Fixed(0.0),
                    Exposure::Fixed(-2.0),
                    Exposure::Automatic(0.3),
                ],
                1,
            )
            .unwrap();
        let middle = |shot: &Shot| shot.pictures[0][64 * 32 + 32][1];
        assert_eq!((middle(&shots[0]), middle(&shots[1])), (137, 71));
        assert!(shots[2].ev > 0.0);
        assert!(
            VirtualCamera {
                size: 0,
                ..camera.clone()
            }
            .shoot(&map, &[], 1)
            .is_err()
        );
        assert!(
            VirtualCamera {
                room: DVec3::ZERO,
                ..camera
            }
            .shoot(&map, &[], 1)
            .is_err()
        );
    }
}

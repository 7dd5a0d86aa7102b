//! The path tracer: from collision to collision, at each of them light by two strategies.

use std::ops::ControlFlow;

use glam::{DMat3, DMat4, DVec3};
use holovol_light::luminance;
use holovol_scene::{PixelRays, Scene};
use holovol_volume::{Material, Voxels};
use rayon::prelude::*;

use crate::Film;
use crate::environment::EnvironmentTable;
use crate::field::{Field, Stored};
use crate::phase::{Phase, Surface};
use crate::rng::Rng;
use crate::tracking::{Medium, Vertex};

/// How directions to the light are found. All three are unbiased, [`Self::Both`] has less noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightStrategy {
    /// Drawn from the environment and from the phase function, by multiple importance sampling.
    #[default]
    Both,
    /// Drawn from the environment only.
    Environment,
    /// Drawn from the phase function only.
    Phase,
}

/// What a rendering is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Samples per pixel.
    pub spp: u32,
    /// The same seed gives the same bits, on any number of threads.
    pub seed: u64,
    /// How light is found.
    pub light_strategy: LightStrategy,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            spp: 64,
            seed: 0,
            light_strategy: LightStrategy::default(),
        }
    }
}

/// Why a scene can't be traced.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TraceError {
    /// The volume has no extent.
    #[error(
        "volume.world_from_unit_cube has determinant {determinant:e} m³: expected a finite matrix that can be inverted"
    )]
    SingularTransform {
        /// Of the upper left 3×3 block.
        determinant: f64,
    },
    /// The window has no width.
    #[error("volume.window = [{low}, {high}]: expected two different finite numbers")]
    Window {
        /// Value at s = 0.
        low: f64,
        /// Value at s = 1.
        high: f64,
    },
    /// The camera has no direction.
    #[error(
        "camera: eye, target, up and fov_y give no picture: expected eye ≠ target, up not along the view, 0° < fov_y < 180°, at least 1 × 1 pixels"
    )]
    Camera,
    /// |g| is too large.
    #[error("phase_g = {g}: expected a number between −1 and 1, exclusive")]
    PhaseG {
        /// What it is.
        g: f64,
    },
}

/// Renders a scene.
///
/// `progress` hears after each pass how many samples per pixel are done, and may end the work
/// early; the film is then what there is so far.
///
/// # Errors
/// See [`TraceError`].
pub fn render(
    scene: &Scene,
    settings: &Settings,
    progress: &mut dyn FnMut(u64) -> ControlFlow<()>,
) -> Result<Film, TraceError> {
    let tracer = Tracer::new(scene, settings)?;
    let mut film = tracer.film();
    let mut pass = 1;
    while film.samples() < u64::from(settings.spp) {
        pass = pass.min(settings.spp - film.samples() as u32);
        tracer.accumulate(&mut film, pass);
        if progress(film.samples()).is_break() {
            break;
        }
        // Short passes first, for a quick sign of life; long ones lose less at their ends.
        pass = (pass * 2).min(16);
    }
    Ok(film)
}

/// A scene made ready for tracing: majorants and light tables are built.
///
/// Time grows with the optical depth of the cells that rays cross: 4³ voxels of 1e9 and beyond,
/// with empty space in the same cell, take minutes per ray.
pub struct Tracer<'a> {
    scene: &'a Scene,
    settings: Settings,
    medium: Medium,
    light: Light,
    rays: PixelRays,
    texel_from_world: DMat4,
    min_spacing: f64,
    emits: bool,
    camera_ray_end: Option<CameraRayEnd<'a>>,
    #[cfg(test)]
    pub(crate) fault: crate::tests::Fault,
}

/// Metres along the camera's ray of a direction (world, unit length) to something opaque.
type CameraRayEnd<'a> = Box<dyn Fn(DVec3) -> f64 + Sync + 'a>;

/// What the environment needs.
enum Light {
    Black,
    /// The same from everywhere: no direction is worth choosing.
    Constant([f64; 3]),
    Map {
        table: EnvironmentTable,
        /// Turns directions of the map's frame into the world's.
        world_from_map: DMat3,
    },
}

impl<'a> Tracer<'a> {
    /// Builds majorants and light tables.
    ///
    /// # Errors
    /// See [`TraceError`].
    pub fn new(scene: &'a Scene, settings: &Settings) -> Result<Self, TraceError> {
        let linear = DMat3::from_mat4(scene.world_from_unit_cube);
        let determinant = linear.determinant();
        let size = DVec3::from_array(scene.volume.dims().map(f64::from));
        let texel_from_world = DMat4::from_scale(size) * scene.world_from_unit_cube.inverse();
        if !determinant.is_finite() || determinant == 0.0 || !texel_from_world.is_finite() {
            return Err(TraceError::SingularTransform { determinant });
        }
        let [low, high] = scene.window;
        if !(low.is_finite() && high.is_finite() && low != high) {
            return Err(TraceError::Window { low, high });
        }
        let g = scene.phase_g;
        if !(g > -1.0 && g < 1.0) {
            return Err(TraceError::PhaseG { g });
        }
        let camera = &scene.camera;
        let rays = camera.pixel_rays(DMat4::IDENTITY);
        let directions = [rays.direction, rays.direction_dx, rays.direction_dy];
        if !(rays.origin.is_finite() && directions.iter().all(|d| d.is_finite()))
            || camera.width == 0
            || camera.height == 0
        {
            return Err(TraceError::Camera);
        }

        let points = scene.transfer_function.points();
        Ok(Self {
            scene,
            settings: *settings,
            medium: Medium::new(scene, &texel_from_world),
            light: Light::new(scene),
            rays,
            texel_from_world,
            min_spacing: scene.min_spacing(),
            emits: points.iter().any(|p| p.emission.iter().any(|&c| c > 0.0)),
            camera_ray_end: None,
            #[cfg(test)]
            fault: crate::tests::Fault::None,
        })
    }

    /// Ends camera rays at something opaque and black: `end` tells how many metres along a
    /// direction (world, unit length) it is away, infinity for never. What lies behind is not in
    /// the picture, nor in its opacity; no light is kept from the volume.
    pub fn with_camera_ray_end(mut self, end: impl Fn(DVec3) -> f64 + Sync + 'a) -> Self {
        self.camera_ray_end = Some(Box::new(end));
        self
    }

    /// An empty film of the camera's size.
    pub fn film(&self) -> Film {
        Film::new(self.scene.camera.width, self.scene.camera.height)
    }

    /// Adds `samples` samples to every pixel of a film of the camera's size.
    ///
    /// # Panics
    /// If the film has another size.
    pub fn accumulate(&self, film: &mut Film, samples: u32) {
        let camera = &self.scene.camera;
        assert_eq!(
            (film.width(), film.height()),
            (camera.width, camera.height),
            "film of another size than the camera's"
        );
        let scene = self.scene;
        match scene.volume.voxels() {
            Voxels::U8(v) => self.trace_all(&Field::new(scene, v), film, samples),
            Voxels::I8(v) => self.trace_all(&Field::new(scene, v), film, samples),
            Voxels::U16(v) => self.trace_all(&Field::new(scene, v), film, samples),
            Voxels::I16(v) => self.trace_all(&Field::new(scene, v), film, samples),
            Voxels::F32(v) => self.trace_all(&Field::new(scene, v), film, samples),
        }
    }

    fn trace_all<T: Stored>(&self, field: &Field<'_, T>, film: &mut Film, samples: u32) {
        const CHUNK: usize = 64;
        let (width, done) = (film.width() as usize, film.samples());
        film.pixels
            .par_chunks_mut(CHUNK)
            .enumerate()
            .for_each(|(chunk, pixels)| {
                for (i, pixel) in pixels.iter_mut().enumerate() {
                    let index = chunk * CHUNK + i;
                    let corner = [(index % width) as f64, (index / width) as f64];
                    for sample in done..done + u64::from(samples) {
                        let mut rng = Rng::new(self.settings.seed, index as u64, sample);
                        pixel.add(sample + 1, self.trace(field, corner, &mut rng));
                    }
                }
            });
        film.add_samples(u64::from(samples));
    }

    /// One path through a pixel: premultiplied radiance, and 1 if it met the volume.
    fn trace<T: Stored>(&self, field: &Field<'_, T>, corner: [f64; 2], rng: &mut Rng) -> [f64; 4] {
        let (x, y) = (corner[0] + rng.uniform(), corner[1] + rng.uniform());
        let rays = &self.rays;
        let mut direction =
            (rays.direction + x * rays.direction_dx + y * rays.direction_dy).normalize();
        let origin = self.texel_from_world.transform_point3(rays.origin);
        let Some(mut vertex) = self.medium.free_flight(field, origin, direction, rng) else {
            return [0.0; 4];
        };
        if let Some(end) = &self.camera_ray_end {
            let step = self.medium.texel_from_direction * direction;
            let way = (vertex.texel - origin).dot(step) / step.length_squared();
            if way > end(direction) {
                return [0.0; 4];
            }
        }

        let mut radiance = DVec3::ZERO;
        let mut throughput = DVec3::ONE;
        let mut scatters = 0;
        loop {
            let material = self.scene.transfer_function.eval(vertex.s);
            radiance += throughput * DVec3::from_array(material.emission);
            if self.scene.integrator.max_scatters == Some(scatters) {
                break;
            }
            throughput *= DVec3::from_array(material.albedo);
            let dark = matches!(self.light, Light::Black) && !self.emits;
            if dark || throughput.max_element() <= 0.0 {
                break;
            }
            scatters += 1;

            // Light by a direction of the environment.
            let wo = -direction;
            let phase = self.phase(field, &vertex, &material, wo);
            radiance += throughput * self.light_by_environment(field, &vertex, &phase, wo, rng);

            // Light by a direction of the phase function, which also carries the path on.
            let wi = phase.draw(wo, rng);
            let pdf = phase.pdf(wo, wi);
            let value = phase.eval(wo, wi);
            if !(value > 0.0 && pdf > 0.0) {
                break;
            }
            throughput *= value / pdf;
            if self.scene.integrator.max_scatters == Some(scatters) && !self.emits {
                let light = self.light_by_phase(wi, pdf);
                if light.max_element() > 0.0 {
                    radiance += throughput
                        * light
                        * self.medium.transmittance(field, vertex.texel, wi, rng);
                }
                break;
            }
            // Russian roulette by what is left of the throughput; none where nothing is absorbed.
            if scatters > 3 {
                let survival = throughput.max_element().min(1.0);
                if rng.uniform() >= survival {
                    break;
                }
                throughput /= survival;
            }
            match self.medium.free_flight(field, vertex.texel, wi, rng) {
                Some(next) => vertex = next,
                None => {
                    radiance += throughput * self.light_by_phase(wi, pdf);
                    break;
                }
            }
            direction = wi;
        }
        [radiance.x, radiance.y, radiance.z, 1.0]
    }

    /// How the point scatters light that leaves along `wo`.
    pub(crate) fn phase<T: Stored>(
        &self,
        field: &Field<'_, T>,
        vertex: &Vertex,
        material: &Material,
        wo: DVec3,
    ) -> Phase {
        let k = self.scene.gradient_factor;
        let surface = (k > 0.0)
            .then(|| {
                let gradient = field.gradient(vertex.texel, &self.medium.texel_from_direction);
                #[cfg(test)]
                let gradient = self.fault.gradient(gradient, || {
                    field.gradient(
                        vertex.texel,
                        &self.medium.texel_from_direction.inverse().transpose(),
                    )
                });
                let length = gradient.length();
                let normal = gradient / length;
                (length > 0.0 && normal.is_finite()).then(|| Surface {
                    weight: -(-k * length * self.min_spacing).exp_m1(),
                    normal: if normal.dot(wo) < 0.0 {
                        -normal
                    } else {
                        normal
                    },
                    alpha: (material.roughness * material.roughness).max(Surface::MIN_ALPHA),
                    f0: material.specular,
                })
            })
            .flatten();
        Phase {
            g: self.scene.phase_g,
            surface,
            #[cfg(test)]
            fault: self.fault,
        }
    }

    /// Radiance that scatters into `wo`, found by drawing from the environment.
    fn light_by_environment<T: Stored>(
        &self,
        field: &Field<'_, T>,
        vertex: &Vertex,
        phase: &Phase,
        wo: DVec3,
        rng: &mut Rng,
    ) -> DVec3 {
        let Light::Map {
            table,
            world_from_map,
        } = &self.light
        else {
            return DVec3::ZERO;
        };
        if self.settings.light_strategy == LightStrategy::Phase {
            return DVec3::ZERO;
        }
        let draw = table.draw(rng);
        let wi = *world_from_map * draw.direction;
        let value = phase.eval(wo, wi);
        let light = DVec3::from_array(self.scene.environment.radiance(wi));
        if !(value > 0.0 && light.max_element() > 0.0 && draw.pdf > 0.0) {
            return DVec3::ZERO;
        }
        #[cfg(test)]
        let draw = self.fault.environment_draw(draw);
        let density = match self.settings.light_strategy {
            LightStrategy::Both => draw.pdf + phase.pdf(wo, wi),
            _ => draw.pdf,
        };
        light * (value / density) * self.medium.transmittance(field, vertex.texel, wi, rng)
    }

    /// The environment's radiance along a direction that the phase function drew with density
    /// `pdf`, times its MIS weight (balance heuristic).
    fn light_by_phase(&self, wi: DVec3, pdf: f64) -> DVec3 {
        match &self.light {
            Light::Black => DVec3::ZERO,
            Light::Constant(radiance) => DVec3::from_array(*radiance),
            Light::Map {
                table,
                world_from_map,
            } => {
                let weight = match self.settings.light_strategy {
                    LightStrategy::Environment => return DVec3::ZERO,
                    LightStrategy::Phase => 1.0,
                    LightStrategy::Both => pdf / (pdf + table.pdf(world_from_map.transpose() * wi)),
                };
                weight * DVec3::from_array(self.scene.environment.radiance(wi))
            }
        }
    }
}

impl Light {
    fn new(scene: &Scene) -> Self {
        let environment = &scene.environment;
        if let Some(radiance) = environment.map.as_constant() {
            let radiance = radiance.map(|c| f64::from(c) * environment.scale);
            return if luminance(radiance) > 0.0 {
                Self::Constant(radiance)
            } else {
                Self::Black
            };
        }
        let table = EnvironmentTable::new(&environment.map);
        match table {
            Some(table) if environment.scale > 0.0 => Self::Map {
                table,
                world_from_map: DMat3::from_rotation_y(environment.rotation_y),
            },
            _ => Self::Black,
        }
    }
}

//! Pictures of the view, traced on a thread of their own as `holovol render` would: PNG, EXR with
//! opacity, and frames of a turntable.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use bevy::prelude::{Quat, Resource, Vec3};
use holovol_light::EnvironmentMap;
use holovol_reference::Image;
use holovol_render::{
    FrameTracer, Gpu, GpuEnvironment, GpuVolume, Interpolation, Kernels, Medium, TraceOptions,
    View, ViewFrame, wgpu,
};
use holovol_scene::{CameraEntry, SceneFile, Sequence};
use holovol_volume::Volume;

use super::scene_io::Viewpoint;
use crate::{Exit, Failure, output, picture};

/// What is to be taken.
pub(crate) struct Order {
    pub(crate) scene: SceneFile,
    pub(crate) volume: Volume,
    pub(crate) map: Arc<EnvironmentMap>,
    /// One picture each; PNG or EXR, as the name says.
    pub(crate) pictures: Vec<(CameraEntry, PathBuf)>,
    /// Per pixel.
    pub(crate) samples: u32,
}

/// The order that is being worked on.
#[derive(Resource, Default)]
pub(crate) struct Pictures(Option<Arc<Work>>);

#[derive(Default)]
struct Work {
    /// In thousandths.
    done: AtomicU32,
    is_cancelled: AtomicBool,
    result: Mutex<Option<Result<String, String>>>,
}

impl Pictures {
    /// The part that is done, 0 … 1, if there is an order.
    pub(crate) fn progress(&self) -> Option<f32> {
        let work = self.0.as_ref()?;
        Some(work.done.load(Ordering::Relaxed) as f32 / 1000.0)
    }

    pub(crate) fn cancel(&self) {
        if let Some(work) = &self.0 {
            work.is_cancelled.store(true, Ordering::Relaxed);
        }
    }

    /// Takes the outcome, in plain words, once there is one.
    pub(crate) fn outcome(&mut self) -> Option<Result<String, String>> {
        let work = self.0.as_ref()?;
        let mut result = work.result.lock().unwrap_or_else(PoisonError::into_inner);
        let outcome = result.take()?;
        drop(result);
        self.0 = None;
        Some(outcome)
    }

    /// Begins, unless a place can't be written.
    ///
    /// # Errors
    /// If another order is being worked on, or a picture can't be written to its place.
    pub(crate) fn begin(&mut self, order: Order) -> Result<(), Failure> {
        if self.0.is_some() {
            let message = "pictures are being taken already; wait, or stop them first";
            return Err(Failure::new(Exit::Usage, message));
        }
        if let Some((_, path)) = order.pictures.first() {
            output::check(path, extension(path), "the picture")?;
        }
        let work = Arc::new(Work::default());
        self.0 = Some(Arc::clone(&work));
        std::thread::spawn(move || {
            let told = |part: f64| {
                let thousandths = (1000.0 * part.clamp(0.0, 1.0)) as u32;
                work.done.store(thousandths, Ordering::Relaxed);
                !work.is_cancelled.load(Ordering::Relaxed)
            };
            let outcome = take(&order, &told).map_err(|failure| failure.to_string());
            let mut result = work.result.lock().unwrap_or_else(PoisonError::into_inner);
            *result = Some(outcome);
        });
        Ok(())
    }
}

fn extension(path: &std::path::Path) -> &'static str {
    let is_exr = path.extension().is_some_and(|e| e == "exr");
    if is_exr { "exr" } else { "png" }
}

/// Takes all pictures and says which; `goes_on` hears the part that is done.
fn take(order: &Order, goes_on: &dyn Fn(f64) -> bool) -> Result<String, Failure> {
    let count = order.pictures.len();
    let mut camera = Camera::new(order)?;
    for (index, (entry, path)) in order.pictures.iter().enumerate() {
        let mut file = order.scene.clone();
        file.camera = *entry;
        let sequence = Sequence::with_data(
            &file,
            order.volume.clone(),
            EnvironmentMap::clone(&order.map),
        )?;
        let scene = sequence.frame(0)?;
        let image = camera.trace(&scene.camera, order.samples, &|part| {
            goes_on((index as f64 + part) / count as f64)
        })?;
        let Some(image) = image else {
            return Ok(format!("stopped after {index} of {count} pictures"));
        };
        if extension(path) == "exr" {
            output::write_exr(&image, path)?;
        } else {
            let settings = file.output.unwrap_or_default();
            let picture = picture::develop(&image, &settings, &scene.camera, &scene.environment);
            output::write_png(&picture, path)?;
        }
    }
    let shown = |path: &PathBuf| {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.clone());
        path.display().to_string()
    };
    Ok(match order.pictures.as_slice() {
        [] => "no picture was asked for".into(),
        [(_, path)] => format!("{} is written", shown(path)),
        [(_, first), .., (_, last)] => {
            format!("{} to {} are written", shown(first), shown(last))
        }
    })
}

/// A device of its own, so that the window goes on.
struct Camera {
    gpu: Gpu,
    tracer: FrameTracer,
}

impl Camera {
    fn new(order: &Order) -> Result<Self, Failure> {
        let sequence = Sequence::with_data(
            &order.scene,
            order.volume.clone(),
            EnvironmentMap::clone(&order.map),
        )?;
        let scene = sequence.frame(0)?;
        let gpu = Gpu::new(None)?;
        let kernels = Arc::new(Kernels::new(&gpu)?);
        let volume = GpuVolume::new(&gpu, &order.volume, Interpolation::Exact, false)?;
        let environment = GpuEnvironment::new(&gpu, &order.map)?;
        let tracer = FrameTracer::new(
            &gpu,
            kernels,
            Arc::new(volume),
            Arc::new(environment),
            Medium::from_scene(&scene),
            TraceOptions::default(),
        )?;
        Ok(Self { gpu, tracer })
    }

    /// `None` if it was not to go on.
    fn trace(
        &mut self,
        camera: &holovol_scene::Camera,
        samples: u32,
        goes_on: &dyn Fn(f64) -> bool,
    ) -> Result<Option<Image>, Failure> {
        let size = [camera.width, camera.height];
        self.tracer.set_views(&[size])?;
        let frame = ViewFrame {
            slot: 0,
            view: View::from_camera(camera),
            samples: 1,
            max_samples: samples,
            restart: false,
            mesh_depth: None,
        };
        let mut is_first = true;
        for done in 0.. {
            if !goes_on(f64::from(done) / f64::from(samples)) {
                return Ok(None);
            }
            let frame = ViewFrame {
                restart: is_first,
                ..frame
            };
            let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
            let mut work = self.tracer.record(&mut encoder, &[frame], None)?;
            if work.is_waiting {
                self.tracer.wait_for_kernels();
                work = self.tracer.record(&mut encoder, &[frame], None)?;
            }
            self.gpu.queue.submit([encoder.finish()]);
            self.gpu
                .device
                .poll(wgpu::PollType::wait_indefinitely())
                .map_err(|error| Failure::new(Exit::Device, error.to_string()))?;
            is_first = false;
            if work.samples == 0 || done + 1 >= samples {
                break;
            }
        }
        let mut pixels = self.tracer.read_image(0)?;
        // A view that misses the scan has no samples and no image.
        pixels.resize((size[0] * size[1]) as usize, [0.0; 4]);
        Ok(Some(Image::new(size[0], size[1], pixels)))
    }
}

/// `frames` views once around what is looked at, the first where the camera stands.
pub(crate) fn turntable(view: &Viewpoint, frames: u32) -> Vec<CameraEntry> {
    let target = view.transform.translation + view.transform.forward().as_vec3() * view.distance;
    (0..frames)
        .map(|frame| {
            let turn = Quat::from_rotation_y(std::f32::consts::TAU * frame as f32 / frames as f32);
            let mut view = *view;
            let from_target: Vec3 = view.transform.translation - target;
            view.transform.translation = target + turn * from_target;
            view.transform.rotation = turn * view.transform.rotation;
            view.camera()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use bevy::math::UVec2;
    use bevy::prelude::Transform;
    use glam::DVec3;

    use super::*;

    #[test]
    fn a_turntable_looks_at_the_same_point_from_the_same_height() {
        let target = Vec3::new(0.1, 0.2, -0.3);
        let eye = Vec3::new(0.6, 0.5, 0.4);
        let view = Viewpoint {
            transform: Transform::from_translation(eye).looking_at(target, Vec3::Y),
            distance: eye.distance(target),
            fov: 0.5,
            size: UVec2::new(40, 30),
            exposure: 1.0,
        };
        let cameras = turntable(&view, 4);
        assert_eq!(cameras.len(), 4);
        for camera in &cameras {
            let found = DVec3::from_array(camera.target);
            assert!(found.distance(target.as_dvec3()) < 1e-5, "{found}");
            assert!((camera.eye[1] - 0.5).abs() < 1e-5);
        }
        let opposite = DVec3::from_array(cameras[2].eye);
        let expected = DVec3::new(-0.4, 0.5, -1.0);
        assert!(opposite.distance(expected) < 1e-5, "{opposite}");
    }
}

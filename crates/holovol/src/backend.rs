//! What traces the paths: a graphics device or the f64 reference.

use std::time::Instant;

use holovol_reference::{Film, Image};
use holovol_render::{Counters, Gpu, TraceOptions, Tracer};
use holovol_scene::Scene;

use crate::cli::{Backend, DeviceArgs, EffortArgs, Interpolation};
use crate::interrupt::{self, Interruptible};
use crate::{Exit, Failure};

/// An open device, or the CPU.
pub(crate) enum Device {
    Gpu(Box<Gpu>, TraceOptions),
    Reference,
}

/// When to stop tracing: at the first of both.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Goal {
    /// Samples per pixel.
    pub(crate) spp: u32,
    pub(crate) seconds: f64,
}

impl From<EffortArgs> for Goal {
    fn from(args: EffortArgs) -> Self {
        /// Samples per pixel unless the user says otherwise.
        const DEFAULT_SPP: u32 = 64;
        match args.seconds {
            Some(seconds) => Self {
                spp: u32::MAX,
                seconds,
            },
            None => Self {
                spp: args.spp.unwrap_or(DEFAULT_SPP),
                seconds: f64::INFINITY,
            },
        }
    }
}

/// An image and what it took.
pub(crate) struct Traced {
    pub(crate) image: Image,
    pub(crate) spp: u64,
    /// Uploading and compiling.
    pub(crate) prepare_seconds: f64,
    /// Tracing.
    pub(crate) seconds: f64,
    /// What a user should know of the image.
    pub(crate) notices: Vec<String>,
    /// Failed checks: the image may be wrong.
    pub(crate) faults: Vec<String>,
}

impl Device {
    pub(crate) fn open(args: &DeviceArgs) -> Result<Self, Failure> {
        match args.backend {
            Backend::Gpu => {
                let interpolation = match args.interpolation {
                    Interpolation::Exact => holovol_render::Interpolation::Exact,
                    Interpolation::Hardware => holovol_render::Interpolation::Hardware,
                };
                let gpu = Gpu::new(args.adapter.as_deref())?;
                let options = TraceOptions {
                    interpolation,
                    exact_volume: args.exact_volume,
                    ..Default::default()
                };
                Ok(Self::Gpu(Box::new(gpu), options))
            }
            Backend::Reference if args.adapter.is_some() => Err(Failure::new(
                Exit::Usage,
                "--adapter is for --backend gpu; the reference runs on the CPU",
            )),
            Backend::Reference if args.interpolation == Interpolation::Hardware => {
                Err(Failure::new(
                    Exit::Usage,
                    "--interpolation hardware is for --backend gpu; the reference is exact",
                ))
            }
            Backend::Reference => Ok(Self::Reference),
        }
    }

    pub(crate) fn adapter(&self) -> String {
        match self {
            Self::Gpu(gpu, _) => gpu.adapter_name().to_owned(),
            Self::Reference => {
                let threads = std::thread::available_parallelism().map_or(1, usize::from);
                format!("CPU, {threads} threads, f64")
            }
        }
    }

    pub(crate) fn driver(&self) -> Option<String> {
        match self {
            Self::Gpu(gpu, _) => Some(gpu.driver()),
            Self::Reference => None,
        }
    }

    /// Traces one image; `progress` hears the part that is done (0 … 1) and samples per pixel.
    pub(crate) fn trace(
        &self,
        scene: &Scene,
        seed: u64,
        goal: Goal,
        progress: &mut dyn FnMut(f64, u64),
    ) -> Result<Traced, Failure> {
        let started = Instant::now();
        match self {
            Self::Gpu(gpu, options) => {
                let options = TraceOptions {
                    seed,
                    ..options.clone()
                };
                let mut tracer = Tracer::new(gpu, scene, &options)?;
                let prepare_seconds = started.elapsed().as_secs_f64();
                let (spp, seconds) =
                    pursue(goal, progress, |samples| Ok(tracer.accumulate(samples)?))?;
                let image = Image::new(
                    scene.camera.width,
                    scene.camera.height,
                    tracer.read_image()?,
                );
                let mut faults = faults(&tracer.counters());
                faults.extend(not_finite(&image));
                Ok(Traced {
                    image,
                    spp,
                    prepare_seconds,
                    seconds,
                    notices: tracer.notices().to_vec(),
                    faults,
                })
            }
            Self::Reference => {
                let settings = holovol_reference::Settings {
                    seed,
                    ..Default::default()
                };
                let tracer = holovol_reference::Tracer::new(scene, &settings)?;
                let mut film: Film = tracer.film();
                let prepare_seconds = started.elapsed().as_secs_f64();
                let (spp, seconds) = pursue(goal, progress, |samples| {
                    tracer.accumulate(&mut film, samples);
                    Ok(())
                })?;
                let image = film.image();
                Ok(Traced {
                    faults: not_finite(&image).into_iter().collect(),
                    image,
                    spp,
                    prepare_seconds,
                    seconds,
                    notices: Vec::new(),
                })
            }
        }
    }
}

/// Accumulates until the goal is reached or the user interrupts; gives samples per pixel and
/// seconds.
fn pursue(
    goal: Goal,
    progress: &mut dyn FnMut(f64, u64),
    mut accumulate: impl FnMut(u32) -> Result<(), Failure>,
) -> Result<(u64, f64), Failure> {
    /// A batch should take about this long, so that progress is seen.
    const BATCH_SECONDS: f64 = 0.25;
    let _interruptible = Interruptible::new()?;
    progress(0.0, 0);
    let started = Instant::now();
    let (mut done, mut batch) = (0u64, 1u32);
    loop {
        let elapsed = started.elapsed().as_secs_f64();
        let per_sample = elapsed / done.max(1) as f64;
        let left = (f64::from(goal.spp) - done as f64).min(if done == 0 {
            // At least one sample is made.
            1.0
        } else {
            ((goal.seconds - elapsed) / per_sample.max(1e-9)).floor()
        });
        let part = (done as f64 / f64::from(goal.spp)).max(elapsed / goal.seconds);
        if done > 0 {
            progress(part, done);
        }
        if left < 1.0 || (done > 0 && interrupt::is_asked()) {
            return Ok((done, elapsed));
        }
        if done > 0 {
            let fitting = (BATCH_SECONDS / per_sample.max(1e-9)).max(1.0);
            batch = fitting.min(f64::from(batch) * 2.0) as u32;
        }
        let samples = f64::from(batch).min(left) as u32;
        accumulate(samples)?;
        done += u64::from(samples);
    }
}

/// A fault if a pixel is not a number.
fn not_finite(image: &Image) -> Option<String> {
    let pixels = image.pixels().iter();
    let count = pixels.filter(|p| p.iter().any(|c| !c.is_finite())).count();
    (count > 0).then(|| {
        format!("{count} pixels are not finite: radiance exceeds what 32-bit floats hold; reduce `environment.scale` or `emission`")
    })
}

/// Checks of the kernel that failed.
fn faults(counters: &Counters) -> Vec<String> {
    let mut faults = Vec::new();
    if counters.majorant_violations > 0 {
        faults.push(format!(
            "{} volume lookups exceeded their majorant: the image may be biased; please report this scene",
            counters.majorant_violations
        ));
    }
    if counters.nonfinite_samples > 0 {
        faults.push(format!(
            "{} samples were not finite and are left out: radiance exceeds what 32-bit floats hold; reduce `environment.scale` or `emission`",
            counters.nonfinite_samples
        ));
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_made_exactly() {
        for spp in [1, 2, 3, 7, 64, 1000] {
            let mut made = 0;
            let mut last = 0.0;
            let (done, _) = pursue(
                Goal {
                    spp,
                    seconds: f64::INFINITY,
                },
                &mut |part, _| last = part,
                |samples| {
                    made += samples;
                    Ok(())
                },
            )
            .unwrap();
            assert_eq!((made, done), (spp, u64::from(spp)));
            assert_eq!(last, 1.0);
        }
    }

    #[test]
    fn seconds_are_kept_and_one_sample_is_always_made() {
        let slow = |samples: u32| {
            std::thread::sleep(std::time::Duration::from_millis(10 * u64::from(samples)));
            Ok(())
        };
        let within = |seconds| Goal {
            spp: u32::MAX,
            seconds,
        };
        let (done, seconds) = pursue(within(0.2), &mut |_, _| {}, slow).unwrap();
        assert!((5..=20).contains(&done), "{done} samples");
        assert!(seconds < 0.4, "{seconds} s");
        let (done, _) = pursue(within(1e-6), &mut |_, _| {}, slow).unwrap();
        assert_eq!(done, 1);
    }
}

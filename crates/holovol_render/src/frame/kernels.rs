//! Compiled variants of the tracer, made on a thread of their own.

use std::collections::HashMap;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use crate::shader::ShaderDefs;
use crate::trace::{TRACE, layout};
use crate::{Gpu, Interpolation, RenderError};

/// What one variant of the tracer consists of.
#[derive(Clone)]
pub(crate) struct FrameKernels {
    pub(crate) trace: wgpu::ComputePipeline,
    pub(crate) resume: wgpu::ComputePipeline,
}

#[derive(Clone)]
enum Variant {
    Pending,
    Ready(FrameKernels),
    Failed(String),
}

/// What decides a variant, its layout included.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Key {
    defs: ShaderDefs,
    filtered: bool,
    slices: bool,
}

#[derive(Default)]
struct Shared {
    variants: Mutex<HashMap<Key, Variant>>,
    changed: Condvar,
}

/// The tracer's compiled variants on one device; all volumes share them.
///
/// Asking for one never waits: it is compiled on a worker, and until then another serves.
pub struct Kernels {
    shared: Arc<Shared>,
    jobs: Sender<Key>,
}

impl Kernels {
    /// Starts the worker; it ends with this.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn new(gpu: &Gpu) -> Result<Self, RenderError> {
        let shared = Arc::new(Shared::default());
        let (jobs, queue) = channel::<Key>();
        let (gpu, results) = (gpu.clone(), Arc::clone(&shared));
        std::thread::Builder::new()
            .name("holovol kernels".into())
            .spawn(move || {
                for key in queue {
                    let variant = match compile(&gpu, &key) {
                        Ok(kernels) => Variant::Ready(kernels),
                        Err(error) => Variant::Failed(error.to_string()),
                    };
                    lock(&results.variants).insert(key, variant);
                    results.changed.notify_all();
                }
            })
            .map_err(|error| RenderError::Internal {
                what: "the thread that compiles kernels".into(),
                reason: error.to_string(),
            })?;
        Ok(Self { shared, jobs })
    }

    /// A variant if it is there; else it will be compiled.
    pub(crate) fn get(
        &self,
        defs: &ShaderDefs,
        interpolation: Interpolation,
        slices: bool,
    ) -> Result<Option<FrameKernels>, RenderError> {
        let key = Key {
            defs: defs.clone(),
            filtered: interpolation == Interpolation::Hardware,
            slices,
        };
        let mut variants = lock(&self.shared.variants);
        match variants.get(&key) {
            Some(Variant::Ready(kernels)) => Ok(Some(kernels.clone())),
            Some(Variant::Pending) => Ok(None),
            Some(Variant::Failed(reason)) => Err(failed(reason.clone())),
            None => {
                variants.insert(key.clone(), Variant::Pending);
                drop(variants);
                self.jobs
                    .send(key)
                    .map(|()| None)
                    .map_err(|_| failed("its thread has ended".into()))
            }
        }
    }

    /// Waits until all variants that were asked for are compiled: for tests and servers.
    pub fn wait(&self) {
        let mut variants = lock(&self.shared.variants);
        while variants
            .values()
            .any(|variant| matches!(variant, Variant::Pending))
        {
            variants = self
                .shared
                .changed
                .wait(variants)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn failed(reason: String) -> RenderError {
    RenderError::Internal {
        what: TRACE.path.into(),
        reason,
    }
}

fn compile(gpu: &Gpu, key: &Key) -> Result<FrameKernels, RenderError> {
    let interpolation = if key.filtered {
        Interpolation::Hardware
    } else {
        Interpolation::Exact
    };
    let layout = layout(gpu, interpolation, key.slices)?;
    Ok(FrameKernels {
        trace: gpu.pipeline(&TRACE, &key.defs, "trace", &layout)?,
        resume: gpu.pipeline(&TRACE, &key.defs, "resume", &layout)?,
    })
}

//! Compiled variants of something, made on a thread of their own.

use std::collections::HashMap;
use std::hash::Hash;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::RenderError;

enum Variant<T> {
    Pending,
    Ready(T),
    Failed(String),
}

struct Shared<K, T> {
    variants: Mutex<HashMap<K, Variant<T>>>,
    changed: Condvar,
}

impl<K, T> Shared<K, T> {
    fn lock(&self) -> MutexGuard<'_, HashMap<K, Variant<T>>> {
        self.variants.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a worker has compiled, by what decides it.
pub(crate) struct Variants<K, T> {
    shared: Arc<Shared<K, T>>,
    jobs: Sender<K>,
    what: &'static str,
}

impl<K, T> Variants<K, T>
where
    K: Clone + Eq + Hash + Send + 'static,
    T: Clone + Send + 'static,
{
    /// Starts the worker; it ends with this. `what` names the thread and stands in errors.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub(crate) fn new(
        what: &'static str,
        compile: impl Fn(&K) -> Result<T, RenderError> + Send + 'static,
    ) -> Result<Self, RenderError> {
        let shared = Arc::new(Shared {
            variants: Mutex::new(HashMap::new()),
            changed: Condvar::new(),
        });
        let (jobs, queue) = channel::<K>();
        let results = Arc::clone(&shared);
        #[cfg(any(test, feature = "testing"))]
        let damage = crate::testing::present_mutation();
        std::thread::Builder::new()
            .name(what.into())
            .spawn(move || {
                #[cfg(any(test, feature = "testing"))]
                crate::testing::set_mutation(damage);
                for key in queue {
                    // Who waits for it must hear of a panic, too.
                    let compiled = catch_unwind(AssertUnwindSafe(|| compile(&key)));
                    let variant = match compiled {
                        Ok(Ok(compiled)) => Variant::Ready(compiled),
                        Ok(Err(error)) => Variant::Failed(error.to_string()),
                        Err(_) => Variant::Failed("it panicked".into()),
                    };
                    results.lock().insert(key, variant);
                    results.changed.notify_all();
                }
            })
            .map_err(|error| RenderError::Internal {
                what: "the thread that compiles kernels".into(),
                reason: error.to_string(),
            })?;
        Ok(Self { shared, jobs, what })
    }

    /// A variant if it is there; else it will be compiled.
    ///
    /// # Errors
    /// If it could not be.
    pub(crate) fn get(&self, key: &K) -> Result<Option<T>, RenderError> {
        let failed = |reason: String| RenderError::Internal {
            what: self.what.into(),
            reason,
        };
        let mut variants = self.shared.lock();
        match variants.get(key) {
            Some(Variant::Ready(compiled)) => Ok(Some(compiled.clone())),
            Some(Variant::Pending) => Ok(None),
            Some(Variant::Failed(reason)) => Err(failed(reason.clone())),
            None => {
                variants.insert(key.clone(), Variant::Pending);
                drop(variants);
                self.jobs
                    .send(key.clone())
                    .map(|()| None)
                    .map_err(|_| failed("its thread has ended".into()))
            }
        }
    }

    /// Waits until all variants that were asked for are compiled.
    pub(crate) fn wait(&self) {
        let mut variants = self.shared.lock();
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

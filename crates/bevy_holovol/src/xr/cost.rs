use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use bevy::prelude::*;

/// CPU time of our systems' threads while they run; measured only when asked, since asking costs
/// as much.
#[doc(hidden)]
#[derive(Resource, Clone, Default)]
pub struct FrameCost(Arc<Shared>);

#[derive(Default)]
struct Shared {
    is_on: AtomicBool,
    nanoseconds: AtomicU64,
}

impl FrameCost {
    /// Begins to measure.
    pub fn measure(&self) {
        self.0.nanoseconds.store(0, Ordering::Relaxed);
        self.0.is_on.store(true, Ordering::Relaxed);
    }

    /// ns since then; `None` where the system doesn't tell.
    pub fn nanoseconds(&self) -> Option<u64> {
        thread_nanoseconds().map(|_| self.0.nanoseconds.load(Ordering::Relaxed))
    }

    /// What passes until the result is dropped counts.
    pub(crate) fn count(&self) -> Counting {
        let start = self
            .0
            .is_on
            .load(Ordering::Relaxed)
            .then(thread_nanoseconds);
        Counting(start.flatten().map(|start| (Arc::clone(&self.0), start)))
    }
}

pub(crate) struct Counting(Option<(Arc<Shared>, u64)>);

impl Drop for Counting {
    fn drop(&mut self) {
        if let Some((shared, start)) = &self.0
            && let Some(end) = thread_nanoseconds()
        {
            let passed = end.saturating_sub(*start);
            shared.nanoseconds.fetch_add(passed, Ordering::Relaxed);
        }
    }
}

fn thread_nanoseconds() -> Option<u64> {
    let times = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    times.split(' ').next()?.parse().ok()
}

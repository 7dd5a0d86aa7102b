use std::cell::Cell;
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

/// Whose code a thread runs, as far as [`FrameCost`] is measuring.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CostOwner {
    /// Somebody else's.
    Other,
    /// That of our systems.
    System,
    /// What our systems make wgpu do.
    Driver,
}

thread_local! {
    static OWNER: Cell<CostOwner> = const { Cell::new(CostOwner::Other) };
}

impl CostOwner {
    /// Of the present thread: for allocators that count.
    pub fn current() -> Self {
        OWNER.try_with(Cell::get).unwrap_or(Self::Other)
    }
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

    fn is_on(&self) -> bool {
        self.0.is_on.load(Ordering::Relaxed)
    }

    /// What passes until the result is dropped counts.
    pub(crate) fn count(&self) -> Counting {
        if !self.is_on() {
            return Counting(None);
        }
        let start = thread_nanoseconds().map(|start| (Arc::clone(&self.0), start));
        OWNER.set(CostOwner::System);
        Counting(start)
    }

    /// Until the result is dropped it is wgpu that works.
    pub(crate) fn in_driver(&self) -> InDriver {
        let is_ours = self.is_on() && CostOwner::current() == CostOwner::System;
        if is_ours {
            OWNER.set(CostOwner::Driver);
        }
        InDriver(is_ours)
    }
}

pub(crate) struct Counting(Option<(Arc<Shared>, u64)>);

impl Drop for Counting {
    fn drop(&mut self) {
        OWNER.set(CostOwner::Other);
        if let Some((shared, start)) = &self.0
            && let Some(end) = thread_nanoseconds()
        {
            let passed = end.saturating_sub(*start);
            shared.nanoseconds.fetch_add(passed, Ordering::Relaxed);
        }
    }
}

pub(crate) struct InDriver(bool);

impl Drop for InDriver {
    fn drop(&mut self) {
        if self.0 {
            OWNER.set(CostOwner::System);
        }
    }
}

fn thread_nanoseconds() -> Option<u64> {
    let times = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    times.split(' ').next()?.parse().ok()
}

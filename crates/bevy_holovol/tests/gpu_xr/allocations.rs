//! Counts what the headset's systems allocate.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use bevy_holovol::xr::CostOwner;

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Of our systems, and of wgpu for them.
static MADE: [AtomicU64; 2] = [AtomicU64::new(0), AtomicU64::new(0)];

fn count() {
    let of = match CostOwner::current() {
        CostOwner::Other => return,
        CostOwner::System => 0,
        CostOwner::Driver => 1,
    };
    MADE[of].fetch_add(1, Ordering::Relaxed);
}

#[expect(unsafe_code, reason = "an allocator that counts")]
// SAFETY: all is done by the system's.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller's.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: as the caller's.
        unsafe { System.dealloc(block, layout) };
    }
}

/// While [`FrameCost`](bevy_holovol::xr::FrameCost) measures.
pub fn made() -> [u64; 2] {
    MADE.each_ref().map(|n| n.load(Ordering::Relaxed))
}

pub fn made_since(before: [u64; 2]) -> [u64; 2] {
    let now = made();
    [0, 1].map(|i| now[i] - before[i])
}

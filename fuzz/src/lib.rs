//! What the targets share: reading, and counting the memory that it takes.

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicIsize, Ordering};

use holovol_volume::{Input, ReadOptions, VolumeReader};

/// Voxels beyond this are refused: packed zeros may claim gigabytes truthfully, which is not what
/// is sought here.
const VOXEL_BYTES_MAX: u64 = 4 << 20;

/// A reader may take so many times its input, of which packed parts unpack in pieces, ...
const PER_INPUT_BYTE: usize = 4;

/// ... so many times its voxels, ...
const PER_VOXEL_BYTE: f64 = 2.5;

/// ... and this, whatever it reads: read-ahead buffers, decoders' tables, a histogram.
const FIXED_BYTES: usize = 6 << 20;

/// The system's allocator, with a count of what is in use and of the most that was.
struct Counting;

static IN_USE: AtomicIsize = AtomicIsize::new(0);
static PEAK: AtomicIsize = AtomicIsize::new(0);

fn count(change: isize) {
    let now = IN_USE.fetch_add(change, Ordering::Relaxed) + change;
    PEAK.fetch_max(now, Ordering::Relaxed);
}

// SAFETY: all calls go on to the system's allocator as they came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: the caller's promises are those that `System` asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as isize);
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size as isize - layout.size() as isize);
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as isize));
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Does the work; panics if it took more memory than the input and `voxel_bytes` justify.
fn within_memory<T>(input: &[u8], work: impl FnOnce() -> T, voxel_bytes: impl Fn(&T) -> u64) -> T {
    let before = IN_USE.load(Ordering::Relaxed);
    PEAK.store(before, Ordering::Relaxed);
    let result = work();
    let taken = (PEAK.load(Ordering::Relaxed) - before).max(0) as usize;
    let voxels = (voxel_bytes(&result) as f64 * PER_VOXEL_BYTE) as usize;
    let allowed = PER_INPUT_BYTE * input.len() + voxels + FIXED_BYTES;
    assert!(
        taken <= allowed,
        "{taken} bytes taken, {allowed} allowed for {} bytes of input",
        input.len()
    );
    result
}

/// Reads bytes as a volume; of any that is sound, everything else has to be sound, too.
pub fn read_volume(reader: &dyn VolumeReader, bytes: &[u8]) {
    let options = ReadOptions::default().with_max_voxel_bytes(VOXEL_BYTES_MAX);
    let read = || {
        let input = Input::from_bytes(Path::new("fuzz"), bytes)
            .gunzip_if_packed()
            .ok()?;
        reader.read(input, &options, &mut |_| {}).ok()
    };
    // What is refused may have been refused after the last voxel.
    let voxel_bytes = |volume: &Option<holovol_volume::Volume>| match volume {
        Some(volume) => (volume.voxels().len() * volume.voxels().kind().bytes()) as u64,
        None => VOXEL_BYTES_MAX,
    };
    let Some(volume) = within_memory(bytes, read, voxel_bytes) else {
        return;
    };
    let voxels: u64 = volume.dims().iter().map(|&n| u64::from(n)).product();
    assert_eq!(voxels, volume.voxels().len() as u64);
    let [low, high] = volume.auto_window();
    assert!(low < high && low.is_finite() && high.is_finite());
    assert!(volume.range().iter().all(|edge| edge.is_finite()));
    let world = volume.world_from_unit_cube();
    assert!(world.is_finite() && world.determinant() != 0.0);
}

//! How much memory a volume may take.

use std::path::Path;

use super::ReadOptions;
use crate::VolumeError;

/// Where the system doesn't tell what is free.
#[cfg(not(target_os = "linux"))]
const ASSUMED_FREE: u64 = 16 << 30;

/// The part of the free memory that a volume may take: its reader needs some, too.
const SHARE: u64 = 2;

/// Refuses voxels that the options or the machine's memory have no room for.
///
/// For volumes of which a small file may honestly claim a large one.
pub(super) fn check_voxel_bytes(
    path: &Path,
    bytes: Option<u64>,
    options: &ReadOptions,
) -> Result<u64, VolumeError> {
    let too_large = |bytes: u64, limit: String| VolumeError::TooLarge {
        path: path.into(),
        bytes,
        limit,
    };
    let bytes = bytes
        .filter(|&bytes| bytes <= isize::MAX as u64)
        .ok_or_else(|| too_large(u64::MAX, "the address space".into()))?;
    if let Some(limit) = options.max_voxel_bytes.filter(|&limit| bytes > limit) {
        return Err(too_large(bytes, format!("the limit of {limit}")));
    }
    // Small volumes need no look at the system.
    if bytes > 64 << 20 && bytes > free_bytes() / SHARE {
        return Err(too_large(bytes, "half of the memory that is free".into()));
    }
    Ok(bytes)
}

#[cfg(target_os = "linux")]
fn free_bytes() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("MemAvailable:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kilobytes.map_or(u64::MAX, |kilobytes| kilobytes.saturating_mul(1024))
}

#[cfg(not(target_os = "linux"))]
fn free_bytes() -> u64 {
    ASSUMED_FREE
}

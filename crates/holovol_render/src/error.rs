/// Why something could not be rendered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// No graphics adapter fits.
    #[error("{}", no_adapter(asked.as_deref(), available))]
    NoAdapter {
        /// The part of a name that was asked for.
        asked: Option<String>,
        /// Names of the adapters that are there.
        available: Vec<String>,
    },
    /// The adapter gave no device.
    #[error("graphics adapter `{adapter}` could not be opened: {reason}")]
    Device {
        /// Name of the adapter.
        adapter: String,
        /// What it said.
        reason: String,
    },
    /// The device was lost, or stopped answering, in the middle of the work.
    #[error(
        "graphics device lost while {doing}: {reason}; start again, or choose another with --adapter"
    )]
    DeviceLost {
        /// What was being done.
        doing: String,
        /// What the driver said.
        reason: String,
    },
    /// The device has no room.
    #[error(
        "graphics device out of memory for {what} ({bytes} bytes): use a smaller volume or image"
    )]
    OutOfMemory {
        /// What needed the room.
        what: String,
        /// How much, in bytes.
        bytes: u64,
    },
    /// The volume does not fit the device and must not be reduced.
    #[error(
        "volume of {dims:?} voxels exceeds this device's limit of {limit} along a side \
         (or {max_bytes} bytes): allow downsampling, or use a device with higher limits"
    )]
    VolumeTooLarge {
        /// Voxels along x, y, z.
        dims: [u32; 3],
        /// Longest side.
        limit: u32,
        /// Largest allocation, bytes.
        max_bytes: u64,
    },
    /// Something in the scene cannot be rendered.
    #[error("{field}: {reason}")]
    Scene {
        /// Which part of the scene.
        field: &'static str,
        /// What is wrong, and the way out.
        reason: String,
    },
    /// A kernel or a call was refused; a mistake of ours.
    #[error("internal error in {what}: {reason}")]
    Internal {
        /// Which part.
        what: String,
        /// What the validator or driver said.
        reason: String,
    },
}

fn no_adapter(asked: Option<&str>, available: &[String]) -> String {
    let found = if available.is_empty() {
        "none were found: install a graphics driver, or Mesa's software Vulkan \
         (mesa-vulkan-drivers), or use `--backend reference`"
            .to_owned()
    } else {
        format!("found: {}", available.join(", "))
    };
    match asked {
        Some(asked) => format!("no graphics adapter whose name contains `{asked}`; {found}"),
        None => format!("no usable graphics adapter; {found}"),
    }
}

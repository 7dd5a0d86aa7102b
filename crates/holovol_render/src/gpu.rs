use wgpu::{Features, Limits};

use crate::RenderError;

/// A device of our own, for use without a window. Bevy brings its device instead.
#[derive(Clone, Debug)]
pub struct Gpu {
    /// The wgpu device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
}

/// Features that make the kernels faster or exact on more data; none is required.
///
/// Bevy enables all that its adapter has; [`Gpu::new`] enables these.
pub fn wanted_features() -> Features {
    Features::TEXTURE_FORMAT_16BIT_NORM
        | Features::FLOAT32_FILTERABLE
        | Features::SUBGROUP
        | Features::TIMESTAMP_QUERY
}

/// The limits that the kernels need of an adapter: WebGPU's defaults, and its own largest
/// textures and buffers.
pub fn wanted_limits(adapter: &Limits) -> Limits {
    Limits {
        max_texture_dimension_2d: adapter.max_texture_dimension_2d,
        max_texture_array_layers: adapter.max_texture_array_layers,
        max_texture_dimension_3d: adapter.max_texture_dimension_3d,
        max_buffer_size: adapter.max_buffer_size,
        max_storage_buffer_binding_size: adapter.max_storage_buffer_binding_size,
        ..Limits::default()
    }
}

impl Gpu {
    /// Opens the fastest adapter, or the first whose name or driver contains `name` (any case).
    ///
    /// # Errors
    /// [`RenderError::NoAdapter`] lists what is there; [`RenderError::Device`] if it can't be opened.
    pub fn new(name: Option<&str>) -> Result<Self, RenderError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::PRIMARY;
        let instance = wgpu::Instance::new(descriptor);
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
        adapters.retain(|adapter| {
            let flags = adapter.get_downlevel_capabilities().flags;
            flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS)
        });
        adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            wgpu::DeviceType::Other => 3,
            wgpu::DeviceType::Cpu => 4,
        });
        let describe = |info: &wgpu::AdapterInfo| format!("{} ({})", info.name, info.backend);
        let available = adapters
            .iter()
            .map(|adapter| describe(&adapter.get_info()))
            .collect();
        let asked = name.map(str::to_lowercase);
        let fits = |adapter: &wgpu::Adapter| {
            let info = adapter.get_info();
            let text = format!("{} {}", describe(&info), info.driver).to_lowercase();
            asked.as_ref().is_none_or(|asked| text.contains(asked))
        };
        let Some(adapter) = adapters.iter().find(|&adapter| fits(adapter)) else {
            return Err(RenderError::NoAdapter {
                asked: name.map(Into::into),
                available,
            });
        };
        let info = adapter.get_info();
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("holovol"),
            required_features: wanted_features() & adapter.features(),
            required_limits: wanted_limits(&adapter.limits()),
            ..Default::default()
        }))
        .map_err(|error| RenderError::Device {
            adapter: info.name.clone(),
            reason: error.to_string(),
        })?;
        Ok(Self {
            device,
            queue,
            info,
        })
    }

    /// Works on a device that somebody else has opened.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue, info: wgpu::AdapterInfo) -> Self {
        Self {
            device,
            queue,
            info,
        }
    }

    /// Name of the adapter, as its driver gives it.
    pub fn adapter_name(&self) -> &str {
        &self.info.name
    }

    /// Driver, its version, and the API it is used through.
    pub fn driver(&self) -> String {
        format!(
            "{} {} ({})",
            self.info.driver, self.info.driver_info, self.info.backend
        )
    }

    /// All that is known of the adapter.
    pub fn info(&self) -> &wgpu::AdapterInfo {
        &self.info
    }

    /// Runs calls that may fail on the device inside error scopes, so that a failure comes back
    /// as a `Result` and never reaches the device's (possibly somebody else's) error handler.
    ///
    /// `what` and `bytes` are for the message.
    ///
    /// # Errors
    /// [`RenderError::OutOfMemory`], or [`RenderError::Internal`] if the calls were wrong.
    pub fn scoped<T>(
        &self,
        what: &str,
        bytes: u64,
        calls: impl FnOnce() -> T,
    ) -> Result<T, RenderError> {
        use wgpu::ErrorFilter::{Internal, OutOfMemory, Validation};
        let scopes = [OutOfMemory, Internal, Validation].map(|f| self.device.push_error_scope(f));
        let value = calls();
        let [memory, internal, validation] = scopes;
        let validation = pollster::block_on(validation.pop());
        let internal = pollster::block_on(internal.pop());
        if pollster::block_on(memory.pop()).is_some() {
            return Err(RenderError::OutOfMemory {
                what: what.into(),
                bytes,
            });
        }
        match validation.or(internal) {
            None => Ok(value),
            Some(error) => Err(RenderError::Internal {
                what: what.into(),
                reason: error.to_string(),
            }),
        }
    }

    /// Waits until the device has done all that was submitted.
    pub(crate) fn wait(&self, doing: &str) -> Result<(), RenderError> {
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map(|_| ())
            .map_err(|error| RenderError::DeviceLost {
                doing: doing.into(),
                reason: error.to_string(),
            })
    }

    /// Copies a buffer back and waits for it.
    pub(crate) fn read_buffer(
        &self,
        what: &str,
        source: &wgpu::Buffer,
        bytes: u64,
    ) -> Result<Vec<u8>, RenderError> {
        let lost = |reason: String| RenderError::DeviceLost {
            doing: format!("reading {what}"),
            reason,
        };
        let (staging, submission) = self.scoped(what, bytes, || {
            let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("holovol read-back"),
                size: bytes,
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            });
            let mut encoder = self.device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(source, 0, &staging, 0, bytes);
            (staging, self.queue.submit([encoder.finish()]))
        })?;
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver is gone only if waiting for the device has failed already.
            sender.send(result).ok();
        });
        self.device
            .poll(wgpu::PollType::Wait {
                submission_index: Some(submission),
                timeout: None,
            })
            .map_err(|error| lost(error.to_string()))?;
        match receiver.try_recv() {
            Ok(Ok(())) => Ok(staging.get_mapped_range(..).to_vec()),
            Ok(Err(error)) => Err(lost(error.to_string())),
            Err(_) => Err(lost("the driver did not finish the copy".into())),
        }
    }
}

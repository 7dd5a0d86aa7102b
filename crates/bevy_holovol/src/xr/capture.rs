//! What the headset was given, brought back: for pictures and tests.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bevy::prelude::*;
use bevy::render::render_resource::TextureFormat;
use holovol_render::wgpu;

use super::graphics::{EyeTargets, SubmittedDepth};
use super::pose::EyeView;

/// Asks for the pictures of a frame, exactly as the headset gets them. Costs that frame a wait for
/// the graphics device.
#[derive(Resource, Clone, Default)]
pub struct EyeCapture(Arc<Mutex<Capture>>);

#[derive(Default)]
struct Capture {
    is_wanted: bool,
    frame: Option<CapturedFrame>,
}

/// The pictures of one frame.
#[derive(Clone, Debug)]
pub struct CapturedFrame {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Of the pictures.
    pub format: TextureFormat,
    /// Left and right, rows from the top, without padding.
    pub pixels: [Vec<u8>; 2],
    /// Left and right, rows from the top: m along the eye's axis to what the compositor takes each
    /// pixel for, infinite where nothing is. `None` where the headset gets no depth.
    pub depths: Option<[Vec<f32>; 2]>,
    /// What they were drawn with and submitted with.
    pub views: [EyeView; 2],
    /// When they were to be shown, ns of the runtime's clock.
    pub display_time: i64,
}

impl EyeCapture {
    /// Wants the next frame that is handed over.
    pub fn request(&self) {
        self.lock().is_wanted = true;
    }

    /// The frame that was wanted, once it is there.
    pub fn take(&self) -> Option<CapturedFrame> {
        self.lock().frame.take()
    }

    fn lock(&self) -> MutexGuard<'_, Capture> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn take_from(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        targets: &EyeTargets,
        views: &[EyeView; 2],
        depth: Option<SubmittedDepth>,
        display_time: openxr::Time,
    ) {
        if !std::mem::take(&mut self.lock().is_wanted) {
            return;
        }
        let texture = &targets.color.texture;
        let depths = targets.depth.as_ref().zip(depth);
        let depths = depths.and_then(|(layers, depth)| {
            let bytes = read(device, queue, &layers.texture)?;
            Some(bytes.map(|bytes| metres(&bytes, layers.texture.format(), depth)))
        });
        let frame = read(device, queue, texture).map(|pixels| CapturedFrame {
            size: [texture.width(), texture.height()],
            format: texture.format(),
            pixels,
            depths,
            views: *views,
            display_time: display_time.as_nanos(),
        });
        self.lock().frame = frame;
    }
}

/// As the compositor reads it.
fn metres(bytes: &[u8], format: TextureFormat, depth: SubmittedDepth) -> Vec<f32> {
    let metres = |stored: f32| depth.near / stored;
    if format == TextureFormat::Depth16Unorm {
        let stored = bytes
            .chunks_exact(2)
            .map(|b| u16::from_le_bytes([b[0], b[1]]));
        stored.map(|d| metres(f32::from(d) / 65535.0)).collect()
    } else {
        let stored = bytes.chunks_exact(4).map(|b| [b[0], b[1], b[2], b[3]]);
        stored.map(|d| metres(f32::from_le_bytes(d))).collect()
    }
}

fn read(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texture: &wgpu::Texture,
) -> Option<[Vec<u8>; 2]> {
    let format = texture.format();
    let drawn = if format.has_depth_aspect() {
        wgpu::TextureUses::DEPTH_STENCIL_WRITE
    } else {
        wgpu::TextureUses::COLOR_TARGET
    };
    let pixel_bytes = format.block_copy_size(None)?;
    let row = texture.width() * pixel_bytes;
    let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let layer = u64::from(padded) * u64::from(texture.height());
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("holovol headset"),
        size: 2 * layer,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(padded),
                rows_per_image: Some(texture.height()),
            },
        },
        wgpu::Extent3d {
            width: texture.width(),
            height: texture.height(),
            depth_or_array_layers: 2,
        },
    );
    // The runtime gets it back as it expects it.
    encoder.transition_resources(
        std::iter::empty(),
        std::iter::once(wgpu::wgt::TextureTransition {
            texture,
            selector: None,
            state: drawn,
        }),
    );
    queue.submit([encoder.finish()]);
    buffer.map_async(wgpu::MapMode::Read, .., |_| {});
    device.poll(wgpu::PollType::wait_indefinitely()).ok()?;
    let mapped = buffer.get_mapped_range(..);
    Some([0, 1].map(|eye: usize| {
        let picture = &mapped[eye * layer as usize..][..layer as usize];
        let rows = picture.chunks(padded as usize);
        rows.flat_map(|bytes| &bytes[..row as usize])
            .copied()
            .collect()
    }))
}

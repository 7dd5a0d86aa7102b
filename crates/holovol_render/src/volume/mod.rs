//! A volume as a 3D texture: the smallest format that holds its numbers exactly.

use holovol_volume::{Volume, VoxelKind, Voxels};
use wgpu::{Features, TextureFormat};

use crate::{Gpu, Interpolation, RenderError};

/// Bytes handed to the queue at once: bounds the staging memory.
const UPLOAD_BYTES: usize = 32 << 20;

/// A volume in the device's memory.
pub struct GpuVolume {
    pub(crate) view: wgpu::TextureView,
    /// Whether the texture is an array of slices, for exact interpolation by two gathers of four
    /// texels instead of eight loads; else it is 3D.
    pub(crate) slices: bool,
    format: TextureFormat,
    texels: [u32; 3],
    factor: u32,
    /// Of the volume it was made of: voxels along x, y, z, and value = slope · stored + intercept.
    dims: [u32; 3],
    slope: f64,
    intercept: f64,
    /// stored = scale · texel + offset
    scale: f64,
    offset: f64,
    notices: Vec<String>,
}

/// How stored numbers become texels.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Encoding {
    format: TextureFormat,
    scale: f64,
    offset: f64,
}

impl Encoding {
    fn choose(volume: &Volume, features: Features, interpolation: Interpolation) -> Self {
        let hardware = interpolation == Interpolation::Hardware;
        let float = if hardware && !features.contains(Features::FLOAT32_FILTERABLE) {
            TextureFormat::R16Float
        } else {
            TextureFormat::R32Float
        };
        let sixteen_bit = features.contains(Features::TEXTURE_FORMAT_16BIT_NORM);
        let (format, scale, offset) = match volume.voxels().kind() {
            VoxelKind::U8 => (TextureFormat::R8Unorm, 255.0, 0.0),
            VoxelKind::I8 => (TextureFormat::R8Unorm, 255.0, -128.0),
            VoxelKind::U16 if sixteen_bit => (TextureFormat::R16Unorm, 65535.0, 0.0),
            VoxelKind::I16 if sixteen_bit => (TextureFormat::R16Unorm, 65535.0, -32768.0),
            // About the middle: f16 overflows at 65,520, and its steps are smallest near 0.
            _ if float == TextureFormat::R16Float => {
                let [low, high] = volume
                    .range()
                    .map(|value| (value - volume.intercept()) / volume.slope());
                let half_range = 0.5 * (high - low).abs();
                let scale = if half_range > 0.0 { half_range } else { 1.0 };
                (float, scale, 0.5 * (low + high))
            }
            _ => (float, 1.0, 0.0),
        };
        Self {
            format,
            scale,
            offset,
        }
    }

    fn bytes(self) -> usize {
        match self.format {
            TextureFormat::R8Unorm => 1,
            TextureFormat::R16Unorm | TextureFormat::R16Float => 2,
            _ => 4,
        }
    }

    /// Appends the texels of stored numbers [start, end).
    fn encode(self, voxels: &Voxels, start: usize, end: usize, out: &mut Vec<u8>) {
        match (self.format, voxels) {
            (TextureFormat::R8Unorm, Voxels::U8(v)) => out.extend_from_slice(&v[start..end]),
            (TextureFormat::R8Unorm, Voxels::I8(v)) => {
                out.extend(v[start..end].iter().map(|&x| (x as u8) ^ 0x80));
            }
            (TextureFormat::R16Unorm, Voxels::U16(v)) => {
                out.extend_from_slice(bytemuck::cast_slice(&v[start..end]));
            }
            (TextureFormat::R16Unorm, Voxels::I16(v)) => {
                let texels = v[start..end].iter().map(|&x| (x as u16) ^ 0x8000);
                out.extend(texels.flat_map(u16::to_ne_bytes));
            }
            (TextureFormat::R16Float, voxels) => {
                let texel = |i| half::f16::from_f64((voxels.stored(i) - self.offset) / self.scale);
                let texels = (start..end).map(texel);
                out.extend(texels.flat_map(|x| x.to_ne_bytes()));
            }
            (_, Voxels::F32(v)) => out.extend_from_slice(bytemuck::cast_slice(&v[start..end])),
            (_, voxels) => {
                out.extend((start..end).flat_map(|i| (voxels.stored(i) as f32).to_ne_bytes()));
            }
        }
    }
}

impl GpuVolume {
    /// Uploads a volume. One beyond the device's limits has f³ voxels averaged into one, with a
    /// notice that says so, unless `exact` is asked for.
    ///
    /// # Errors
    /// [`RenderError::VolumeTooLarge`] if `exact` and it does not fit, [`RenderError::OutOfMemory`].
    pub fn new(
        gpu: &Gpu,
        volume: &Volume,
        interpolation: Interpolation,
        exact: bool,
    ) -> Result<Self, RenderError> {
        let limit = gpu.device.limits().max_texture_dimension_3d;
        let longest = volume.dims().into_iter().max().unwrap_or(1);
        let factor = longest.div_ceil(limit);
        let mut notices = Vec::new();
        let reduced;
        let source = if factor == 1 {
            volume
        } else if exact {
            return Err(RenderError::VolumeTooLarge {
                dims: volume.dims(),
                limit,
                max_bytes: gpu.device.limits().max_buffer_size,
            });
        } else {
            notices.push(format!(
                "volume of {:?} voxels exceeds the device's {limit} along a side: \
                 {factor}×{factor}×{factor} voxels are averaged into one",
                volume.dims()
            ));
            reduced = downsample(volume, factor)?;
            &reduced
        };
        let encoding = Encoding::choose(source, gpu.device.features(), interpolation);
        if encoding.format == TextureFormat::R16Float && source.voxels().kind() != VoxelKind::U8 {
            notices.push(
                "this device filters no format that holds these values exactly: 16-bit floats \
                 keep 11 significant bits; --interpolation exact keeps all"
                    .into(),
            );
        }
        let layers = gpu.device.limits().max_texture_array_layers;
        let slices = interpolation == Interpolation::Exact && source.dims()[2] <= layers;
        let view = upload(gpu, source, encoding, slices)?;
        Ok(Self {
            view,
            slices,
            format: encoding.format,
            texels: source.dims(),
            factor,
            dims: volume.dims(),
            slope: volume.slope(),
            intercept: volume.intercept(),
            scale: encoding.scale,
            offset: encoding.offset,
            notices,
        })
    }

    /// The texture's format.
    pub fn format(&self) -> TextureFormat {
        self.format
    }

    /// Texels along x, y, z.
    pub fn texels(&self) -> [u32; 3] {
        self.texels
    }

    /// Voxels along x, y, z of the volume it was made of.
    pub fn dims(&self) -> [u32; 3] {
        self.dims
    }

    /// Texel coordinates at which the volume ends.
    pub(crate) fn extent(&self) -> [f64; 3] {
        self.dims.map(|n| f64::from(n) / f64::from(self.factor))
    }

    /// (x, y) of s = (texel − x) · y for a window in data units.
    pub(crate) fn s_from_texel(&self, window: [f64; 2]) -> [f64; 2] {
        let stored = (window[0] - self.intercept) / self.slope;
        let zero = (stored - self.offset) / self.scale;
        [zero, self.scale * self.slope / (window[1] - window[0])]
    }

    /// What a user should know of how the volume was stored.
    pub fn notices(&self) -> &[String] {
        &self.notices
    }
}

fn upload(
    gpu: &Gpu,
    volume: &Volume,
    encoding: Encoding,
    slices: bool,
) -> Result<wgpu::TextureView, RenderError> {
    let (dimension, view_dimension) = if slices {
        (
            wgpu::TextureDimension::D2,
            wgpu::TextureViewDimension::D2Array,
        )
    } else {
        (wgpu::TextureDimension::D3, wgpu::TextureViewDimension::D3)
    };
    let [width, height, depth] = volume.dims();
    let slice = width as usize * height as usize;
    let slice_bytes = slice * encoding.bytes();
    let texture = gpu.scoped("the volume", (slice_bytes * depth as usize) as u64, || {
        gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("holovol volume"),
            size: wgpu::Extent3d {
                width,
                height,
                depth_or_array_layers: depth,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension,
            format: encoding.format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        })
    })?;
    let slices_at_once = (UPLOAD_BYTES / slice_bytes).max(1) as u32;
    let mut bytes = Vec::new();
    for z in (0..depth).step_by(slices_at_once as usize) {
        let count = slices_at_once.min(depth - z);
        bytes.clear();
        encoding.encode(
            volume.voxels(),
            z as usize * slice,
            (z + count) as usize * slice,
            &mut bytes,
        );
        gpu.scoped("the volume's upload", bytes.len() as u64, || {
            gpu.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    texture: &texture,
                    mip_level: 0,
                    origin: wgpu::Origin3d { x: 0, y: 0, z },
                    aspect: wgpu::TextureAspect::All,
                },
                &bytes,
                wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(width * encoding.bytes() as u32),
                    rows_per_image: Some(height),
                },
                wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: count,
                },
            );
            gpu.queue.submit([]);
        })?;
        gpu.wait("uploading the volume")?;
    }
    Ok(texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(view_dimension),
        ..Default::default()
    }))
}

/// Means over factor³ voxels; blocks at the far borders may hold fewer.
fn downsample(volume: &Volume, factor: u32) -> Result<Volume, RenderError> {
    let dims = volume.dims();
    let reduced = dims.map(|n| n.div_ceil(factor));
    let mut means = Vec::with_capacity(reduced.iter().map(|&n| n as usize).product());
    let span = |axis: usize, i: u32| i * factor..((i + 1) * factor).min(dims[axis]);
    let [nx, ny] = [dims[0] as usize, dims[1] as usize];
    for z in 0..reduced[2] {
        for y in 0..reduced[1] {
            for x in 0..reduced[0] {
                let (mut sum, mut count) = (0.0, 0.0);
                for k in span(2, z) {
                    for j in span(1, y) {
                        for i in span(0, x) {
                            let index = i as usize + nx * (j as usize + ny * k as usize);
                            sum += volume.voxels().stored(index);
                            count += 1.0;
                        }
                    }
                }
                means.push((sum / count) as f32);
            }
        }
    }
    Volume::new(
        Voxels::F32(means),
        reduced,
        volume.slope(),
        volume.intercept(),
        *volume.geometry(),
    )
    .map_err(|error| RenderError::Scene {
        field: "volume",
        reason: error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holovol_volume::Geometry;

    #[test]
    fn half_floats_hold_any_range() {
        for (voxels, range) in [
            (Voxels::F32(vec![-2e5, 0.0, 1e6, 7e5]), 1.2e6),
            (Voxels::U16(vec![0, 65535, 40000, 1]), 65535.0),
            (Voxels::F32(vec![3.0; 4]), 1.0),
        ] {
            let geometry = Geometry::from_spacing([1.0; 3]);
            let volume = Volume::new(voxels, [4, 1, 1], -2.0, 5.0, geometry).unwrap();
            let encoding = Encoding::choose(&volume, Features::empty(), Interpolation::Hardware);
            assert_eq!(encoding.format, TextureFormat::R16Float);
            let mut bytes = Vec::new();
            encoding.encode(volume.voxels(), 0, 4, &mut bytes);
            for (i, bytes) in bytes.chunks(2).enumerate() {
                let texel = half::f16::from_ne_bytes([bytes[0], bytes[1]]).to_f64();
                let stored = encoding.scale * texel + encoding.offset;
                let error = (stored - volume.voxels().stored(i)).abs();
                assert!(error <= range * 2f64.powi(-12), "{stored}, off by {error}");
            }
        }
    }
}

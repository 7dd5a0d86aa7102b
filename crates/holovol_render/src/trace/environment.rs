use holovol_light::{EnvironmentMap, EnvironmentSampler, LIGHT_BANDS};
use wgpu::util::DeviceExt;

use crate::denoise::Sun;
use crate::{Gpu, RenderError};

/// An environment map in the device's memory, with the table that light is drawn from.
pub struct GpuEnvironment {
    pub(super) view: wgpu::TextureView,
    /// A texture: buffers that a shader may bind end at 128 MiB on some devices, an 8K map's table
    /// doesn't.
    pub(super) alias: wgpu::TextureView,
    size: [u32; 2],
    constant: Option<[f32; 3]>,
    /// Where most light comes from.
    sun: Option<Sun>,
    mean: f64,
    /// 1 / integral of importance; `None` if nothing can be drawn: a constant or a black map.
    normalisation: Option<f64>,
    /// Of the table that light is drawn from.
    alias_rows: u32,
}

impl GpuEnvironment {
    /// Uploads a map as 32-bit floats: suns pass what 16 bits hold. One texel if it is constant.
    ///
    /// # Errors
    /// If the map is larger than the device allows or doesn't fit its memory.
    pub fn new(gpu: &Gpu, map: &EnvironmentMap) -> Result<Self, RenderError> {
        let constant = map.as_constant();
        let (width, height) = if constant.is_some() {
            (1, 1)
        } else {
            (map.width() as u32, map.height() as u32)
        };
        let limit = gpu.device.limits().max_texture_dimension_2d;
        // The table has more rows than the map.
        let alias_rows = (height + 1).next_multiple_of(LIGHT_BANDS as u32);
        if width > limit || alias_rows > limit {
            return Err(RenderError::Scene {
                field: "environment",
                reason: format!(
                    "map of {width} × {height}: this device holds at most {limit} × {}; make it \
                     smaller",
                    limit - limit % LIGHT_BANDS as u32 - 1
                ),
            });
        }
        let sampler = if constant.is_some() {
            None
        } else {
            EnvironmentSampler::new(map)
        };
        let alias: Vec<[u32; 2]> = match &sampler {
            Some(sampler) => {
                let entries = sampler.entries().iter();
                entries
                    .map(|entry| {
                        let [column, row] = entry.alias.map(u32::from);
                        [entry.threshold.to_bits(), column | row << 16]
                    })
                    .collect()
            }
            None => vec![[0, 0]; width as usize],
        };
        let alias_rows = (alias.len() / width as usize) as u32;
        let texels: Vec<[f32; 4]> = map.texels()[..width as usize * height as usize]
            .iter()
            .map(|&[r, g, b]| [r, g, b, 0.0])
            .collect();
        let bytes = 16 * texels.len() as u64 + 8 * alias.len() as u64;
        let (view, alias) = gpu.scoped("the environment", bytes, || {
            let texture = |label, height, format, data| {
                let texture = gpu.device.create_texture_with_data(
                    &gpu.queue,
                    &wgpu::TextureDescriptor {
                        label: Some(label),
                        size: wgpu::Extent3d {
                            width,
                            height,
                            depth_or_array_layers: 1,
                        },
                        mip_level_count: 1,
                        sample_count: 1,
                        dimension: wgpu::TextureDimension::D2,
                        format,
                        usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST,
                        view_formats: &[],
                    },
                    wgpu::util::TextureDataOrder::LayerMajor,
                    data,
                );
                texture.create_view(&Default::default())
            };
            (
                texture(
                    "holovol environment",
                    height,
                    wgpu::TextureFormat::Rgba32Float,
                    bytemuck::cast_slice(&texels),
                ),
                texture(
                    "holovol light",
                    alias_rows,
                    wgpu::TextureFormat::Rg32Uint,
                    bytemuck::cast_slice(&alias),
                ),
            )
        })?;
        Ok(Self {
            view,
            alias,
            size: [width, height],
            constant,
            sun: Sun::find(map),
            mean: mean_radiance(map),
            normalisation: sampler.map(|sampler| sampler.normalisation()),
            alias_rows,
        })
    }

    /// Whether its radiance is the same from everywhere.
    pub fn is_constant(&self) -> bool {
        self.constant.is_some()
    }

    /// Its dominant light, in the map's frame.
    pub(crate) fn sun(&self) -> Option<Sun> {
        self.sun
    }

    /// Over all directions, and over R, G, B.
    pub(super) fn mean_radiance(&self) -> f64 {
        self.mean
    }

    /// Whether directions can be drawn from its table.
    pub(crate) fn has_density(&self) -> bool {
        self.normalisation.is_some()
    }

    /// `environment_size` of the scene uniform: a constant map's scaled radiance, or the size of
    /// another, the normalisation of its density, and rows of a band of its table.
    pub(super) fn size_or_radiance(&self, scale: f64) -> [f32; 4] {
        match self.constant {
            Some(radiance) => {
                let [r, g, b] = radiance.map(|c| (f64::from(c) * scale) as f32);
                [r, g, b, 0.0]
            }
            None => {
                let normalisation = self.normalisation.unwrap_or(0.0) as f32;
                let [width, height] = self.size.map(|n| n as f32);
                let band_rows = self.alias_rows / LIGHT_BANDS as u32;
                [width, height, normalisation, band_rows as f32]
            }
        }
    }
}
/// Over all directions, and over R, G, B.
fn mean_radiance(map: &EnvironmentMap) -> f64 {
    let (width, height) = (map.width(), map.height());
    let rows = map.texels().chunks_exact(width).take(height).enumerate();
    let (mut sum, mut all) = (0.0, 0.0);
    for (y, row) in rows {
        let solid_angle = ((y as f64 + 0.5) / height as f64 * std::f64::consts::PI).sin();
        let texels = row.iter().flatten().map(|&c| f64::from(c));
        sum += solid_angle * texels.sum::<f64>() / (3 * width) as f64;
        all += solid_angle;
    }
    sum / all
}

//! Majorants of 8³ cells.
//!
//! The range of values in each cell is found once per volume. When the transfer function or the
//! window changes, one small dispatch takes the largest extinction over each cell's range from a
//! sparse table (range maximum over the points), and the box of cells that are not empty.

#[cfg(any(test, feature = "testing"))]
pub mod cpu;
#[cfg(test)]
mod tests;

use bytemuck::{Pod, Zeroable};
use holovol_volume::TransferFunction;
use wgpu::util::DeviceExt;

use crate::shader::{ShaderFile, shader_file};
use crate::{Gpu, GpuVolume, RenderError};

pub(crate) const MAJORANT: ShaderFile = shader_file!("majorant.wgsl");

/// Majorants of a volume under a transfer function.
pub struct MajorantGrid {
    pub(crate) view: wgpu::TextureView,
    pub(crate) occupied: wgpu::Buffer,
    layout: wgpu::BindGroupLayout,
    majorant_pipeline: wgpu::ComputePipeline,
    pub(crate) cell_ranges: wgpu::Buffer,
    field_view: wgpu::TextureView,
    cells: [u32; 3],
    texels: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    dims: [u32; 4],
    cells: [u32; 4],
    field: [f32; 4],
}

/// Row k, entry i: the largest of `values[i..i + 2^k]`, cut at the end.
pub(crate) fn range_maximum_table(values: &[f32]) -> Vec<f32> {
    let mut table = values.to_vec();
    let mut span = 1;
    while 2 * span <= values.len() {
        let previous = table.len() - values.len();
        for i in 0..values.len() {
            let right = (i + span).min(values.len() - 1);
            table.push(table[previous + i].max(table[previous + right]));
        }
        span *= 2;
    }
    table
}

impl MajorantGrid {
    /// Finds the range of values in each cell of `cell_size`³ voxels.
    ///
    /// # Errors
    /// If the device fails or has no room.
    pub fn new(gpu: &Gpu, volume: &GpuVolume, cell_size: u32) -> Result<Self, RenderError> {
        let texels = volume.texels();
        let cells = texels.map(|n| n.div_ceil(cell_size));
        let count: u64 = cells.iter().map(|&n| u64::from(n)).product();
        let layout = layout(gpu, volume.slices)?;
        let defs = vec![
            ("CELL_SIZE", cell_size),
            ("SLICES", u32::from(volume.slices)),
        ];
        let range_pipeline = gpu.pipeline(&MAJORANT, &defs, "cell_range", &layout)?;
        let majorant_pipeline = gpu.pipeline(&MAJORANT, &defs, "majorant", &layout)?;
        let (texture, cell_ranges, occupied) =
            gpu.scoped("the majorant grid", 12 * count, || {
                let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                    label: Some("holovol majorants"),
                    size: wgpu::Extent3d {
                        width: cells[0],
                        height: cells[1],
                        depth_or_array_layers: cells[2],
                    },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D3,
                    format: wgpu::TextureFormat::R32Float,
                    usage: wgpu::TextureUsages::TEXTURE_BINDING
                        | wgpu::TextureUsages::STORAGE_BINDING,
                    view_formats: &[],
                });
                let buffer = |label, size| {
                    gpu.device.create_buffer(&wgpu::BufferDescriptor {
                        label: Some(label),
                        size,
                        usage: wgpu::BufferUsages::STORAGE
                            | wgpu::BufferUsages::COPY_DST
                            | wgpu::BufferUsages::COPY_SRC,
                        mapped_at_creation: false,
                    })
                };
                let ranges = buffer("holovol cell ranges", 8 * count);
                (texture, ranges, buffer("holovol occupied cells", 32))
            })?;
        let grid = Self {
            view: texture.create_view(&Default::default()),
            occupied,
            layout,
            majorant_pipeline,
            cell_ranges,
            field_view: volume.view.clone(),
            cells,
            texels,
        };
        grid.dispatch(gpu, &range_pipeline, [0.0, 1.0], &[[0.0; 2]])?;
        Ok(grid)
    }

    /// Takes the majorants of a transfer function on s = (texel − x) · y.
    ///
    /// # Errors
    /// If the device fails or has no room.
    pub fn update(
        &self,
        gpu: &Gpu,
        transfer_function: &TransferFunction,
        s_from_texel: [f64; 2],
    ) -> Result<(), RenderError> {
        let points: Vec<_> = transfer_function
            .points()
            .iter()
            .map(|point| [point.s as f32, point.sigma_t as f32])
            .collect();
        let empty = [i32::MAX, i32::MAX, i32::MAX, 0, 0, 0, 0, 0];
        gpu.queue
            .write_buffer(&self.occupied, 0, bytemuck::bytes_of(&empty));
        self.dispatch(
            gpu,
            &self.majorant_pipeline,
            s_from_texel.map(|x| x as f32),
            &points,
        )
    }

    /// Cells along x, y, z.
    pub fn cells(&self) -> [u32; 3] {
        self.cells
    }

    fn dispatch(
        &self,
        gpu: &Gpu,
        pipeline: &wgpu::ComputePipeline,
        field: [f32; 2],
        points: &[[f32; 2]],
    ) -> Result<(), RenderError> {
        let pad = |[x, y, z]: [u32; 3], w| [x, y, z, w];
        let params = Params {
            dims: pad(self.texels, 0),
            cells: pad(self.cells, points.len() as u32),
            field: [field[0], field[1], 0.0, 0.0],
        };
        let sigma_t: Vec<f32> = points.iter().map(|point| point[1]).collect();
        gpu.scoped("majorants", 0, || {
            let buffer = |label, contents, usage| {
                gpu.device
                    .create_buffer_init(&wgpu::util::BufferInitDescriptor {
                        label: Some(label),
                        contents,
                        usage,
                    })
            };
            use wgpu::BufferUsages as Usage;
            let params = buffer(
                "holovol majorant",
                bytemuck::bytes_of(&params),
                Usage::UNIFORM,
            );
            let table = range_maximum_table(&sigma_t);
            let table = buffer(
                "range maximum",
                bytemuck::cast_slice(&table),
                Usage::STORAGE,
            );
            let points = buffer("points", bytemuck::cast_slice(points), Usage::STORAGE);
            let texture = wgpu::BindingResource::TextureView;
            let resources = [
                params.as_entire_binding(),
                texture(&self.field_view),
                self.cell_ranges.as_entire_binding(),
                texture(&self.view),
                points.as_entire_binding(),
                table.as_entire_binding(),
                self.occupied.as_entire_binding(),
            ];
            let bind_group = gpu.bind_group("holovol majorants", &self.layout, resources);
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("holovol majorants"),
                timestamp_writes: None,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &bind_group, &[]);
            let [x, y, z] = self.cells.map(|n| n.div_ceil(4));
            pass.dispatch_workgroups(x, y, z);
            drop(pass);
            gpu.queue.submit([encoder.finish()]);
        })
    }
}

fn layout(gpu: &Gpu, slices: bool) -> Result<wgpu::BindGroupLayout, RenderError> {
    use crate::layout::{storage, texture_3d, uniform};
    let entries = [
        uniform(),
        if slices {
            crate::layout::texture_2d_array(false)
        } else {
            texture_3d(false)
        },
        storage(false),
        wgpu::BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::WriteOnly,
            format: wgpu::TextureFormat::R32Float,
            view_dimension: wgpu::TextureViewDimension::D3,
        },
        storage(true),
        storage(true),
        storage(false),
    ];
    gpu.bind_group_layout("holovol majorants", &entries)
}

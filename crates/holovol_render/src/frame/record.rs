//! What goes into a frame's commands.

use super::split::Split;
use super::view::Slot;
use super::{
    FrameKernels, FrameTracer, FrameWork, SHARE_BLOCK, SPREAD_SAMPLES, ViewFrame, beginning_seed,
};
use crate::RenderError;
use crate::trace::{
    DispatchUniform, GpuCounters, PIXEL_BYTES, QUEUE_CAPACITY, ViewUniform, kernel_seed,
};

impl FrameTracer {
    /// Brings a slot to a frame's wishes.
    pub(super) fn prepare_view(&mut self, encoder: &mut wgpu::CommandEncoder, frame: &ViewFrame) {
        let slot = &mut self.slots[frame.slot];
        let [width, height] = frame.view.size;
        assert!(
            width <= slot.room[0] && height <= slot.room[1],
            "a view no larger than its room"
        );
        let begins = slot.begins_with(frame);
        if frame.samples == 0 {
            // Stands still, with what there is.
            slot.is_stale |= frame.restart;
            return;
        }
        if begins {
            let pixel = PIXEL_BYTES;
            encoder.clear_buffer(
                &self.buffers.accumulators,
                pixel * u64::from(slot.first_pixel),
                Some(pixel * u64::from(width) * u64::from(height)),
            );
            slot.view = Some(frame.view);
            slot.is_stale = false;
            slot.world_from_unit_cube = self.medium.world_from_unit_cube;
            slot.mesh_depth = frame.mesh_depth;
            slot.samples = 0;
            self.beginnings += 1;
            let mut uniform = ViewUniform::new(&frame.view, &self.medium, &self.volume);
            uniform.image[2] = slot.first_pixel;
            uniform.image[3] = kernel_seed(beginning_seed(self.options.seed, self.beginnings));
            slot.uniform = uniform;
        }
        if let Some(depth) = frame.mesh_depth {
            slot.uniform.mesh_depth = [depth.size[0], depth.size[1], depth.first, depth.count];
        }
        let start = slot.samples;
        let end = start.saturating_add(frame.samples).min(frame.max_samples);
        if end > start && frame.view.is_valid() {
            slot.samples = end;
            let few = match frame.max_samples {
                most @ ..=SPREAD_SAMPLES => most,
                _ => 0,
            };
            let texels_per_cell = self
                .fresh_light
                .as_ref()
                .map_or(0, |fresh| fresh.texels_per_cell);
            slot.uniform.samples = [start, end, few, texels_per_cell];
        }
    }

    pub(super) fn bind(
        &mut self,
        mesh_depth: Option<&wgpu::TextureView>,
    ) -> Result<(), RenderError> {
        if self.bound_mesh_depth.as_ref() != mesh_depth {
            self.bound_mesh_depth = mesh_depth.cloned();
            self.bind_groups = None;
        }
        if self.bind_groups.is_none() {
            self.bind_groups = Some(self.buffers.bind_groups(
                &self.gpu,
                &self.layout,
                &self.volume,
                &self.majorants,
                &self.environment,
                mesh_depth,
                self.shares.view(),
                self.fresh_light.as_ref(),
                0..self.buffers.pixels(),
            )?);
        }
        Ok(())
    }

    pub(super) fn record_dispatches(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        kernels: &FrameKernels,
    ) -> Result<FrameWork, RenderError> {
        let mut work = FrameWork::default();
        let Some(bind_groups) = self.bind_groups.clone() else {
            return Ok(work);
        };
        let traced = || self.slots.iter().filter(|slot| slot.is_traced());
        let [left, top, right, bottom] = traced()
            .filter_map(|slot| slot.view?.bounds(&self.medium.corners()))
            .fold([u32::MAX, u32::MAX, 0, 0], |a, b| {
                [
                    a[0].min(b[0]),
                    a[1].min(b[1]),
                    a[2].max(b[2]),
                    a[3].max(b[3]),
                ]
            });
        // Blocks that share their samples are workgroups.
        let has_shares = self.shares.are_there();
        let [left, top] = match has_shares {
            true => [left, top].map(|n| n / SHARE_BLOCK * SHARE_BLOCK),
            false => [left, top],
        };
        let count = |slot: &Slot| slot.uniform.samples[1] - slot.uniform.samples[0];
        let split = Split::new(
            [left, top, right, bottom],
            traced().count() as u32,
            traced().map(count).max().unwrap_or(0),
            // A block's share is of all samples.
            has_shares,
            self.samples_per_dispatch,
        );
        let tiles: Vec<_> = split
            .tiles()
            .map(|[tile_origin, tile_size]| DispatchUniform {
                tile_origin,
                tile_size,
                seed: 0,
                budget: self.options.budget,
                resumed_paths: 0,
                queue_capacity: QUEUE_CAPACITY,
            })
            .collect();
        // Slots keep their place, so that a path that was saved finds its view again.
        let views: Vec<_> = self.slots.iter().map(|slot| slot.uniform).collect();
        let of_batch = |batch: [u32; 2]| {
            let mut views = views.clone();
            for view in &mut views {
                let [start, end, ..] = view.samples;
                let [first, last] = batch.map(|n| start.saturating_add(n).min(end));
                [view.samples[0], view.samples[1]] = [first, last];
            }
            views
        };
        let batches: Vec<_> = split.batches().map(of_batch).collect();
        let queue = &self.gpu.queue;
        if let ([tile], [views]) = (&tiles[..], &batches[..]) {
            queue.write_buffer(&self.buffers.dispatch, 0, bytemuck::bytes_of(tile));
            queue.write_buffer(&self.buffers.views, 0, bytemuck::cast_slice(views));
            self.record_tile(encoder, kernels, &bind_groups, tile);
            work.dispatches += 5;
        } else if !tiles.is_empty() {
            // The device takes them from here as their turn comes.
            let mut contents: Vec<u8> = bytemuck::cast_slice(&tiles).to_vec();
            let views_from = contents.len() as u64;
            for views in &batches {
                contents.extend_from_slice(bytemuck::cast_slice(views));
            }
            let parts = self.parts(&contents)?;
            let tile_bytes = size_of::<DispatchUniform>() as u64;
            let view_bytes = size_of_val(&views[..]) as u64;
            for batch in 0..batches.len() as u64 {
                let from = views_from + batch * view_bytes;
                encoder.copy_buffer_to_buffer(&parts, from, &self.buffers.views, 0, view_bytes);
                for (index, tile) in (0..).zip(&tiles) {
                    let from = index * tile_bytes;
                    let to = &self.buffers.dispatch;
                    encoder.copy_buffer_to_buffer(&parts, from, to, 0, tile_bytes);
                    self.record_tile(encoder, kernels, &bind_groups, tile);
                    work.dispatches += 5;
                }
            }
        }
        for (slot, view) in views.iter().enumerate() {
            let samples = view.samples[1] - view.samples[0];
            let pixels = u64::from(view.image[0]) * u64::from(view.image[1]);
            work.samples += match self.shares.of(slot) {
                Some(shares) => shares.total(samples),
                None => pixels * u64::from(samples),
            };
        }
        self.readback.record(encoder, &self.buffers.counters);
        Ok(work)
    }

    /// A buffer that holds this when the frame is submitted.
    fn parts(&mut self, contents: &[u8]) -> Result<wgpu::Buffer, RenderError> {
        let bytes = contents.len() as u64;
        let parts = match &self.parts {
            Some(parts) if parts.size() >= bytes => parts.clone(),
            _ => {
                let usage = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
                let size = bytes.next_power_of_two();
                let make = || self.gpu.empty("holovol parts of a frame", size, usage);
                let made = self.gpu.scoped("parts of a frame", size, make)?;
                self.parts.insert(made).clone()
            }
        };
        self.gpu.queue.write_buffer(&parts, 0, contents);
        Ok(parts)
    }

    /// The paths of one tile, to their end.
    fn record_tile(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        kernels: &FrameKernels,
        bind_groups: &[wgpu::BindGroup; 2],
        tile: &DispatchUniform,
    ) {
        // The words that the kernels which count saved paths write.
        encoder.clear_buffer(&self.buffers.counters, GpuCounters::FLOW, Some(8));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("holovol trace"),
            timestamp_writes: None,
        });
        let [x, y] = tile.tile_size.map(|n| n.div_ceil(8));
        pass.set_pipeline(&kernels.trace);
        pass.set_bind_group(0, &bind_groups[0], &[]);
        pass.dispatch_workgroups(x, y, self.slots.len() as u32);
        // Paths that outlived their budget; the last dispatch has none.
        for (count, bind_group) in self.resume.pipelines.iter().zip([1, 0]) {
            pass.set_pipeline(count);
            pass.set_bind_group(0, &self.resume.bind_group, &[]);
            pass.dispatch_workgroups(1, 1, 1);
            pass.set_pipeline(&kernels.resume);
            pass.set_bind_group(0, &bind_groups[bind_group], &[]);
            pass.dispatch_workgroups_indirect(&self.resume.workgroups, 0);
        }
    }
}

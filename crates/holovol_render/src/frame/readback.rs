use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use crate::{Gpu, RenderError};

/// A small buffer's contents, some frames later, without waiting.
pub(crate) struct Readback {
    staging: wgpu::Buffer,
    state: State,
}

enum State {
    Idle,
    /// Recorded into an encoder that the caller submits before the next frame.
    Recorded,
    Mapping(Arc<AtomicU8>),
}

const PENDING: u8 = 0;
const MAPPED: u8 = 1;
const FAILED: u8 = 2;

impl Readback {
    pub(crate) fn new(gpu: &Gpu, size: u64) -> Result<Self, RenderError> {
        let staging = gpu.scoped("counters", size, || {
            let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
            gpu.empty("holovol read-back", size, usage)
        })?;
        Ok(Self {
            staging,
            state: State::Idle,
        })
    }

    /// Copies the buffer, unless a copy is under way.
    pub(crate) fn record(&mut self, encoder: &mut wgpu::CommandEncoder, source: &wgpu::Buffer) {
        if matches!(self.state, State::Idle) {
            encoder.copy_buffer_to_buffer(source, 0, &self.staging, 0, self.staging.size());
            self.state = State::Recorded;
        }
    }

    /// Once per frame, before [`Self::record`]: the contents, once they are there.
    pub(crate) fn poll(&mut self) -> Option<Vec<u8>> {
        match &self.state {
            State::Idle => None,
            State::Recorded => {
                let flag = Arc::new(AtomicU8::new(PENDING));
                let result = Arc::clone(&flag);
                self.staging
                    .map_async(wgpu::MapMode::Read, .., move |mapped| {
                        let outcome = if mapped.is_ok() { MAPPED } else { FAILED };
                        result.store(outcome, Ordering::Release);
                    });
                self.state = State::Mapping(flag);
                None
            }
            State::Mapping(flag) => {
                let outcome = flag.load(Ordering::Acquire);
                if outcome == PENDING {
                    return None;
                }
                self.state = State::Idle;
                if outcome == FAILED {
                    return None;
                }
                let bytes = self.staging.get_mapped_range(..).to_vec();
                self.staging.unmap();
                Some(bytes)
            }
        }
    }
}

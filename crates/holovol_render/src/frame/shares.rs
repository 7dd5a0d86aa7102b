//! Where an image gets fewer samples: at the edge of sight, and where nobody looks.
//!
//! Samples that are fewer weigh more, so that every pixel's expectation, and what it is divided by,
//! stay what they are: unbiased, noisier in places.

use std::sync::Arc;

use crate::{Gpu, RenderError};

/// Pixels along a side of a block: those of a workgroup.
pub const SHARE_BLOCK: u32 = 8;

/// How many of a frame's samples each block of 8 × 8 pixels gets.
///
/// Of n samples a block of share s gets ⌈n·s/255⌉: 255 is all, 0 none (its pixels stay empty), and
/// whatever is between at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SampleShares {
    size: [u32; 2],
    shares: Vec<u8>,
    /// Pixels of each share.
    pixels: Vec<u64>,
}

impl SampleShares {
    /// For an image of `size` pixels: `share` is asked for the first pixel and the one past the
    /// last of each block.
    pub fn new(size: [u32; 2], mut share: impl FnMut([u32; 2], [u32; 2]) -> u8) -> Self {
        let [across, down] = size.map(|n| n.div_ceil(SHARE_BLOCK));
        let mut shares = Vec::with_capacity((across * down) as usize);
        let mut pixels = vec![0; 256];
        for y in 0..down {
            for x in 0..across {
                let first = [x, y].map(|n| n * SHARE_BLOCK);
                let end = [0, 1].map(|i| (first[i] + SHARE_BLOCK).min(size[i]));
                let share = share(first, end);
                pixels[usize::from(share)] +=
                    u64::from(end[0] - first[0]) * u64::from(end[1] - first[1]);
                shares.push(share);
            }
        }
        Self {
            size,
            shares,
            pixels,
        }
    }

    /// The image that they are for, pixels across and down.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Of each block, row by row.
    pub fn blocks(&self) -> &[u8] {
        &self.shares
    }

    fn block_counts(&self) -> [u32; 2] {
        self.size.map(|n| n.div_ceil(SHARE_BLOCK))
    }

    /// Samples of all pixels where each is given `samples`.
    pub fn total(&self, samples: u32) -> u64 {
        let of_share = |share: usize| (u64::from(samples) * share as u64).div_ceil(255);
        let pixels = self.pixels.iter().enumerate();
        pixels.map(|(share, n)| n * of_share(share)).sum()
    }

    /// Whether the same blocks get none.
    fn hides_as(&self, other: &Self) -> bool {
        let hidden = |shares: &Self| shares.shares.iter().map(|s| *s == 0).collect::<Vec<_>>();
        self.size == other.size && hidden(self) == hidden(other)
    }
}

/// Those of a tracer's views on the device; nothing while no view has any.
#[derive(Default)]
pub(super) struct Shares {
    slots: Vec<Option<Arc<SampleShares>>>,
    texture: Option<(wgpu::Texture, wgpu::TextureView)>,
}

impl Shares {
    pub(super) fn set_slots(&mut self, count: usize) {
        self.slots = vec![None; count];
        self.texture = None;
    }

    pub(super) fn of(&self, slot: usize) -> Option<&Arc<SampleShares>> {
        self.slots.get(slot)?.as_ref()
    }

    pub(super) fn are_there(&self) -> bool {
        self.slots.iter().any(Option::is_some)
    }

    pub(super) fn view(&self) -> Option<&wgpu::TextureView> {
        self.texture.as_ref().map(|(_, view)| view)
    }

    /// Takes a slot's; true if pixels appear or disappear by it.
    pub(super) fn set(
        &mut self,
        gpu: &Gpu,
        slot: usize,
        shares: Option<&Arc<SampleShares>>,
    ) -> Result<bool, RenderError> {
        let former = self.of(slot);
        let is_same = match (former, shares) {
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            (None, None) => true,
            _ => false,
        };
        if is_same {
            return Ok(false);
        }
        let hides_alike = match (former, shares) {
            (Some(a), Some(b)) => a.hides_as(b),
            (Some(one), None) | (None, Some(one)) => !one.shares.contains(&0),
            (None, None) => true,
        };
        if let Some(place) = self.slots.get_mut(slot) {
            *place = shares.cloned();
        }
        if !self.are_there() {
            self.texture = None;
            return Ok(!hides_alike);
        }
        let most = |i: usize| {
            let counts = self.slots.iter().flatten().map(|s| s.block_counts()[i]);
            counts.max().unwrap_or(1)
        };
        let wanted = [most(0), most(1)];
        let fits = self.texture.as_ref().is_some_and(|(texture, _)| {
            texture.width() >= wanted[0] && texture.height() >= wanted[1]
        });
        if fits {
            self.write(gpu, slot);
        } else {
            let layers = self.slots.len() as u32;
            let bytes = u64::from(wanted[0]) * u64::from(wanted[1]) * u64::from(layers);
            self.texture = Some(gpu.scoped("shares of samples", bytes, || {
                let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                    label: Some("holovol shares of samples"),
                    size: wgpu::Extent3d {
                        width: wanted[0],
                        height: wanted[1],
                        depth_or_array_layers: layers,
                    },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format: wgpu::TextureFormat::R8Uint,
                    usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                    view_formats: &[],
                });
                let view = texture.create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2Array),
                    ..Default::default()
                });
                (texture, view)
            })?);
            for slot in 0..self.slots.len() {
                self.write(gpu, slot);
            }
        }
        Ok(!hides_alike)
    }

    /// Views without shares of their own get all.
    fn write(&self, gpu: &Gpu, slot: usize) {
        let Some((texture, _)) = &self.texture else {
            return;
        };
        let all;
        let ([across, down], shares) = match self.of(slot) {
            Some(shares) => (shares.block_counts(), &shares.shares),
            None => {
                let size = [texture.width(), texture.height()];
                all = vec![255; (size[0] * size[1]) as usize];
                (size, &all)
            }
        };
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: 0,
                origin: wgpu::Origin3d {
                    x: 0,
                    y: 0,
                    z: slot as u32,
                },
                aspect: wgpu::TextureAspect::All,
            },
            shares,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(across),
                rows_per_image: Some(down),
            },
            wgpu::Extent3d {
                width: across,
                height: down,
                depth_or_array_layers: 1,
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_counted_block_by_block() {
        // 20 × 9: blocks of 8, 8 and 4 by 8 and 1.
        let shares = SampleShares::new([20, 9], |[x, y], end| {
            assert_eq!(end, [(x + 8).min(20), (y + 8).min(9)]);
            match (x, y) {
                (0, 0) => 0,
                (8, _) => 63,
                (_, 8) => 1,
                _ => 255,
            }
        });
        assert_eq!(shares.blocks(), [0, 63, 255, 1, 63, 1]);
        // Of 4: none, 1 of 64 pixels, 4 of 32; 1 of each of the last row's 20.
        assert_eq!(shares.total(4), 64 + 4 * 32 + 20);
        assert_eq!(shares.total(1), 64 + 32 + 20);
        assert_eq!(shares.total(0), 0);
    }

    #[test]
    fn what_is_hidden_is_told_from_what_is_seldom_sampled() {
        let of = |share: u8| SampleShares::new([16, 8], |[x, _], _| if x == 0 { share } else { 9 });
        assert!(of(3).hides_as(&of(200)));
        assert!(!of(0).hides_as(&of(200)));
    }
}

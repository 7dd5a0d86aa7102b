//! Where a view's samples go: fewer where the eye sees less, none where it sees nothing.

use std::collections::HashMap;
use std::sync::Arc;

use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;
use bevy::render::sync_world::MainEntity;
use holovol_render::{SHARE_BLOCK, SampleShares};

/// Gives a camera's pixels unequal numbers of samples. Unbiased: fewer samples weigh more, so that
/// the image is noisier in places and brighter nowhere.
///
/// A pixel that gets any gets at least one, so that a view with one sample per frame
/// ([`VolumeRenderSettings::samples`](crate::VolumeRenderSettings::samples)) saves only what is
/// hidden.
///
/// Places are in the image: (0, 0) top left, (1, 1) bottom right; lengths in heights of the image.
#[derive(Component, ExtractComponent, Clone, Debug, PartialEq)]
pub struct VolumeSampling {
    /// Where the eye looks; the middle by default.
    pub gaze: Vec2,
    /// Distance from the gaze within which pixels get all samples; 0.35 by default.
    pub fovea: f32,
    /// Distance from which on they get [`Self::periphery`] of them; 0.8 by default.
    pub far: f32,
    /// Part of the samples, 0 to 1, far from the gaze; 1 by default, which is none saved.
    pub periphery: f32,
    /// Triangles that nobody sees. What lies in one of them and 8 pixels from what is seen isn't
    /// traced.
    pub hidden: Arc<[[Vec2; 3]]>,
}

impl Default for VolumeSampling {
    fn default() -> Self {
        Self {
            gaze: Vec2::splat(0.5),
            fovea: 0.35,
            far: 0.8,
            periphery: 1.0,
            hidden: Arc::new([]),
        }
    }
}

impl VolumeSampling {
    /// For an image of the lattice's size; `None` where every pixel gets all.
    fn shares(&self, hidden: &HiddenPlaces) -> Option<SampleShares> {
        let size = hidden.size;
        let full = UVec2::from(size).max(UVec2::ONE).as_vec2();
        // Lengths in heights, so that circles are round.
        let place = |uv: Vec2| Vec2::new(uv.x * full.x / full.y, uv.y);
        let gaze = place(self.gaze);
        let numbers = [self.fovea, self.far, self.periphery];
        let is_number = gaze.is_finite() && numbers.iter().all(|n| n.is_finite());
        let part = |distance: f32| {
            let beyond = (distance - self.fovea) / (self.far - self.fovea).max(1e-6);
            1.0 - beyond.clamp(0.0, 1.0) * (1.0 - self.periphery).clamp(0.0, 1.0)
        };
        let share = |first: [u32; 2], end: [u32; 2]| {
            if hidden.hides(first) {
                return 0;
            }
            if !is_number {
                return 255;
            }
            let [low, high] = [first, end].map(|pixel| place(UVec2::from(pixel).as_vec2() / full));
            let nearest = gaze.clamp(low, high);
            (255.0 * part(nearest.distance(gaze))).clamp(1.0, 255.0) as u8
        };
        let shares = SampleShares::new(size, share);
        let saves = shares.blocks().iter().any(|&share| share != 255);
        saves.then_some(shares)
    }
}

/// Which corners of blocks lie in hidden triangles.
struct HiddenPlaces {
    of: Arc<[[Vec2; 3]]>,
    size: [u32; 2],
    across: usize,
    /// Row by row; empty where nothing is hidden.
    corners: Vec<bool>,
}

impl HiddenPlaces {
    fn new(of: &Arc<[[Vec2; 3]]>, size: [u32; 2]) -> Self {
        let [across, down] = size.map(|n| n.div_ceil(SHARE_BLOCK) as usize + 1);
        let full = UVec2::from(size).max(UVec2::ONE).as_vec2();
        let is_hidden = |i: usize| {
            let corner = Vec2::new((i % across) as f32, (i / across) as f32);
            let place = (corner * SHARE_BLOCK as f32 / full).min(Vec2::ONE);
            of.iter().any(|triangle| holds(triangle, place))
        };
        let count = if of.is_empty() { 0 } else { across * down };
        Self {
            of: Arc::clone(of),
            size,
            across,
            corners: (0..count).map(is_hidden).collect(),
        }
    }

    /// Whether all of a block is hidden, and of those around it: what is seen has neighbours that
    /// are traced.
    fn hides(&self, first_pixel: [u32; 2]) -> bool {
        if self.corners.is_empty() {
            return false;
        }
        let [x, y] = first_pixel.map(|n| (n / SHARE_BLOCK) as usize);
        let down = self.corners.len() / self.across;
        let rows = y.saturating_sub(1)..(y + 3).min(down);
        let columns = x.saturating_sub(1)..(x + 3).min(self.across);
        rows.into_iter().all(|row| {
            self.corners[row * self.across..][columns.clone()]
                .iter()
                .all(|c| *c)
        })
    }
}

/// Whether a triangle holds a point, its edges included.
fn holds([a, b, c]: &[Vec2; 3], point: Vec2) -> bool {
    let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| (*to - *from).perp_dot(point - *from));
    sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0)
}

/// What was made of each view's [`VolumeSampling`], per size of the traced image.
#[derive(Resource, Default)]
pub(super) struct SamplingMaps(HashMap<MainEntity, Map>);

struct Map {
    of: VolumeSampling,
    hidden: HiddenPlaces,
    shares: Option<Arc<SampleShares>>,
    is_used: bool,
}

impl SamplingMaps {
    pub(super) fn get(
        &mut self,
        camera: MainEntity,
        sampling: Option<&VolumeSampling>,
        size: [u32; 2],
    ) -> Option<Arc<SampleShares>> {
        let sampling = sampling?;
        let make = |hidden: HiddenPlaces| Map {
            of: sampling.clone(),
            shares: sampling.shares(&hidden).map(Arc::new),
            hidden,
            is_used: true,
        };
        let places = || HiddenPlaces::new(&sampling.hidden, size);
        let map = self.0.entry(camera).or_insert_with(|| make(places()));
        map.is_used = true;
        let has_places = map.hidden.size == size && Arc::ptr_eq(&map.hidden.of, &sampling.hidden);
        if !has_places {
            *map = make(places());
        } else if map.of != *sampling {
            map.of = sampling.clone();
            map.shares = sampling.shares(&map.hidden).map(Arc::new);
        }
        map.shares.clone()
    }

    /// Forgets views that are gone.
    pub(super) fn end_frame(&mut self) {
        self.0.retain(|_, map| std::mem::take(&mut map.is_used));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [320, 240];

    fn shares(sampling: &VolumeSampling) -> Option<SampleShares> {
        sampling.shares(&HiddenPlaces::new(&sampling.hidden, SIZE))
    }

    fn at(shares: &SampleShares, x: usize, y: usize) -> u8 {
        shares.blocks()[(y / 8) * 40 + x / 8]
    }

    #[test]
    fn without_wishes_every_pixel_gets_all() {
        assert_eq!(shares(&VolumeSampling::default()), None);
        let few = VolumeSampling {
            periphery: 0.25,
            ..default()
        };
        assert!(shares(&few).is_some());
        let hopeless = [
            VolumeSampling {
                gaze: Vec2::NAN,
                ..few.clone()
            },
            VolumeSampling {
                fovea: f32::NAN,
                ..few.clone()
            },
            VolumeSampling {
                far: f32::INFINITY,
                ..few.clone()
            },
            VolumeSampling {
                periphery: f32::NAN,
                ..few
            },
        ];
        for sampling in hopeless {
            assert_eq!(shares(&sampling), None, "{sampling:?}");
        }
    }

    #[test]
    fn samples_are_fewer_far_from_the_gaze() {
        let sampling = VolumeSampling {
            gaze: Vec2::new(0.25, 0.5),
            periphery: 0.25,
            ..default()
        };
        let shares = shares(&sampling).expect("some are saved");
        assert_eq!(at(&shares, 80, 120), 255);
        // 0.35 heights are 84 pixels, either way.
        assert_eq!(at(&shares, 80 + 80, 120), 255);
        assert_eq!(at(&shares, 80, 120 - 80), 255);
        assert!(at(&shares, 80 + 100, 120) < 255);
        // ⌈4 · 63/255⌉ is 1.
        assert_eq!(at(&shares, 319, 120), 63);
        assert!(10 * shares.total(4) < 9 * 4 * 320 * 240);
        assert_eq!(shares.total(1), 320 * 240, "at least one");
    }

    #[test]
    fn what_is_hidden_gets_none_with_a_margin_around_what_is_seen() {
        // The left quarter, of two triangles.
        let [a, b] = [Vec2::ZERO, Vec2::new(0.25, 0.0)];
        let [c, d] = [Vec2::new(0.0, 1.0), Vec2::new(0.25, 1.0)];
        let sampling = VolumeSampling {
            hidden: Arc::new([[a, b, c], [b, d, c]]),
            ..default()
        };
        let shares = shares(&sampling).expect("some are saved");
        assert_eq!(at(&shares, 4, 4), 0);
        assert_eq!(at(&shares, 60, 230), 0);
        assert_eq!(at(&shares, 76, 4), 255, "next to what is seen");
        assert_eq!(at(&shares, 84, 120), 255);
        // Ten blocks across, the last of which has a neighbour that is seen.
        let none = shares.blocks().iter().filter(|s| **s == 0).count();
        assert_eq!(none, 9 * 30);
    }
}

//! What a ray meets: collisions by delta tracking, light's way out by ratio tracking.

use std::ops::ControlFlow;

use glam::{DMat3, DMat4, DVec3, DVec4};
use holovol_scene::Scene;
use holovol_volume::Voxels;

use crate::field::{Extinction, Field, Stored};
use crate::majorants::Majorants;
use crate::rng::Rng;

/// Extinction in space. Rays start at texel coordinates and run along unit directions of the
/// world, so that lengths are metres.
pub struct Medium {
    pub extinction: Extinction,
    pub majorants: Majorants,
    pub texel_from_direction: DMat3,
    /// What lies at n·texel + w < 0 of a plane is left out.
    clip: Vec<DVec4>,
}

/// Where a path is in space.
#[derive(Clone, Copy)]
pub struct Vertex {
    /// Texel coordinates.
    pub texel: DVec3,
    pub s: f64,
}

impl Medium {
    /// Builds the majorants.
    pub fn new(scene: &Scene, texel_from_world: &DMat4) -> Self {
        let extinction = Extinction::new(&scene.transfer_function);
        let majorants = match scene.volume.voxels() {
            Voxels::U8(v) => Majorants::new(&Field::new(scene, v), &extinction),
            Voxels::I8(v) => Majorants::new(&Field::new(scene, v), &extinction),
            Voxels::U16(v) => Majorants::new(&Field::new(scene, v), &extinction),
            Voxels::I16(v) => Majorants::new(&Field::new(scene, v), &extinction),
            Voxels::F32(v) => Majorants::new(&Field::new(scene, v), &extinction),
        };
        Self {
            extinction,
            majorants,
            texel_from_direction: DMat3::from_mat4(*texel_from_world),
            // A plane goes by the inverse transpose.
            clip: scene
                .clip_planes
                .iter()
                .map(|plane| texel_from_world.inverse().transpose() * *plane)
                .collect(),
        }
    }

    /// Extinction at a place, 1/m, and s there.
    #[inline]
    fn extinction<T: Stored>(&self, field: &Field<'_, T>, texel: DVec3) -> (f64, f64) {
        let s = field.sample(texel);
        if self
            .clip
            .iter()
            .any(|plane| plane.dot(texel.extend(1.0)) < 0.0)
        {
            return (0.0, s);
        }
        (self.extinction.at(s), s)
    }

    /// Delta tracking (Woodcock et al. 1965): the first collision along a world direction.
    #[inline]
    pub fn free_flight<T: Stored>(
        &self,
        field: &Field<'_, T>,
        origin: DVec3,
        direction: DVec3,
        rng: &mut Rng,
    ) -> Option<Vertex> {
        let step = self.texel_from_direction * direction;
        let mut depth = rng.exponential();
        self.majorants
            .walk(origin, step, |start, length, majorant| {
                let mut t = 0.0;
                loop {
                    let way = depth / majorant;
                    if t + way >= length {
                        depth -= (length - t) * majorant;
                        return ControlFlow::Continue(());
                    }
                    t += way;
                    let texel = start + step * t;
                    let (sigma_t, s) = self.extinction(field, texel);
                    debug_assert!(sigma_t <= majorant * (1.0 + 1e-9), "{sigma_t} > {majorant}");
                    if rng.uniform() * majorant < sigma_t {
                        return ControlFlow::Break(Vertex { texel, s });
                    }
                    depth = rng.exponential();
                }
            })
    }

    /// Ratio tracking (Novák et al. 2014) with Russian roulette.
    #[inline]
    pub fn transmittance<T: Stored>(
        &self,
        field: &Field<'_, T>,
        origin: DVec3,
        direction: DVec3,
        rng: &mut Rng,
    ) -> f64 {
        /// Below it a ray survives only by chance.
        const ROULETTE: f64 = 0.1;
        let step = self.texel_from_direction * direction;
        let mut depth = rng.exponential();
        let mut transmittance = 1.0;
        let blocked = self
            .majorants
            .walk(origin, step, |start, length, majorant| {
                let mut t = 0.0;
                loop {
                    let way = depth / majorant;
                    if t + way >= length {
                        depth -= (length - t) * majorant;
                        return ControlFlow::Continue(());
                    }
                    t += way;
                    let (sigma_t, _) = self.extinction(field, start + step * t);
                    transmittance *= (1.0 - sigma_t / majorant).max(0.0);
                    if transmittance < ROULETTE {
                        if rng.uniform() * ROULETTE >= transmittance {
                            return ControlFlow::Break(());
                        }
                        transmittance = ROULETTE;
                    }
                    depth = rng.exponential();
                }
            });
        if blocked.is_some() {
            0.0
        } else {
            transmittance
        }
    }
}

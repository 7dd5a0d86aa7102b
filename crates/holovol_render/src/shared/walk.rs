//! Twin of `walk.wgsl`.

use glam::{BVec3, IVec3, Vec3};

use crate::majorant::cpu::Majorants;

const PARALLEL: f32 = 1e-30;
const NEVER: f32 = 3e38;
const LONG_DEPTH: f32 = 4096.0;

/// Where a walk stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// Between two cells.
    Moving = 0,
    /// At a tentative collision.
    Collision = 1,
    /// Out of the occupied box.
    Left = 2,
}

/// A walk through the cells of a majorant grid.
#[derive(Clone, Debug)]
pub struct Walk<'a> {
    grid: &'a Majorants,
    origin: Vec3,
    direction: Vec3,
    /// Where the current cell was entered, metres.
    pub t_cell: f32,
    /// End of the occupied box, metres.
    pub t_end: f32,
    /// Optical depth from `t_cell` to the next tentative collision.
    pub tau: f32,
    /// The current cell.
    pub cell: IVec3,
    sigma_maj: f32,
    t_next: Vec3,
}

fn inverse(direction: Vec3) -> Vec3 {
    let parallel = direction.abs().cmplt(Vec3::splat(PARALLEL));
    Vec3::select(parallel, Vec3::splat(PARALLEL), direction).recip()
}

impl<'a> Walk<'a> {
    /// Enters the occupied box; [`Walk::misses`] it otherwise.
    pub fn start(
        grid: &'a Majorants,
        origin: Vec3,
        direction: Vec3,
        t_start: f32,
        tau: f32,
    ) -> Self {
        let [low_cell, high_cell] = grid.occupied;
        let size = grid.cell_size as f32;
        let low = size * low_cell.as_vec3();
        let high = (size * high_cell.as_vec3()).min(grid.extent);
        let inverse = inverse(direction);
        let (t0, t1) = ((low - origin) * inverse, (high - origin) * inverse);
        let parallel = direction.abs().cmplt(Vec3::splat(PARALLEL));
        let inside = origin.cmpge(low) & origin.cmple(high);
        let never = Vec3::splat(NEVER);
        let near = Vec3::select(parallel, Vec3::select(inside, -never, never), t0.min(t1));
        let far = Vec3::select(parallel, never, t0.max(t1));
        let mut walk = Self {
            grid,
            origin,
            direction,
            t_cell: near.max_element().max(t_start),
            t_end: far.min_element(),
            tau,
            cell: IVec3::ZERO,
            sigma_maj: 0.0,
            t_next: Vec3::ZERO,
        };
        if !walk.misses() {
            let entry = origin + walk.t_cell * direction;
            walk.cell = (entry / size)
                .floor()
                .as_ivec3()
                .clamp(low_cell, high_cell - 1);
            walk.t_next = Vec3::select(parallel, never, walk.borders(walk.cell));
            walk.sigma_maj = grid.at(walk.cell);
        }
        walk
    }

    /// Whether the ray misses the occupied box.
    pub fn misses(&self) -> bool {
        self.t_end.is_nan() || self.t_end <= self.t_cell
    }

    fn borders(&self, cell: IVec3) -> Vec3 {
        let ahead = Vec3::select(self.direction.cmpgt(Vec3::ZERO), Vec3::ONE, Vec3::ZERO);
        (self.grid.cell_size as f32 * (cell.as_vec3() + ahead) - self.origin)
            * inverse(self.direction)
    }

    /// Goes on to the next tentative collision or out of the box, by at most `max_steps` cells.
    pub fn advance(&mut self, max_steps: u32) -> Event {
        let [low_cell, high_cell] = self.grid.occupied;
        let forward = self.direction.cmpgt(Vec3::ZERO);
        for _ in 0..max_steps {
            let t_border = self.t_next.min_element();
            let t_exit = t_border.min(self.t_end);
            let tau_exit = self.sigma_maj * (t_exit - self.t_cell).max(0.0);
            if self.tau < tau_exit {
                return Event::Collision;
            }
            self.tau -= tau_exit;
            self.t_cell = t_exit.max(self.t_cell);
            if t_border >= self.t_end {
                return Event::Left;
            }
            let Vec3 { x, y, z } = self.t_next;
            let axis_x = x <= y && x <= z;
            let axis_y = !axis_x && y <= z;
            let axis = BVec3::new(axis_x, axis_y, !axis_x && !axis_y);
            let step = IVec3::select(forward, IVec3::ONE, IVec3::NEG_ONE);
            let cell = IVec3::select(axis, self.cell + step, self.cell);
            if cell.cmplt(low_cell).any() || cell.cmpge(high_cell).any() {
                return Event::Left;
            }
            self.cell = cell;
            self.t_next = Vec3::select(axis, self.borders(cell), self.t_next);
            self.sigma_maj = self.grid.at(cell);
        }
        Event::Moving
    }

    /// Goes on by `tau`, measured from nearer by where the cell is deep.
    pub fn deepen(&mut self, tau: f32) {
        self.tau += tau;
        if self.tau > LONG_DEPTH {
            let start = self.t_cell;
            self.t_cell = self.distance();
            self.tau -= self.sigma_maj * (self.t_cell - start);
        }
    }

    /// Metres from the origin to the tentative collision.
    pub fn distance(&self) -> f32 {
        self.t_cell + self.tau / self.sigma_maj
    }
}

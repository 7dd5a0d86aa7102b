//! Connected bright regions on the sphere: run-length union–find, wrapping in longitude.

use std::f64::consts::PI;

use glam::DVec3;

use super::prior::{NEAR, edge_gain};
use crate::Grid;
use crate::measure::any_reaches;

/// Texels that are looked at together, since most are dark.
const BLOCK: usize = 16;

/// Texels in a row, all of one region.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub y: u32,
    pub start: u32,
    pub end: u32,
    pub region: u32,
}

/// A bright region: texels above a level that hang together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Region {
    /// Solid angle of all of it, sr.
    pub halo: f32,
    /// Solid angle of the texels with a clipped channel, sr.
    pub clipped: f32,
    /// Solid angle of the texels with all channels clipped, sr.
    pub core: f32,
    /// Sum of direction × solid angle over the core, or over the clipped part of a coreless one.
    pub moment: [f32; 3],
    /// Radiance × solid angle of the unclipped rim, RGB.
    pub rim: [f32; 3],
}

impl Region {
    /// Direction of the core's centre.
    pub fn centre(&self) -> DVec3 {
        let moment = DVec3::from_array(self.moment.map(f64::from));
        moment.try_normalize().unwrap_or(DVec3::Y)
    }

    /// What the edge of a region found by [`Regions::find_cores`] says of its gain, EV; see
    /// [`edge_gain`].
    pub(super) fn edge_gain(&self, grid: &Grid) -> f64 {
        let texel = 2.0 * PI * PI / grid.len() as f64;
        edge_gain(f64::from(self.halo), f64::from(self.core), texel)
    }
}

/// Finds regions; keeps its memory between frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Regions {
    pub runs: Vec<Run>,
    parents: Vec<u32>,
    pub regions: Vec<Region>,
}

impl Regions {
    /// Labels the texels whose brightest channel reaches half the ceiling; those that touch, also
    /// at a corner or across the seam, are one region.
    pub fn find(&mut self, grid: &Grid, radiance: &[[f32; 3]], clipped: &[u8], ceiling: f32) {
        let level = 0.5 * ceiling;
        let bright = |texel: &[f32; 3]| texel[0].max(texel[1]).max(texel[2]) >= level;
        self.label(grid, radiance, level, bright);
        self.measure(grid, radiance, clipped);
    }

    /// Labels the texels whose channels are all near the ceiling ([`NEAR`]): lamps before a wall
    /// that nearly clips are told apart, and from the wall.
    pub fn find_cores(&mut self, grid: &Grid, radiance: &[[f32; 3]], clipped: &[u8], ceiling: f32) {
        let level = NEAR * ceiling;
        let near = |texel: &[f32; 3]| texel[0].min(texel[1]).min(texel[2]) >= level;
        self.label(grid, radiance, level, near);
        self.measure(grid, radiance, clipped);
    }

    /// Joins the texels that are `inside`, none of which is below `level` in all channels.
    fn label(
        &mut self,
        grid: &Grid,
        radiance: &[[f32; 3]],
        level: f32,
        inside: impl Fn(&[f32; 3]) -> bool,
    ) {
        self.runs.clear();
        let width = grid.width();
        let mut above = 0..0;
        for (y, row) in radiance.chunks_exact(width).enumerate() {
            let first = self.runs.len();
            let mut start = None;
            for (block, texels) in row.chunks(BLOCK).enumerate() {
                let x = block * BLOCK;
                if !any_reaches(texels, level) {
                    if let Some(from) = start.take() {
                        self.push(y, from, x);
                    }
                    continue;
                }
                for (x, texel) in (x..).zip(texels) {
                    match (inside(texel), start) {
                        (true, None) => start = Some(x),
                        (false, Some(from)) => {
                            self.push(y, from, x);
                            start = None;
                        }
                        _ => {}
                    }
                }
            }
            if let Some(from) = start {
                self.push(y, from, width);
            }
            let here = first..self.runs.len();
            self.join(above, here.clone(), width as u32);
            above = here;
        }
    }

    /// For each run of regions that lie within these: which of these it lies in.
    pub fn containing<'a>(&'a self, inner: &'a [Run]) -> impl Iterator<Item = Option<u32>> + 'a {
        let mut i = 0;
        inner.iter().map(move |run| {
            let before = |outer: &Run| (outer.y, outer.end) <= (run.y, run.start);
            while self.runs.get(i).is_some_and(before) {
                i += 1;
            }
            let outer = self.runs.get(i)?;
            (outer.y == run.y && outer.start <= run.start).then_some(outer.region)
        })
    }

    fn push(&mut self, y: usize, start: usize, end: usize) {
        let region = self.runs.len() as u32;
        self.runs.push(Run {
            y: y as u32,
            start: start as u32,
            end: end as u32,
            region,
        });
    }

    /// Joins the runs of a row with those of the row above and with itself across the seam.
    fn join(&mut self, above: std::ops::Range<usize>, here: std::ops::Range<usize>, width: u32) {
        self.parents.truncate(here.start);
        self.parents.extend(here.clone().map(|i| i as u32));
        let mut i = above.start;
        for j in here.clone() {
            let Run { start, end, .. } = self.runs[j];
            while i < above.end && self.runs[i].end < start {
                i += 1;
            }
            let mut k = i;
            while k < above.end && self.runs[k].start <= end {
                self.unite(k, j);
                k += 1;
            }
        }
        let edges = |runs: &[Run], range: &std::ops::Range<usize>| {
            let left = runs[range.clone()].first().filter(|run| run.start == 0);
            let right = runs[range.clone()].last().filter(|run| run.end == width);
            (left.map(|_| range.start), right.map(|_| range.end - 1))
        };
        let (left, right) = edges(&self.runs, &here);
        let (left_above, right_above) = edges(&self.runs, &above);
        for (a, b) in [(left, right), (left, right_above), (left_above, right)] {
            if let (Some(a), Some(b)) = (a, b) {
                self.unite(a, b);
            }
        }
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while self.parents[i as usize] != i {
            let grandparent = self.parents[self.parents[i as usize] as usize];
            self.parents[i as usize] = grandparent;
            i = grandparent;
        }
        i
    }

    fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a as u32), self.root(b as u32));
        self.parents[a.max(b) as usize] = a.min(b);
    }

    /// Measures the regions; of one with nothing clipped only the halo and the rim are not 0.
    fn measure(&mut self, grid: &Grid, radiance: &[[f32; 3]], clipped: &[u8]) {
        let width = grid.width();
        self.regions.clear();
        self.parents.truncate(self.runs.len());
        // A root comes before its members, so that one pass numbers the regions.
        for i in 0..self.runs.len() {
            let root = self.root(i as u32);
            self.runs[i].region = if root == i as u32 {
                self.regions.push(Region::default());
                self.regions.len() as u32 - 1
            } else {
                self.runs[root as usize].region
            };
        }
        for run in &self.runs {
            let region = &mut self.regions[run.region as usize];
            let y = run.y as usize;
            let solid_angle = grid.solid_angle(y);
            let [sin, cos] = grid.row(y);
            let row = y * width;
            let (mut clipped_texels, mut core_texels) = (0, 0);
            let (mut moment, mut core_moment) = ([0.0; 2], [0.0; 2]);
            let mut rim = [0.0; 3];
            for x in run.start as usize..run.end as usize {
                match clipped[row + x] {
                    0 => {
                        for c in 0..3 {
                            rim[c] += radiance[row + x][c];
                        }
                    }
                    bits => {
                        let [dx, dz] = grid.column(x);
                        clipped_texels += 1;
                        moment[0] += dx;
                        moment[1] += dz;
                        if bits == 7 {
                            core_texels += 1;
                            core_moment[0] += dx;
                            core_moment[1] += dz;
                        }
                    }
                }
            }
            region.halo += solid_angle * (run.end - run.start) as f32;
            region.clipped += solid_angle * clipped_texels as f32;
            for c in 0..3 {
                region.rim[c] += solid_angle * rim[c];
            }
            // The core counts; the rest only breaks the tie of a coreless region.
            const FAINT: f32 = 1e-4;
            region.core += solid_angle * core_texels as f32;
            let weigh = |core: f32, all: f32| solid_angle * (core + FAINT * all);
            region.moment[0] += weigh(sin * core_moment[0], sin * moment[0]);
            region.moment[1] += cos * weigh(core_texels as f32, clipped_texels as f32);
            region.moment[2] += weigh(sin * core_moment[1], sin * moment[1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// '#' all channels clipped, '+' near clipping, '.' dark.
    fn find(rows: &[&str]) -> (Regions, Grid) {
        let grid = Grid::new(rows[0].len(), rows.len());
        let bytes: Vec<u8> = rows.iter().flat_map(|row| row.bytes()).collect();
        let radiance: Vec<[f32; 3]> = bytes
            .iter()
            .map(|b| match b {
                b'#' => [1.0; 3],
                b'+' => [0.6; 3],
                _ => [0.1; 3],
            })
            .collect();
        let clipped: Vec<u8> = bytes
            .iter()
            .map(|&b| if b == b'#' { 7 } else { 0 })
            .collect();
        let mut regions = Regions::default();
        regions.find(&grid, &radiance, &clipped, 1.0);
        (regions, grid)
    }

    fn cores(regions: &Regions) -> usize {
        regions
            .regions
            .iter()
            .filter(|region| region.core > 0.0)
            .count()
    }

    #[test]
    fn diagonals_and_the_seam_connect() {
        let (regions, _) = find(&["........", ".#......", "..#....."]);
        assert_eq!(cores(&regions), 1);
        let (regions, grid) = find(&["........", "#......#", "........"]);
        assert_eq!(cores(&regions), 1);
        let centre = regions.regions[0].centre();
        assert!(centre.z > 0.99, "the seam looks along +z: {centre}");
        assert!((regions.regions[0].core - 2.0 * grid.solid_angle(1)).abs() < 1e-6);
        let (regions, _) = find(&["........", "#.......", ".......#"]);
        assert_eq!(cores(&regions), 1);
        let (regions, _) = find(&["........", ".......#", "#......."]);
        assert_eq!(cores(&regions), 1);
        let (regions, _) = find(&["#.#.....", "........", ".#......"]);
        assert_eq!(cores(&regions), 3);
    }

    #[test]
    fn halos_join_late_and_count_once() {
        let (regions, grid) = find(&["........", "#+....+#", ".+.++.+.", ".++..++."]);
        assert_eq!(cores(&regions), 1);
        let halo: f32 = (1..4).map(|y| 4.0 * grid.solid_angle(y)).sum();
        let found: f32 = regions.regions.iter().map(|region| region.halo).sum();
        assert!((found - halo).abs() < 1e-5, "{found} {halo}");
        assert_eq!(regions.regions.len(), 1);
        let (regions, _) = find(&["........", "#..++...", "........"]);
        assert_eq!((regions.regions.len(), cores(&regions)), (2, 1));
    }

    #[test]
    fn cores_before_a_bright_wall_are_told_apart_and_know_their_halo() {
        // The wall is '+', 0.6 of the ceiling: one halo, two cores, one of them with an edge.
        let rows = ["........", "++#++#-+", "++++++++", "........", "#......."];
        let grid = Grid::new(8, 5);
        let level = |b: u8| match b {
            b'#' => 1.0,
            b'-' => 0.9,
            b'+' => 0.6,
            _ => 0.1,
        };
        let bytes: Vec<u8> = rows.iter().flat_map(|row| row.bytes()).collect();
        let radiance: Vec<[f32; 3]> = bytes.iter().map(|&b| [level(b); 3]).collect();
        let clipped: Vec<u8> = bytes.iter().map(|&b| 7 * u8::from(b == b'#')).collect();
        let (mut halos, mut found) = (Regions::default(), Regions::default());
        halos.find(&grid, &radiance, &clipped, 1.0);
        found.find_cores(&grid, &radiance, &clipped, 1.0);
        assert_eq!((cores(&halos), cores(&found)), (2, 3));
        let texel = grid.solid_angle(1);
        let sizes: Vec<f32> = found
            .regions
            .iter()
            .map(|r| (r.halo / texel).round())
            .collect();
        assert_eq!(sizes[..2], [1.0, 2.0]);
        assert!(found.regions[0].edge_gain(&grid) > found.regions[1].edge_gain(&grid));
        let within: Vec<Option<u32>> = halos.containing(&found.runs).collect();
        assert_eq!(within, [Some(0), Some(0), Some(1)]);
        // One channel near the ceiling does not make a core.
        let red: Vec<[f32; 3]> = radiance.iter().map(|t| [t[0], 0.5 * t[0], 0.5]).collect();
        found.find_cores(&grid, &red, &clipped, 1.0);
        assert!(found.regions.is_empty());
    }
}

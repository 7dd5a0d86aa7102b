//! HDR light from LDR exposures and whatever else is known: a ladder of evidence.

mod constrain;
mod doubt;
mod extend;
mod found;
mod merge;
mod observe;
mod prior;
mod regions;
mod resolve;
mod sky;
#[cfg(test)]
mod tests;
mod weigh;

use glam::DVec3;

use crate::measure::luminous_flux;
use crate::{Grid, luminance};
use regions::Regions;

pub use doubt::{Doubt, distinct_directions};
pub(crate) use extend::draw_discs;
pub use found::{FoundLight, find_lights};
pub use merge::{CLIPPED, Exposure};
pub use observe::Observation;
pub use prior::Prior;
pub use regions::Region;
pub use sky::Sky;

/// What is known of a scene's light.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence<'a> {
    /// Exposures of the same view, the brightest first; at least one.
    pub frames: &'a [Exposure<'a>],
    /// A light meter's reading.
    pub meter: Option<Meter>,
    /// Irradiance measured on a diffuse ball, or by many meters: of [`PROBE_DIRECTIONS`] or more.
    pub probe: Option<&'a [ProbeSample]>,
}

/// A reading of luminous irradiance, in the units of the first frame: π is what a world that just
/// clips would give. (A lux value divided by the luminance that clips, cd/m².)
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meter {
    /// Which way the meter looks, in the panorama's frame.
    pub normal: DVec3,
    /// Luminous irradiance.
    pub irradiance: f64,
    /// One standard deviation relative to the reading.
    pub relative_sigma: f64,
}

impl Meter {
    /// A meter that looks up and reads to ± 5 %.
    pub fn upward(irradiance: f64) -> Self {
        Self {
            normal: DVec3::Y,
            irradiance,
            relative_sigma: 0.05,
        }
    }
}

/// Irradiance of one surface direction of a probe, in the units of the first frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeSample {
    /// The surface's normal, in the panorama's frame.
    pub normal: DVec3,
    /// RGB.
    pub irradiance: [f64; 3],
}

/// A probe tells of at least so many directions, 15° or more from each other.
pub const PROBE_DIRECTIONS: usize = 4;

/// What an estimate rests on, from the least to the most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rung {
    /// One exposure: clipped lights are guessed.
    Single,
    /// One exposure and a light meter.
    SingleAndMeter,
    /// Several exposures: only what the darkest clips is guessed.
    Bracket,
    /// Several exposures and a light meter.
    BracketAndMeter,
    /// A diffuse probe, with one exposure or several.
    Probe,
}

impl Rung {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::SingleAndMeter => "single+lux",
            Self::Bracket => "bracket",
            Self::BracketAndMeter => "bracket+lux",
            Self::Probe => "probe",
        }
    }
}

/// What a light seems to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightClass {
    /// The sun, or a moon exposed like one.
    Sun,
    /// Small with sharp edges.
    Lamp,
    /// Large: a window, a softbox, bright sky.
    Window,
    /// Something lit, below the horizon.
    Reflection,
}

/// A clipped light, extended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// What it seems to be.
    pub class: LightClass,
    /// Unit direction of its centre, in the panorama's frame.
    pub direction: DVec3,
    /// sr.
    pub solid_angle: f64,
    /// Irradiance facing it, RGB: mean radiance × solid angle.
    pub irradiance: [f64; 3],
    /// One standard deviation of its strength, EV.
    pub sigma_ev: f64,
    /// Whether it is small enough to be a disc light: then it can be taken out of the map.
    pub disc: bool,
    /// Its region: a sun's among the halos, another's among the cores.
    region: u32,
}

/// Lights smaller than this are discs, sr.
pub const DISC_SOLID_ANGLE: f64 = 0.02;
/// The sun's disc, sr.
pub const SUN_SOLID_ANGLE: f64 = 6.8e-5;

/// Estimates HDR light for one size of panorama; owns its memory, so that the steady state
/// allocates nothing.
#[derive(Clone, Debug)]
pub struct Estimator {
    grid: Grid,
    prior: Prior,
    radiance: Vec<[f32; 3]>,
    clipped: Vec<u8>,
    /// What is within 1 EV of clipping in a channel, and what is near it in all.
    halos: Regions,
    cores: Regions,
    /// Clipped cores but the sun's, the strongest first.
    order: Vec<u32>,
    /// Per core: how many times the ceiling it is taken for.
    strengths: Vec<f32>,
    /// Per core: its light, or none (`u8::MAX`).
    assignment: Vec<u8>,
    /// Per core: whether it lies in the sun's halo.
    sunlit: Vec<bool>,
    lights: Vec<Light>,
    /// For small lights that were seen: marks, regions, and what each has above its level.
    marks: Vec<u8>,
    bright: Regions,
    above: Vec<([f64; 3], DVec3)>,
    /// Where the last estimate's lights of that kind were.
    resolved: Vec<DVec3>,
    /// Per frame: whether it is believed. And what speaks against the evidence.
    believed: Vec<bool>,
    doubts: Vec<Doubt>,
    ceiling: f32,
    /// Where the brightest frame clips.
    base: f32,
    sky: Sky,
    rung: Rung,
    sigma_ev: f64,
}

impl Estimator {
    /// An estimator for panoramas of this size, both at least 1.
    pub fn new(width: usize, height: usize, prior: Prior) -> Self {
        let grid = Grid::new(width, height);
        Self {
            prior,
            radiance: vec![[0.0; 3]; grid.len()],
            clipped: vec![0; grid.len()],
            halos: Regions::default(),
            cores: Regions::default(),
            order: Vec::new(),
            strengths: Vec::new(),
            assignment: Vec::new(),
            sunlit: Vec::new(),
            lights: Vec::new(),
            marks: Vec::new(),
            bright: Regions::default(),
            above: Vec::new(),
            resolved: Vec::new(),
            believed: Vec::new(),
            doubts: Vec::new(),
            ceiling: 1.0,
            base: 1.0,
            sky: Sky::default(),
            rung: Rung::Single,
            sigma_ev: 0.0,
            grid,
        }
    }

    /// Estimates the light; afterwards the getters tell it.
    ///
    /// # Panics
    /// If there is no frame, or one whose length is not the panorama's.
    pub fn estimate(&mut self, evidence: &Evidence) {
        let frames = evidence.frames;
        assert!(
            !frames.is_empty() && frames.iter().all(|f| f.radiance.len() == self.grid.len()),
            "every frame has the estimator's size"
        );
        self.believe(frames);
        let believed = frames.iter().zip(&self.believed);
        let mut believed = believed.filter_map(|(frame, believed)| believed.then_some(frame));
        let brightest = believed.clone().next().unwrap_or(&frames[0]);
        let exposures = believed.clone().count();
        self.base = (-brightest.ev).exp2() as f32;
        self.ceiling = merge::merge(&mut believed, &mut self.radiance, &mut self.clipped);
        let ceiling = self.ceiling;
        let clipped = merge::CLIPPED * self.base;
        self.sky = Sky::look(&self.grid, &self.radiance, clipped);
        self.mark_blunted_sun();
        self.halos
            .find(&self.grid, &self.radiance, &self.clipped, ceiling);
        self.cores
            .find_cores(&self.grid, &self.radiance, &self.clipped, ceiling);
        let missed_sun = match doubt::is_colourless(brightest.radiance) {
            true => self.possible_sun(),
            false => 0.0,
        };
        self.extend();
        let flux = self.constrain(evidence, exposures);
        self.doubt_picture(flux, missed_sun);
        self.sigma_ev = self.sigma_ev.hypot(self.doubt_ev());
        self.resolve();
    }

    /// How far the exposures reach beyond the brightest one's clipping level, or beyond that of an
    /// exposure of 0 EV if that is further: a dark frame may be the first, or the only one.
    fn reach_of_exposures(&self) -> f32 {
        self.ceiling / self.base.min(1.0)
    }

    /// The panorama's grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The radiance map without the lights that are discs, in units in which the first frame
    /// clips at 1.
    pub fn radiance(&self) -> &[[f32; 3]] {
        &self.radiance
    }

    /// The clipped lights, the strongest first.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// What the estimate rests on.
    pub fn rung(&self) -> Rung {
        self.rung
    }

    /// One standard deviation of the log₂ of all light together, EV.
    pub fn sigma_ev(&self) -> f64 {
        self.sigma_ev
    }

    /// What speaks against the evidence or the estimate: empty, as a rule.
    pub fn doubts(&self) -> &[Doubt] {
        &self.doubts
    }

    /// What was seen of a sky.
    pub fn sky(&self) -> &Sky {
        &self.sky
    }

    /// Radiance at which the darkest exposure clips.
    pub fn ceiling(&self) -> f32 {
        self.ceiling
    }

    /// Luminous flux of map and discs: four times the mean luminous irradiance.
    pub fn flux(&self) -> f64 {
        let discs = self.lights.iter().filter(|light| light.disc);
        luminous_flux(&self.grid, &self.radiance)
            + discs.map(|light| luminance(light.irradiance)).sum::<f64>()
    }
}

//! What the panel edits: one value, so that it can be undone, saved and compared.

use std::path::PathBuf;

use bevy::camera::Exposure;
use bevy::prelude::Handle;
use bevy_holovol::environment::DEFAULT_INTENSITY;
use bevy_holovol::prelude::{EnvironmentAsset, VolumeMedium};
use glam::{DMat4, DVec3, DVec4};
use holovol_volume::{TransferFunction, TransferFunctionFile, TransferPoint};

/// As many planes cut a volume, the sides of the crop box among them.
pub(crate) const MAX_PLANES: usize = holovol_render::Medium::MAX_CLIP_PLANES;

/// How a scan is shown, but for the camera.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Look {
    /// Values at which s is 0 and 1, data units; not equal.
    pub(crate) window: [f64; 2],
    /// Sorted by s, at least one.
    pub(crate) points: Vec<TransferPoint>,
    /// As in [`TransferFunctionFile`].
    pub(crate) optical_depth_scale: Option<f64>,
    /// Factor on extinctions.
    pub(crate) density: f64,
    pub(crate) gradient_factor: f64,
    pub(crate) phase_g: f64,
    pub(crate) light: Light,
    /// Of the camera: radiance is multiplied by 2 to this to be shown.
    pub(crate) exposure_ev: f64,
    pub(crate) max_scatters: Option<u32>,
    pub(crate) planes: Vec<Plane>,
    pub(crate) crop: Crop,
}

/// Light from all around.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Light {
    pub(crate) source: LightSource,
    /// About +y, degrees.
    pub(crate) rotation_deg: f64,
    /// Radiance is multiplied by 2 to this.
    pub(crate) stops: f64,
    /// It is seen behind the scan.
    pub(crate) is_sky: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum LightSource {
    /// Linear RGB from everywhere.
    Constant([f32; 3]),
    Map {
        map: Handle<EnvironmentAsset>,
        /// Its file, unless the program made it.
        path: Option<PathBuf>,
        name: String,
    },
}

/// Leaves out what lies farther along `normal` than `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane {
    /// Of length 1, world.
    pub(crate) normal: DVec3,
    /// Metres from the scan's middle.
    pub(crate) offset: f64,
    pub(crate) is_on: bool,
}

/// The side of the crop box that a cut in coordinates of the unit cube is: axis, whether it is the
/// high one, and where. The box keeps its least thickness, so a cut beyond that is none.
fn side(cut: DVec4) -> Option<(usize, bool, f64)> {
    let normal = cut.truncate();
    let axis = normal.abs().max_position();
    let others = DVec3::ONE - DVec3::AXES[axis];
    let at = -cut.w / normal[axis];
    let is_along = (normal * others).length() < 1e-6 * normal.length();
    let inside = Crop::THINNEST..=1.0 - Crop::THINNEST;
    (is_along && inside.contains(&at)).then_some((axis, normal[axis] < 0.0, at))
}

impl Plane {
    /// The plane that leaves out what lies at n·x + w < 0 of a scan with this middle.
    pub(crate) fn from_cut(cut: DVec4, middle: DVec3) -> Self {
        let length = cut.truncate().length();
        let normal = -cut.truncate() / length;
        Self {
            normal,
            offset: cut.w / length - normal.dot(middle),
            is_on: true,
        }
    }
}

/// A box along the scan's own axes; what lies outside is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Crop {
    pub(crate) is_on: bool,
    /// Corners in coordinates of the unit cube.
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
}

impl Default for Crop {
    fn default() -> Self {
        Self {
            is_on: false,
            low: DVec3::ZERO,
            high: DVec3::ONE,
        }
    }
}

impl Crop {
    /// Least distance of opposite sides.
    const THINNEST: f64 = 0.01;

    /// Moves one side as far as the other lets it.
    pub(crate) fn set_side(&mut self, axis: usize, is_high: bool, to: f64) {
        if is_high {
            self.high[axis] = to.clamp((self.low[axis] + Self::THINNEST).min(1.0), 1.0);
        } else {
            self.low[axis] = to.clamp(0.0, (self.high[axis] - Self::THINNEST).max(0.0));
        }
    }

    /// Middle of a side, in coordinates of the unit cube.
    pub(crate) fn middle_of_side(&self, axis: usize, is_high: bool) -> DVec3 {
        let mut middle = 0.5 * (self.low + self.high);
        middle[axis] = if is_high {
            self.high[axis]
        } else {
            self.low[axis]
        };
        middle
    }
}

impl Default for Look {
    fn default() -> Self {
        let grey = bevy_holovol::TransferFunctionAsset::default();
        Self {
            window: [0.0, 1.0],
            points: grey.file().transfer_function.points().to_vec(),
            optical_depth_scale: grey.file().optical_depth_scale,
            density: 1.0,
            gradient_factor: 0.0,
            phase_g: 0.0,
            light: Light {
                source: LightSource::Constant([1.0; 3]),
                rotation_deg: 0.0,
                stops: 0.0,
                is_sky: true,
            },
            exposure_ev: 0.0,
            max_scatters: Some(1),
            planes: Vec::new(),
            crop: Crop::default(),
        }
    }
}

impl Look {
    /// The transfer function as its file would say it; `None` while a field is being typed wrongly.
    pub(crate) fn transfer_function(&self) -> Option<TransferFunctionFile> {
        Some(TransferFunctionFile {
            transfer_function: TransferFunction::new(self.points.clone()).ok()?,
            window: None,
            optical_depth_scale: self.optical_depth_scale,
        })
    }

    pub(crate) fn set_transfer_function(&mut self, file: &TransferFunctionFile) {
        self.points = file.transfer_function.points().to_vec();
        self.optical_depth_scale = file.optical_depth_scale;
        // Extinctions are the file's own.
        self.density = 1.0;
        // A window of its own belongs to it; else that of the scan stays.
        if let Some(window) = file.window {
            self.window = window;
        }
    }

    pub(crate) fn medium(&self) -> VolumeMedium {
        let [low, high] = self.window;
        VolumeMedium {
            window: Some((low, high)),
            phase_g: self.phase_g,
            gradient_factor: self.gradient_factor,
            density: self.density,
            ..Default::default()
        }
    }

    /// Points with extinctions in 1/m, for a volume whose longest edge is this long in metres.
    pub(crate) fn points_in_metres(&self, longest_edge: f64) -> Vec<TransferPoint> {
        let factor = self.density * self.optical_depth_scale.map_or(1.0, |s| s / longest_edge);
        let points = self.points.iter().map(|point| TransferPoint {
            sigma_t: point.sigma_t * factor,
            ..*point
        });
        points.collect()
    }

    /// Planes (n, w), n of length 1: what has n·x + w < 0 is left out. Those beyond
    /// [`MAX_PLANES`] are not there.
    pub(crate) fn clip_planes(&self, world_from_unit_cube: DMat4) -> Vec<DVec4> {
        let mut planes = self.wanted_planes(world_from_unit_cube);
        planes.truncate(MAX_PLANES);
        planes
    }

    /// The planes that are on, and the sides of the box that are drawn in, however many.
    pub(crate) fn wanted_planes(&self, world_from_unit_cube: DMat4) -> Vec<DVec4> {
        let mut planes = Vec::new();
        if self.crop.is_on {
            let normal_from_unit_cube = world_from_unit_cube.inverse().transpose();
            for axis in 0..3 {
                for (is_high, at, border) in [
                    (false, self.crop.low[axis], 0.0),
                    (true, self.crop.high[axis], 1.0),
                ] {
                    if at == border {
                        continue;
                    }
                    let inwards = DVec3::AXES[axis] * if is_high { -1.0 } else { 1.0 };
                    let normal = normal_from_unit_cube
                        .transform_vector3(inwards)
                        .normalize_or_zero();
                    let side = self.crop.middle_of_side(axis, is_high);
                    let point = world_from_unit_cube.transform_point3(side);
                    planes.push(normal.extend(-normal.dot(point)));
                }
            }
        }
        let middle = world_from_unit_cube.transform_point3(DVec3::splat(0.5));
        for plane in self.planes.iter().filter(|plane| plane.is_on) {
            let w = plane.offset + plane.normal.dot(middle);
            planes.push((-plane.normal).extend(w));
        }
        planes
    }

    /// Cuts as [`Self::clip_planes`] gives them: those along the scan's own axes become sides of the
    /// crop box.
    pub(crate) fn set_cuts(&mut self, cuts: &[DVec4], world_from_unit_cube: DMat4) {
        self.crop = Crop::default();
        self.planes.clear();
        let middle = world_from_unit_cube.transform_point3(DVec3::splat(0.5));
        for &cut in cuts {
            match side(world_from_unit_cube.transpose() * cut) {
                Some((axis, is_high, at)) => {
                    let inner = if is_high {
                        at.min(self.crop.high[axis])
                    } else {
                        at.max(self.crop.low[axis])
                    };
                    self.crop.set_side(axis, is_high, inner);
                    self.crop.is_on = true;
                }
                None => self.planes.push(Plane::from_cut(cut, middle)),
            }
        }
    }

    /// The camera's setting for [`Self::exposure_ev`], in Bevy's terms.
    pub(crate) fn exposure(&self) -> Exposure {
        let factor = self.exposure_ev.exp2() / f64::from(DEFAULT_INTENSITY);
        Exposure {
            ev100: -(1.2 * factor).log2() as f32,
        }
    }

    pub(crate) fn intensity(&self) -> f32 {
        DEFAULT_INTENSITY * (self.light.stops as f32).exp2()
    }
}

/// Former and undone looks.
#[derive(Debug, Default)]
pub(crate) struct History {
    before: Vec<Look>,
    after: Vec<Look>,
    /// The look that the last edit ended with.
    settled: Option<Look>,
}

impl History {
    /// Steps that can be undone.
    const DEPTH: usize = 200;

    /// A new beginning, such as another scan.
    pub(crate) fn begin(&mut self, look: &Look) {
        *self = Self {
            settled: Some(look.clone()),
            ..Self::default()
        };
    }

    /// Notes an edit once it is over: a drag is one step.
    pub(crate) fn note(&mut self, look: &Look, is_dragging: bool) {
        if is_dragging || self.settled.as_ref() == Some(look) {
            return;
        }
        if let Some(settled) = self.settled.replace(look.clone()) {
            self.before.push(settled);
            let extra = self.before.len().saturating_sub(Self::DEPTH);
            self.before.drain(..extra);
            self.after.clear();
        }
    }

    pub(crate) fn can_undo(&self) -> bool {
        !self.before.is_empty()
    }

    pub(crate) fn can_redo(&self) -> bool {
        !self.after.is_empty()
    }

    pub(crate) fn undo(&mut self, look: &mut Look) {
        self.note(look, false);
        if let Some(former) = self.before.pop() {
            self.after.push(std::mem::replace(look, former));
            self.settled = Some(look.clone());
        }
    }

    pub(crate) fn redo(&mut self, look: &mut Look) {
        self.note(look, false);
        if let Some(later) = self.after.pop() {
            self.before.push(std::mem::replace(look, later));
            self.settled = Some(look.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use bevy::prelude::Vec3;
    use bevy_holovol::prelude::VolumeClipPlane;

    use super::*;

    fn thick(density: f64) -> Look {
        Look {
            density,
            ..Look::default()
        }
    }

    #[test]
    fn a_drag_is_one_step_and_a_new_edit_forgets_what_was_undone() {
        let mut history = History::default();
        let mut look = thick(1.0);
        history.begin(&look);
        for density in [2.0, 3.0, 4.0] {
            look = thick(density);
            history.note(&look, true);
        }
        history.note(&look, false);
        look = thick(5.0);
        history.undo(&mut look);
        assert_eq!(look, thick(4.0), "an edit that was not noted yet is one");
        history.undo(&mut look);
        assert_eq!(look, thick(1.0), "the drag is undone as a whole");
        assert!(!history.can_undo());
        history.redo(&mut look);
        history.redo(&mut look);
        assert_eq!(look, thick(5.0));
        history.undo(&mut look);
        look = thick(9.0);
        history.note(&look, false);
        assert!(!history.can_redo());
        history.undo(&mut look);
        assert_eq!(look, thick(4.0));
    }

    #[test]
    fn sides_of_the_crop_box_cut_what_is_outside() {
        // A sheared box, 0.2 m along x.
        let matrix = DMat4::from_cols(
            DVec4::new(0.2, 0.0, 0.0, 0.0),
            DVec4::new(0.1, 0.3, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 0.4, 0.0),
            DVec4::new(-1.0, 2.0, 0.0, 1.0),
        );
        let mut look = Look::default();
        look.crop.is_on = true;
        assert!(look.clip_planes(matrix).is_empty(), "the whole scan");
        look.crop.set_side(0, false, 0.25);
        look.crop.set_side(1, true, 0.5);
        let planes = look.clip_planes(matrix);
        assert_eq!(planes.len(), 2);
        for (unit, is_in) in [
            (DVec3::new(0.3, 0.45, 0.9), true),
            (DVec3::new(0.2, 0.45, 0.9), false),
            (DVec3::new(0.3, 0.55, 0.9), false),
        ] {
            let at = matrix.transform_point3(unit).extend(1.0);
            let stays = planes.iter().all(|plane| plane.dot(at) >= 0.0);
            assert_eq!(stays, is_in, "{unit}");
        }
        // It comes back from a scene, with a free plane beside it.
        look.planes.push(Plane {
            normal: DVec3::new(0.6, 0.0, 0.8),
            offset: 0.01,
            is_on: true,
        });
        let cuts = look.clip_planes(matrix);
        let mut again = Look::default();
        again.set_cuts(&cuts, matrix);
        assert!(again.crop.is_on);
        assert!(
            again.crop.low.distance(look.crop.low) < 1e-12,
            "{:?}",
            again.crop
        );
        assert!(
            again.crop.high.distance(look.crop.high) < 1e-12,
            "{:?}",
            again.crop
        );
        let [plane] = again.planes[..] else {
            panic!("{:?}", again.planes);
        };
        assert!((plane.offset - 0.01).abs() < 1e-12);
        look.crop.set_side(0, true, 0.0);
        assert!(look.crop.high.x > look.crop.low.x);
    }

    #[test]
    fn planes_of_the_panel_and_of_bevy_cut_the_same() {
        let normal = DVec3::new(0.6, 0.0, -0.8);
        let look = Look {
            planes: vec![Plane {
                normal,
                offset: 0.05,
                is_on: true,
            }],
            ..Look::default()
        };
        let matrix = DMat4::from_translation(DVec3::new(0.5, 0.5, 0.5));
        let [plane] = look.clip_planes(matrix)[..] else {
            panic!("one plane");
        };
        let again = Plane::from_cut(3.0 * plane, DVec3::ONE);
        assert!(again.normal.distance(normal) < 1e-12 && (again.offset - 0.05).abs() < 1e-12);
        let height = |at: DVec3| plane.dot((DVec3::ONE + at).extend(1.0));
        assert!(height(normal * 0.04) > 0.0 && height(normal * 0.06) < 0.0);
        let transform = VolumeClipPlane::transform(plane);
        let up = transform.rotation * Vec3::Y;
        assert!(up.as_dvec3().distance(normal) < 1e-6);
        let point = transform.translation.as_dvec3().extend(1.0);
        assert!(plane.dot(point).abs() < 1e-6);
    }
}

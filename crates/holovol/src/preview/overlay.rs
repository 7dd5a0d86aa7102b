//! Drawn over the scene: handles of cuts, ruler, orientation, scale.

use bevy::prelude::{Camera, GlobalTransform, Vec3};
use bevy_egui::egui::{self, Align2, Color32, FontId, Order, Pos2, Sense, Stroke, Vec2, vec2};
use glam::{DMat4, DVec3};

use super::measure::{length_text, scale_bar};
use super::panel::{Panel, Shown};
use super::slices::direction_name;
use super::studio::Scan;

/// What is drawn, and the ruler's ends.
pub(crate) struct Overlay {
    pub(crate) shows_marks: bool,
    pub(crate) shows_handles: bool,
    /// While it is there, clicks set its ends.
    ruler: Option<Vec<DVec3>>,
}

impl Default for Overlay {
    fn default() -> Self {
        Self {
            shows_marks: true,
            shows_handles: true,
            ruler: None,
        }
    }
}

impl Overlay {
    pub(crate) fn is_ruling(&self) -> bool {
        self.ruler.is_some()
    }

    pub(crate) fn toggle_ruler(&mut self) {
        self.ruler = match self.ruler {
            Some(_) => None,
            None => Some(Vec::new()),
        };
    }

    /// Puts the ruler away; false if it was not there.
    pub(crate) fn leave_ruler(&mut self) -> bool {
        self.ruler.take().is_some()
    }

    /// Sets an end of the ruler; false if there is none.
    pub(crate) fn click(&mut self, at: DVec3) -> bool {
        let Some(ends) = &mut self.ruler else {
            return false;
        };
        // A third click begins another.
        if ends.len() >= 2 {
            ends.clear();
        }
        ends.push(at);
        true
    }

    /// Metres between the ends, once there are two.
    pub(crate) fn length(&self) -> Option<f64> {
        match self.ruler.as_deref() {
            Some([a, b]) => Some(a.distance(*b)),
            _ => None,
        }
    }
}

/// From the world to the panel's points.
struct Projector<'a> {
    camera: &'a Camera,
    transform: &'a GlobalTransform,
    zoom: f32,
}

impl Projector<'_> {
    fn at(&self, point: DVec3) -> Option<Pos2> {
        let at = self
            .camera
            .world_to_viewport(self.transform, point.as_vec3())
            .ok()?;
        let at = at / self.zoom;
        at.is_finite().then(|| Pos2::new(at.x, at.y))
    }

    fn line(&self, painter: &egui::Painter, ends: [DVec3; 2], stroke: Stroke) {
        if let [Some(a), Some(b)] = ends.map(|end| self.at(end)) {
            let under = Stroke::new(stroke.width + 2.0, Color32::from_black_alpha(110));
            painter.line_segment([a, b], under);
            painter.line_segment([a, b], stroke);
        }
    }
}

const ACCENT: Color32 = Color32::from_rgb(255, 196, 64);

pub(crate) fn draw(
    context: &egui::Context,
    free: egui::Rect,
    panel: &mut Panel,
    shown: &mut Shown,
) {
    let studio = &mut *shown.studio;
    let Some(scan) = &studio.scan else { return };
    let Ok((orbit, camera, transform, ..)) = shown.cameras.get(shown.session.camera) else {
        return;
    };
    let project = Projector {
        camera,
        transform,
        zoom: context.zoom_factor(),
    };
    let layer = egui::LayerId::new(Order::Background, "overlay".into());
    let painter = context.layer_painter(layer).with_clip_rect(free);
    let overlay = &panel.overlay;
    if overlay.shows_handles {
        crop(context, &painter, &project, scan, &mut studio.look.crop);
        planes(context, &painter, &project, scan, &mut studio.look.planes);
    }
    if let Some(ends) = &overlay.ruler {
        ruler(&painter, &project, free, ends, overlay.length());
    }
    if panel.slices.is_open
        && let Some(cross) = panel.slices.cross
    {
        let arm = 0.06 * scan.radius();
        for axis in DVec3::AXES {
            let ends = [cross - axis * arm, cross + axis * arm];
            project.line(&painter, ends, Stroke::new(1.5, ACCENT));
        }
    }
    if overlay.shows_marks {
        let is_patient = scan.is_patient();
        orientation(&painter, transform, free, is_patient);
        // At the depth of what is looked at.
        let side = transform.right().as_vec3() * orbit.distance * 0.1;
        let ends = [orbit.target, orbit.target + side];
        if let [Some(a), Some(b)] = ends.map(|end| project.at(end.as_dvec3())) {
            let metres_per_point = 0.1 * f64::from(orbit.distance / a.distance(b).max(1e-3));
            scale(&painter, free, metres_per_point);
        }
    }
}

/// A round handle; gives how far it is dragged.
fn handle(context: &egui::Context, id: egui::Id, at: Pos2) -> Vec2 {
    const SIZE: f32 = 18.0;
    egui::Area::new(id)
        .fixed_pos(at - vec2(0.5 * SIZE, 0.5 * SIZE))
        .order(Order::Background)
        .constrain(false)
        .fade_in(false)
        .show(context, |ui| {
            let (rect, response) = ui.allocate_exact_size(vec2(SIZE, SIZE), Sense::drag());
            let is_held = response.hovered() || response.dragged();
            let radius = if is_held { 8.0 } else { 6.0 };
            let rim = Stroke::new(1.5, Color32::from_black_alpha(200));
            ui.painter().circle(rect.center(), radius, ACCENT, rim);
            if is_held {
                ui.ctx().set_cursor_icon(egui::CursorIcon::Grab);
            }
            response.drag_delta()
        })
        .inner
}

/// How far along `axis` (metres) a drag on the screen takes a point.
fn along(project: &Projector, at: DVec3, axis: DVec3, drag: Vec2) -> Option<f64> {
    let (from, to) = (project.at(at)?, project.at(at + axis)?);
    let seen = to - from;
    // An axis that points at the viewer can't be dragged along.
    (seen.length() > 2.0).then(|| f64::from(drag.dot(seen) / seen.length_sq()))
}

fn crop(
    context: &egui::Context,
    painter: &egui::Painter,
    project: &Projector,
    scan: &Scan,
    crop: &mut super::look::Crop,
) {
    if !crop.is_on {
        return;
    }
    let matrix: DMat4 = scan.world_from_unit_cube();
    let corner = |bits: usize| {
        let pick = |axis: usize| {
            let end = if bits >> axis & 1 == 1 {
                crop.high
            } else {
                crop.low
            };
            end[axis]
        };
        matrix.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
    };
    for bits in 0..8 {
        for axis in 0..3 {
            if bits >> axis & 1 == 0 {
                let ends = [corner(bits), corner(bits | 1 << axis)];
                project.line(painter, ends, Stroke::new(1.2, ACCENT));
            }
        }
    }
    for axis in 0..3 {
        for is_high in [false, true] {
            let middle = crop.middle_of_side(axis, is_high);
            let at = matrix.transform_point3(middle);
            let Some(place) = project.at(at) else {
                continue;
            };
            let drag = handle(context, egui::Id::new(("crop", axis, is_high)), place);
            let edge = matrix.col(axis).truncate();
            if drag != Vec2::ZERO
                && let Some(part) = along(project, at, edge, drag)
            {
                crop.set_side(axis, is_high, middle[axis] + part);
            }
        }
    }
}

fn planes(
    context: &egui::Context,
    painter: &egui::Painter,
    project: &Projector,
    scan: &Scan,
    planes: &mut [super::look::Plane],
) {
    let (middle, radius) = (scan.middle(), scan.radius());
    for (index, plane) in planes.iter_mut().enumerate() {
        if !plane.is_on {
            continue;
        }
        let at = middle + plane.normal * plane.offset;
        let (a, b) = plane.normal.any_orthonormal_pair();
        // Upright where the plane is.
        let b = if a.y.abs() > b.y.abs() { a } else { b };
        let a = b.cross(plane.normal);
        let reach = 0.7 * radius;
        let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(u, v)| at + (a * u + b * v) * reach);
        for (i, &from) in corners.iter().enumerate() {
            let ends = [from, corners[(i + 1) % 4]];
            project.line(painter, ends, Stroke::new(1.2, ACCENT));
        }
        let arrow = [at, at + plane.normal * 0.25 * radius];
        project.line(painter, arrow, Stroke::new(2.0, ACCENT));
        let Some(place) = project.at(arrow[1]) else {
            continue;
        };
        let drag = handle(context, egui::Id::new(("plane", index)), place);
        if drag != Vec2::ZERO
            && let Some(part) = along(project, arrow[1], plane.normal * radius, drag)
        {
            plane.offset = (plane.offset + part * radius).clamp(-radius, radius);
        }
    }
}

fn text(painter: &egui::Painter, at: Pos2, align: Align2, text: &str, size: f32, color: Color32) {
    let font = FontId::proportional(size);
    for shift in [
        vec2(1.0, 1.0),
        vec2(-1.0, 1.0),
        vec2(1.0, -1.0),
        vec2(-1.0, -1.0),
    ] {
        let shadow = Color32::from_black_alpha(170);
        painter.text(at + shift, align, text, font.clone(), shadow);
    }
    painter.text(at, align, text, font, color);
}

fn ruler(
    painter: &egui::Painter,
    project: &Projector,
    free: egui::Rect,
    ends: &[DVec3],
    length: Option<f64>,
) {
    for &end in ends {
        if let Some(at) = project.at(end) {
            painter.circle(at, 4.0, ACCENT, Stroke::new(1.5, Color32::BLACK));
        }
    }
    if let (&[a, b], Some(length)) = (ends, length) {
        project.line(painter, [a, b], Stroke::new(2.0, ACCENT));
        if let Some(at) = project.at(0.5 * (a + b)) {
            let label = length_text(length);
            // On a plate, clear of handles that may lie on the line.
            let galley = painter.layout_no_wrap(label, FontId::proportional(16.0), ACCENT);
            let place = Align2::CENTER_BOTTOM.anchor_size(at - vec2(0.0, 16.0), galley.size());
            painter.rect_filled(place.expand(4.0), 4.0, Color32::from_black_alpha(190));
            painter.galley(place.min, galley, ACCENT);
        }
        return;
    }
    let hint = match ends.len() {
        0 => "ruler: click where it begins",
        _ => "ruler: click where it ends",
    };
    let at = free.center_top() + vec2(0.0, 12.0);
    text(painter, at, Align2::CENTER_TOP, hint, 15.0, ACCENT);
}

/// Where the patient's sides are, or the axes.
fn orientation(
    painter: &egui::Painter,
    camera: &GlobalTransform,
    free: egui::Rect,
    is_patient: bool,
) {
    const REACH: f32 = 34.0;
    let middle = free.right_bottom() - vec2(REACH + 24.0, REACH + 24.0);
    let view_from_world = camera.rotation().inverse();
    let mut arms: Vec<(f32, Vec2, usize, bool)> = (0..3)
        .flat_map(|axis| {
            [false, true].map(|is_positive| {
                let sign = if is_positive { 1.0 } else { -1.0 };
                let seen = view_from_world * (Vec3::AXES[axis] * sign);
                (seen.z, vec2(seen.x, -seen.y) * REACH, axis, is_positive)
            })
        })
        .collect();
    // The farthest first.
    arms.sort_by(|a, b| a.0.total_cmp(&b.0));
    const COLORS: [Color32; 3] = [
        Color32::from_rgb(255, 110, 100),
        Color32::from_rgb(130, 230, 110),
        Color32::from_rgb(120, 170, 255),
    ];
    for (depth, arm, axis, is_positive) in arms {
        let color = if depth < -0.3 {
            COLORS[axis].gamma_multiply(0.55)
        } else {
            COLORS[axis]
        };
        painter.line_segment([middle, middle + arm * 0.72], Stroke::new(2.0, color));
        let name = direction_name(axis, is_positive, is_patient);
        text(
            painter,
            middle + arm,
            Align2::CENTER_CENTER,
            name,
            14.0,
            color,
        );
    }
}

fn scale(painter: &egui::Painter, free: egui::Rect, metres_per_point: f64) {
    const LONGEST: f64 = 170.0;
    let Some((metres, name)) = scale_bar(LONGEST * metres_per_point) else {
        return;
    };
    let half = 0.5 * (metres / metres_per_point) as f32;
    // Above the orientation, where the status line does not reach.
    let middle = free.right_bottom() - vec2(16.0 + half, 124.0);
    let [left, right] = [-half, half].map(|x| middle + vec2(x, 0.0));
    for (width, color) in [(4.0, Color32::from_black_alpha(170)), (2.0, Color32::WHITE)] {
        let stroke = Stroke::new(width, color);
        painter.line_segment([left, right], stroke);
        for end in [left, right] {
            painter.line_segment([end - vec2(0.0, 5.0), end + vec2(0.0, 5.0)], stroke);
        }
    }
    let at = middle - vec2(0.0, 6.0);
    text(
        painter,
        at,
        Align2::CENTER_BOTTOM,
        &name,
        14.0,
        Color32::WHITE,
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_clicks_measure_and_a_third_begins_anew() {
        let mut overlay = Overlay::default();
        assert!(!overlay.click(DVec3::ZERO), "no ruler, no click for it");
        overlay.toggle_ruler();
        assert!(overlay.click(DVec3::new(0.01, 0.0, 0.0)));
        assert_eq!(overlay.length(), None);
        overlay.click(DVec3::new(0.01, 0.03, 0.04));
        let length = overlay.length().unwrap();
        assert!((length - 0.05).abs() < 1e-12, "{length}");
        overlay.click(DVec3::ZERO);
        assert_eq!(overlay.length(), None);
        overlay.click(DVec3::X);
        assert_eq!(overlay.length(), Some(1.0));
        overlay.toggle_ruler();
        assert!(!overlay.is_ruling());
    }
}

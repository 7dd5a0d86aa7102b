//! The transfer function, drawn over the histogram: points are dragged, added and deleted.

use bevy_egui::egui::{self, Color32, Pos2, Rect, Sense, Stroke, vec2};
use holovol_volume::TransferFunction;

use super::super::look::Look;
use super::super::studio::Scan;
use super::super::transfer::{Axes, bars, insert_point, move_point, remove_point};
use crate::picture::encode_srgb;

const HEIGHT: f32 = 130.0;
/// Logical pixels.
const POINT_RADIUS: f32 = 5.0;
/// Of a bar of the histogram, and of a stripe of colour.
const STRIPE: f32 = 2.0;

/// What the editor remembers.
#[derive(Default)]
pub(crate) struct Curve {
    selected: Option<usize>,
    /// The histogram from end to end; else only where the points are.
    pub(super) shows_all: bool,
    /// Axes stand still while a point is dragged.
    held: Option<Axes>,
}

pub(super) fn draw(ui: &mut egui::Ui, curve: &mut Curve, look: &mut Look, scan: &Scan) {
    let [low, high] = look.window;
    let s_of = |value: f64| (value - low) / (high - low);
    let range = curve.shows_all.then(|| scan.volume().range().map(s_of));
    let axes = curve.held.unwrap_or_else(|| Axes::of(&look.points, range));
    let size = vec2(ui.available_width(), HEIGHT);
    let (rect, background) = ui.allocate_exact_size(size, Sense::click());
    paint(ui, rect, axes, look, scan);
    points(ui, rect, axes, curve, look);

    let background = background.on_hover_text(
        "Drag points; double click for a new one, right click deletes. Below: how often values \
         occur",
    );
    if background.double_clicked()
        && let Some(at) = background.interact_pointer_pos()
    {
        curve.selected = insert_point(&mut look.points, axes.point(place_in(rect, at)));
    }
    let values = axes.s.map(|s| low + s * (high - low));
    ui.horizontal(|ui| {
        ui.weak(number(values[0]));
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            ui.weak(number(values[1]));
        });
    });
    selected(ui, curve, look);
}

fn place_in(rect: Rect, at: Pos2) -> [f64; 2] {
    [
        f64::from((at.x - rect.left()) / rect.width()),
        f64::from((rect.bottom() - at.y) / rect.height()),
    ]
}

fn pos_in(rect: Rect, [x, y]: [f64; 2]) -> Pos2 {
    Pos2::new(
        rect.left() + x as f32 * rect.width(),
        rect.bottom() - y as f32 * rect.height(),
    )
}

fn color(albedo: [f64; 3]) -> Color32 {
    let [r, g, b] = albedo.map(encode_srgb);
    Color32::from_rgb(r, g, b)
}

/// Histogram, the function's colours and its line.
fn paint(ui: &egui::Ui, rect: Rect, axes: Axes, look: &Look, scan: &Scan) {
    let painter = ui.painter().with_clip_rect(rect);
    let visuals = ui.visuals();
    painter.rect_filled(rect, 3.0, visuals.extreme_bg_color);
    let Ok(function) = TransferFunction::new(look.points.clone()) else {
        return;
    };
    let stripes = (rect.width() / STRIPE).floor().max(1.0) as usize;
    let [low, high] = look.window;
    let mut ends = axes.s.map(|s| low + s * (high - low));
    let is_mirrored = ends[0] > ends[1];
    ends.sort_by(f64::total_cmp);
    let mut heights = bars(&scan.histogram, ends, stripes);
    if is_mirrored {
        heights.reverse();
    }
    let grey = visuals.weak_text_color().gamma_multiply(0.6);
    for (i, height) in heights.into_iter().enumerate() {
        let x = (i as f64 + 0.5) / stripes as f64;
        let s = axes.point([x, 0.0])[0];
        let material = function.eval(s);
        let top = pos_in(rect, axes.place(s, material.sigma_t));
        let left = top.x - 0.5 * STRIPE;
        let stripe = |top: f32| {
            let corner = Pos2::new(left, top);
            Rect::from_min_max(corner, Pos2::new(left + STRIPE, rect.bottom()))
        };
        let filled = color(material.albedo).gamma_multiply(0.85);
        painter.rect_filled(stripe(top.y), 0.0, filled);
        let bar = rect.bottom() - height * rect.height();
        // Where matter is, its histogram is seen through it.
        let shade = if bar < top.y {
            grey
        } else {
            grey.gamma_multiply(0.5)
        };
        painter.rect_filled(stripe(bar), 0.0, shade);
    }
    let mut line: Vec<Pos2> = Vec::with_capacity(look.points.len() + 2);
    if let (Some(first), Some(last)) = (look.points.first(), look.points.last()) {
        line.push(pos_in(rect, axes.place(axes.s[0], first.sigma_t)));
        for pair in look.points.windows(2) {
            // Straight in extinction is bent in its cube root.
            const PARTS: usize = 12;
            for part in 0..PARTS {
                let t = part as f64 / PARTS as f64;
                let lerp = |a: f64, b: f64| a + t * (b - a);
                let s = lerp(pair[0].s, pair[1].s);
                let sigma_t = lerp(pair[0].sigma_t, pair[1].sigma_t);
                line.push(pos_in(rect, axes.place(s, sigma_t)));
            }
        }
        line.push(pos_in(rect, axes.place(last.s, last.sigma_t)));
        line.push(pos_in(rect, axes.place(axes.s[1], last.sigma_t)));
    }
    painter.line(line, Stroke::new(1.5, visuals.strong_text_color()));
}

/// The points themselves.
fn points(ui: &mut egui::Ui, rect: Rect, axes: Axes, curve: &mut Curve, look: &mut Look) {
    let mut removed = None;
    let mut is_dragged = false;
    for index in 0..look.points.len() {
        let point = look.points[index];
        let at = pos_in(rect, axes.place(point.s, point.sigma_t));
        let room = Rect::from_center_size(at, egui::Vec2::splat(3.0 * POINT_RADIUS));
        let response = ui.interact(
            room,
            ui.id().with(("point", index)),
            Sense::click_and_drag(),
        );
        if response.clicked() || response.drag_started() {
            curve.selected = Some(index);
        }
        if response.dragged()
            && let Some(to) = response.interact_pointer_pos()
        {
            is_dragged = true;
            move_point(&mut look.points, index, axes.point(place_in(rect, to)));
        }
        if response.secondary_clicked() {
            removed = Some(index);
        }
        let is_chosen = curve.selected == Some(index);
        let radius = if is_chosen || response.hovered() {
            POINT_RADIUS + 1.5
        } else {
            POINT_RADIUS
        };
        let rim = if is_chosen {
            ui.visuals().selection.bg_fill
        } else {
            ui.visuals().strong_text_color()
        };
        ui.painter()
            .circle(at, radius, color(point.albedo), Stroke::new(2.0, rim));
    }
    curve.held = is_dragged.then_some(axes);
    if let Some(index) = removed {
        remove_point(&mut look.points, index);
        curve.selected = None;
    }
}

/// The chosen point's numbers.
fn selected(ui: &mut egui::Ui, curve: &mut Curve, look: &mut Look) {
    let Some(index) = curve.selected.filter(|&index| index < look.points.len()) else {
        return;
    };
    let [low, high] = look.window;
    let mut point = look.points[index];
    let mut value = low + point.s * (high - low);
    let mut is_removed = false;
    egui::Grid::new("point").num_columns(4).show(ui, |ui| {
        ui.label("value");
        let speed = ((high - low) / 400.0).abs().max(1e-9);
        let drag = egui::DragValue::new(&mut value)
            .speed(speed)
            .max_decimals(4);
        if ui.add(drag).changed() {
            point.s = (value - low) / (high - low);
        }
        ui.label("extinction").on_hover_text(
            "How much is scattered and absorbed, against the other points; scenes and pictures have \
             it times density, for the scan's size",
        );
        let speed = 0.02 * point.sigma_t.max(0.01);
        let drag = egui::DragValue::new(&mut point.sigma_t).speed(speed);
        ui.add(drag.range(0.0..=1e7).max_decimals(4));
        ui.end_row();
        ui.label("colour");
        let mut rgb = point.albedo.map(|c| c as f32);
        if ui.color_edit_button_rgb(&mut rgb).changed() {
            point.albedo = rgb.map(|c| f64::from(c.clamp(0.0, 1.0)));
        }
        ui.label("glow")
            .on_hover_text("Light of its own, in the colour above");
        let mut glow = point.emission.iter().copied().fold(0.0, f64::max);
        let drag = egui::DragValue::new(&mut glow).speed(0.01).range(0.0..=1e4);
        if ui.add(drag).changed() {
            point.emission = point.albedo.map(|c| c * glow);
        }
        ui.end_row();
        ui.label("rough")
            .on_hover_text("Of its surface: 0 a mirror, 1 dull");
        let fraction = |number| egui::DragValue::new(number).speed(0.005).range(0.0..=1.0);
        ui.add(fraction(&mut point.roughness));
        ui.label("mirror")
            .on_hover_text("Reflectance of its surface looked at straight on");
        ui.add(fraction(&mut point.specular));
        is_removed = look.points.len() > 1 && ui.button("Delete").clicked();
        ui.end_row();
    });
    let place = [point.s, point.sigma_t];
    let old = look.points[index];
    look.points[index] = holovol_volume::TransferPoint { s: old.s, ..point };
    move_point(&mut look.points, index, place);
    if is_removed {
        remove_point(&mut look.points, index);
        curve.selected = None;
    }
}

/// A value at the end of an axis.
fn number(value: f64) -> String {
    if value.abs() >= 100.0 {
        format!("{value:.0}")
    } else {
        format!("{value:.2}")
    }
}

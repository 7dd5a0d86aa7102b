//! Three linked cuts beside the scene: a click in one moves the cross in all.

use bevy_egui::egui::{self, Align2, Color32, ColorImage, FontId, Pos2, Rect, Sense, Stroke, vec2};
use glam::DVec3;

use super::panel::{Panel, Shown};
use super::slices::{Cut, Field, resample};
use super::studio::Scan;

/// Logical pixels along a cut: the least, the most, and of the screen's width.
const SIDES: [f32; 2] = [96.0, 420.0];
const WIDTH_SHARE: f32 = 0.24;
/// The enlarged cut has this side, the others the rest of three.
const LARGE: f32 = 2.0;

#[derive(Default)]
pub(crate) struct SliceViews {
    pub(crate) is_open: bool,
    /// Where the three meet; the scan's middle at first.
    pub(crate) cross: Option<DVec3>,
    drawn: [Option<Drawn>; 3],
    /// The cut that is larger than the others.
    large: Option<usize>,
    /// The scan that `cross` is in.
    of: u32,
}

impl SliceViews {
    /// What the window takes of the screen's width.
    pub(crate) fn width(&self, screen: Rect) -> f32 {
        let largest = if self.large.is_some() { LARGE } else { 1.0 };
        largest * side(screen) + 28.0
    }
}

/// Logical pixels along each of three cuts of the same size.
fn side(screen: Rect) -> f32 {
    let [least, most] = SIDES;
    let fits = (screen.height() - 130.0) / 3.0 - 8.0;
    fits.min(WIDTH_SHARE * screen.width()).clamp(least, most)
}

struct Drawn {
    at: f64,
    pixels: usize,
    grey: [f64; 2],
    texture: egui::TextureHandle,
}

pub(crate) fn draw(context: &egui::Context, panel: &mut Panel, shown: &mut Shown) {
    let views = &mut panel.slices;
    let studio = &mut *shown.studio;
    let Some(scan) = &mut studio.scan else {
        return;
    };
    if !views.is_open {
        return;
    }
    if views.of != studio.opened {
        views.of = studio.opened;
        views.drawn = Default::default();
    }
    let mut cross = views.cross.unwrap_or(scan.middle());
    let side = side(context.viewport_rect());
    let large = views.large;
    egui::Window::new("slices")
        .title_bar(false)
        .anchor(Align2::LEFT_TOP, [8.0, 8.0])
        .resizable(false)
        .show(context, |ui| {
            ui.spacing_mut().item_spacing.y = 4.0;
            for (index, (cut, drawn)) in Cut::ALL.into_iter().zip(&mut views.drawn).enumerate() {
                let side = match large {
                    None => side,
                    Some(large) if large == index => LARGE * side,
                    Some(_) => 0.5 * (3.0 - LARGE) * side,
                };
                let (moved, is_enlarged) = one(ui, cut, drawn, scan, cross, side);
                cross = moved;
                if is_enlarged {
                    views.large = (large != Some(index)).then_some(index);
                }
            }
            let speed = ((scan.grey[1] - scan.grey[0]) / 300.0).abs().max(1e-9);
            ui.horizontal(|ui| {
                let [mut low, mut high] = scan.grey;
                ui.label("grey");
                ui.add(egui::DragValue::new(&mut low).speed(speed).max_decimals(3));
                ui.label("to");
                ui.add(egui::DragValue::new(&mut high).speed(speed).max_decimals(3));
                if low != high && low.is_finite() && high.is_finite() {
                    scan.grey = [low, high];
                }
            });
            let unit = scan
                .world_from_unit_cube()
                .inverse()
                .transform_point3(cross);
            let value = scan.volume().sample(unit);
            let shown = scan.volume().unit().unwrap_or_default();
            ui.label(format!("value {value:.2} {shown}"));
        });
    views.cross = Some(cross);
}

/// One cut; gives where the cross is now, and whether the cut is to be larger, or smaller again.
fn one(
    ui: &mut egui::Ui,
    cut: Cut,
    drawn: &mut Option<Drawn>,
    scan: &Scan,
    cross: DVec3,
    side: f32,
) -> (DVec3, bool) {
    let matrix = scan.world_from_unit_cube();
    let field = Field::of(matrix);
    let at = cross[cut.across()];
    let pixels = (side * ui.ctx().pixels_per_point()).round() as usize;
    let is_same = |drawn: &Drawn| (drawn.at, drawn.grey, drawn.pixels) == (at, scan.grey, pixels);
    if !drawn.as_ref().is_some_and(is_same) {
        let grey = resample(scan.volume(), matrix, cut, cross, scan.grey, pixels);
        let image = ColorImage::from_gray([pixels, pixels], &grey);
        let options = egui::TextureOptions::LINEAR;
        match drawn {
            Some(drawn) => {
                drawn.texture.set(image, options);
                drawn.at = at;
                drawn.grey = scan.grey;
                drawn.pixels = pixels;
            }
            None => {
                *drawn = Some(Drawn {
                    at,
                    pixels,
                    grey: scan.grey,
                    texture: ui.ctx().load_texture(cut.name(), image, options),
                });
            }
        }
    }
    let (rect, response) = ui.allocate_exact_size(vec2(side, side), Sense::click_and_drag());
    let painter = ui.painter().with_clip_rect(rect);
    if let Some(drawn) = drawn {
        let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        painter.image(drawn.texture.id(), rect, whole, Color32::WHITE);
    }
    let [x, y] = field.place(cut, cross).map(|part| part as f32);
    let centre = rect.left_top() + vec2(x, y) * side;
    let line = Stroke::new(1.0, Color32::from_rgba_unmultiplied(255, 196, 64, 170));
    painter.hline(rect.x_range(), centre.y, line);
    painter.vline(centre.x, rect.y_range(), line);
    let letters = cut.letters(scan.is_patient());
    let places = [
        (rect.left_center() + vec2(3.0, 0.0), Align2::LEFT_CENTER),
        (rect.right_center() - vec2(3.0, 0.0), Align2::RIGHT_CENTER),
        (rect.center_bottom() - vec2(0.0, 2.0), Align2::CENTER_BOTTOM),
        (rect.center_top() + vec2(0.0, 2.0), Align2::CENTER_TOP),
    ];
    let font = FontId::proportional(13.0);
    for (letter, (place, align)) in letters.into_iter().zip(places) {
        painter.text(place, align, letter, font.clone(), Color32::WHITE);
    }
    // Elsewhere the axes at its sides are its name.
    if scan.is_patient() {
        let corner = rect.left_top() + vec2(3.0, 2.0);
        painter.text(
            corner,
            Align2::LEFT_TOP,
            cut.name(),
            FontId::proportional(11.0),
            Color32::GRAY,
        );
    }
    let mut moved = cross;
    if (response.clicked() || response.dragged())
        && let Some(to) = response.interact_pointer_pos()
    {
        let place = (to - rect.left_top()) / side;
        let place = [place.x, place.y].map(|part| f64::from(part.clamp(0.0, 1.0)));
        moved = field.point(cut, cross, place);
    }
    if response.hovered() {
        let lines = ui.input(|input| input.smooth_scroll_delta().y) / 24.0;
        if lines != 0.0 {
            // A voxel or so per line of the wheel.
            let step = 2.0 * field.half / 224.0;
            let axis = cut.across();
            let to = moved[axis] + step * f64::from(lines);
            moved[axis] = to.clamp(
                field.middle[axis] - field.half,
                field.middle[axis] + field.half,
            );
        }
    }
    let is_enlarged = response.double_clicked();
    (moved, is_enlarged)
}

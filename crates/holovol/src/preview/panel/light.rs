//! Light: where it comes from, its panorama with what is bright in it, and a ball in it.

use bevy::tasks::{AsyncComputeTaskPool, Task, block_on, poll_once};
use bevy_egui::egui::{self, Color32, ColorImage, Pos2, Rect, Sense, Stroke, TextureOptions, vec2};
use holovol_light::EnvironmentMap;
use holovol_light::estimate::{FoundLight, LightClass, Rung, find_lights};

use super::super::lights::{HEIGHT, Overview, WIDTH};
use super::super::look::{Light, LightSource, Look};
use super::{Panel, Shown as PanelShown};

/// What has been drawn of the present light.
#[derive(Default)]
pub(crate) struct Shown {
    /// The light, and how often the camera's had changed.
    of: Option<(LightSource, u64)>,
    overview: Option<Overview>,
    lights: Vec<FoundLight>,
    panorama: Option<egui::TextureHandle>,
    ball: Option<(i32, egui::TextureHandle)>,
    /// Another light that is being looked at: 8K take some tenths of a second.
    looking: Option<Task<Self>>,
}

/// Pixels along the ball.
const BALL: usize = 56;

pub(super) fn draw(ui: &mut egui::Ui, panel: &mut Panel, shown: &mut PanelShown) {
    refresh(ui, &mut panel.light, shown);
    camera(ui, shown);
    let Look {
        light, exposure_ev, ..
    } = &mut shown.studio.look;
    ui.horizontal(|ui| {
        let name = match &light.source {
            LightSource::Constant(_) => "the same from everywhere",
            LightSource::Map { name, .. } => name,
        };
        ui.label(name)
            .on_hover_text("Drop a panorama for another: .hdr, .exr, or a picture, .png, .jpg");
        if ui.button("White").clicked() {
            light.source = LightSource::Constant([1.0; 3]);
            *exposure_ev = -light.stops;
        }
        if let LightSource::Constant(rgb) = &mut light.source {
            ui.color_edit_button_rgb(rgb);
        }
    });
    panorama(ui, &mut panel.light, light);
    egui::Grid::new("light").num_columns(2).show(ui, |ui| {
        ui.label("turned by");
        ui.add(egui::Slider::new(&mut light.rotation_deg, -180.0..=180.0).suffix("°"));
        ui.end_row();
        ui.label("stops");
        ui.add(
            egui::Slider::new(&mut light.stops, -8.0..=8.0).clamping(egui::SliderClamping::Never),
        );
        ui.end_row();
    });
    ui.checkbox(&mut light.is_sky, "show it behind the scan");
    let lights = &panel.light.lights;
    if !lights.is_empty() {
        ui.label("lights found, of all light:");
        ui.horizontal_wrapped(|ui| {
            for (index, found) in lights.iter().enumerate() {
                let share = 100.0 * found.share;
                let text = format!("{}: {}, {share:.0} %", index + 1, name(found.class));
                // Not broken within.
                ui.add(egui::Label::new(text).extend())
                    .on_hover_text(whereabouts(found, light.rotation_deg));
            }
        });
    }
}

/// What a 360° camera sees and how sure that is, or a way back to it.
fn camera(ui: &mut egui::Ui, shown: &mut PanelShown) {
    let (Some(camera), Some(live)) = (&shown.room_camera, &shown.live) else {
        return;
    };
    if let Some(problem) = camera.problem().or_else(|| live.problem.clone()) {
        ui.colored_label(ui.visuals().error_fg_color, format!("camera: {problem}"));
    }
    let Some(seen) = shown.environments.get(live.map()) else {
        if camera.problem().is_none() {
            ui.weak("waiting for the camera's first picture");
        }
        return;
    };
    if camera.is(&shown.studio.look.light.source) {
        let evidence = live.rung.map_or("", evidence);
        // Below a tenth of a stop nobody knows a camera.
        let stops = live.sigma_ev.max(0.1);
        let text = format!("{} pictures, {evidence}, ±{stops:.1} stops", live.frames);
        ui.weak(text).on_hover_text(
            "What the room's light was estimated from, and one standard deviation of all light",
        );
    } else if ui
        .button("Camera")
        .on_hover_text("Light by the 360° camera again")
        .clicked()
    {
        camera.choose(&mut shown.studio.look, seen.map());
    }
}

fn evidence(rung: Rung) -> &'static str {
    match rung {
        Rung::Single => "one exposure",
        Rung::SingleAndMeter => "one exposure and a light meter",
        Rung::Bracket => "several exposures",
        Rung::BracketAndMeter => "several exposures and a light meter",
        Rung::Probe => "a probe",
    }
}

fn name(class: LightClass) -> &'static str {
    match class {
        LightClass::Sun => "sun",
        LightClass::Lamp => "lamp",
        LightClass::Window => "window or sky",
        LightClass::Reflection => "reflection",
    }
}

/// Where a light stands, as seen from the scan looking along −z, and how large it is.
fn whereabouts(light: &FoundLight, rotation_deg: f64) -> String {
    let d = light.direction;
    let right = (d.x.atan2(-d.z).to_degrees() - rotation_deg + 180.0).rem_euclid(360.0) - 180.0;
    let up = d.y.clamp(-1.0, 1.0).asin().to_degrees();
    let side = if right < 0.0 { "left" } else { "right" };
    let height = if up < 0.0 { "down" } else { "up" };
    // Across a disc of the same solid angle.
    let across = 2.0
        * (light.solid_angle / std::f64::consts::PI)
            .sqrt()
            .to_degrees();
    format!(
        "{:.0}° {side}, {:.0}° {height}; {across:.1}° across",
        right.abs(),
        up.abs()
    )
}

/// Looks at the light again if it is another.
fn refresh(ui: &egui::Ui, drawn: &mut Shown, shown: &PanelShown) {
    // A camera's light changes while it stays the same source.
    let uploads = shown.live.as_ref().map_or(0, |live| live.uploads);
    let now = (shown.studio.look.light.source.clone(), uploads);
    if let Some(seen) = drawn
        .looking
        .as_mut()
        .and_then(|task| block_on(poll_once(task)))
    {
        *drawn = seen;
    }
    if drawn.looking.is_none()
        && drawn.of.as_ref() != Some(&now)
        && let Some(map) = shown.map()
    {
        let task = async move { Shown::of(now, &map) };
        drawn.looking = Some(AsyncComputeTaskPool::get().spawn(task));
    }
    if drawn.looking.is_some() {
        ui.ctx().request_repaint();
    }
    let Some(overview) = &drawn.overview else {
        return;
    };
    if drawn.panorama.is_none() {
        let pixels = overview.picture().concat();
        let image = ColorImage::from_rgb([WIDTH, HEIGHT], &pixels);
        let texture = ui
            .ctx()
            .load_texture("panorama", image, TextureOptions::LINEAR);
        drawn.panorama = Some(texture);
    }
    // A degree is not seen on a ball so small.
    let degrees = shown.studio.look.light.rotation_deg.round() as i32;
    if drawn.ball.as_ref().map(|ball| ball.0) != Some(degrees) {
        let pixels = overview
            .ball(f64::from(degrees).to_radians(), BALL)
            .concat();
        let image = ColorImage::from_rgba_unmultiplied([BALL, BALL], &pixels);
        match &mut drawn.ball {
            Some((of, texture)) => {
                *of = degrees;
                texture.set(image, TextureOptions::LINEAR);
            }
            None => {
                let texture = ui.ctx().load_texture("ball", image, TextureOptions::LINEAR);
                drawn.ball = Some((degrees, texture));
            }
        }
    }
}

impl Shown {
    /// What shows chalk in the present map just below white; `None` before it has been looked at.
    pub(super) fn exposure_ev(&self) -> Option<f64> {
        self.overview.as_ref().map(Overview::exposure_ev)
    }

    fn of(source: (LightSource, u64), map: &EnvironmentMap) -> Self {
        let overview = Overview::new(map);
        Self {
            of: Some(source),
            lights: find_lights(map),
            overview: Some(overview),
            panorama: None,
            ball: None,
            looking: None,
        }
    }
}

/// The panorama as it stands in the room: dragging it turns the light.
fn panorama(ui: &mut egui::Ui, drawn: &mut Shown, light: &mut Light) {
    let (Some(panorama), Some((_, ball))) = (&drawn.panorama, &drawn.ball) else {
        return;
    };
    ui.horizontal(|ui| {
        let width = ui.available_width() - BALL as f32 - 12.0;
        let (rect, response) =
            ui.allocate_exact_size(vec2(width, 0.5 * width), Sense::click_and_drag());
        // The image's centre is −z; turning the light by +θ moves it to the left.
        let shift = -(light.rotation_deg / 360.0) as f32;
        let painter = ui.painter().with_clip_rect(rect);
        let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        for turn in -1..=1 {
            let moved = rect.translate(vec2((shift + turn as f32) * rect.width(), 0.0));
            painter.image(panorama.id(), moved, whole, Color32::WHITE);
        }
        for (index, bright) in drawn.lights.iter().enumerate() {
            let [u, v] = EnvironmentMap::uv_from_direction(bright.direction);
            let x = (u as f32 + shift).rem_euclid(1.0);
            let at = Pos2::new(
                rect.left() + x * rect.width(),
                rect.top() + v as f32 * rect.height(),
            );
            let radius = 4.0 + 12.0 * bright.share.sqrt() as f32;
            painter.circle_stroke(at, radius, Stroke::new(2.5, Color32::from_black_alpha(160)));
            painter.circle_stroke(at, radius, Stroke::new(1.2, Color32::YELLOW));
            let font = egui::FontId::proportional(11.0);
            let text = (index + 1).to_string();
            painter.text(at, egui::Align2::CENTER_CENTER, text, font, Color32::YELLOW);
        }
        if response.dragged() {
            let turned =
                light.rotation_deg - f64::from(response.drag_delta().x / rect.width() * 360.0);
            light.rotation_deg = (turned + 180.0).rem_euclid(360.0) - 180.0;
        }
        response.on_hover_text("Drag to turn the light");
        let size = egui::Vec2::splat(BALL as f32);
        ui.image((ball.id(), size))
            .on_hover_text("A ball in this light: half mirror, half chalk");
    });
}

//! The control panel, drawn over the scene: what it shows and how its parts fit together.

mod choose;
mod curve;
mod cut;
mod files;
mod info;
mod keys;
mod light;
mod matter;
mod status;
mod view;

use std::path::PathBuf;
use std::sync::Arc;

use bevy::camera::{Exposure, Viewport};
use bevy::diagnostic::DiagnosticsStore;
use bevy::prelude::*;
use bevy::render::renderer::{RenderAdapterInfo, RenderDevice};
use bevy_egui::egui::text::LayoutJob;
use bevy_egui::{EguiContexts, EguiPreUpdateSet, EguiPrimaryContextPass, egui};
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::*;
use holovol_light::EnvironmentMap;
pub(crate) use keys::CONTROL;

use super::camera::Orbit;
use super::look::LightSource;
use super::open::Opening;
use super::pictures::{Order, Pictures};
use super::pointer::Pointer;
use super::quality::Quality;
use super::scene_io::{self, Viewpoint, free_name, stem};
use super::settings::Settings;
use super::studio::Studio;
use super::{Session, Status, overlay, slice_views};
use crate::Failure;
use crate::room_camera::RoomCamera;

pub(crate) struct PanelPlugin;

impl Plugin for PanelPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Panel>()
            .add_systems(EguiPrimaryContextPass, draw)
            .add_systems(Update, keys::shortcuts)
            .add_systems(
                PreUpdate,
                keys::keep_tab
                    .after(EguiPreUpdateSet::ProcessInput)
                    .before(EguiPreUpdateSet::BeginPass),
            );
    }
}

/// Logical pixels.
const WIDTH: f32 = 330.0;

/// What the panel itself remembers; nothing of it is in the picture.
#[derive(Resource)]
pub(crate) struct Panel {
    pub(crate) is_open: bool,
    /// A path typed in, since not every desktop drags files.
    path: String,
    /// Where pictures and scenes go.
    folder: String,
    curve: curve::Curve,
    light: light::Shown,
    pub(crate) slices: slice_views::SliceViews,
    pub(crate) overlay: overlay::Overlay,
    /// Samples per pixel of pictures.
    samples: u32,
    turntable_frames: u32,
    shows_about: bool,
    /// The scan that it was last drawn for.
    of: u32,
    /// Pixels per point at which all glyphs have been drawn once.
    glyphs_at: f32,
}

impl Default for Panel {
    fn default() -> Self {
        let folder = std::env::current_dir().unwrap_or_else(|_| PathBuf::from("."));
        Self {
            is_open: true,
            path: String::new(),
            folder: folder.to_string_lossy().into_owned(),
            curve: curve::Curve::default(),
            light: light::Shown::default(),
            slices: slice_views::SliceViews::default(),
            overlay: overlay::Overlay::default(),
            samples: 256,
            turntable_frames: 36,
            shows_about: false,
            of: 0,
            glyphs_at: 0.0,
        }
    }
}

/// All that the panel shows and edits.
#[derive(bevy::ecs::system::SystemParam)]
pub(crate) struct Shown<'w, 's> {
    pub(crate) studio: ResMut<'w, Studio>,
    pub(crate) session: ResMut<'w, Session>,
    opening: ResMut<'w, Opening>,
    pictures: ResMut<'w, Pictures>,
    settings: ResMut<'w, Settings>,
    pub(crate) pointer: Res<'w, Pointer>,
    environments: Res<'w, Assets<EnvironmentAsset>>,
    pub(crate) cameras: Query<
        'w,
        's,
        (
            &'static mut Orbit,
            &'static mut Camera,
            &'static GlobalTransform,
            &'static Projection,
            Option<&'static Exposure>,
        ),
    >,
    statistics: Res<'w, VolumeStatistics>,
    diagnostics: Res<'w, DiagnosticsStore>,
    quality: Res<'w, Quality>,
    adapter: Res<'w, RenderAdapterInfo>,
    device: Res<'w, RenderDevice>,
    room_camera: Option<Res<'w, RoomCamera>>,
    live: Option<Res<'w, LiveLight>>,
}

impl Shown<'_, '_> {
    fn viewpoint(&self) -> Option<Viewpoint> {
        let (orbit, camera, _, projection, exposure) =
            self.cameras.get(self.session.camera).ok()?;
        viewpoint((orbit, camera, projection, exposure))
    }

    /// The map that lights everything.
    fn map(&self) -> Option<Arc<EnvironmentMap>> {
        match &self.studio.look.light.source {
            LightSource::Constant(radiance) => Some(Arc::new(EnvironmentMap::constant(*radiance))),
            LightSource::Map { map, .. } => Some(Arc::clone(self.environments.get(map)?.map())),
        }
    }

    fn tell(&mut self, outcome: Result<String, Failure>) {
        self.session.status = Some(match outcome {
            Ok(text) => Status::Done(text),
            Err(failure) => Status::Failed(failure.to_string()),
        });
    }

    /// Writes the view as a scene.
    fn save_scene(&mut self, panel: &Panel) {
        let (Some(view), Some(scan)) = (self.viewpoint(), &self.studio.scan) else {
            return;
        };
        let look = &self.studio.look;
        // Not `SCAN.json`, which describes raw voxels beside it.
        let name = format!("{}-view", stem(&self.session.name));
        let path = free_name(&panel.folder(), &name, "json", &["nrrd", "light.exr"]);
        let file = scene_io::scene_file(look, scan, &view);
        let map = self.map();
        let source = &look.light.source;
        let outcome = scene_io::save(file, scan, source, map.as_deref(), &path).map(|files| {
            let beside = match files.len() {
                1 => "",
                _ => ", with the files that it needs beside it",
            };
            format!("{} is written{beside}", path.display())
        });
        self.tell(outcome);
    }

    /// Begins to take pictures of the view, `.png` or `.exr`; more than one are a turntable.
    fn take_pictures(&mut self, panel: &Panel, extension: &str, frames: u32) {
        let (Some(view), Some(scan), Some(map)) = (self.viewpoint(), &self.studio.scan, self.map())
        else {
            return;
        };
        let look = &self.studio.look;
        let folder = panel.folder();
        let pictures = if frames == 1 {
            let path = free_name(&folder, stem(&self.session.name), extension, &[]);
            vec![(view.camera(), path)]
        } else {
            let name = format!("{}-turn", stem(&self.session.name));
            let first = free_name(&folder, &name, extension, &[&format!("0000.{extension}")]);
            let cameras = super::pictures::turntable(&view, frames);
            let numbered = |frame| crate::output::numbered(&first, None, Some(frame));
            (0..frames)
                .map(numbered)
                .zip(cameras)
                .map(|(path, camera)| (camera, path))
                .collect()
        };
        let order = Order {
            scene: scene_io::scene_file(look, scan, &view),
            volume: scan.volume().clone(),
            map,
            pictures,
            samples: panel.samples,
        };
        if let Err(failure) = self.pictures.begin(order) {
            self.tell(Err(failure));
        }
    }
}

/// What a viewpoint is made of.
pub(crate) type CameraParts<'a> = (&'a Orbit, &'a Camera, &'a Projection, Option<&'a Exposure>);

pub(crate) fn viewpoint((orbit, camera, projection, exposure): CameraParts) -> Option<Viewpoint> {
    let Projection::Perspective(perspective) = projection else {
        return None;
    };
    let exposure = exposure.copied().unwrap_or_default().exposure();
    Some(Viewpoint {
        transform: orbit.transform(),
        distance: orbit.distance,
        fov: perspective.fov,
        size: camera.physical_viewport_size()?,
        exposure: exposure * bevy_holovol::environment::DEFAULT_INTENSITY,
    })
}

impl Panel {
    fn folder(&self) -> PathBuf {
        files::expand(&self.folder)
    }
}

fn draw(mut contexts: EguiContexts, mut panel: ResMut<Panel>, mut shown: Shown) -> Result {
    let context = contexts.ctx_mut()?.clone();
    let panel = &mut *panel;
    let theme = if shown.settings.is_light {
        egui::Theme::Light
    } else {
        egui::Theme::Dark
    };
    if context.theme() != theme {
        context.set_theme(theme);
    }
    glyphs(&context, &mut panel.glyphs_at);
    if (context.zoom_factor() - shown.settings.zoom).abs() > 1e-3 {
        context.set_zoom_factor(shown.settings.zoom);
    }
    if let Some(outcome) = shown.pictures.outcome() {
        shown.session.status = Some(match outcome {
            Ok(text) => Status::Done(text),
            Err(text) => Status::Failed(text),
        });
    }
    let mut free = context.viewport_rect();
    if panel.is_open {
        free.max.x -= WIDTH + 28.0;
    }
    if panel.slices.is_open {
        free.min.x += panel.slices.width(context.viewport_rect());
    }
    fit_viewport(&context, free, &mut shown);
    paint_beside(&context, free);
    forget_former_scan(panel, &shown);
    overlay::draw(&context, free, panel, &mut shown);
    status::draw(&context, free, &mut shown);
    slice_views::draw(&context, panel, &mut shown);
    info::about(&context, panel);
    choose::draw(&context, &mut shown);
    if panel.is_open {
        window(&context, panel, &mut shown);
    }
    let is_editing =
        context.input(|input| input.pointer.any_down()) || context.egui_wants_keyboard_input();
    let studio = &mut *shown.studio;
    studio.history.note(&studio.look, is_editing);
    Ok(())
}

/// Draws all characters that may come into the font's texture: those that are new to it are
/// missing for a frame, which is seen where frames are slow.
fn glyphs(context: &egui::Context, drawn_at: &mut f32) {
    if *drawn_at == context.pixels_per_point() {
        return;
    }
    *drawn_at = context.pixels_per_point();
    let characters = (' '..='~').chain("äöüÄÖÜßéèàç×°·−–—…±µ²³½≤≥".chars());
    let styles = &context.global_style().text_styles;
    let sizes = [11.0, 13.0].map(egui::FontId::proportional);
    let fonts: Vec<egui::FontId> = styles.values().cloned().chain(sizes).collect();
    for character in characters {
        for font in &fonts {
            // Each is drawn for four places within a pixel.
            for quarter in 0..4 {
                let white = egui::Color32::WHITE;
                let text = character.to_string();
                let mut job = LayoutJob::simple_singleline(text, font.clone(), white);
                let section = job.sections.first_mut();
                if let Some(section) = section {
                    section.leading_space = (0.25 * quarter as f32 + 0.01) / *drawn_at;
                }
                context.fonts_mut(|fonts| fonts.layout_job(job));
            }
        }
    }
}

/// The window beside the scan's part of it.
fn paint_beside(context: &egui::Context, free: egui::Rect) {
    let screen = context.viewport_rect();
    let fill = context.global_style().visuals.panel_fill;
    let painter = context.layer_painter(egui::LayerId::background());
    let mut left = screen;
    left.max.x = free.min.x;
    let mut right = screen;
    right.min.x = free.max.x;
    for beside in [left, right] {
        painter.rect_filled(beside, 0.0, fill);
    }
}

/// What was measured in one scan says nothing of the next.
fn forget_former_scan(panel: &mut Panel, shown: &Shown) {
    if panel.of != shown.studio.opened {
        panel.of = shown.studio.opened;
        panel.overlay.leave_ruler();
        panel.slices.cross = None;
    }
}

/// The scan stands in the middle of what the panel leaves free.
fn fit_viewport(context: &egui::Context, free: egui::Rect, shown: &mut Shown) {
    let scale = context.pixels_per_point();
    let camera = shown.session.camera;
    let Ok((_, mut camera, ..)) = shown.cameras.get_mut(camera) else {
        return;
    };
    let Some(target) = camera.physical_target_size() else {
        return;
    };
    let pixels = |x: f32, most: u32| ((x * scale).round().max(0.0) as u32).min(most);
    let low = UVec2::new(pixels(free.left(), target.x), pixels(free.top(), target.y));
    let high = UVec2::new(
        pixels(free.right(), target.x),
        pixels(free.bottom(), target.y),
    );
    // A window hardly wider than the panel shows the scan behind it.
    let is_roomy = high.x >= low.x + target.x / 4 && high.y > low.y;
    let wanted = is_roomy.then(|| (low, high - low));
    let found = camera
        .viewport
        .as_ref()
        .map(|v| (v.physical_position, v.physical_size));
    if found != wanted {
        camera.viewport = wanted.map(|(physical_position, physical_size)| Viewport {
            physical_position,
            physical_size,
            ..default()
        });
    }
}

fn window(context: &egui::Context, panel: &mut Panel, shown: &mut Shown) {
    let screen = context.viewport_rect();
    let frame = egui::Frame::side_top_panel(&context.global_style()).inner_margin(8.0);
    let height = screen.height() - 16.0;
    egui::Window::new("holovol")
        .title_bar(false)
        .frame(frame)
        .fixed_pos(egui::Pos2::new(screen.right() - WIDTH - 28.0, screen.top()))
        .fixed_size([WIDTH + 12.0, height])
        .vscroll(true)
        .show(context, |ui| {
            ui.set_width(WIDTH);
            ui.set_min_height(height - 12.0);
            buttons(ui, panel, shown);
            files::draw(ui, panel, shown);
            if shown.studio.scan.is_none() {
                return;
            }
            type Section = fn(&mut egui::Ui, &mut Panel, &mut Shown);
            let sections: [(&str, bool, Section); 7] = [
                ("Matter", true, matter::draw),
                ("Light", false, light::draw),
                ("Cut", false, cut::draw),
                ("View", false, view::draw),
                ("Pictures", false, view::pictures),
                ("Statistics", false, |ui, _, shown| info::numbers(ui, shown)),
                ("Keys", false, |ui, _, _| info::keys(ui)),
            ];
            for (title, is_open, section) in sections {
                egui::CollapsingHeader::new(title)
                    .default_open(is_open)
                    .show(ui, |ui| section(ui, panel, shown));
            }
            ui.separator();
            ui.horizontal(|ui| {
                if ui.button("About").clicked() {
                    panel.shows_about = true;
                }
                let text = if shown.settings.is_light {
                    "Dark"
                } else {
                    "Bright"
                };
                if ui.button(text).clicked() {
                    shown.settings.is_light = !shown.settings.is_light;
                    shown.settings.save();
                }
                for (text, factor) in [("A−", 1.0 / 1.125), ("A+", 1.125)] {
                    if ui.button(text).on_hover_text("Size of the panel").clicked() {
                        let zoom = (shown.settings.zoom * factor).clamp(0.5, 3.0);
                        shown.settings.zoom = zoom;
                        shown.settings.save();
                    }
                }
            });
        });
}

fn buttons(ui: &mut egui::Ui, panel: &mut Panel, shown: &mut Shown) {
    ui.horizontal(|ui| {
        let studio = &mut *shown.studio;
        let undo = egui::Button::new("Undo");
        if ui.add_enabled(studio.history.can_undo(), undo).clicked() {
            studio.history.undo(&mut studio.look);
        }
        let redo = egui::Button::new("Redo");
        if ui.add_enabled(studio.history.can_redo(), redo).clicked() {
            studio.history.redo(&mut studio.look);
        }
        ui.separator();
        let has_scan = shown.studio.scan.is_some();
        ui.add_enabled_ui(has_scan, |ui| {
            let save = ui.button("Save scene");
            if save
                .on_hover_text("For `holovol render`, and to come back to")
                .clicked()
            {
                shown.save_scene(panel);
            }
            if ui.button("Picture").clicked() {
                shown.take_pictures(panel, "png", 1);
            }
            ui.toggle_value(&mut panel.slices.is_open, "Slices");
        });
    });
}

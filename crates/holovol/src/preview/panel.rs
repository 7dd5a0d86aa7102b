//! The control panel, the status line, and screenshots.

use std::path::PathBuf;

use bevy::diagnostic::FrameCount;
use bevy::prelude::*;
use bevy::render::renderer::RenderAdapterInfo;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured};
use bevy_egui::{EguiContexts, EguiPrimaryContextPass, egui};
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::*;
use holovol_volume::TransferFunction;

use super::camera::Orbit;
use super::open::Opening;
use super::quality::{Quality, RESTING_SAMPLES};
use super::{Session, Status};

pub(crate) struct PanelPlugin;

impl Plugin for PanelPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Panel>()
            .add_systems(EguiPrimaryContextPass, draw)
            .add_systems(Update, shortcuts);
    }
}

/// What the panel itself remembers.
#[derive(Resource)]
struct Panel {
    is_open: bool,
    /// A path typed in, since not every desktop drags files.
    path: String,
    clip: Option<Entity>,
}

impl Default for Panel {
    fn default() -> Self {
        Self {
            is_open: true,
            path: String::new(),
            clip: None,
        }
    }
}

const SHORTCUTS: &[(&str, &str)] = &[
    ("drag", "turn"),
    ("Shift or right drag", "move"),
    ("wheel, pinch", "nearer, farther"),
    ("F", "fly or orbit"),
    ("W A S D Q E", "fly"),
    ("Home", "first view"),
    ("P", "picture"),
    ("Tab", "panel"),
];

fn shortcuts(
    mut commands: Commands,
    keys: Res<ButtonInput<KeyCode>>,
    typing: Res<bevy_egui::input::EguiWantsInput>,
    mut panel: ResMut<Panel>,
) {
    if typing.wants_keyboard_input() {
        return;
    }
    if keys.just_pressed(KeyCode::Tab) {
        panel.is_open = !panel.is_open;
    }
    if keys.just_pressed(KeyCode::KeyP) {
        take_picture(&mut commands);
    }
}

/// Of the window, as it is, in the folder that the command was started in.
fn take_picture(commands: &mut Commands) {
    commands.spawn(Screenshot::primary_window()).observe(
        |captured: On<ScreenshotCaptured>,
         mut session: ResMut<Session>,
         frames: Res<FrameCount>| {
            let path = PathBuf::from(format!("holovol-{}.png", frames.0));
            let saved = captured
                .image
                .clone()
                .try_into_dynamic()
                .map_err(|error| error.to_string())
                .and_then(|image| {
                    let rgb = image.to_rgb8();
                    rgb.save(&path).map_err(|error| error.to_string())
                });
            let shown = std::path::absolute(&path).unwrap_or(path);
            session.status = Some(match saved {
                Ok(()) => Status::Done(format!("{} is written", shown.display())),
                Err(error) => Status::Failed(format!(
                    "{}: the picture can't be written: {error}; start holovol in a folder that \
                     can be written",
                    shown.display()
                )),
            });
        },
    );
}

#[derive(bevy::ecs::system::SystemParam)]
struct Shown<'w, 's> {
    volumes: Res<'w, Assets<VolumeAsset>>,
    transfer_functions: ResMut<'w, Assets<TransferFunctionAsset>>,
    environment: ResMut<'w, VolumeEnvironment>,
    parts: Query<
        'w,
        's,
        (
            &'static Volume3d,
            &'static VolumeMaterial3d,
            &'static mut VolumeMedium,
        ),
    >,
    cameras: Query<'w, 's, (&'static mut Orbit, &'static mut VolumeRenderSettings)>,
    planes: Query<'w, 's, &'static mut Transform, With<VolumeClipPlane>>,
    statistics: Res<'w, VolumeStatistics>,
    quality: Res<'w, Quality>,
    adapter: Res<'w, RenderAdapterInfo>,
}

fn draw(
    mut contexts: EguiContexts,
    mut commands: Commands,
    mut panel: ResMut<Panel>,
    mut session: ResMut<Session>,
    mut opening: ResMut<Opening>,
    mut shown: Shown,
) -> Result {
    let context = contexts.ctx_mut()?.clone();
    status(&context, &mut session, &opening, &shown);
    if !panel.is_open {
        return Ok(());
    }
    egui::Window::new("holovol")
        .anchor(egui::Align2::RIGHT_TOP, [-8.0, 8.0])
        .default_width(260.0)
        .resizable(false)
        .vscroll(true)
        .show(&context, |ui| {
            files(ui, &mut panel, &mut opening);
            ui.collapsing("Matter", |ui| matter(ui, &session, &mut shown));
            ui.collapsing("Light", |ui| light(ui, &mut shown));
            ui.collapsing("View", |ui| view(ui, &mut commands, &session, &mut shown));
            ui.collapsing("Clip", |ui| {
                clip(ui, &mut commands, &session, &mut panel, &mut shown)
            });
            ui.collapsing("Statistics", |ui| numbers(ui, &shown));
            ui.collapsing("Keys", |ui| {
                egui::Grid::new("keys").show(ui, |ui| {
                    for (key, what) in SHORTCUTS {
                        ui.monospace(*key);
                        ui.label(*what);
                        ui.end_row();
                    }
                });
            });
            ui.collapsing("About", |ui| {
                ui.label(concat!("holovol ", env!("CARGO_PKG_VERSION")));
                ui.label("Path-traced volumes in the light of a room.");
                ui.strong("Not for diagnosis: this is no medical device.");
            });
        });
    Ok(())
}

/// One line at the bottom: what is being read, what went wrong, how far the picture is.
fn status(context: &egui::Context, session: &mut Session, opening: &Opening, shown: &Shown) {
    let numbers = shown.statistics.get();
    egui::Area::new("status".into())
        .anchor(egui::Align2::LEFT_BOTTOM, [8.0, -8.0])
        .show(context, |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.set_max_width(760.0);
                if let Some((name, part)) = opening.progress() {
                    ui.horizontal(|ui| {
                        ui.label(format!("reading {name}"));
                        match part {
                            Some(part) => {
                                ui.add(egui::ProgressBar::new(part).desired_width(160.0));
                            }
                            None => {
                                ui.spinner();
                            }
                        }
                    });
                    return;
                }
                let problem = numbers.errors.first().cloned();
                match (&session.status, problem) {
                    (_, Some(error)) => {
                        ui.colored_label(ui.visuals().error_fg_color, error);
                    }
                    (Some(Status::Failed(error)), _) => {
                        let mut is_read = false;
                        ui.horizontal_wrapped(|ui| {
                            ui.colored_label(ui.visuals().error_fg_color, error);
                            is_read = ui.button("OK").clicked();
                        });
                        if is_read {
                            session.status = None;
                        }
                    }
                    (Some(Status::Done(text)), _) => {
                        ui.label(text);
                    }
                    (None, _) if numbers.is_waiting => {
                        ui.label("compiling and uploading");
                    }
                    (None, _) => {
                        let spp = numbers.samples_per_pixel;
                        ui.label(format!(
                            "{}   {spp} / {RESTING_SAMPLES} samples",
                            session.name
                        ));
                    }
                }
            });
        });
}

fn files(ui: &mut egui::Ui, panel: &mut Panel, opening: &mut Opening) {
    ui.label(
        "Drop a scan, a folder, a scene, a transfer function or a light map, or type its path:",
    );
    ui.horizontal(|ui| {
        let field = ui.text_edit_singleline(&mut panel.path);
        let entered = field.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
        if (ui.button("Open").clicked() || entered) && !panel.path.trim().is_empty() {
            opening.open(PathBuf::from(panel.path.trim()));
        }
    });
}

fn matter(ui: &mut egui::Ui, session: &Session, shown: &mut Shown) {
    let Ok((volume, material, mut medium)) = shown.parts.get_mut(session.volume) else {
        return;
    };
    let range = shown
        .volumes
        .get(&volume.0)
        .map(|asset| asset.volume().range());
    let [low_end, high_end] = range.unwrap_or([0.0, 1.0]);
    let speed = ((high_end - low_end) / 300.0).abs().max(1e-9);
    let mut edited = medium.clone();
    let (mut low, mut high) = edited.window.unwrap_or((low_end, high_end));
    egui::Grid::new("matter").num_columns(2).show(ui, |ui| {
        ui.label("values from");
        ui.add(egui::DragValue::new(&mut low).speed(speed));
        ui.end_row();
        ui.label("to");
        ui.add(egui::DragValue::new(&mut high).speed(speed));
        ui.end_row();
        ui.label("density");
        let density = egui::Slider::new(&mut edited.density, 0.01..=100.0).logarithmic(true);
        ui.add(density);
        ui.end_row();
        ui.label("surface");
        ui.add(egui::Slider::new(&mut edited.gradient_factor, 0.0..=10.0));
        ui.end_row();
        ui.label("forward");
        ui.add(egui::Slider::new(&mut edited.phase_g, -0.95..=0.95));
        ui.end_row();
    });
    if low != high {
        edited.window = Some((low, high));
    }
    medium.set_if_neq(edited);
    points(ui, material, &mut shown.transfer_functions);
}

/// The transfer function, point by point.
fn points(
    ui: &mut egui::Ui,
    material: &VolumeMaterial3d,
    assets: &mut Assets<TransferFunctionAsset>,
) {
    let Some(asset) = assets.get(&material.0) else {
        return;
    };
    let mut file = asset.file().clone();
    let before = file.transfer_function.points().to_vec();
    let mut edited = before.clone();
    let mut removed = None;
    ui.separator();
    egui::Grid::new("points").num_columns(4).show(ui, |ui| {
        for title in ["at", "extinction", "colour", ""] {
            ui.weak(title);
        }
        ui.end_row();
        for (i, point) in edited.iter_mut().enumerate() {
            ui.add(egui::DragValue::new(&mut point.s).speed(0.005));
            let speed = 0.02 * point.sigma_t.max(0.1);
            let extinction = egui::DragValue::new(&mut point.sigma_t).speed(speed);
            ui.add(extinction.range(0.0..=1e7));
            let mut rgb = point.albedo.map(|c| c as f32);
            if ui.color_edit_button_rgb(&mut rgb).changed() {
                point.albedo = rgb.map(|c| f64::from(c.clamp(0.0, 1.0)));
            }
            if before.len() > 1 && ui.small_button("×").clicked() {
                removed = Some(i);
            }
            ui.end_row();
        }
    });
    if let Some(i) = removed {
        edited.remove(i);
    }
    if ui.small_button("+ point").clicked()
        && let Some(last) = edited.last().copied()
    {
        edited.push(holovol_volume::TransferPoint {
            s: last.s + 0.1,
            ..last
        });
    }
    if edited == before {
        return;
    }
    edited.sort_by(|a, b| a.s.total_cmp(&b.s));
    // What is not valid is not taken: the field shows its old value again.
    if let Ok(function) = TransferFunction::new(edited) {
        file.transfer_function = function;
        if let Some(mut asset) = assets.get_mut(&material.0) {
            *asset = TransferFunctionAsset::new(file);
        }
    }
}

fn light(ui: &mut egui::Ui, shown: &mut Shown) {
    let mut edited = shown.environment.clone();
    let mut degrees = edited.rotation_y.to_degrees();
    let mut stops = (edited.intensity / bevy_holovol::environment::DEFAULT_INTENSITY).log2();
    egui::Grid::new("light").num_columns(2).show(ui, |ui| {
        ui.label("turned by");
        ui.add(egui::Slider::new(&mut degrees, -180.0..=180.0).suffix("°"));
        ui.end_row();
        ui.label("stops");
        ui.add(egui::Slider::new(&mut stops, -8.0..=8.0));
        ui.end_row();
    });
    ui.checkbox(&mut edited.is_sky, "show it behind the scan");
    edited.rotation_y = degrees.to_radians();
    edited.intensity = bevy_holovol::environment::DEFAULT_INTENSITY * stops.exp2();
    // Slider rounding alone is no change.
    let turned = (edited.rotation_y - shown.environment.rotation_y).abs() > 1e-5;
    let brighter = (edited.intensity / shown.environment.intensity - 1.0).abs() > 1e-5;
    if turned || brighter || edited.is_sky != shown.environment.is_sky {
        *shown.environment = edited;
    }
}

fn view(ui: &mut egui::Ui, commands: &mut Commands, session: &Session, shown: &mut Shown) {
    let Ok((mut orbit, mut settings)) = shown.cameras.get_mut(session.camera) else {
        return;
    };
    ui.horizontal(|ui| {
        if ui.button("First view").clicked() {
            orbit.go_home();
        }
        if ui.button("Picture").clicked() {
            take_picture(commands);
        }
    });
    let mut scatters = settings.max_scatters;
    ui.horizontal(|ui| {
        ui.label("scatterings");
        for (text, value) in [("1", Some(1)), ("4", Some(4)), ("all", None)] {
            ui.selectable_value(&mut scatters, value, text);
        }
    });
    if settings.max_scatters != scatters {
        settings.max_scatters = scatters;
    }
    let mut flies = orbit.flies;
    if ui.checkbox(&mut flies, "fly").changed() {
        orbit.flies = flies;
    }
}

fn clip(
    ui: &mut egui::Ui,
    commands: &mut Commands,
    session: &Session,
    panel: &mut Panel,
    shown: &mut Shown,
) {
    let mut is_cut = panel.clip.is_some();
    if ui.checkbox(&mut is_cut, "cut the scan open").changed() {
        panel.clip = match panel.clip {
            Some(plane) => {
                commands.entity(plane).despawn();
                None
            }
            None => Some(
                commands
                    .spawn((VolumeClipPlane, ChildOf(session.volume)))
                    .id(),
            ),
        };
    }
    let Some(mut transform) = panel
        .clip
        .and_then(|plane| shown.planes.get_mut(plane).ok())
    else {
        return;
    };
    let reach = shown
        .parts
        .get(session.volume)
        .ok()
        .and_then(|(volume, ..)| shown.volumes.get(&volume.0))
        .map_or(0.2, |asset| {
            let matrix = asset.local_from_unit_cube();
            let edge = |i| matrix.col(i).truncate().length();
            (0.6 * edge(0).max(edge(1)).max(edge(2))) as f32
        });
    let normal = transform.rotation * Vec3::Y;
    let axes = [("x", Vec3::X), ("y", Vec3::Y), ("z", Vec3::Z)];
    let mut chosen = None;
    ui.horizontal(|ui| {
        ui.label("away along");
        for (name, axis) in axes {
            for (sign, text) in [(1.0, format!("+{name}")), (-1.0, format!("−{name}"))] {
                let direction = sign * axis;
                let is_chosen = normal.dot(direction) > 0.99;
                if ui.selectable_label(is_chosen, text).clicked() {
                    chosen = Some(direction);
                }
            }
        }
    });
    let normal = chosen.unwrap_or(normal);
    let mut height = transform.translation.dot(normal) / reach;
    let moved = ui.add(egui::Slider::new(&mut height, -1.0..=1.0).text("place"));
    if chosen.is_some() || moved.changed() {
        *transform = Transform {
            translation: normal * height * reach,
            rotation: Quat::from_rotation_arc(Vec3::Y, normal),
            scale: Vec3::ONE,
        };
    }
}

fn numbers(ui: &mut egui::Ui, shown: &Shown) {
    let numbers = shown.statistics.get();
    let rows = [
        ("adapter", shown.adapter.name.clone()),
        (
            "frame",
            format!("{:.0} ms", 1e3 * shown.quality.frame_seconds),
        ),
        ("samples per pixel", numbers.samples_per_pixel.to_string()),
        (
            "samples in all",
            format!("{:.1} M", numbers.samples as f64 / 1e6),
        ),
        ("uploads", numbers.uploads.to_string()),
    ];
    egui::Grid::new("numbers").num_columns(2).show(ui, |ui| {
        for (name, value) in rows {
            ui.label(name);
            ui.monospace(value);
            ui.end_row();
        }
    });
}

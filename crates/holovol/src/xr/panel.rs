//! The panel in the room: egui on a rectangle that stands where it was opened, pressed with a
//! fingertip, or with a ray and a pinch.

use bevy::camera::RenderTarget;
use bevy::camera::visibility::RenderLayers;
use bevy::ecs::schedule::ScheduleLabel;
use bevy::light::NotShadowCaster;
use bevy::prelude::*;
use bevy::render::render_resource::{SpecializedRenderPipelines, TextureFormat};
use bevy::render::{GpuResourceAppExt, RenderApp};
use bevy_egui::input::EguiInputEvent;
use bevy_egui::render::EguiPipeline;
use bevy_egui::render::systems::{EguiRenderData, EguiTransforms};
use bevy_egui::{EguiContext, EguiInputSet, EguiPreUpdateSet, EguiSchedule, egui};
use bevy_holovol::interaction::{InteractionSystems, SurfaceTouch, TouchPanel};
use bevy_holovol::prelude::*;
use bevy_holovol::xr::{EyeCamera, HeadPose, before};

use super::actions::{Action, OwnPlane};
use super::place::Placed;
use crate::preview::presets::Preset;
use crate::preview::settings::Noise;
use crate::preview::studio::Studio;

/// m to the right and the upper edge.
const HALF_SIZE: Vec2 = Vec2::new(0.18, 0.21);
/// egui's points, and pixels for each.
const POINTS: UVec2 = UVec2::new(360, 420);
const PIXELS_PER_POINT: f32 = 2.0;
/// m before the head, and radians to its right, where it opens: beside the volume.
const DISTANCE: f32 = 0.6;
const ASIDE: f32 = 0.55;

pub(super) struct RoomPanelPlugin {
    pub(super) is_open: bool,
}

impl Plugin for RoomPanelPlugin {
    fn build(&self, app: &mut App) {
        app.insert_resource(PanelIsOpen(self.is_open))
            .add_systems(
                PreUpdate,
                poke.after(InteractionSystems)
                    .after(EguiPreUpdateSet::InitContexts)
                    .before(EguiInputSet::WriteEguiEvents),
            )
            .add_systems(
                Update,
                (toggle, spawn.run_if(is_open.and_then(run_once)), place).chain(),
            )
            .add_systems(RoomPanelPass, draw);
    }

    /// bevy_egui 0.42 makes these once: they are of the device that Bevy had then. What else it has
    /// there is made in each frame, and fonts stay in the main world.
    fn finish(&self, app: &mut App) {
        if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
            render_app
                .init_gpu_resource::<EguiPipeline>()
                .init_gpu_resource::<SpecializedRenderPipelines<EguiPipeline>>()
                .init_gpu_resource::<EguiTransforms>()
                .init_gpu_resource::<EguiRenderData>();
        }
    }
}

/// Whether it is wanted; it opens as soon as it is known where the head is.
#[derive(Resource)]
pub(super) struct PanelIsOpen(pub(super) bool);

#[derive(ScheduleLabel, Clone, Debug, PartialEq, Eq, Hash)]
struct RoomPanelPass;

/// What is drawn into the picture.
#[derive(Component)]
struct PanelCamera;

/// The rectangle that has it.
#[derive(Component)]
struct RoomPanel;

fn is_open(panel: Res<PanelIsOpen>) -> bool {
    panel.0
}

/// Not before it is opened for the first time.
fn spawn(
    mut commands: Commands,
    mut images: ResMut<Assets<Image>>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let size = (POINTS.as_vec2() * PIXELS_PER_POINT).as_uvec2();
    let format = TextureFormat::Rgba8UnormSrgb;
    let image = images.add(Image::new_target_texture(size.x, size.y, format, None));
    commands.spawn((
        PanelCamera,
        Camera2d,
        Camera {
            // Before the eyes, which see it in the same frame.
            order: -3,
            is_active: false,
            clear_color: ClearColorConfig::Custom(Color::BLACK),
            ..default()
        },
        Msaa::Off,
        RenderTarget::Image(image.clone().into()),
        RenderLayers::none(),
        EguiSchedule::new(RoomPanelPass),
    ));
    let material = materials.add(StandardMaterial {
        base_color_texture: Some(image),
        unlit: true,
        ..default()
    });
    commands.spawn((
        RoomPanel,
        Mesh3d(meshes.add(Rectangle::from_size(2.0 * HALF_SIZE))),
        MeshMaterial3d(material),
        NotShadowCaster,
        Visibility::Hidden,
    ));
}

fn toggle(mut actions: MessageReader<Action>, mut is_open: ResMut<PanelIsOpen>) {
    let presses = actions.read().filter(|action| **action == Action::Panel);
    if presses.count() % 2 == 1 {
        is_open.0 = !is_open.0;
    }
}

type Shown<'a> = (
    Entity,
    &'a mut Transform,
    &'a mut Visibility,
    Has<TouchPanel>,
);

/// Opens it beside what the user looks at, and closes it.
fn place(
    mut commands: Commands,
    is_open: Res<PanelIsOpen>,
    head: Res<HeadPose>,
    placed: Res<Placed>,
    mut panel: Single<Shown, With<RoomPanel>>,
    mut camera: Single<&mut Camera, With<PanelCamera>>,
) {
    let (entity, transform, visibility, is_shown) = &mut *panel;
    // A user who has been placed is there in the next frame; the panel comes along.
    let is_placed = placed.0.is_some() && !placed.is_changed();
    let is_wanted = is_open.0 && is_placed && (*is_shown || head.0.is_some());
    if is_wanted == *is_shown {
        return;
    }
    camera.is_active = is_wanted;
    if is_wanted && let Some(head) = head.0 {
        let turned = head.rotation * Quat::from_rotation_y(-ASIDE);
        **transform = before(Isometry3d::new(head.translation, turned), DISTANCE);
        **visibility = Visibility::Inherited;
        commands.entity(*entity).insert(TouchPanel::new(HALF_SIZE));
    } else {
        **visibility = Visibility::Hidden;
        commands.entity(*entity).remove::<TouchPanel>();
    }
}

/// Tells egui what the hands do.
fn poke(
    panel: Query<&TouchPanel, With<RoomPanel>>,
    context: Query<Entity, With<PanelCamera>>,
    mut events: MessageWriter<EguiInputEvent>,
    mut was_at: Local<bool>,
) {
    let (Ok(context), touch) = (context.single(), panel.single().map(TouchPanel::touch)) else {
        return;
    };
    let touch = touch.unwrap_or_default();
    let happened = events_of(touch, &mut was_at);
    events.write_batch(
        happened
            .into_iter()
            .flatten()
            .map(|event| EguiInputEvent { context, event }),
    );
}

/// A touch as a pointer; `was_at`: whether there was one in the frame before.
fn events_of(touch: SurfaceTouch, was_at: &mut bool) -> [Option<egui::Event>; 3] {
    let is_at = touch.hand.is_some();
    let left = std::mem::replace(was_at, is_at) && !is_at;
    let at = touch.place * POINTS.as_vec2();
    let pos = egui::pos2(at.x, at.y);
    let button = |pressed| egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::NONE,
    };
    let change = match touch {
        _ if touch.just_pressed => Some(button(true)),
        _ if touch.just_released => Some(button(false)),
        _ => None,
    };
    [
        is_at.then_some(egui::Event::PointerMoved(pos)),
        change,
        left.then_some(egui::Event::PointerGone),
    ]
}

fn draw(
    mut panel: Single<(&mut EguiContext, &Camera), With<PanelCamera>>,
    mut studio: ResMut<Studio>,
    planes: Query<(), With<OwnPlane>>,
    mut eyes: Query<&mut VolumeRenderSettings, With<EyeCamera>>,
    mut actions: MessageWriter<Action>,
) {
    let (context, camera) = &mut *panel;
    if !camera.is_active {
        return;
    }
    let context = context.get_mut().clone();
    if context.zoom_factor() != PIXELS_PER_POINT {
        context.set_zoom_factor(PIXELS_PER_POINT);
    }
    if context.theme() != egui::Theme::Dark {
        context.set_theme(egui::Theme::Dark);
    }
    let size = POINTS.as_vec2();
    let margin = 12.0;
    let frame = egui::Frame::side_top_panel(&context.global_style()).inner_margin(margin);
    egui::Window::new("holovol")
        .title_bar(false)
        .frame(frame)
        .fixed_pos(egui::Pos2::ZERO)
        .fixed_size([size.x - 2.0 * margin, size.y - 2.0 * margin])
        .show(&context, |ui| {
            // Fingertips are thick.
            let spacing = ui.spacing_mut();
            spacing.interact_size.y = 30.0;
            spacing.item_spacing = egui::vec2(8.0, 8.0);
            spacing.slider_width = 200.0;
            ui.set_min_size(egui::vec2(size.x - 2.0 * margin, size.y - 2.0 * margin));
            presets(ui, &mut studio);
            ui.separator();
            let look = &mut studio.look;
            ui.label("Exposure, EV");
            ui.add(egui::Slider::new(&mut look.exposure_ev, -8.0..=8.0).step_by(0.1));
            ui.label("Density");
            ui.add(egui::Slider::new(&mut look.density, 0.05..=20.0).logarithmic(true));
            ui.separator();
            noise(ui, &mut eyes);
            ui.separator();
            ui.horizontal_wrapped(|ui| {
                if ui
                    .selectable_label(!planes.is_empty(), "Cut by hand")
                    .clicked()
                {
                    actions.write(Action::Cut(1));
                }
                if ui.button("Bring it here").clicked() {
                    actions.write(Action::Reset);
                }
                if ui.button("Close").clicked() {
                    actions.write(Action::Panel);
                }
            });
        });
}

fn presets(ui: &mut egui::Ui, studio: &mut Studio) {
    ui.label("Show as");
    ui.horizontal_wrapped(|ui| {
        for preset in Preset::ALL {
            let Studio { look, scan, .. } = &mut *studio;
            let Some(scan) = scan else { continue };
            if ui.button(preset.name()).clicked() {
                preset.apply(look, scan);
            }
        }
    });
}

fn noise(ui: &mut egui::Ui, eyes: &mut Query<&mut VolumeRenderSettings, With<EyeCamera>>) {
    let now = eyes.iter().next().map(|eye| (eye.mode, eye.denoiser));
    ui.label("Noise");
    ui.horizontal_wrapped(|ui| {
        for (noise, name, _) in Noise::ALL {
            let wanted = (noise.mode(), noise.denoiser());
            let is_on = now.is_some_and(|now| match noise {
                Noise::Left => now.0 != VolumeRenderMode::Denoised,
                _ => now == wanted,
            });
            if ui.selectable_label(is_on, name).clicked() && !is_on {
                for mut eye in eyes.iter_mut() {
                    (eye.mode, eye.denoiser) = wanted;
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant};

    use bevy::ecs::change_detection::Tick;
    use bevy::render::error_handler::{RenderErrorHandler, RenderErrorPolicy};
    use bevy::render::gpu_readback::{Readback, ReadbackComplete};
    use bevy::render::render_resource::{PollType, TextureUsages};
    use bevy::render::renderer::RenderDevice;
    use bevy_egui::{EguiGlobalSettings, EguiPlugin};
    use bevy_holovol::InteractionPlugin;

    use super::*;
    use crate::preview::tests::{app_with, has_adapter};

    const PATIENCE: Duration = Duration::from_secs(60);

    /// An open panel without a headset.
    fn room(app: &mut App) {
        app.add_plugins((
            EguiPlugin::default(),
            InteractionPlugin,
            RoomPanelPlugin { is_open: true },
        ))
        .insert_resource(EguiGlobalSettings {
            auto_create_primary_context: false,
            ..default()
        })
        .insert_resource(HeadPose(Some(Isometry3d::IDENTITY)))
        .insert_resource(Placed(Some((AssetId::default(), Transform::IDENTITY))))
        .add_message::<Action>();
    }

    fn read(app: &mut App, image: &Handle<Image>) -> Vec<u8> {
        let found = Arc::new(Mutex::new(None));
        let result = Arc::clone(&found);
        let reader = app
            .world_mut()
            .spawn(Readback::texture(image.clone()))
            .observe(move |event: On<ReadbackComplete>| {
                *result.lock().unwrap() = Some(event.data.clone());
            })
            .id();
        let start = Instant::now();
        loop {
            app.update();
            if let Some(picture) = found.lock().unwrap().take() {
                app.world_mut().despawn(reader);
                return picture;
            }
            assert!(start.elapsed() < PATIENCE, "nothing was read back");
        }
    }

    /// When Bevy got its device.
    fn device_tick(app: &App) -> Tick {
        let device = app.world().get_resource_ref::<RenderDevice>();
        device.unwrap().last_changed()
    }

    #[test]
    fn the_panel_is_there_again_on_another_device() {
        if !has_adapter() {
            return;
        }
        let (mut app, _) = app_with(room);
        app.insert_resource(RenderErrorHandler(|_, _, _| {
            RenderErrorPolicy::Recover(default())
        }));
        app.update();
        let mut targets = app
            .world_mut()
            .query_filtered::<&RenderTarget, With<PanelCamera>>();
        let target = targets.single(app.world()).unwrap().as_image().unwrap();
        let target = target.clone();
        {
            let mut images = app.world_mut().resource_mut::<Assets<Image>>();
            let mut image = images.get_mut(&target).unwrap();
            image.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        }
        let start = Instant::now();
        let mut before = read(&mut app, &target);
        loop {
            let is_bright = |texel: &&[u8]| texel[0] > 100;
            let written = before.chunks(4).filter(is_bright).count();
            let now = read(&mut app, &target);
            if written > 1000 && now == before {
                break;
            }
            before = now;
            assert!(start.elapsed() < PATIENCE, "no panel: {written}");
        }
        // Bevy 0.19 keeps the buffers that it reads back with for ten frames, and takes them for the
        // other device's then.
        for _ in 0..15 {
            app.update();
        }
        let former = device_tick(&app);
        let device = app.world().resource::<RenderDevice>().clone();
        // What Bevy reads back doesn't expect to lose it.
        device.poll(PollType::wait_indefinitely()).unwrap();
        device.wgpu_device().destroy();
        device.poll(PollType::wait_indefinitely()).unwrap();
        let start = Instant::now();
        while device_tick(&app) == former || read(&mut app, &target) != before {
            app.update();
            assert!(start.elapsed() < PATIENCE, "no panel");
        }
    }

    #[test]
    fn a_poke_is_a_click_where_it_is_and_leaves() {
        let mut was_at = false;
        let mut touch = SurfaceTouch {
            hand: Some(1),
            place: Vec2::new(0.25, 0.5),
            ..default()
        };
        let pos = egui::pos2(90.0, 210.0);
        let hover = events_of(touch, &mut was_at);
        assert_eq!(hover, [Some(egui::Event::PointerMoved(pos)), None, None]);
        (touch.just_pressed, touch.is_pressed) = (true, true);
        let [moved, press, gone] = events_of(touch, &mut was_at);
        assert!(moved.is_some() && gone.is_none());
        let is_press = |event: &Option<egui::Event>, wanted| match event {
            Some(egui::Event::PointerButton {
                pos: at, pressed, ..
            }) => (*at, *pressed) == (pos, wanted),
            _ => false,
        };
        assert!(is_press(&press, true), "{press:?}");
        touch.just_pressed = false;
        assert_eq!(events_of(touch, &mut was_at)[1], None, "once");
        (touch.just_released, touch.is_pressed) = (true, false);
        assert!(is_press(&events_of(touch, &mut was_at)[1], false));
        let gone = Some(egui::Event::PointerGone);
        assert_eq!(
            events_of(SurfaceTouch::default(), &mut was_at),
            [None, None, gone]
        );
        assert_eq!(
            events_of(SurfaceTouch::default(), &mut was_at),
            [None, None, None]
        );
    }
}

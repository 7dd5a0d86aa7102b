//! The eyes as cameras: where they are, what they draw into, and when.

use bevy::camera::{CameraProjection, ImageRenderTarget, RenderTarget, SubCameraView};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::math::Vec3A;
use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;
use bevy::render::render_resource::{TextureFormat, TextureUsages};

use super::cost::FrameCost;
use super::output::RoomOutput;
use super::pose::{self, EyeView, FieldOfView};
use super::session::CurrentFrame;
use super::{HeadsetBlend, HeadsetStatus, MixedRealitySettings};
use crate::environment::WithoutSky;
use crate::interaction::{Hands, Viewer};
use crate::{RightEyeOf, VolumeSampling};

/// m; scans are looked at from near.
pub(crate) const NEAR: f32 = 0.03;

/// An eye's camera: 0 is the left one, 1 the right.
///
/// Whatever else these cameras shall have (layers, bloom …) can be inserted; their transform,
/// projection, target and activity are set in every frame.
#[derive(Component, ExtractComponent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct EyeCamera(pub usize);

/// Where tracking space stands in the world: moving it moves the user. Spawned by
/// [`MixedRealityPlugin`](super::MixedRealityPlugin), parent of the eyes. Without scale: hands and head
/// keep their size.
#[derive(Component, Clone, Copy, Debug, Default)]
#[require(Transform, Visibility)]
pub struct MixedRealityOrigin;

/// Where the head is; in the world's coordinates.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct HeadPose(pub Option<Isometry3d>);

/// A place `distance` m before a head and somewhat below it, upright, that faces it: +z is toward the
/// user.
pub fn before(head: Isometry3d, distance: f32) -> Transform {
    let ahead = head.rotation * Vec3::NEG_Z;
    let ahead = Vec3::new(ahead.x, 0.0, ahead.z);
    let ahead = ahead.try_normalize().unwrap_or(Vec3::NEG_Z);
    let below = Vec3::new(0.0, -0.15 * distance, 0.0);
    Transform::from_translation(Vec3::from(head.translation) + distance * ahead + below)
        .looking_to(ahead, Vec3::Y)
}

/// What the eyes draw into.
#[derive(Resource, Clone, Debug)]
pub struct EyeImages {
    /// Left and right.
    pub images: [Handle<Image>; 2],
    size: UVec2,
    format: TextureFormat,
}

/// The projection of an eye, asymmetric as its optics.
#[derive(Debug, Clone)]
pub(crate) struct EyeProjection {
    fov: FieldOfView,
    near: f32,
}

impl EyeProjection {
    pub(crate) fn new(fov: FieldOfView) -> Self {
        Self { fov, near: NEAR }
    }
}

impl Default for EyeProjection {
    fn default() -> Self {
        Self::new(FieldOfView {
            left: -0.7,
            right: 0.7,
            up: 0.7,
            down: -0.7,
        })
    }
}

impl CameraProjection for EyeProjection {
    fn get_clip_from_view(&self) -> Mat4 {
        self.fov.clip_from_view(self.near)
    }

    /// Part of an eye is the whole eye: nothing draws one in parts.
    fn get_clip_from_view_for_sub(&self, _sub_view: &SubCameraView) -> Mat4 {
        self.get_clip_from_view()
    }

    fn update(&mut self, _width: f32, _height: f32) {}

    fn far(&self) -> f32 {
        1000.0
    }

    fn get_frustum_corners(&self, z_near: f32, z_far: f32) -> [Vec3A; 8] {
        let [left, right, up, down] =
            [self.fov.left, self.fov.right, self.fov.up, self.fov.down].map(f32::tan);
        let corners = |z: f32| {
            let depth = z.abs();
            [(right, down), (right, up), (left, up), (left, down)]
                .map(|(x, y)| Vec3A::new(x * depth, y * depth, z))
        };
        let ([a, b, c, d], [e, f, g, h]) = (corners(z_near), corners(z_far));
        [a, b, c, d, e, f, g, h]
    }
}

pub(crate) fn clip_from_view(fov: FieldOfView) -> Mat4 {
    fov.clip_from_view(NEAR)
}

/// The tracking origin and the eyes.
pub(crate) fn spawn(
    mut commands: Commands,
    mut images: ResMut<Assets<Image>>,
    settings: Res<MixedRealitySettings>,
    status: Res<HeadsetStatus>,
) {
    let eyes = EyeImages::new(&mut images, &settings, status.eye_size);
    let origin = commands.spawn(MixedRealityOrigin).id();
    let mut left = None;
    for index in 0..2 {
        let mut eye = commands.spawn((
            EyeCamera(index),
            ChildOf(origin),
            Camera3d::default(),
            Camera {
                // Before the window's cameras, which may show the eyes.
                order: index as isize - 2,
                is_active: false,
                ..default()
            },
            target(&eyes, index),
            Projection::custom(EyeProjection::default()),
            Msaa::Off,
            DebandDither::Disabled,
            settings.render.clone(),
            VolumeSampling::default(),
            settings.layers.clone(),
        ));
        if let Some(left) = left.replace(eye.id()) {
            eye.insert(RightEyeOf(left));
        }
    }
    commands.insert_resource(eyes);
}

fn target(eyes: &EyeImages, index: usize) -> RenderTarget {
    RenderTarget::Image(ImageRenderTarget::from(eyes.images[index].clone()))
}

impl EyeImages {
    fn new(images: &mut Assets<Image>, settings: &MixedRealitySettings, full: UVec2) -> Self {
        let size = full.max(UVec2::ONE);
        let format = settings.eye_format;
        let image = || {
            let mut image = Image::new_target_texture(size.x, size.y, format, None);
            image.texture_descriptor.usage |=
                TextureUsages::COPY_SRC | TextureUsages::TEXTURE_BINDING;
            image
        };
        Self {
            images: [images.add(image()), images.add(image())],
            size,
            format,
        }
    }
}

type Eye<'a> = (
    Entity,
    &'a EyeCamera,
    &'a mut Camera,
    &'a mut RenderTarget,
    &'a mut Transform,
    &'a mut Projection,
);

/// Moves the eyes to where the runtime has them, and the hands.
#[expect(clippy::too_many_arguments, reason = "all that an eye consists of")]
pub(crate) fn update(
    mut commands: Commands,
    frame: Res<CurrentFrame>,
    status: Res<HeadsetStatus>,
    settings: Res<MixedRealitySettings>,
    mut images: ResMut<Assets<Image>>,
    mut eyes: ResMut<EyeImages>,
    mut head: ResMut<HeadPose>,
    mut hands: ResMut<Hands>,
    mut viewer: ResMut<Viewer>,
    origin: Query<&GlobalTransform, With<MixedRealityOrigin>>,
    mut cameras: Query<Eye>,
    mut blend: Local<Option<HeadsetBlend>>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let size = status.eye_size.max(UVec2::ONE);
    let is_new = eyes.size != size || eyes.format != settings.eye_format;
    if is_new {
        *eyes = EyeImages::new(&mut images, &settings, status.eye_size);
    }
    let has_new_blend = blend.replace(status.blend) != Some(status.blend);
    let views = frame.timing.and_then(|timing| {
        let views = frame.views?;
        timing.should_render.then_some(views)
    });
    for (entity, eye, mut camera, mut render_target, mut transform, mut projection) in &mut cameras
    {
        camera.is_active = views.is_some();
        if is_new {
            *render_target = target(&eyes, eye.0);
        }
        if has_new_blend || settings.is_changed() {
            dress(
                &mut commands.entity(entity),
                &mut camera,
                status.blend,
                &settings,
            );
        }
        if let Some(view) = views.as_ref().and_then(|views| views.get(eye.0)) {
            *transform = Transform::from_isometry(view.pose);
            let wanted = EyeProjection::new(view.fov);
            match &mut *projection {
                Projection::Custom(custom) => match custom.get_mut::<EyeProjection>() {
                    Some(projection) => *projection = wanted,
                    None => *projection = Projection::custom(wanted),
                },
                _ => *projection = Projection::custom(wanted),
            }
        }
    }
    let place = origin.single().map(GlobalTransform::to_isometry);
    let place = place.unwrap_or_default();
    head.0 = frame.views.as_ref().map(|views| place * pose::head(views));
    *hands = frame.hands.moved(place);
    *viewer = Viewer(head.0);
}

/// What the way that pictures meet the room asks of a camera.
fn dress(
    commands: &mut EntityCommands,
    camera: &mut Camera,
    blend: HeadsetBlend,
    settings: &MixedRealitySettings,
) {
    if blend == HeadsetBlend::Opaque {
        camera.clear_color = ClearColorConfig::Default;
        commands
            .insert(settings.tonemapping)
            .remove::<(WithoutSky, RoomOutput)>();
    } else {
        // The room is the background; `output` maps tones.
        camera.clear_color = ClearColorConfig::Custom(Color::NONE);
        let output = if blend == HeadsetBlend::Additive {
            RoomOutput::Additive
        } else {
            RoomOutput::Alpha
        };
        commands.insert((Tonemapping::None, WithoutSky, output));
    }
}

/// An eye's pose in the world.
pub(crate) fn world_from_eye(root: &GlobalTransform, view: &EyeView) -> GlobalTransform {
    root.mul_transform(Transform::from_isometry(view.pose))
}

//! Bevy's light and sky for meshes, filtered from the map on a worker.

use std::f64::consts::PI;
use std::sync::Arc;

use bevy::asset::RenderAssetUsages;
use bevy::light::{EnvironmentMapLight, Skybox};
use bevy::prelude::*;
use bevy::render::render_resource::{
    Extent3d, TextureDimension, TextureFormat, TextureViewDescriptor, TextureViewDimension,
};
use bevy::render::renderer::RenderDevice;
use bevy::tasks::{AsyncComputeTaskPool, Task, futures::check_ready};
use glam::{DMat3, DVec3};
use half::f16;
use holovol_light::EnvironmentMap;

use super::{EnvironmentAsset, EnvironmentSource, VolumeEnvironment, WithoutSky};
use crate::VolumeRenderSettings;

/// Texels along a face: irradiance is smooth, reflections less so.
const DIFFUSE_SIZE: u32 = 16;
const SPECULAR_SIZE: u32 = 128;
const SKY_MAX_SIZE: u32 = 1024;
/// Cells of the grid that irradiance is summed over: 3° wide.
const GRID_WIDTH: usize = 128;
/// Draws for a texel of a rough reflection.
const SPECULAR_DRAWS: u32 = 64;

/// What is being filtered, and the last that was.
#[derive(Resource, Default)]
pub(super) struct Filtering {
    light: Filter<[Image; 2], [Handle<Image>; 2]>,
    sky: Filter<Image, Handle<Image>>,
}

/// A map that is made into what Bevy takes.
struct Filter<Made, Kept> {
    source: Option<Arc<EnvironmentMap>>,
    task: Option<Task<Made>>,
    kept: Option<Kept>,
}

impl<Made, Kept> Default for Filter<Made, Kept> {
    fn default() -> Self {
        Self {
            source: None,
            task: None,
            kept: None,
        }
    }
}

impl<Made: Send + 'static, Kept> Filter<Made, Kept> {
    /// Takes in what is done, and begins if the map is another and this is wanted.
    fn follow(
        &mut self,
        map: &Arc<EnvironmentMap>,
        is_wanted: bool,
        make: impl FnOnce(&EnvironmentMap) -> Made + Send + 'static,
        keep: impl FnOnce(Made) -> Kept,
    ) {
        if let Some(made) = self.task.as_mut().and_then(check_ready) {
            self.task = None;
            self.kept = Some(keep(made));
        }
        // One at a time: live light is filtered as fast as that goes.
        let is_same = |source: &Arc<EnvironmentMap>| Arc::ptr_eq(source, map);
        if self.task.is_some() || self.source.as_ref().is_some_and(is_same) {
            return;
        }
        if is_wanted {
            let map = Arc::clone(map);
            self.source = Some(Arc::clone(&map));
            let task = AsyncComputeTaskPool::get().spawn(async move { make(&map) });
            self.task = Some(task);
        } else {
            // Not to be seen for a moment when it is wanted again.
            *self = Self::default();
        }
    }
}

/// What we gave a camera. Light that differs, or is gone, is the user's doing and stays so.
#[derive(Component)]
pub(super) struct LitByEnvironment(EnvironmentMapLight);
#[derive(Component)]
pub(super) struct SkyOfEnvironment(Skybox);

fn is_same_light(a: &EnvironmentMapLight, b: &EnvironmentMapLight) -> bool {
    a.diffuse_map == b.diffuse_map
        && a.specular_map == b.specular_map
        && a.intensity == b.intensity
        && a.rotation == b.rotation
        && a.affects_lightmapped_mesh_diffuse == b.affects_lightmapped_mesh_diffuse
}

fn is_same_sky(a: &Skybox, b: &Skybox) -> bool {
    a.image == b.image && a.brightness == b.brightness && a.rotation == b.rotation
}

/// The map that lights everything now; `None` while it is loading.
#[derive(Resource, Default)]
pub(crate) struct CurrentMap(pub(crate) Option<Arc<EnvironmentMap>>);

/// Follows the source; the same light stays the same map.
pub(super) fn update_map(
    environment: Res<VolumeEnvironment>,
    assets: Res<Assets<EnvironmentAsset>>,
    mut current: ResMut<CurrentMap>,
) {
    let map = match &environment.source {
        EnvironmentSource::Constant(radiance) => {
            // As maps have it, so that what is not light is the same in every frame, too.
            let light = |c: f32| if c.is_finite() { c.max(0.0) } else { 0.0 };
            let texel = [radiance.red, radiance.green, radiance.blue].map(light);
            let is_same = |map: &Arc<EnvironmentMap>| map.as_constant() == Some(texel);
            if current.0.as_ref().is_some_and(is_same) {
                return;
            }
            Some(Arc::new(EnvironmentMap::constant(texel)))
        }
        EnvironmentSource::Map(handle) => match assets.get(handle) {
            Some(asset) => Some(Arc::clone(asset.map())),
            // While another is read, the former goes on.
            None => return,
        },
    };
    let is_same = match (&current.0, &map) {
        (Some(a), Some(b)) => Arc::ptr_eq(a, b),
        (None, None) => true,
        _ => false,
    };
    if !is_same {
        current.0 = map;
    }
}

/// Has Bevy keep its own tables, which it would move to the device and forget. On another one they
/// would be all zero, and of meshes in this light nothing but NaN would be seen.
pub(super) fn keep_tables(images: &mut Assets<Image>) {
    // Bevy's have 2.1 MiB together; what an app has made larger than that is its own to keep.
    const LARGEST: usize = 4 << 20;
    for (_, image) in images.iter_mut() {
        if image
            .data
            .as_ref()
            .is_some_and(|data| data.len() <= LARGEST)
        {
            image.asset_usage |= RenderAssetUsages::MAIN_WORLD;
        }
    }
}

/// Starts filtering when there is another map and a camera that is to have it, and takes in what is
/// done.
pub(super) fn filter(
    environment: Res<VolumeEnvironment>,
    current: Res<CurrentMap>,
    cameras: Query<(), (With<Camera3d>, With<VolumeRenderSettings>)>,
    meshes: Query<(), With<Mesh3d>>,
    mut filtering: ResMut<Filtering>,
    mut images: ResMut<Assets<Image>>,
    device: Option<Res<RenderDevice>>,
) {
    // What was made is on the device only, and gone with it.
    if device.is_some_and(|device| device.is_changed()) {
        *filtering = Filtering::default();
    }
    let Some(map) = &current.0 else {
        return;
    };
    let has_cameras = !cameras.is_empty();
    let Filtering { light, sky } = &mut *filtering;
    let lights = environment.lights_meshes && has_cameras && !meshes.is_empty();
    light.follow(map, lights, mesh_light, |made| {
        made.map(|image| images.add(image))
    });
    let is_seen = environment.is_sky && has_cameras;
    sky.follow(map, is_seen, sky_cube, |made| images.add(made));
}

type Camera<'a> = (
    Entity,
    Option<&'a EnvironmentMapLight>,
    Option<&'a Skybox>,
    Option<&'a LitByEnvironment>,
    Option<&'a SkyOfEnvironment>,
    Has<WithoutSky>,
);

/// Gives the cameras light and sky, and takes them away again.
pub(super) fn apply(
    mut commands: Commands,
    environment: Res<VolumeEnvironment>,
    filtering: Res<Filtering>,
    cameras: Query<Camera, (With<Camera3d>, With<VolumeRenderSettings>)>,
) {
    // What is no number would never be found again to be ours.
    let finite = |number: f32| if number.is_finite() { number } else { 0.0 };
    let rotation = Quat::from_rotation_y(finite(environment.rotation_y));
    let intensity = finite(environment.intensity);
    for (entity, light, sky, our_light, our_sky, is_without) in &cameras {
        let mut camera = commands.entity(entity);
        let is_ours = match (light, our_light) {
            (Some(light), Some(ours)) => is_same_light(light, &ours.0),
            (light, ours) => light.is_none() && ours.is_none(),
        };
        let light_maps = filtering.light.kept.as_ref();
        if let Some([diffuse, specular]) =
            light_maps.filter(|_| is_ours && environment.lights_meshes)
        {
            let wanted = EnvironmentMapLight {
                diffuse_map: diffuse.clone(),
                specular_map: specular.clone(),
                intensity,
                rotation,
                ..default()
            };
            if light.is_none_or(|light| !is_same_light(light, &wanted)) {
                camera.try_insert((wanted.clone(), LitByEnvironment(wanted)));
            }
        } else if is_ours && our_light.is_some() && !environment.lights_meshes {
            camera.try_remove::<(EnvironmentMapLight, LitByEnvironment)>();
        } else if !environment.lights_meshes && our_light.is_some() {
            camera.try_remove::<LitByEnvironment>();
        }
        let is_ours = match (sky, our_sky) {
            (Some(sky), Some(ours)) => is_same_sky(sky, &ours.0),
            (sky, ours) => sky.is_none() && ours.is_none(),
        };
        let has_sky = environment.is_sky && !is_without;
        let sky_map = filtering.sky.kept.as_ref();
        if let Some(image) = sky_map.filter(|_| is_ours && has_sky) {
            let wanted = Skybox {
                image: Some(image.clone()),
                brightness: intensity,
                rotation,
            };
            if sky.is_none_or(|sky| !is_same_sky(sky, &wanted)) {
                camera.try_insert((wanted.clone(), SkyOfEnvironment(wanted)));
            }
        } else if is_ours && our_sky.is_some() && !has_sky {
            camera.try_remove::<(Skybox, SkyOfEnvironment)>();
        } else if !has_sky && our_sky.is_some() {
            camera.try_remove::<SkyOfEnvironment>();
        }
    }
}

/// For diffuse and for specular meshes.
fn mesh_light(map: &EnvironmentMap) -> [Image; 2] {
    let pyramid = Pyramid::new(map);
    let grid = Grid::new(map);
    let specular_levels = SPECULAR_SIZE.ilog2() + 1;
    [
        cube(DIFFUSE_SIZE, 1, |_, direction| {
            grid.irradiance(direction) / PI
        }),
        cube(SPECULAR_SIZE, specular_levels, |level, direction| {
            // As Bevy chooses levels: by perceptual roughness, from mirror to fully rough.
            let roughness = f64::from(level) / f64::from(specular_levels - 1);
            pyramid.reflection(direction, roughness)
        }),
    ]
}

/// What is seen behind everything.
fn sky_cube(map: &EnvironmentMap) -> Image {
    let size = (map.width() as u32 / 4)
        .next_power_of_two()
        .clamp(1, SKY_MAX_SIZE);
    cube(size, 1, |_, direction| DVec3::from(map.radiance(direction)))
}

/// A cube map of a function of level and direction, in half floats (suns are cut at their end).
fn cube(size: u32, levels: u32, value: impl Fn(u32, DVec3) -> DVec3) -> Image {
    let mut data = Vec::new();
    for face in 0..6 {
        for level in 0..levels {
            let size = (size >> level).max(1);
            for j in 0..size {
                for i in 0..size {
                    let at = |k: u32| 2.0 * (f64::from(k) + 0.5) / f64::from(size) - 1.0;
                    let rgb = value(level, face_direction(face, at(i), at(j)));
                    let rgba = [rgb.x, rgb.y, rgb.z, 1.0];
                    let limit = f64::from(f16::MAX);
                    let halves = rgba.map(|c| f16::from_f64(c.min(limit)).to_le_bytes());
                    data.extend(halves.into_iter().flatten());
                }
            }
        }
    }
    let mut image = Image::new_uninit(
        Extent3d {
            width: size,
            height: size,
            depth_or_array_layers: 6,
        },
        TextureDimension::D2,
        TextureFormat::Rgba16Float,
        RenderAssetUsages::RENDER_WORLD,
    );
    image.data = Some(data);
    image.texture_descriptor.mip_level_count = levels;
    image.texture_view_descriptor = Some(TextureViewDescriptor {
        dimension: Some(TextureViewDimension::Cube),
        ..default()
    });
    image
}

/// World direction of a place on a cube's face; x, y from the top left, −1 … 1.
///
/// Cube maps are left-handed: Bevy negates z when it looks one up.
fn face_direction(face: u32, x: f64, y: f64) -> DVec3 {
    let direction = match face {
        0 => DVec3::new(1.0, -y, -x),
        1 => DVec3::new(-1.0, -y, x),
        2 => DVec3::new(x, 1.0, y),
        3 => DVec3::new(x, -1.0, -y),
        4 => DVec3::new(x, -y, 1.0),
        _ => DVec3::new(-x, -y, -1.0),
    };
    (direction * DVec3::new(1.0, 1.0, -1.0)).normalize()
}

/// Radiance times solid angle from the middle of each cell of a coarse map.
struct Grid(Vec<(DVec3, DVec3)>);

impl Grid {
    fn new(map: &EnvironmentMap) -> Self {
        let [columns, rows] = [GRID_WIDTH, GRID_WIDTH / 2];
        let mut cells = vec![(DVec3::ZERO, DVec3::ZERO); columns * rows];
        // As many samples as the map has texels, or more: none is passed over.
        let per_cell = |texels: usize, cells: usize| texels.div_ceil(cells).max(2);
        let [across, down] = [per_cell(map.width(), columns), per_cell(map.height(), rows)];
        let [width, height] = [columns * across, rows * down];
        for y in 0..height {
            let v = (y as f64 + 0.5) / height as f64;
            let solid_angle = 2.0 * PI * PI / (width * height) as f64 * (PI * v).sin();
            for x in 0..width {
                let uv = [(x as f64 + 0.5) / width as f64, v];
                let (direction, power) = &mut cells[x / across + columns * (y / down)];
                *direction += solid_angle * EnvironmentMap::direction_from_uv(uv);
                *power += solid_angle * DVec3::from(map.radiance_at_uv(uv));
            }
        }
        for (direction, _) in &mut cells {
            *direction = direction.normalize_or_zero();
        }
        Self(cells)
    }

    fn irradiance(&self, normal: DVec3) -> DVec3 {
        let cells = self.0.iter();
        cells
            .map(|&(direction, power)| normal.dot(direction).max(0.0) * power)
            .sum()
    }
}

/// The map, halved again and again, for lookups as wide as what they stand for.
struct Pyramid(Vec<EnvironmentMap>);

impl Pyramid {
    fn new(map: &EnvironmentMap) -> Self {
        let mut levels = vec![map.clone()];
        while let Some(last) = levels.last()
            && last.width() > 8
            && last.height() > 4
        {
            let [width, height] = [last.width() / 2, last.height() / 2];
            let texel = |i: usize| {
                let [x, y] = [2 * (i % width) as i64, 2 * (i / width) as i64];
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| last.texel(x + a, y + b));
                std::array::from_fn(|c| 0.25 * four.iter().map(|t| t[c]).sum::<f32>())
            };
            let texels = (0..width * height).map(texel).collect();
            levels.push(EnvironmentMap::new(width, height, texels));
        }
        Self(levels)
    }

    /// Mean radiance over a cone of this solid angle, about.
    fn radiance(&self, direction: DVec3, solid_angle: f64) -> DVec3 {
        let texel = 4.0 * PI / (self.0[0].width() * self.0[0].height()) as f64;
        let level = (0.5 * (solid_angle / texel).max(1.0).log2()).round() as usize;
        let map = &self.0[level.min(self.0.len() - 1)];
        DVec3::from(map.radiance(direction))
    }

    /// Light that a rough mirror sends back along its normal (Karis 2013: view = normal).
    fn reflection(&self, normal: DVec3, perceptual_roughness: f64) -> DVec3 {
        let alpha = perceptual_roughness * perceptual_roughness;
        if alpha == 0.0 {
            return self.radiance(normal, 0.0);
        }
        let frame = DMat3::from_quat(glam::DQuat::from_rotation_arc(DVec3::Z, normal));
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        for i in 0..SPECULAR_DRAWS {
            // Points spread evenly: van der Corput in base 2 against their index.
            let x = (f64::from(i) + 0.5) / f64::from(SPECULAR_DRAWS);
            let y = f64::from(i.reverse_bits()) / 4_294_967_296.0;
            let cos2 = (1.0 - x) / (1.0 + (alpha * alpha - 1.0) * x);
            let (sin_phi, cos_phi) = (2.0 * PI * y).sin_cos();
            let sin = (1.0 - cos2).max(0.0).sqrt();
            let half = frame * DVec3::new(sin * cos_phi, sin * sin_phi, cos2.sqrt());
            let wi = 2.0 * normal.dot(half) * half - normal;
            let cos = normal.dot(wi);
            if cos <= 0.0 {
                continue;
            }
            let d = cos2 * (alpha * alpha - 1.0) + 1.0;
            let pdf = alpha * alpha / (PI * d * d) / 4.0;
            sum += cos * self.radiance(wi, 1.0 / (f64::from(SPECULAR_DRAWS) * pdf));
            weights += cos;
        }
        sum / weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half_floats(image: &Image) -> Vec<f64> {
        let data = image.data.as_deref().unwrap();
        let halves = data
            .chunks(2)
            .map(|b| f16::from_le_bytes([b[0], b[1]]).to_f64());
        halves.collect()
    }

    #[test]
    fn faces_cover_all_directions() {
        for (face, axis) in [
            (0, DVec3::X),
            (1, DVec3::NEG_X),
            (2, DVec3::Y),
            (3, DVec3::NEG_Y),
            (4, DVec3::NEG_Z),
            (5, DVec3::Z),
        ] {
            assert_eq!(face_direction(face, 0.0, 0.0), axis);
        }
        let near = face_direction(0, -0.9999, 0.3);
        assert!(
            near.distance(face_direction(4, 0.9999, 0.3)) < 1e-3,
            "faces meet at their edges"
        );
    }

    #[test]
    fn uniform_light_stays_as_it_is() {
        let map = EnvironmentMap::constant([0.5, 2.0, 8.0]);
        let [diffuse, specular] = mesh_light(&map);
        for image in [diffuse, specular, sky_cube(&map)] {
            for pixel in half_floats(&image).chunks(4) {
                for (value, expected) in pixel.iter().zip([0.5, 2.0, 8.0]) {
                    assert!((value / expected - 1.0).abs() < 2e-3, "{pixel:?}");
                }
            }
        }
    }

    #[test]
    fn irradiance_of_half_a_sky_is_its_closed_form() {
        // Radiance 1 above the horizon: E(n) = π (1 + n.y) / 2.
        let texels = (0..512).map(|i| [if i < 256 { 1.0 } else { 0.0 }; 3]);
        let map = EnvironmentMap::new(32, 16, texels.collect());
        let grid = Grid::new(&map);
        for normal in [DVec3::Y, DVec3::X, DVec3::new(0.6, -0.8, 0.0), DVec3::NEG_Y] {
            let found = grid.irradiance(normal).x;
            let expected = PI * (1.0 + normal.y) / 2.0;
            assert!(
                (found - expected).abs() < 0.01 * PI,
                "{normal}: {found}, not {expected}"
            );
        }
    }

    #[test]
    fn reflections_widen_with_roughness() {
        let mut texels = vec![[0.0; 3]; 64 * 32];
        texels[64 * 16 + 32] = [1000.0; 3];
        let pyramid = Pyramid::new(&EnvironmentMap::new(64, 32, texels));
        let at = EnvironmentMap::direction_from_uv([32.5 / 64.0, 16.5 / 32.0]);
        let peaks = [0.0, 0.3, 0.6, 1.0].map(|r| pyramid.reflection(at, r).x);
        assert!((peaks[0] - 1000.0).abs() < 1.0, "a mirror");
        assert!(
            peaks.windows(2).all(|pair| pair[1] < 0.7 * pair[0]),
            "{peaks:?}"
        );
    }
}

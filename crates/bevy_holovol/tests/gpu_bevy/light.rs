//! Radiance, exposure, and the light that meshes stand in.

use std::f32::consts::PI;
use std::time::{Duration, Instant};

use bevy::camera::Exposure;
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::{EnvironmentMapLight, Skybox};
use bevy::prelude::*;
use bevy_holovol::prelude::*;
use holovol_light::EnvironmentMap;

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "white_medium_vanishes_in_a_uniform_sky",
        white_medium_vanishes_in_a_uniform_sky,
    ),
    (
        "radiance_meets_the_cameras_exposure",
        radiance_meets_the_cameras_exposure,
    ),
    ("sky_is_the_environment", sky_is_the_environment),
    (
        "a_cameras_own_light_and_sky_stay",
        a_cameras_own_light_and_sky_stay,
    ),
    (
        "diffuse_mesh_has_the_analytic_irradiance",
        diffuse_mesh_has_the_analytic_irradiance,
    ),
    (
        "sky_and_light_are_there_again_on_another_device",
        light_on_another_device,
    ),
    (
        "everything_is_tone_mapped_once",
        everything_is_tone_mapped_once,
    ),
    ("light_that_changes_in_every_frame_arrives", changing_light),
];

/// Albedo 1 in uniform light: radiance comes out as it goes in, so that the sky behind shows on.
fn white_medium_vanishes_in_a_uniform_sky() {
    let mut app = app();
    app.insert_resource(VolumeEnvironment {
        intensity: unit_intensity(),
        lights_meshes: false,
        ..VolumeEnvironment::from_radiance(LinearRgba::rgb(0.5, 1.0, 2.0))
    });
    spawn_volume(&mut app, solid(Vec3::ONE), matter(3.0, 1.0));
    let target = target(&mut app, 32, 32);
    let unlimited = VolumeRenderSettings {
        max_scatters: None,
        ..settings(256)
    };
    spawn_camera(&mut app, &target, 4.0, unlimited);
    finish(&mut app);
    let picture = read(&mut app, &target);
    let mean = picture.middle();
    for (found, expected) in mean.xyz().to_array().into_iter().zip([0.5, 1.0, 2.0]) {
        assert_near("the sky through the medium", found / expected, 1.0, 0.02);
    }
    let edge = picture.mean([0, 0, 32, 1]);
    assert_near("the sky beside it", edge.y, 1.0, 2e-3);
}

/// One scattering at a thin layer: radiance = opacity × albedo × light, then × exposure.
fn radiance_meets_the_cameras_exposure() {
    let mut app = app();
    spawn_volume(
        &mut app,
        solid(Vec3::new(1.0, 1.0, 1e-3)),
        matter(20.0, 0.5),
    );
    let target = target(&mut app, 32, 32);
    let camera = spawn_camera(&mut app, &target, 2.0, settings(256));
    finish(&mut app);
    let single = read(&mut app, &target).middle();
    let opacity = 1.0 - (-0.02f32).exp();
    // Light has to cross the layer too: up to its mean over directions, about 5 %.
    assert_near("radiance", single.x / (0.5 * opacity), 1.0, 0.08);
    assert_near("grey", single.x, single.z, 1e-6);
    let ev100 = Exposure::default().ev100 - 3.0;
    app.world_mut()
        .entity_mut(camera)
        .insert(Exposure { ev100 });
    let brighter = read(&mut app, &target).middle();
    assert_near("three stops more", brighter.x / single.x, 8.0, 0.02);
}

/// A map whose six sides differ; camera turned to each: the sky must show what the map says.
fn sky_is_the_environment() {
    let mut app = app();
    let size = [64, 32];
    let texel = |i: usize| {
        let uv = [
            (0.5 + (i % size[0]) as f64) / size[0] as f64,
            (0.5 + (i / size[0]) as f64) / size[1] as f64,
        ];
        let d = EnvironmentMap::direction_from_uv(uv);
        [d.x, d.y, d.z].map(|c| (0.5 + 0.4 * c) as f32)
    };
    let map = EnvironmentMap::new(
        size[0],
        size[1],
        (0..size[0] * size[1]).map(texel).collect(),
    );
    let handle = app
        .world_mut()
        .resource_mut::<Assets<EnvironmentAsset>>()
        .add(EnvironmentAsset::new(map.clone()));
    let rotation_y = 0.6f32;
    app.insert_resource(VolumeEnvironment {
        intensity: unit_intensity(),
        rotation_y,
        ..VolumeEnvironment::from_map(handle)
    });
    let target = target(&mut app, 16, 16);
    let camera = spawn_camera(&mut app, &target, 2.0, settings(1));
    for direction in [
        Vec3::X,
        Vec3::NEG_X,
        Vec3::Y,
        Vec3::NEG_Y,
        Vec3::Z,
        Vec3::NEG_Z,
    ] {
        let up = direction.any_orthonormal_vector();
        let looking = Transform::from_translation(Vec3::ZERO).looking_to(direction, up);
        *app.world_mut()
            .get_mut::<Transform>(camera)
            .expect("a transform") = looking;
        wait_for_sky(&mut app, camera);
        let found = read(&mut app, &target).mean([7, 7, 9, 9]).xyz();
        let world = Quat::from_rotation_y(-rotation_y) * direction;
        let expected = (0.5 + 0.4 * world).to_array();
        for (found, expected) in found.to_array().into_iter().zip(expected) {
            assert_near(&format!("sky to {direction}"), found, expected, 0.02);
        }
    }
}

/// Also if it is given them after ours, or if ours are changed or taken away.
fn a_cameras_own_light_and_sky_stay() {
    let mut app = app();
    app.insert_resource(VolumeEnvironment {
        intensity: unit_intensity(),
        ..default()
    });
    let target = target(&mut app, 8, 8);
    let camera = spawn_camera(&mut app, &target, 2.0, settings(1));
    wait_for_sky(&mut app, camera);
    let our_light = |app: &App| app.world().get::<EnvironmentMapLight>(camera).cloned();
    for _ in 0..20 {
        std::thread::sleep(Duration::from_millis(10));
        app.update();
    }
    assert!(our_light(&app).is_none(), "there is no mesh to light");
    app.world_mut().spawn(Mesh3d::default());
    let started = Instant::now();
    while our_light(&app).is_none() {
        assert!(started.elapsed() < Duration::from_secs(60), "no light");
        std::thread::sleep(Duration::from_millis(2));
        app.update();
    }
    let ours = our_light(&app).expect("our light");
    let mut images = app.world_mut().resource_mut::<Assets<Image>>();
    let own = EnvironmentMapLight::solid_color(&mut images, Color::WHITE);
    let own_sky = Skybox {
        image: Some(own.diffuse_map.clone()),
        brightness: 7.0,
        ..default()
    };
    let insert = (own.clone(), own_sky.clone());
    app.world_mut().entity_mut(camera).insert(insert);
    let turn = |app: &mut App, rotation_y| {
        let mut environment = app.world_mut().resource_mut::<VolumeEnvironment>();
        environment.rotation_y = rotation_y;
        for _ in 0..3 {
            app.update();
        }
    };
    turn(&mut app, 1.0);
    let of_camera = |app: &App| {
        let camera = app.world().entity(camera);
        let light = camera.get::<EnvironmentMapLight>().cloned();
        (light, camera.get::<Skybox>().cloned())
    };
    let (light, sky) = of_camera(&app);
    assert_eq!(light.expect("light").diffuse_map, own.diffuse_map);
    let sky = sky.expect("a sky");
    assert_eq!((sky.image, sky.brightness), (own_sky.image.clone(), 7.0));
    // Off and on again leaves them, too.
    for is_on in [false, true] {
        let mut environment = app.world_mut().resource_mut::<VolumeEnvironment>();
        (environment.lights_meshes, environment.is_sky) = (is_on, is_on);
        turn(&mut app, 2.0);
        let (light, sky) = of_camera(&app);
        assert!(light.is_some_and(|light| light.diffuse_map == own.diffuse_map));
        assert!(sky.is_some_and(|sky| sky.image == own_sky.image));
    }
    // Without its own it gets ours.
    let mut entity = app.world_mut().entity_mut(camera);
    entity.remove::<(EnvironmentMapLight, Skybox)>();
    turn(&mut app, 0.5);
    let (light, sky) = of_camera(&app);
    assert_eq!(light.expect("light").diffuse_map, ours.diffuse_map);
    assert_eq!(sky.expect("a sky").rotation, Quat::from_rotation_y(0.5));
    // Ours, dimmed by the user, stays as dim.
    let mut light = app.world_mut().get_mut::<EnvironmentMapLight>(camera);
    light.as_mut().expect("light").intensity = 0.25;
    app.world_mut().entity_mut(camera).remove::<Skybox>();
    turn(&mut app, 1.5);
    let (light, sky) = of_camera(&app);
    assert_eq!(light.expect("light").intensity, 0.25);
    assert!(sky.is_none(), "what was taken away stays away");
}

/// Until the camera has been given its sky and, where there are meshes, their light, and the
/// textures are uploaded.
#[track_caller]
pub fn wait_for_sky(app: &mut App, camera: Entity) {
    let mut meshes = app.world_mut().query::<&Mesh3d>();
    for _ in 0..10_000 {
        app.update();
        let world = app.world();
        let is_lit = world.get::<EnvironmentMapLight>(camera).is_some()
            || !world.resource::<VolumeEnvironment>().lights_meshes
            || meshes.iter(world).next().is_none();
        if is_lit && world.get::<Skybox>(camera).is_some() {
            for _ in 0..3 {
                app.update();
            }
            return;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("no sky");
}

/// A white diffuse plane under half a sky, turned: radiance E/π = (1 + n·y)/2, rotated with the map.
fn diffuse_mesh_has_the_analytic_irradiance() {
    let mut app = app();
    // Radiance 1 from +z, the half of u in (½ ± ¼) turned away: −z is the centre of the map.
    let texel = |i: usize| {
        if (16..48).contains(&(i % 64)) {
            [0.0; 3]
        } else {
            [1.0; 3]
        }
    };
    let map = EnvironmentMap::new(64, 32, (0..64 * 32).map(texel).collect());
    let handle = app
        .world_mut()
        .resource_mut::<Assets<EnvironmentAsset>>()
        .add(EnvironmentAsset::new(map));
    let mesh = app
        .world_mut()
        .resource_mut::<Assets<Mesh>>()
        .add(Rectangle::new(9.0, 9.0));
    let material = StandardMaterial {
        base_color: Color::WHITE,
        reflectance: 0.0,
        perceptual_roughness: 1.0,
        ..default()
    };
    let material = app
        .world_mut()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(material);
    app.world_mut()
        .spawn((Mesh3d(mesh), MeshMaterial3d(material)));
    app.insert_resource(GlobalAmbientLight::NONE);
    let target = target(&mut app, 16, 16);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(1));
    for rotation_y in [0.0, 1.0, 2.0, PI] {
        app.insert_resource(VolumeEnvironment {
            intensity: unit_intensity(),
            rotation_y,
            ..VolumeEnvironment::from_map(handle.clone())
        });
        wait_for_sky(&mut app, camera);
        let found = read(&mut app, &target).middle();
        let expected = (1.0 + rotation_y.cos()) / 2.0;
        assert_near(&format!("turned by {rotation_y}"), found.y, expected, 0.03);
    }
}

/// What is filtered lives on the device only.
fn light_on_another_device() {
    let mut app = app();
    app.insert_resource(GlobalAmbientLight::NONE);
    app.insert_resource(VolumeEnvironment {
        intensity: unit_intensity(),
        ..VolumeEnvironment::from_radiance(LinearRgba::rgb(0.5, 1.0, 2.0))
    });
    let world = app.world_mut();
    let mesh = world
        .resource_mut::<Assets<Mesh>>()
        .add(Rectangle::new(0.3, 0.3));
    let material = StandardMaterial {
        base_color: Color::WHITE,
        reflectance: 0.0,
        perceptual_roughness: 1.0,
        ..default()
    };
    let material = world
        .resource_mut::<Assets<StandardMaterial>>()
        .add(material);
    world.spawn((Mesh3d(mesh), MeshMaterial3d(material)));
    let target = target(&mut app, 16, 16);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(1));
    wait_for_sky(&mut app, camera);
    let look = |app: &mut App| {
        let picture = read(app, &target);
        [[7, 7, 9, 9], [0, 0, 16, 1]].map(|part| picture.mean(part).xyz())
    };
    let before = look(&mut app);
    for found in before {
        assert!(
            (found - Vec3::new(0.5, 1.0, 2.0)).length() < 0.06,
            "{found}"
        );
    }
    lose_device(&mut app);
    let started = Instant::now();
    loop {
        let found = look(&mut app);
        let is_near = |i: usize| (found[i] - before[i]).length() < 0.01;
        if is_near(0) && is_near(1) {
            return;
        }
        let is_late = started.elapsed() > Duration::from_secs(20);
        assert!(!is_late, "{found:?}, not {before:?}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// A mesh and a volume of the same scene-referred radiance show as the same colour.
fn everything_is_tone_mapped_once() {
    let mut app = app();
    app.insert_resource(VolumeEnvironment {
        intensity: unit_intensity(),
        lights_meshes: false,
        ..VolumeEnvironment::from_radiance(LinearRgba::rgb(0.7, 0.4, 0.1))
    });
    // A dense white medium in uniform light looks like the sky behind it.
    spawn_volume(&mut app, solid(Vec3::splat(0.3)), matter(200.0, 1.0));
    let target = target(&mut app, 32, 32);
    let unlimited = VolumeRenderSettings {
        max_scatters: None,
        ..settings(64)
    };
    let camera = spawn_camera(&mut app, &target, 4.0, unlimited);
    finish(&mut app);
    let plain = read(&mut app, &target);
    app.world_mut()
        .entity_mut(camera)
        .insert(Tonemapping::TonyMcMapface);
    let mapped = read(&mut app, &target);
    let (inside, beside) = (mapped.mean([14, 14, 18, 18]), mapped.mean([0, 0, 32, 2]));
    assert!(
        (plain.mean([0, 0, 32, 2]) - beside).xyz().length() > 0.03,
        "tone mapping changes the sky"
    );
    assert!(
        (inside - beside).xyz().abs().max_element() < 0.02,
        "{inside} in front of {beside}"
    );
}

fn changing_light() {
    let mut app = app();
    spawn_volume(&mut app, solid(Vec3::splat(2.0)), matter(100.0, 1.0));
    let target = target(&mut app, 16, 16);
    let fresh = VolumeRenderSettings {
        mode: VolumeRenderMode::Fresh,
        ..settings(16)
    };
    spawn_camera(&mut app, &target, 4.0, fresh);
    let shade = |app: &mut App, frame: u32| {
        let grey = 0.5 + 0.001 * (frame % 7) as f32;
        let mut environment = app.world_mut().resource_mut::<VolumeEnvironment>();
        // Less than no light is none.
        let radiance = LinearRgba::rgb(grey, grey, -1.0);
        environment.source = EnvironmentSource::Constant(radiance);
        app.update();
    };
    // Nothing is drawn before a first light has arrived; no frame keeps the last one's.
    let is_drawn = (0..1000).any(|frame| {
        shade(&mut app, frame);
        statistics(&app).samples > 0
    });
    assert!(
        is_drawn,
        "lit, though there was another light in each frame"
    );
    assert!(read(&mut app, &target).middle().x > 0.05);
    let uploads = statistics(&app).uploads;
    for _ in 0..20 {
        app.update();
    }
    let later = statistics(&app).uploads;
    assert!(
        later <= uploads + 2,
        "the last light is uploaded once: {uploads}, {later}"
    );
}

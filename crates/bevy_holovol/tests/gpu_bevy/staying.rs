//! What is shown stays until what takes its place is there.

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use holovol_light::EnvironmentMap;

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "a_volume_stays_while_another_is_loaded",
        while_another_is_loaded,
    ),
    (
        "a_volume_stays_while_its_matter_is_loaded",
        while_its_matter_is_loaded,
    ),
    (
        "a_volume_stays_while_kernels_are_compiled",
        while_kernels_are_compiled,
    ),
    ("going_back_to_what_is_shown_costs_nothing", going_back),
    (
        "volumes_that_change_in_every_frame_arrive",
        changing_volumes,
    ),
];

/// 1 m of 2/m before white, e^−2 of which is seen.
fn stage(max_samples: u32) -> (App, Entity, Entity, Handle<Image>) {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let volume = spawn_volume(&mut app, solid(Vec3::ONE), matter(2.0, 0.0));
    let target = target(&mut app, 24, 24);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(max_samples));
    finish(&mut app);
    (app, volume, camera, target)
}

/// No frame without the volume is as dark.
const WITH_VOLUME: f32 = 0.6;

fn dark(app: &mut App, target: &Handle<Image>) -> f32 {
    read(app, target).mean([10, 10, 14, 14]).x
}

fn while_another_is_loaded() {
    let (mut app, volume, _, target) = stage(64);
    let watch = Watch::begin(&mut app, &target);
    let late = app
        .world()
        .resource::<Assets<VolumeAsset>>()
        .reserve_handle();
    app.world_mut()
        .entity_mut(volume)
        .insert(Volume3d(late.clone()));
    for _ in 0..5 {
        app.update();
    }
    assert_near("the former", dark(&mut app, &target), (-2f32).exp(), 0.01);
    watch.assert_at_most("while it is read", WITH_VOLUME);
    let insert = |app: &mut App, metres| {
        let solid = solid(Vec3::new(1.0, 1.0, metres));
        let mut assets = app.world_mut().resource_mut::<Assets<VolumeAsset>>();
        assets.insert(&late, solid.into()).expect("a handle in use");
        app.update();
        finish(app);
    };
    for (metres, what) in [(0.5, "loaded"), (1.5, "loaded again")] {
        insert(&mut app, metres);
        let found = dark(&mut app, &target);
        assert_near(what, found, (-2.0 * metres).exp(), 0.01);
        watch.assert_at_most(what, WITH_VOLUME);
    }
    // An asset that is taken away, and a handle of nothing, are not waited for.
    app.world_mut()
        .resource_mut::<Assets<VolumeAsset>>()
        .remove(&late);
    assert_near("taken away", dark(&mut app, &target), 1.0, 1e-3);
    insert(&mut app, 1.0);
    assert_near("back again", dark(&mut app, &target), (-2f32).exp(), 0.01);
    // Nor is one that can't be loaded: what is shown under its handle would be another's scan.
    let server = app.world().resource::<AssetServer>().clone();
    let missing: Handle<VolumeAsset> = server.load("nobody.nrrd");
    app.world_mut()
        .entity_mut(volume)
        .insert(Volume3d(missing.clone()));
    for _ in 0..2000 {
        app.update();
        if server.load_state(&missing).is_failed() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    assert!(server.load_state(&missing).is_failed());
    assert_near("can't be loaded", dark(&mut app, &target), 1.0, 1e-3);
    app.world_mut()
        .entity_mut(volume)
        .insert(Volume3d::default());
    assert_near("no volume", dark(&mut app, &target), 1.0, 1e-3);
}

fn going_back() {
    let (mut app, volume, _, target) = stage(64);
    let former = app.world().get::<Volume3d>(volume).cloned();
    let former = former.expect("a volume");
    let before = statistics(&app).samples;
    let mut times = 0;
    // From its upload to its tracer, every stage of what is coming is gone back from.
    loop {
        let mut assets = app.world_mut().resource_mut::<Assets<VolumeAsset>>();
        let other = Volume3d(assets.add(solid(Vec3::new(1.0, 1.0, 0.2))));
        app.world_mut().entity_mut(volume).insert(other);
        for _ in 0..=times {
            app.update();
        }
        if statistics(&app).samples > before {
            break;
        }
        let uploads = statistics(&app).uploads;
        app.world_mut().entity_mut(volume).insert(former.clone());
        app.update();
        if statistics(&app).samples > before {
            // It was there before the way back was certain.
            break;
        }
        finish(&mut app);
        let after = statistics(&app);
        assert_eq!(after.uploads, uploads, "{times}: it is still there");
        assert_eq!(after.samples, before, "{times}: its image stays");
        assert_near("the former", dark(&mut app, &target), (-2f32).exp(), 0.01);
        times += 1;
    }
    assert!(times > 0, "nothing was gone back from");
}

fn while_its_matter_is_loaded() {
    let (mut app, volume, _, target) = stage(64);
    let watch = Watch::begin(&mut app, &target);
    let uploads = statistics(&app).uploads;
    let assets = app.world().resource::<Assets<TransferFunctionAsset>>();
    let late = assets.reserve_handle();
    app.world_mut()
        .entity_mut(volume)
        .insert(VolumeMaterial3d(late.clone()));
    for _ in 0..5 {
        app.update();
    }
    assert_near("the former", dark(&mut app, &target), (-2f32).exp(), 0.01);
    let mut assets = app
        .world_mut()
        .resource_mut::<Assets<TransferFunctionAsset>>();
    assets
        .insert(&late, matter(1.0, 0.0))
        .expect("a reserved handle");
    app.update();
    finish(&mut app);
    assert_near("the latter", dark(&mut app, &target), (-1f32).exp(), 0.01);
    watch.assert_at_most("all the while", WITH_VOLUME);
    assert_eq!(statistics(&app).uploads, uploads, "the voxels stay");
}

fn while_kernels_are_compiled() {
    let (mut app, volume, camera, target) = stage(64);
    let watch = Watch::begin(&mut app, &target);
    let before = statistics(&app);
    let mut changed = |what: &str, change: &dyn Fn(&mut App)| {
        change(&mut app);
        app.update();
        finish(&mut app);
        let found = dark(&mut app, &target);
        // Black matter looks the same in any light.
        assert_near(what, found, (-2f32).exp(), 0.01);
        watch.assert_at_most(what, WITH_VOLUME);
    };
    changed("a clip plane beside the middle", &|app| {
        let lid = Transform::from_xyz(0.0, 0.4, 0.0);
        app.world_mut().spawn((VolumeClipPlane, lid));
    });
    changed("unlimited scatterings", &|app| {
        let mut camera = app.world_mut().entity_mut(camera);
        let mut settings = camera.get_mut::<VolumeRenderSettings>().expect("settings");
        settings.max_scatters = None;
    });
    changed("a surface", &|app| {
        let mut volume = app.world_mut().entity_mut(volume);
        volume
            .get_mut::<VolumeMedium>()
            .expect("a medium")
            .gradient_factor = 0.5;
    });
    changed("light from a map", &|app| {
        let texel = |i: usize| [if i < 256 { 1.0 } else { 0.0 }; 3];
        let map = EnvironmentMap::new(32, 16, (0..512).map(texel).collect());
        let mut assets = app.world_mut().resource_mut::<Assets<EnvironmentAsset>>();
        let map = assets.add(EnvironmentAsset::new(map));
        let mut environment = app.world_mut().resource_mut::<VolumeEnvironment>();
        environment.source = EnvironmentSource::Map(map);
    });
    let after = statistics(&app);
    assert_eq!(after.uploads, before.uploads + 1, "the light alone");
    assert_eq!(after.resizes, before.resizes, "the tracer stays");
}

/// As series of scans over time are shown: each frame has other voxels than the last.
fn changing_volumes() {
    let (mut app, volume, _, target) = stage(16);
    let watch = Watch::begin(&mut app, &target);
    let handles: Vec<_> = (0..3)
        .map(|step| {
            let solid = solid(Vec3::new(1.0, 1.0, 0.4 + 0.1 * step as f32));
            let mut assets = app.world_mut().resource_mut::<Assets<VolumeAsset>>();
            assets.add(solid)
        })
        .collect();
    let before = statistics(&app).samples;
    let (mut frames, mut frame) = (0, 0);
    // An image of each that is shown takes one frame.
    let wanted = before + 4 * 16 * 24 * 24;
    while statistics(&app).samples < wanted {
        assert!(frame < 5000, "{frames} frames, none of which arrived");
        app.world_mut()
            .entity_mut(volume)
            .insert(Volume3d(handles[frame % 3].clone()));
        app.update();
        frames += 1;
        frame += 1;
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    watch.assert_at_most("all the while", WITH_VOLUME);
    finish(&mut app);
    let last = 0.4 + 0.1 * ((frame - 1) % 3) as f32;
    assert_near(
        "the last",
        dark(&mut app, &target),
        (-2.0 * last).exp(),
        0.02,
    );
}

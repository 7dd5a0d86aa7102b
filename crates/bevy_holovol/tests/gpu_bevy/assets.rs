//! Loading, hot reloading, and apps that lack parts.

use std::io::Write;

use bevy::camera::RenderTarget;
use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::{
    TransferFunctionPlugin, VolumeEnvironmentPlugin, VolumePlugin, VolumeRenderPlugin,
};

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    ("any_plugin_can_be_left_out", any_plugin_can_be_left_out),
    (
        "plugins_work_without_a_renderer",
        plugins_work_without_a_renderer,
    ),
    ("files_anywhere_are_opened", files_anywhere_are_opened),
    (
        "a_volume_that_is_replaced_is_shown",
        a_volume_that_is_replaced_is_shown,
    ),
    (
        "transfer_functions_are_loaded_again_when_they_change",
        transfer_functions_are_loaded_again,
    ),
    (
        "an_impossible_medium_is_reported",
        an_impossible_medium_is_reported,
    ),
    (
        "what_is_wrong_with_one_volume_concerns_no_other",
        one_bad_volume,
    ),
];

fn plugins_work_without_a_renderer() {
    let mut app = App::new();
    app.add_plugins((
        MinimalPlugins,
        AssetPlugin::default(),
        VolumePlugin,
        TransferFunctionPlugin,
        VolumeEnvironmentPlugin,
    ));
    app.finish();
    app.cleanup();
    let volume = app
        .world_mut()
        .resource_mut::<Assets<VolumeAsset>>()
        .add(solid(Vec3::ONE));
    let entity = app.world_mut().spawn(Volume3d(volume)).id();
    for _ in 0..3 {
        app.update();
    }
    assert!(
        app.world().get::<VolumeMaterial3d>(entity).is_some(),
        "what it requires"
    );
}

fn any_plugin_can_be_left_out() {
    let groups = [
        HolovolPlugins.build().disable::<VolumePlugin>(),
        HolovolPlugins.build().disable::<TransferFunctionPlugin>(),
        HolovolPlugins.build().disable::<VolumeEnvironmentPlugin>(),
        HolovolPlugins.build().disable::<VolumeRenderPlugin>(),
    ];
    for (index, group) in groups.into_iter().enumerate() {
        let mut app = app_with(group);
        let target = target(&mut app, 8, 8);
        spawn_camera(&mut app, &target, 4.0, settings(4));
        app.world_mut()
            .spawn((Volume3d::default(), Transform::default()));
        for _ in 0..3 {
            app.update();
        }
        if index == 2 {
            // Volumes stand in white light then.
            app.world_mut().remove_resource::<VolumeEnvironment>();
            spawn_volume(&mut app, solid(Vec3::ONE), matter(3.0, 1.0));
            finish(&mut app);
            assert!(read(&mut app, &target).mean([3, 3, 5, 5]).x > 0.0);
        }
    }
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, AssetPlugin::default(), HolovolPlugins));
    app.finish();
    app.cleanup();
    app.update();
}

fn files_anywhere_are_opened() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("block.nrrd");
    let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: 500 500 500\nencoding: raw\n\n";
    let mut file = std::fs::File::create(&path).expect("a file");
    file.write_all(header.as_bytes()).expect("written");
    file.write_all(&[255; 8]).expect("written");
    drop(file);
    let missing = folder.path().join("missing.nrrd");
    let [found, lost] = app
        .world_mut()
        .run_system_cached_with(
            |In(paths): In<[std::path::PathBuf; 2]>, mut files: VolumeFiles| {
                paths.map(|path| files.open(path))
            },
            [path, missing.clone()],
        )
        .expect("a system");
    let mut assets = app
        .world_mut()
        .resource_mut::<Assets<TransferFunctionAsset>>();
    let matter = VolumeMaterial3d(assets.add(matter(2.0, 0.0)));
    let lost_volume = Volume3d(lost.clone());
    app.world_mut()
        .spawn((Volume3d(found), matter.clone(), medium()));
    app.world_mut().spawn((lost_volume, matter));
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    finish(&mut app);
    let seen = read(&mut app, &target).mean([10, 10, 14, 14]).x;
    assert_near("1 m of the file", seen, (-2f32).exp(), 0.01);
    let progress = app
        .world_mut()
        .run_system_cached_with(
            |In(handle): In<Handle<VolumeAsset>>, files: VolumeFiles| files.progress(&handle),
            lost,
        )
        .expect("a system")
        .expect("still known");
    assert_eq!(progress.path, missing);
    let error = progress.error.expect("a reason").to_string();
    assert!(error.contains("missing.nrrd"), "{error}");
}

fn a_volume_that_is_replaced_is_shown() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let volume = spawn_volume(&mut app, solid(Vec3::ONE), matter(1.0, 0.0));
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    finish(&mut app);
    let handle = app
        .world()
        .get::<Volume3d>(volume)
        .expect("a volume")
        .0
        .clone();
    let longer = solid(Vec3::new(1.0, 1.0, 2.0));
    let mut assets = app.world_mut().resource_mut::<Assets<VolumeAsset>>();
    assets
        .insert(&handle, longer.into())
        .expect("a handle in use");
    app.update();
    finish(&mut app);
    let seen = read(&mut app, &target).mean([10, 10, 14, 14]).x;
    assert_near("2 m of it", seen, (-2f32).exp(), 0.01);
}

/// As an editor saves it: another file takes the old one's name.
fn transfer_functions_are_loaded_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |sigma_t: f64| {
        let text =
            format!(r#"{{"points": [{{"s": 0, "sigma_t": {sigma_t}, "albedo": [0, 0, 0]}}]}}"#);
        let beside = folder.path().join("beside");
        std::fs::write(&beside, text).expect("written");
        std::fs::rename(beside, folder.path().join("matter.tf.json")).expect("renamed");
    };
    write(1.0);
    let files = AssetPlugin {
        file_path: folder.path().to_string_lossy().into_owned(),
        watch_for_changes_override: Some(true),
        ..default()
    };
    let mut app = app_on(files, HolovolPlugins);
    app.insert_resource(ClearColor(Color::WHITE));
    let material = app
        .world()
        .resource::<AssetServer>()
        .load::<TransferFunctionAsset>("matter.tf.json");
    let volume = spawn_volume(&mut app, solid(Vec3::ONE), matter(5.0, 0.0));
    app.world_mut()
        .entity_mut(volume)
        .insert(VolumeMaterial3d(material));
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    for sigma_t in [1.0f32, 2.0, 0.5] {
        write(f64::from(sigma_t));
        let expected = (-sigma_t).exp();
        let mut seen = f32::NAN;
        // The watcher waits a moment for further changes.
        for _ in 0..200 {
            finish(&mut app);
            seen = read(&mut app, &target).mean([10, 10, 14, 14]).x;
            if (seen - expected).abs() < 0.01 {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        assert_near("1 m of what the file says", seen, expected, 0.01);
    }
}

fn an_impossible_medium_is_reported() {
    let mut app = app();
    let volume = spawn_volume(&mut app, solid(Vec3::ONE), matter(1.0, 0.0));
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(16));
    finish(&mut app);
    app.world_mut()
        .get_mut::<VolumeMedium>(volume)
        .expect("a medium")
        .phase_g = 1.5;
    app.update();
    let errors = statistics(&app).errors;
    assert!(
        errors.iter().any(|error| error.contains("phase_g")),
        "{errors:?}"
    );
    app.world_mut()
        .get_mut::<VolumeMedium>(volume)
        .expect("a medium")
        .phase_g = 0.5;
    finish(&mut app);
}

fn one_bad_volume() {
    let mut app = app();
    app.insert_resource(ClearColor(Color::WHITE));
    let phase_g = |app: &mut App, volume, g| {
        let mut medium = app.world_mut().get_mut::<VolumeMedium>(volume);
        medium.as_mut().expect("a medium").phase_g = g;
    };
    let place = |app: &mut App, volume: Entity, x| {
        let mut entity = app.world_mut().entity_mut(volume);
        entity.insert(Transform::from_xyz(x, 0.0, 0.0));
    };
    // Bad from the start, and the first of them.
    let bad = spawn_volume(&mut app, solid(Vec3::splat(0.2)), matter(100.0, 0.0));
    phase_g(&mut app, bad, 1.5);
    place(&mut app, bad, -0.4);
    let good = spawn_volume(&mut app, solid(Vec3::splat(0.2)), matter(100.0, 0.0));
    place(&mut app, good, 0.4);
    let first = target(&mut app, 48, 24);
    let camera = spawn_camera(&mut app, &first, 4.0, settings(16));
    let until_there = |app: &mut App, target: &Handle<Image>, pixel: [usize; 2]| {
        let [x, y] = pixel;
        for _ in 0..500 {
            if read(app, target).mean([x, y, x + 1, y + 1]).x < 0.1 {
                return true;
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        false
    };
    assert!(until_there(&mut app, &first, [32, 12]), "the good one");
    // Views grow while something is wrong.
    let second = target(&mut app, 96, 48);
    app.world_mut()
        .entity_mut(camera)
        .insert(RenderTarget::Image(second.clone().into()));
    assert!(
        until_there(&mut app, &second, [64, 24]),
        "the good one, larger"
    );
    assert!(!statistics(&app).errors.is_empty());
    phase_g(&mut app, bad, 0.5);
    finish(&mut app);
    assert!(
        until_there(&mut app, &second, [32, 24]),
        "the bad one, mended"
    );
}

//! Loading, hot reloading, and apps that lack parts.

use std::io::Write;

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::{
    TransferFunctionPlugin, VolumeEnvironmentPlugin, VolumePlugin, VolumeRenderPlugin,
};

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
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
    let _optional = VolumeRenderPlugin;
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
    let error = progress.error.expect("a reason");
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

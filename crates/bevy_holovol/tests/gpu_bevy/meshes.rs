//! Meshes in, before and behind volumes.

use bevy::camera::Viewport;
use bevy::prelude::*;
use bevy_holovol::prelude::*;
use glam::DVec3;
use holovol_reference::{Settings, Tracer};

use crate::app::*;
use crate::scenes::{measures, offline, reference_scene_files, small_scene_files, stage};

pub const TESTS: &[crate::Test] = &[
    (
        "a_box_hides_what_is_behind_it",
        a_box_hides_what_is_behind_it,
    ),
    (
        "meshes_apart_from_volumes_cost_no_depth",
        meshes_apart_from_volumes_cost_no_depth,
    ),
    (
        "edges_of_meshes_are_smooth_with_msaa",
        edges_of_meshes_are_smooth_with_msaa,
    ),
    ("a_mesh_that_is_loaded_late_is_seen", loaded_late),
    ("a_mesh_whose_pipeline_comes_late_is_seen", compiled_late),
    (
        "meshes_elsewhere_leave_a_finished_image_alone",
        meshes_elsewhere,
    ),
    (
        "meshes_that_move_unseen_begin_the_image_anew",
        meshes_unseen,
    ),
    (
        "a_mesh_inside_a_scan_equals_the_reference",
        a_mesh_inside_a_scan_equals_the_reference,
    ),
];

/// Black absorbing slab, 1 m deep, in front of white: what is seen of the box or the background is
/// the transmittance of what is before it.
const SIGMA: f64 = 1.5;

pub fn spawn_box(app: &mut App, size: Vec3, at: Vec3) -> Entity {
    let mesh = app
        .world_mut()
        .resource_mut::<Assets<Mesh>>()
        .add(Cuboid::from_size(size));
    let material = StandardMaterial {
        base_color: Color::WHITE,
        unlit: true,
        ..default()
    };
    let material = app
        .world_mut()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(material);
    let place = Transform::from_translation(at);
    app.world_mut()
        .spawn((Mesh3d(mesh), MeshMaterial3d(material), place))
        .id()
}

/// As a box moves through the slab, its brightness is e^(−σd) of what is before it, in two
/// viewports of one target and in a target of its own, multisampled or not.
fn a_box_hides_what_is_behind_it() {
    for msaa in [Msaa::Off, Msaa::Sample4] {
        let mut app = app();
        app.insert_resource(VolumeEnvironment {
            lights_meshes: false,
            is_sky: false,
            ..VolumeEnvironment::from_radiance(LinearRgba::BLACK)
        });
        spawn_volume(
            &mut app,
            solid(Vec3::new(3.0, 3.0, 1.0)),
            matter(SIGMA, 0.0),
        );
        let cube = spawn_box(&mut app, Vec3::new(3.0, 3.0, 0.2), Vec3::ZERO);
        let both = target(&mut app, 48, 24);
        let alone = target(&mut app, 20, 20);
        let cameras = [(&both, 3.0), (&both, 5.0), (&alone, 4.0)].map(|(target, distance)| {
            let camera = spawn_camera(&mut app, target, distance, settings(64));
            app.world_mut().entity_mut(camera).insert(msaa);
            camera
        });
        for (i, camera) in [0, 1].into_iter().zip(cameras) {
            let mut camera = app.world_mut().get_mut::<Camera>(camera).expect("a camera");
            camera.order = i as isize;
            camera.viewport = Some(Viewport {
                physical_position: UVec2::new(24 * i as u32, 0),
                physical_size: UVec2::splat(24),
                ..default()
            });
            if i == 1 {
                camera.clear_color = ClearColorConfig::None;
            }
        }
        // The box's front lies 0.1 m before its centre, the slab's at z = 0.5.
        for centre in [0.45f32, 0.2, -0.3, -0.7, 0.8] {
            let mut transform = app.world_mut().get_mut::<Transform>(cube).expect("a box");
            transform.translation.z = centre;
            finish(&mut app);
            let depth = f64::from(0.5 - (centre + 0.1)).clamp(0.0, 1.0);
            let expected = (-SIGMA * depth).exp() as f32;
            let views = read(&mut app, &both);
            let found = [
                views.mean([6, 6, 18, 18]).x,
                views.mean([30, 6, 42, 18]).x,
                read(&mut app, &alone).middle().x,
            ];
            for (view, found) in found.into_iter().enumerate() {
                let what = format!("{msaa:?}, view {view}, box at {centre} m");
                // Rays of the outermost pixels are longer by 1 %.
                assert_near(&what, found, expected, 0.012);
            }
        }
    }
}

/// Depth is drawn only while a mesh is inside, and its hiding doesn't need it before the volume.
fn meshes_apart_from_volumes_cost_no_depth() {
    let mut app = app();
    app.insert_resource(VolumeEnvironment {
        is_sky: false,
        ..VolumeEnvironment::from_radiance(LinearRgba::BLACK)
    });
    spawn_volume(&mut app, solid(Vec3::ONE), matter(50.0, 0.0));
    let cube = spawn_box(&mut app, Vec3::splat(0.2), Vec3::new(0.0, 0.0, 1.0));
    let target = target(&mut app, 32, 32);
    spawn_camera(&mut app, &target, 4.0, settings(16));
    finish(&mut app);
    assert_eq!(statistics(&app).depth_passes, 0);
    assert_near(
        "a box in front",
        read(&mut app, &target).mean([15, 15, 17, 17]).x,
        1.0,
        1e-3,
    );
    app.world_mut()
        .get_mut::<Transform>(cube)
        .expect("a box")
        .translation
        .z = -1.0;
    finish(&mut app);
    assert_near(
        "a box behind",
        read(&mut app, &target).mean([15, 15, 17, 17]).x,
        0.0,
        1e-3,
    );
    assert_eq!(statistics(&app).depth_passes, 0);
    app.world_mut()
        .get_mut::<Transform>(cube)
        .expect("a box")
        .translation
        .z = 0.35;
    app.update();
    finish(&mut app);
    let passes = statistics(&app).depth_passes;
    assert!(passes > 0, "a mesh inside needs depth");
    for _ in 0..5 {
        app.update();
    }
    assert_eq!(
        statistics(&app).depth_passes,
        passes,
        "a finished image needs none"
    );
}

/// A black slab in which a white box will stand, whose front lies 0.3 m behind the slab's.
fn slab(app: &mut App) -> Handle<Image> {
    app.insert_resource(VolumeEnvironment {
        lights_meshes: false,
        is_sky: false,
        ..VolumeEnvironment::from_radiance(LinearRgba::BLACK)
    });
    let size = Vec3::new(3.0, 3.0, 1.0);
    spawn_volume(app, solid(size), matter(SIGMA, 0.0));
    let target = target(app, 24, 24);
    // Done in one frame: before anything of a mesh's can be compiled.
    spawn_camera(app, &target, 4.0, settings(16));
    target
}

const SLAB_BOX: (Vec3, Vec3) = (Vec3::new(3.0, 3.0, 0.2), Vec3::new(0.0, 0.0, 0.1));

/// What is seen of the box.
fn through_the_slab() -> f32 {
    (-SIGMA * 0.3).exp() as f32
}

/// The handle is there first, and its mesh only when the image is done.
fn loaded_late() {
    let mut app = app();
    let target = slab(&mut app);
    let cube = spawn_box(&mut app, SLAB_BOX.0, SLAB_BOX.1);
    let late = app.world().resource::<Assets<Mesh>>().reserve_handle();
    app.world_mut()
        .entity_mut(cube)
        .insert(Mesh3d(late.clone()));
    finish(&mut app);
    assert_near("nothing yet", read(&mut app, &target).middle().x, 0.0, 1e-3);
    app.world_mut()
        .resource_mut::<Assets<Mesh>>()
        .insert(&late, Cuboid::from_size(SLAB_BOX.0).into())
        .expect("a reserved handle");
    app.update();
    finish(&mut app);
    let found = read(&mut app, &target).middle().x;
    assert_near("the box", found, through_the_slab(), 0.02);
}

/// As in apps, where frames don't wait for Bevy's pipelines.
fn compiled_late() {
    let mut app = app_that(false, AssetPlugin::default(), HolovolPlugins);
    app.insert_resource(ClearColor(Color::BLACK));
    let target = slab(&mut app);
    finish(&mut app);
    spawn_box(&mut app, SLAB_BOX.0, SLAB_BOX.1);
    let mut found = f32::NAN;
    for _ in 0..200 {
        app.update();
        finish(&mut app);
        found = read(&mut app, &target).middle().x;
        if (found - through_the_slab()).abs() < 0.02 {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    assert_near("the box", found, through_the_slab(), 0.02);
}

/// Two volumes behind each other, each with a box, and a third box beside them.
fn meshes_elsewhere() {
    let mut app = app();
    let volumes = [0.5, -0.5].map(|z| {
        let volume = spawn_volume(&mut app, solid(Vec3::splat(0.4)), matter(SIGMA, 0.5));
        let place = Transform::from_xyz(0.0, 0.0, z);
        app.world_mut().entity_mut(volume).insert(place);
        spawn_box(&mut app, Vec3::splat(0.1), place.translation)
    });
    let beside = spawn_box(&mut app, Vec3::splat(0.1), Vec3::new(0.4, 0.0, 0.0));
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    finish(&mut app);
    for _ in 0..3 {
        app.update();
    }
    finish(&mut app);
    let samples = |app: &mut App| {
        app.update();
        finish(app);
        statistics(app).samples
    };
    let before = samples(&mut app);
    let shift = |app: &mut App, mesh| {
        let mut place = app.world_mut().get_mut::<Transform>(mesh);
        place.as_mut().expect("a place").translation.y += 0.01;
    };
    shift(&mut app, beside);
    assert_eq!(samples(&mut app), before, "a box beside the volumes moves");
    let mesh = app.world().get::<Mesh3d>(beside).expect("a mesh").0.clone();
    let other = Cuboid::from_size(Vec3::splat(0.12));
    let mut meshes = app.world_mut().resource_mut::<Assets<Mesh>>();
    meshes.insert(&mesh, other.into()).expect("a handle in use");
    assert_eq!(samples(&mut app), before, "it gets another shape");
    shift(&mut app, volumes[0]);
    let of_one = 64 * 24 * 24;
    assert_eq!(samples(&mut app), before + of_one, "one volume's box moves");
    let mesh = app
        .world()
        .get::<Mesh3d>(volumes[1])
        .expect("a mesh")
        .0
        .clone();
    let mut meshes = app.world_mut().resource_mut::<Assets<Mesh>>();
    meshes.insert(&mesh, other.into()).expect("a handle in use");
    let after = samples(&mut app);
    assert_eq!(after, before + 2 * of_one, "the other's gets another shape");
}

/// Twice, since after the first time nothing is known of the mesh either.
fn meshes_unseen() {
    let mut app = app();
    let volume = spawn_volume(&mut app, solid(Vec3::splat(0.4)), matter(SIGMA, 0.5));
    let mesh = spawn_box(&mut app, Vec3::splat(0.1), Vec3::ZERO);
    let target = target(&mut app, 24, 24);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    for _ in 0..3 {
        finish(&mut app);
        app.update();
    }
    finish(&mut app);
    for round in 0..3 {
        let before = statistics(&app).samples;
        app.world_mut()
            .entity_mut(volume)
            .insert(Visibility::Hidden);
        app.update();
        let mut place = app.world_mut().get_mut::<Transform>(mesh).expect("a place");
        place.translation.y += 0.02;
        for _ in 0..3 {
            app.update();
        }
        app.world_mut()
            .entity_mut(volume)
            .insert(Visibility::Visible);
        app.update();
        finish(&mut app);
        let samples = statistics(&app).samples - before;
        assert_eq!(samples, 64 * 24 * 24, "round {round}");
    }
}

/// A tilted edge in front of the volume is as smooth as without a volume behind it.
fn edges_of_meshes_are_smooth_with_msaa() {
    let mut app = app();
    app.insert_resource(VolumeEnvironment {
        is_sky: false,
        ..VolumeEnvironment::from_radiance(LinearRgba::BLACK)
    });
    let volume = spawn_volume(&mut app, solid(Vec3::new(3.0, 3.0, 0.5)), matter(50.0, 0.0));
    let cube = spawn_box(
        &mut app,
        Vec3::new(1.0, 1.0, 0.1),
        Vec3::new(-0.5, 0.0, 1.0),
    );
    let mut transform = app.world_mut().get_mut::<Transform>(cube).expect("a box");
    transform.rotation = Quat::from_rotation_z(0.1);
    let target = target(&mut app, 48, 48);
    let camera = spawn_camera(&mut app, &target, 4.0, settings(16));
    app.world_mut().entity_mut(camera).insert(Msaa::Sample4);
    finish(&mut app);
    let with = read(&mut app, &target);
    app.world_mut().despawn(volume);
    let without = read(&mut app, &target);
    let partial = |p: &&[f32; 4]| p[0] > 0.05 && p[0] < 0.95;
    assert!(
        without.pixels.iter().filter(partial).count() > 10,
        "the edge is smooth"
    );
    for (a, b) in with.pixels.iter().zip(&without.pixels) {
        assert_near("a pixel of the edge", a[0], b[0], 2e-3);
    }
}

/// A tilted square across the middle of scans: radiance of what is before it, pixel by pixel,
/// against the f64 tracer with the same square.
fn a_mesh_inside_a_scan_equals_the_reference() {
    let mut files = small_scene_files();
    files.extend(reference_scene_files());
    let inside_of = |path: &std::path::Path| path.ends_with("inside.json");
    files.retain(|path| !inside_of(path));
    for file in files {
        compare_with_square(&file);
    }
}

fn compare_with_square(path: &std::path::Path) {
    const SIZE: u32 = 32;
    const SAMPLES: u32 = 256;
    let mut scene = holovol_scene::load(path, &mut |_| {}).expect("a scene file");
    (scene.camera.width, scene.camera.height) = (SIZE, SIZE);
    let camera = scene.camera;
    let [right, up, _] = camera.axes();
    let middle = scene
        .world_from_unit_cube
        .transform_point3(DVec3::splat(0.5));
    let diagonal = scene.world_from_unit_cube.transform_vector3(DVec3::ONE);
    let side = 0.5 * diagonal.length();
    // Turned away from the camera by half a radian.
    let towards = (camera.eye - middle).normalize();
    let normal = (towards + 0.5 * up).normalize();
    let tangent = right.cross(normal).normalize();
    let [across, along] = [normal.cross(tangent), tangent];
    let distance = |direction: DVec3| {
        let way = (middle - camera.eye).dot(normal) / direction.dot(normal);
        let at = camera.eye + way * direction - middle;
        let is_hit =
            way > 0.0 && at.dot(across).abs() < 0.5 * side && at.dot(along).abs() < 0.5 * side;
        if is_hit { way } else { f64::INFINITY }
    };
    let rays = camera.pixel_rays(glam::DMat4::IDENTITY);
    let ray = |x: f64, y: f64| {
        (rays.direction + x * rays.direction_dx + y * rays.direction_dy).normalize()
    };

    let settings = Settings {
        spp: SAMPLES,
        ..default()
    };
    let film = |tracer: Tracer| {
        let mut film = tracer.film();
        tracer.accumulate(&mut film, SAMPLES);
        film.image().pixels().to_vec()
    };
    let whole = film(Tracer::new(&scene, &settings).expect("a scene"));
    let tracer = Tracer::new(&scene, &settings).expect("a scene");
    let truth = film(tracer.with_camera_ray_end(distance));
    let gpu = holovol_render::Gpu::new(None).expect("an adapter");
    let (_, noise) = measures(&offline(&gpu, &scene, 3, SAMPLES), &whole);

    let (mut app, target) = stage(scene, SAMPLES);
    let mesh = app
        .world_mut()
        .resource_mut::<Assets<Mesh>>()
        .add(Rectangle::new(side as f32, side as f32));
    let material = app
        .world_mut()
        .resource_mut::<Assets<StandardMaterial>>()
        .add(StandardMaterial {
            base_color: Color::BLACK,
            unlit: true,
            double_sided: true,
            cull_mode: None,
            ..default()
        });
    let rotation = glam::DMat3::from_cols(across, along, across.cross(along));
    let place = Transform {
        translation: middle.as_vec3(),
        rotation: glam::DQuat::from_mat3(&rotation).as_quat(),
        scale: Vec3::ONE,
    };
    app.world_mut()
        .spawn((Mesh3d(mesh), MeshMaterial3d(material), place));
    finish(&mut app);
    assert!(statistics(&app).depth_passes > 0, "the mesh is inside");
    let picture = read(&mut app, &target);

    // Where the square's edge is not in the pixel.
    let (mut ours, mut theirs, mut behind) = (Vec::new(), Vec::new(), 0);
    for (index, (truth, found)) in truth.iter().zip(&picture.pixels).enumerate() {
        let corner = [index as u32 % SIZE, index as u32 / SIZE].map(f64::from);
        let hits = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
            .map(|[x, y]| distance(ray(corner[0] + x, corner[1] + y)).is_finite());
        if hits == [hits[0]; 4] {
            behind += usize::from(hits[0]);
            ours.push(*found);
            theirs.push(*truth);
        }
    }
    let (mean, error) = measures(&ours, &theirs);
    let drift = mean / measures(&theirs, &theirs).0 - 1.0;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    eprintln!(
        "{name}: {behind} pixels of the square, mean off by {drift:.2e}, relMSE {error:.3e} \
         ({noise:.3e} without the square)"
    );
    assert!(behind > 20, "{name}: the square is seen");
    assert!(drift.abs() < 0.02, "{name}: mean off by {drift}");
    // With it less is seen of the volume, and its noise.
    assert!(
        error < 1.5 * noise + 1e-5,
        "{name}: relMSE {error} where {noise} is noise"
    );
}

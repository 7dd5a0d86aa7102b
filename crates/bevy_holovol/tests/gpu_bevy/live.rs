//! Light that a camera sees.

use std::f64::consts::PI;
use std::time::{Duration, Instant};

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::{LiveCamera, LiveFrame, LivePicture};
use glam::DVec3;
use holovol_camera::{Exposure, VirtualCamera};
use holovol_light::EnvironmentMap;
use holovol_light::lens::Calibration;

use crate::app::*;

pub const TESTS: &[crate::Test] = &[
    (
        "a_lamp_that_is_switched_on_shows_and_noise_uploads_nothing",
        a_lamp_that_is_switched_on_shows_and_noise_uploads_nothing,
    ),
    (
        "frames_that_do_not_fit_say_so_and_the_light_stays",
        frames_that_do_not_fit_say_so_and_the_light_stays,
    ),
    (
        "another_light_stays_while_the_camera_goes_on",
        another_light_stays_while_the_camera_goes_on,
    ),
];

const PICTURE: usize = 96;

/// Half the lamp's width, radians, and its radiance: the darker exposure sees it whole.
const LAMP: (f64, f32) = (0.07, 55.0);
/// Where it is; not quite of length 1.
const TOWARDS: DVec3 = DVec3::new(0.3, 0.8, 0.5);

/// A grey room, and a lamp.
fn room(lamp: bool) -> EnvironmentMap {
    let (width, height) = (128, 64);
    let texel = |i: usize| {
        let uv = [
            ((i % width) as f64 + 0.5) / width as f64,
            ((i / width) as f64 + 0.5) / height as f64,
        ];
        let at = EnvironmentMap::direction_from_uv(uv);
        let is_lamp = lamp && at.angle_between(TOWARDS) < LAMP.0;
        [if is_lamp {
            30.0
        } else {
            0.2 + 0.1 * at.x as f32
        }; 3]
    };
    EnvironmentMap::new(width, height, (0..width * height).map(texel).collect())
}

/// Ideal lenses, noisy pixels.
fn camera() -> (VirtualCamera, Calibration) {
    let camera = VirtualCamera {
        size: PICTURE,
        baseline: 0.0,
        vignetting: [0.0; 2],
        gains: [1.0; 2],
        glare: 0.0,
        ..VirtualCamera::default()
    };
    (camera, Calibration::nominal([PICTURE; 2], 195.0))
}

struct Feed {
    live: LiveCamera,
    camera: VirtualCamera,
    captured: Instant,
    seed: u64,
}

impl Feed {
    /// A bracket of what the room looks like now, as the app's frames go on.
    fn shoot(&mut self, app: &mut App, room: &EnvironmentMap) {
        let exposures = [0.0, -6.0];
        let shots = self
            .camera
            .shoot(room, &exposures.map(Exposure::Fixed), self.seed)
            .expect("a camera");
        self.seed += 1;
        for (shot, ev) in shots.into_iter().zip(exposures) {
            self.captured += Duration::from_millis(33);
            let before = app.world().resource::<LiveLight>().frames;
            self.live.send(LiveFrame {
                picture: LivePicture::Fisheyes {
                    pictures: shot.pictures,
                },
                ev: Some(ev),
                captured: self.captured,
            });
            wait_for(app, |live| live.frames > before);
        }
    }
}

fn wait_for(app: &mut App, is_done: impl Fn(&LiveLight) -> bool) {
    let started = Instant::now();
    while !is_done(app.world().resource::<LiveLight>()) {
        assert!(started.elapsed() < Duration::from_secs(60), "no news");
        std::thread::sleep(Duration::from_millis(1));
        app.update();
    }
}

/// Where the environment is brightest.
fn brightest(app: &App) -> DVec3 {
    let environment = app.world().resource::<VolumeEnvironment>();
    let EnvironmentSource::Map(handle) = &environment.source else {
        panic!("no map");
    };
    let assets = app.world().resource::<Assets<EnvironmentAsset>>();
    let map = assets.get(handle).expect("the map").map();
    let texels = map.texels().iter().enumerate();
    let (i, _) = texels
        .max_by(|a, b| a.1[1].total_cmp(&b.1[1]))
        .expect("texels");
    let [x, y] = [i % map.width(), i / map.width()].map(|k| k as f64 + 0.5);
    EnvironmentMap::direction_from_uv([x / map.width() as f64, y / map.height() as f64])
}

fn live_app(calibration: Option<Calibration>) -> App {
    app_with((
        HolovolPlugins,
        LiveLightPlugin {
            size: [128, 64],
            calibration,
            ..default()
        },
    ))
}

fn a_lamp_that_is_switched_on_shows_and_noise_uploads_nothing() {
    let (camera, calibration) = camera();
    let mut app = live_app(Some(calibration));
    app.world_mut().resource_mut::<VolumeEnvironment>().source =
        EnvironmentSource::Constant(LinearRgba::BLACK);
    spawn_volume(&mut app, solid(Vec3::ONE), matter(3.0, 0.8));
    let target = target(&mut app, 32, 32);
    spawn_camera(&mut app, &target, 4.0, settings(64));
    let mut feed = Feed {
        live: app.world().resource::<LiveLight>().camera(),
        camera,
        captured: Instant::now(),
        seed: 1,
    };
    let (dark, lit) = (room(false), room(true));
    for _ in 0..6 {
        feed.shoot(&mut app, &dark);
    }
    let uploads = app.world().resource::<LiveLight>().uploads;
    assert!(uploads > 0, "the room is seen");
    for _ in 0..10 {
        feed.shoot(&mut app, &dark);
    }
    let live = app.world().resource::<LiveLight>();
    assert_eq!(live.uploads, uploads, "noise is no change");
    assert!(live.problem.is_none(), "{:?}", live.problem);
    finish(&mut app);
    let before = read(&mut app, &target).middle();

    // One bracket later the lamp is there.
    feed.shoot(&mut app, &lit);
    let live = app.world().resource::<LiveLight>();
    assert!(live.uploads > uploads, "{live:?}");
    assert!(live.light_change > 0.5, "{live:?}");
    let off = brightest(&app).angle_between(TOWARDS);
    assert!(off < 0.1, "the lamp is {off} off");
    finish(&mut app);
    let after = read(&mut app, &target).middle();

    // What the offline light would say: flux of lamp and room.
    let lamp = f64::from(LAMP.1) * 2.0 * PI * (1.0 - LAMP.0.cos());
    let expected = 1.0 + lamp / (0.2 * 4.0 * PI);
    let found = f64::from(after.y / before.y);
    assert!(
        found > 1.0 + 0.5 * (expected - 1.0) && found < 1.0 + 2.0 * (expected - 1.0),
        "{found} times as bright, about {expected} expected"
    );
}

fn frames_that_do_not_fit_say_so_and_the_light_stays() {
    let mut app = live_app(None);
    let live = app.world().resource::<LiveLight>().camera();
    let send = |picture| {
        live.send(LiveFrame {
            picture,
            ev: None,
            captured: Instant::now(),
        })
    };
    send(LivePicture::Panorama {
        size: [64, 32],
        pixels: vec![[90; 3]; 64 * 32],
    });
    wait_for(&mut app, |live| live.uploads == 1);
    let source = app.world().resource::<VolumeEnvironment>().source.clone();
    assert!(matches!(source, EnvironmentSource::Map(_)));
    let fisheye = vec![[90; 3]; 16];
    for picture in [
        LivePicture::Panorama {
            size: [64, 32],
            pixels: vec![[90; 3]; 7],
        },
        LivePicture::Panorama {
            size: [0, 0],
            pixels: Vec::new(),
        },
        LivePicture::Fisheyes {
            pictures: [fisheye.clone(), fisheye],
        },
    ] {
        let before = app.world().resource::<LiveLight>().frames;
        send(picture);
        wait_for(&mut app, |live| live.frames > before);
        let live = app.world().resource::<LiveLight>();
        assert!(live.problem.is_some() && live.uploads == 1, "{live:?}");
    }
    send(LivePicture::Panorama {
        size: [64, 32],
        pixels: vec![[90; 3]; 64 * 32],
    });
    wait_for(&mut app, |live| live.problem.is_none());
    assert_eq!(
        app.world().resource::<VolumeEnvironment>().source,
        source,
        "still the same map"
    );
}

fn another_light_stays_while_the_camera_goes_on() {
    let mut app = live_app(None);
    let live = app.world().resource::<LiveLight>().camera();
    let mut captured = Instant::now();
    let mut send = |app: &mut App, code: u8, uploads: u64| {
        // A change of light shows within some frames.
        for _ in 0..60 {
            captured += Duration::from_millis(33);
            live.send(LiveFrame {
                picture: LivePicture::Panorama {
                    size: [128, 64],
                    pixels: vec![[code; 3]; 128 * 64],
                },
                ev: Some(0.0),
                captured,
            });
            let before = app.world().resource::<LiveLight>().frames;
            wait_for(app, |live| live.frames > before);
            if app.world().resource::<LiveLight>().uploads >= uploads {
                return;
            }
        }
        panic!("the change is not seen");
    };
    send(&mut app, 60, 1);
    let map = EnvironmentSource::Map(app.world().resource::<LiveLight>().map().clone());
    let source = |app: &App| app.world().resource::<VolumeEnvironment>().source.clone();
    assert_eq!(source(&app), map);
    let own = EnvironmentSource::Constant(LinearRgba::WHITE);
    app.world_mut().resource_mut::<VolumeEnvironment>().source = own.clone();
    send(&mut app, 160, 2);
    assert_eq!(source(&app), own);
}

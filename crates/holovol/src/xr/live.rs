//! `--camera`: the light of the room as a camera sees it.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::xr::MixedRealityOrigin;
use bevy_holovol::{LiveCamera, LiveFrame, LivePicture};
use holovol_camera::{Exposure, VirtualCamera};
use holovol_light::EnvironmentMap;
use holovol_light::lens::Calibration;

use crate::kinds::FileKind;
use crate::light::input::rgb8;
use crate::preview::lights::Overview;
use crate::preview::look::LightSource;
use crate::preview::studio::Studio;
use crate::{Exit, Failure, demo};

/// Pixels across of the virtual camera's fisheyes, and their field of view in degrees.
const PICTURE: usize = 640;
const FOV_DEG: f64 = 195.0;
/// Texels of the light, which on opaque headsets is all that is seen of the room.
const SIZE: [usize; 2] = [1024, 512];
/// Between two frames.
const PERIOD: Duration = Duration::from_millis(100);
/// Mean code, in linear light, that the virtual camera exposes for; and stops of the second
/// exposure, which sees lamps.
const METERED: f64 = 0.2;
const BRACKET_EV: f64 = -6.0;

/// What `--camera` names.
#[derive(Clone, Debug)]
pub(super) enum Source {
    /// A camera that isn't there, in a room that is a map.
    Virtual(EnvironmentMap),
    /// Panoramas, again and again.
    Frames(Vec<PathBuf>),
}

impl Source {
    /// `virtual`, `virtual:ROOM`, a panorama, or a folder of panoramas.
    pub(super) fn find(uri: &str) -> Result<Self, Failure> {
        if uri == "virtual" {
            return Ok(Self::Virtual(demo::environment()));
        }
        if let Some(room) = uri.strip_prefix("virtual:") {
            return Ok(Self::Virtual(EnvironmentMap::load(Path::new(room))?));
        }
        if let Some((scheme, _)) = uri.split_once("://") {
            let message = format!(
                "--camera {uri}: {scheme} is not read yet; give a panorama, a folder of panoramas, \
                 virtual, or virtual:ROOM.hdr"
            );
            return Err(Failure::new(Exit::Usage, message));
        }
        let path = Path::new(uri);
        let input = |message: String| Failure::new(Exit::Input, format!("--camera {message}"));
        let mut frames = if path.is_dir() {
            let entries =
                std::fs::read_dir(path).map_err(|error| input(format!("{uri}: {error}")))?;
            entries.flatten().map(|entry| entry.path()).collect()
        } else {
            vec![path.to_owned()]
        };
        frames.retain(|frame| FileKind::of(frame) == FileKind::Panorama { is_hdr: false });
        frames.sort();
        match frames.first() {
            // Said before the headset is put on.
            Some(first) => rgb8(first).map(|_| Self::Frames(frames)),
            None if FileKind::of(path) == (FileKind::Panorama { is_hdr: true }) => {
                Err(input(format!(
                    "{uri}: cameras give no radiance; as a room for a virtual camera it is \
                     virtual:{uri}, as light it is a file like others"
                )))
            }
            None => Err(input(format!(
                "{uri}: there is no panorama there (*.jpg, *.png)"
            ))),
        }
    }
}

/// Lights the volume by a camera.
pub(super) struct CameraPlugin {
    pub(super) source: Source,
    /// What the camera's panorama is turned by about +y, radians, against the tracking space.
    pub(super) turn: f32,
}

#[derive(Resource)]
struct Turn(f32);

impl Plugin for CameraPlugin {
    fn build(&self, app: &mut App) {
        let calibration = match self.source {
            Source::Virtual(_) => Some(Calibration::nominal([PICTURE; 2], FOV_DEG)),
            Source::Frames(_) => None,
        };
        app.add_plugins(LiveLightPlugin {
            size: SIZE,
            calibration,
            ..default()
        })
        .insert_resource(Turn(self.turn))
        .add_systems(Update, follow);
        let live = app.world().resource::<LiveLight>().camera();
        let source = self.source.clone();
        let thread = std::thread::Builder::new().name("camera".into());
        if let Err(error) = thread.spawn(move || film(&source, &live)) {
            warn!("no camera: its thread can't be started: {error}");
        }
    }
}

/// What the camera's thread does, until the app has ended.
fn film(source: &Source, live: &LiveCamera) {
    match source {
        Source::Virtual(room) => film_virtually(room, live),
        Source::Frames(frames) => play(frames, live),
    }
}

fn film_virtually(room: &EnvironmentMap, live: &LiveCamera) {
    let camera = VirtualCamera {
        size: PICTURE,
        ..default()
    };
    // As people set theirs, once: what is metered in every frame would hide that the light changes.
    let metered = match camera.shoot(room, &[Exposure::Automatic(METERED)], 0) {
        Ok(shots) => shots[0].ev,
        Err(error) => return warn!("no camera: {error}"),
    };
    for shot in 1_u64.. {
        let ev = metered + BRACKET_EV * (shot % 2) as f64;
        let Ok(mut shots) = camera.shoot(room, &[Exposure::Fixed(ev)], shot) else {
            return;
        };
        let pictures = shots.remove(0).pictures;
        let is_wanted = live.send(LiveFrame {
            picture: LivePicture::Fisheyes { pictures },
            ev: Some(ev),
            captured: Instant::now(),
        });
        if !is_wanted {
            return;
        }
        std::thread::sleep(PERIOD);
    }
}

fn play(frames: &[PathBuf], live: &LiveCamera) {
    let mut held = None;
    for frame in frames.iter().cycle() {
        // One frame is a camera that stands still: read once.
        let read = match held.take() {
            Some(read) => read,
            None => match rgb8(frame) {
                Ok(read) => read,
                Err(failure) => {
                    warn!("{failure}");
                    std::thread::sleep(PERIOD);
                    continue;
                }
            },
        };
        if frames.len() == 1 {
            held = Some(read.clone());
        }
        let (width, height, pixels) = read;
        let is_wanted = live.send(LiveFrame {
            picture: LivePicture::Panorama {
                size: [width, height],
                pixels,
            },
            ev: None,
            captured: Instant::now(),
        });
        if !is_wanted {
            return;
        }
        std::thread::sleep(PERIOD);
    }
}

#[expect(clippy::too_many_arguments, reason = "what the look depends on")]
/// Keeps the look on the camera's light, exposed so that chalk in it isn't white.
fn follow(
    live: Res<LiveLight>,
    turn: Res<Turn>,
    environment: Res<VolumeEnvironment>,
    environments: Res<Assets<EnvironmentAsset>>,
    origin: Query<&Transform, With<MixedRealityOrigin>>,
    mut studio: ResMut<Studio>,
    mut exposed: Local<bool>,
    mut of_camera: Local<Option<Handle<EnvironmentAsset>>>,
) {
    if live.uploads == 0 {
        return;
    }
    // The camera's, as long as nothing else has been opened since.
    let map = of_camera.get_or_insert_with(|| match &environment.source {
        EnvironmentSource::Map(map) => map.clone(),
        EnvironmentSource::Constant(_) => Handle::default(),
    });
    let is_set =
        matches!(&studio.look.light.source, LightSource::Map { map: set, .. } if set == map);
    if !is_set {
        studio.look.light.source = LightSource::Map {
            map: map.clone(),
            path: None,
            name: "camera".into(),
        };
        studio.look.light.stops = 0.0;
        *exposed = false;
    }
    if !*exposed && let Some(asset) = environments.get(&*map) {
        *exposed = true;
        studio.look.exposure_ev = Overview::new(asset.map()).exposure_ev();
    }
    // The camera stands in the room; the user's place in the world is turned against it.
    let yaw = origin
        .single()
        .map_or(0.0, |o| o.rotation.to_euler(EulerRot::YXZ).0);
    let degrees = f64::from((yaw + turn.0).to_degrees());
    if (studio.look.light.rotation_deg - degrees).abs() > 1e-4 {
        studio.look.light.rotation_deg = degrees;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uris_name_cameras_or_say_what_would() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        let said = |uri: &str| Source::find(uri).expect_err("no camera").to_string();
        assert!(matches!(Source::find("virtual"), Ok(Source::Virtual(_))));
        assert!(said("rtsp://camera/live").contains("rtsp"));
        assert!(said(&place("none.jpg")).contains("none.jpg"));
        assert!(said(&place("room.hdr")).contains("virtual:"));
        let empty = folder.path().to_string_lossy();
        assert!(said(&empty).contains("no panorama"));
        for name in ["b.png", "a.png", "notes.txt"] {
            image::RgbImage::new(8, 4)
                .save_with_format(place(name), image::ImageFormat::Png)
                .unwrap();
        }
        match Source::find(&empty) {
            Ok(Source::Frames(frames)) => {
                assert_eq!(frames, [place("a.png"), place("b.png")].map(PathBuf::from));
            }
            other => panic!("{other:?}"),
        }
        match Source::find(&place("b.png")) {
            Ok(Source::Frames(frames)) => assert_eq!(frames.len(), 1),
            other => panic!("{other:?}"),
        }
    }
}

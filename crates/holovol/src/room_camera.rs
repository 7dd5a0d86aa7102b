//! `--camera`: the light of the room as a camera sees it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bevy::prelude::*;
use bevy_holovol::prelude::*;
use bevy_holovol::{LiveCamera, LiveFrame, LivePicture};
use holovol_camera::{Exposure, VirtualCamera};
use holovol_light::EnvironmentMap;
use holovol_light::lens::Calibration;

use crate::kinds::FileKind;
use crate::light::input::rgb8;
use crate::preview::lights::Overview;
use crate::preview::look::{LightSource, Look};
use crate::preview::open::Opening;
use crate::preview::studio::Studio;
use crate::{Exit, Failure, demo};

/// Pixels across of the virtual camera's fisheyes, and their field of view in degrees.
const PICTURE: usize = 640;
const FOV_DEG: f64 = 195.0;
/// Texels of the light, which can be all that is seen of the room.
const SIZE: [usize; 2] = [1024, 512];
/// Between two frames.
const PERIOD: Duration = Duration::from_millis(100);
/// Mean code, in linear light, that the virtual camera exposes for; and stops of the second
/// exposure, which sees lamps.
const METERED: f64 = 0.2;
const BRACKET_EV: f64 = -6.0;

/// Shots of a virtual camera at each exposure, which then come again.
const SHOTS: usize = 4;

/// What `--camera` names.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    /// A camera that isn't there, in a room that is a map.
    Virtual(EnvironmentMap),
    /// Panoramas, again and again.
    Frames(Vec<PathBuf>),
}

impl Source {
    /// `virtual`, `virtual:ROOM`, a panorama, or a folder of panoramas.
    pub(crate) fn find(uri: &str) -> Result<Self, Failure> {
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
pub(crate) struct RoomCameraPlugin(pub(crate) Source);

impl Plugin for RoomCameraPlugin {
    fn build(&self, app: &mut App) {
        let calibration = match self.0 {
            Source::Virtual(_) => Some(Calibration::nominal([PICTURE; 2], FOV_DEG)),
            Source::Frames(_) => None,
        };
        app.add_plugins(LiveLightPlugin {
            size: SIZE,
            calibration,
            ..default()
        })
        .add_systems(Update, take_over);
        let problem = Problem::default();
        let live = app.world().resource::<LiveLight>().camera();
        let (source, tell) = (self.0.clone(), problem.clone());
        let thread = std::thread::Builder::new().name("camera".into());
        if let Err(error) = thread.spawn(move || film(&source, &live, &tell)) {
            problem.set(format!("its thread can't be started: {error}"));
        }
        app.insert_resource(RoomCamera {
            map: Handle::default(),
            problem,
        });
    }
}

/// The camera's light among others.
#[derive(Resource)]
pub(crate) struct RoomCamera {
    map: Handle<EnvironmentAsset>,
    problem: Problem,
}

impl RoomCamera {
    /// Whether this light is the camera's.
    pub(crate) fn is(&self, source: &LightSource) -> bool {
        matches!(source, LightSource::Map { map, .. } if *map == self.map)
    }

    /// The camera's light once it is known.
    pub(crate) fn source(&self) -> Option<LightSource> {
        (self.map != Handle::default()).then(|| LightSource::Map {
            map: self.map.clone(),
            path: None,
            name: "camera".into(),
        })
    }

    /// Why the camera gives no frames.
    pub(crate) fn problem(&self) -> Option<String> {
        self.problem.get()
    }
}

/// What the camera's thread has to say.
#[derive(Clone, Default)]
struct Problem(Arc<Mutex<Option<String>>>);

impl Problem {
    fn set(&self, problem: String) {
        warn!("no camera: {problem}");
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(problem);
    }

    fn clear(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    fn get(&self) -> Option<String> {
        let problem = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        problem.clone()
    }
}

/// What the camera's thread does, until the app has ended.
fn film(source: &Source, live: &LiveCamera, problem: &Problem) {
    match source {
        Source::Virtual(room) => film_virtually(room, live, problem),
        Source::Frames(frames) => play(frames, live, problem),
    }
}

fn film_virtually(room: &EnvironmentMap, live: &LiveCamera, problem: &Problem) {
    let camera = VirtualCamera {
        size: PICTURE,
        ..default()
    };
    // As people set theirs, once: what is metered in every frame would hide that the light changes.
    let metered = match camera.shoot(room, &[Exposure::Automatic(METERED)], 0) {
        Ok(shots) => shots[0].ev,
        Err(error) => return problem.set(error.to_string()),
    };
    // The room stands still: only noise differs from shot to shot.
    let mut taken = [const { Vec::new() }; 2];
    for shot in 1_usize.. {
        let (dark, turn) = (shot % 2, shot / 2 % SHOTS);
        let ev = metered + BRACKET_EV * dark as f64;
        let taken = &mut taken[dark];
        if taken.len() <= turn {
            match camera.shoot(room, &[Exposure::Fixed(ev)], shot as u64) {
                Ok(mut shots) => taken.push(shots.remove(0).pictures),
                Err(error) => return problem.set(error.to_string()),
            }
        }
        let is_wanted = live.send(LiveFrame {
            picture: LivePicture::Fisheyes {
                pictures: taken[turn].clone(),
            },
            ev: Some(ev),
            captured: Instant::now(),
        });
        if !is_wanted {
            return;
        }
        std::thread::sleep(PERIOD);
    }
}

fn play(frames: &[PathBuf], live: &LiveCamera, problem: &Problem) {
    let mut held = None;
    for frame in frames.iter().cycle() {
        // One frame is a camera that stands still: read once.
        let read = match held.take() {
            Some(read) => read,
            None => match rgb8(frame) {
                Ok(read) => {
                    problem.clear();
                    read
                }
                Err(failure) => {
                    problem.set(failure.to_string());
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

/// Makes the camera's first light the look's, once what was opened before it is there: after that it
/// is one light to choose among others.
fn take_over(
    live: Res<LiveLight>,
    environments: Res<Assets<EnvironmentAsset>>,
    opening: Res<Opening>,
    mut camera: ResMut<RoomCamera>,
    mut studio: ResMut<Studio>,
) {
    if camera.source().is_some() || studio.scan.is_none() || opening.is_busy() {
        return;
    }
    let Some(asset) = environments.get(live.map()) else {
        return;
    };
    camera.map = live.map().clone();
    let Studio { look, history, .. } = &mut *studio;
    camera.choose(look, asset.map());
    // Nobody edited anything.
    history.begin(look);
}

impl RoomCamera {
    /// Lights the look by the camera, exposed so that chalk isn't white.
    pub(crate) fn choose(&self, look: &mut Look, map: &EnvironmentMap) {
        if let Some(source) = self.source() {
            look.light.source = source;
            look.light.stops = 0.0;
            look.exposure_ev = Overview::new(map).exposure_ev();
        }
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

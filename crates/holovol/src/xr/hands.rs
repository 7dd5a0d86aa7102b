//! `--hands`: recorded hands instead of the headset's own.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use bevy::prelude::*;
use bevy_holovol::interaction::{HandRecording, Hands, InteractionSystems};
use bevy_holovol::xr::{HeadPose, MixedRealityOrigin};

use super::place::{Placed, turn_of};
use crate::{Exit, Failure};

pub(super) fn read(path: &Path) -> Result<HandRecording, Failure> {
    let fail = |error: &dyn std::fmt::Display| {
        Failure::new(Exit::Input, format!("{}: {error}", path.display()))
    };
    let file = File::open(path).map_err(|error| fail(&error))?;
    let recording = HandRecording::read(BufReader::new(file)).map_err(|error| fail(&error))?;
    if recording.frames().is_empty() {
        return Err(fail(&"holds no frame"));
    }
    Ok(recording)
}

/// Plays a recording from when the user stands before the scan; its last frame stays. Where it has a
/// head, hands are where that had them.
pub(super) struct PlayPlugin(pub(super) HandRecording);

#[derive(Resource)]
struct Playing {
    recording: HandRecording,
    /// s
    time: f64,
    /// To the world.
    place: Option<Isometry3d>,
}

impl Plugin for PlayPlugin {
    fn build(&self, app: &mut App) {
        app.insert_resource(Playing {
            recording: self.0.clone(),
            time: 0.0,
            place: None,
        })
        .add_systems(PreUpdate, play.before(InteractionSystems));
    }
}

fn play(
    mut playing: ResMut<Playing>,
    placed: Res<Placed>,
    head: Res<HeadPose>,
    time: Res<Time>,
    origin: Query<&Transform, With<MixedRealityOrigin>>,
    mut hands: ResMut<Hands>,
) {
    let (true, Some(head), Ok(origin)) = (placed.0.is_some(), head.0, origin.single()) else {
        return;
    };
    let playing = &mut *playing;
    let place = *playing.place.get_or_insert_with(|| {
        let recorded = playing.recording.frames().first().and_then(|f| f.head);
        recorded.map_or(origin.to_isometry(), |recorded| aligned(recorded, head))
    });
    let recording = &playing.recording;
    let last = recording.frames().last();
    if let Some(frame) = recording.at(playing.time).or(last) {
        *hands = frame.hands().moved(place);
    }
    playing.time += time.delta_secs_f64();
}

/// Takes one head to the place of another, and to where that looks; upright stays upright.
fn aligned(from: Isometry3d, to: Isometry3d) -> Isometry3d {
    let rotation = turn_of(to) * turn_of(from).inverse();
    let [from, to] = [from, to].map(|head| Vec3::from(head.translation));
    Isometry3d::new(to - rotation * from, rotation.normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hands_are_where_the_recorded_head_had_them() {
        let head = |x: f32, yaw: f32| {
            let rotation = Quat::from_rotation_y(yaw) * Quat::from_rotation_x(-0.3);
            Isometry3d::new(Vec3::new(x, 1.6, 0.0), rotation)
        };
        let place = aligned(head(1.0, 0.4), head(-2.0, 1.1));
        let before =
            |x: f32, yaw: f32| Vec3::new(x, 1.2, 0.0) + Quat::from_rotation_y(yaw) * Vec3::NEG_Z;
        let found = place * before(1.0, 0.4);
        assert!(found.distance(before(-2.0, 1.1)) < 1e-5, "{found}");
    }

    #[test]
    fn files_that_hold_no_hands_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hands.jsonl");
        for (text, reason) in [("", "no frame"), ("{\"time\":0}\n", "line 1")] {
            std::fs::write(&path, text).unwrap();
            let said = read(&path).expect_err("none").to_string();
            assert!(
                said.contains("hands.jsonl") && said.contains(reason),
                "{said}"
            );
        }
    }
}

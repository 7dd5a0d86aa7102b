//! Hands on file: one line of JSON for each frame, so that what went wrong in a headset can be
//! played again without one.
//!
//! ```json
//! {"time":0.011,"head":[0,1.6,0,0,0,0,1],"hands":[{"joints":[[…7 numbers…],null,…]},{"grip":[…],"aim":[…],"squeeze":0.2,"poke":[x,y,z]}]}
//! ```
//!
//! `time` is in s and grows. Places are x, y, z in m and orientations x, y, z, w, seven numbers in
//! all, in tracking space. A hand has either `joints`, 26 in the order of `XR_EXT_hand_tracking`,
//! `null` where one isn't tracked; or what a controller has; or is `null`.

use std::io::{BufRead, Write};

use bevy::math::{Isometry3d, Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::{Hand, Hands, JOINT_COUNT};

/// The joints of a hand, those that are tracked.
pub type Joints = [Option<Isometry3d>; JOINT_COUNT];

/// What is known of a hand in a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum HandData {
    /// It isn't tracked.
    #[default]
    None,
    /// Its joints.
    Joints(Box<Joints>),
    /// A controller's poses, or those of whatever else serves as a hand.
    Poses(Hand),
}

/// A frame of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HandFrame {
    /// s since anything.
    pub time: f64,
    /// Between the eyes.
    pub head: Option<Isometry3d>,
    /// Left and right.
    pub hands: [HandData; 2],
}

impl HandFrame {
    /// What interaction is told.
    pub fn hands(&self) -> Hands {
        let head = self.head.map(|head| Vec3::from(head.translation));
        Hands([0, 1].map(|hand: usize| match &self.hands[hand] {
            HandData::None => Hand::default(),
            HandData::Joints(joints) => Hand::from_joints(joints, head),
            HandData::Poses(hand) => *hand,
        }))
    }
}

/// Why a recording can't be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The file can't be read or written.
    #[error("the recording of hands can't be read or written: {0}")]
    Io(#[from] std::io::Error),
    /// A line isn't a frame.
    #[error("line {line} of the recording of hands: {reason}")]
    Line {
        /// From 1 on.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
}

type Pose = [f32; 7];

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileFrame {
    time: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    head: Option<Pose>,
    hands: [Option<FileHand>; 2],
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct FileHand {
    #[serde(skip_serializing_if = "Option::is_none")]
    joints: Option<Vec<Option<Pose>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    grip: Option<Pose>,
    #[serde(skip_serializing_if = "Option::is_none")]
    aim: Option<Pose>,
    #[serde(skip_serializing_if = "Option::is_none")]
    squeeze: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    poke: Option<[f32; 3]>,
}

/// What JSON can't hold isn't tracked.
fn to_file(pose: Isometry3d) -> Option<Pose> {
    let ([x, y, z], q) = (pose.translation.to_array(), pose.rotation.to_array());
    let all = [x, y, z, q[0], q[1], q[2], q[3]];
    all.iter().all(|n| n.is_finite()).then_some(all)
}

fn to_pose([x, y, z, qx, qy, qz, qw]: Pose) -> Result<Isometry3d, String> {
    let rotation = Quat::from_xyzw(qx, qy, qz, qw);
    // Decimals round.
    if (rotation.length() - 1.0).abs() > 0.01 {
        return Err(format!(
            "the orientation {qx} {qy} {qz} {qw} hasn't length 1"
        ));
    }
    Ok(Isometry3d::new(Vec3::new(x, y, z), rotation.normalize()))
}

impl FileFrame {
    fn new(frame: &HandFrame) -> Self {
        let hand = |hand: &HandData| match hand {
            HandData::None => None,
            HandData::Joints(joints) => Some(FileHand {
                joints: Some(joints.iter().map(|joint| joint.and_then(to_file)).collect()),
                ..Default::default()
            }),
            HandData::Poses(hand) => Some(FileHand {
                grip: hand.grip.and_then(to_file),
                aim: hand.aim.and_then(to_file),
                squeeze: Some(hand.squeeze).filter(|s| s.is_finite()),
                poke: hand.poke.filter(|p| p.is_finite()).map(|p| p.to_array()),
                joints: None,
            }),
        };
        Self {
            time: frame.time,
            head: frame.head.and_then(to_file),
            hands: [hand(&frame.hands[0]), hand(&frame.hands[1])],
        }
    }

    fn frame(self) -> Result<HandFrame, String> {
        let [left, right] = self.hands;
        let hand = |hand: Option<FileHand>| match hand {
            None => Ok(HandData::None),
            Some(hand) => hand.data(),
        };
        Ok(HandFrame {
            time: self.time,
            head: self.head.map(to_pose).transpose()?,
            hands: [hand(left)?, hand(right)?],
        })
    }
}

impl FileHand {
    fn data(self) -> Result<HandData, String> {
        let has_poses = self.grip.is_some() || self.aim.is_some() || self.poke.is_some();
        let Some(joints) = self.joints else {
            return Ok(HandData::Poses(Hand {
                grip: self.grip.map(to_pose).transpose()?,
                aim: self.aim.map(to_pose).transpose()?,
                squeeze: self.squeeze.unwrap_or(0.0),
                poke: self.poke.map(Vec3::from),
            }));
        };
        if has_poses || self.squeeze.is_some() {
            return Err("a hand has joints or poses, not both".into());
        }
        let found = joints.len();
        let joints: [Option<Pose>; JOINT_COUNT] = joints
            .try_into()
            .map_err(|_| format!("a hand has {JOINT_COUNT} joints, not {found}"))?;
        let mut data: Joints = [None; JOINT_COUNT];
        for (joint, pose) in data.iter_mut().zip(joints) {
            *joint = pose.map(to_pose).transpose()?;
        }
        Ok(HandData::Joints(Box::new(data)))
    }
}

/// Writes frames, one after the other.
pub struct HandRecorder<W: Write>(W);

impl<W: Write> HandRecorder<W> {
    /// Into a file, or whatever bytes can be written to.
    pub fn new(to: W) -> Self {
        Self(to)
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&mut self, frame: &HandFrame) -> Result<(), RecordingError> {
        let line = serde_json::to_string(&FileFrame::new(frame)).map_err(std::io::Error::from)?;
        writeln!(self.0, "{line}")?;
        Ok(())
    }
}

/// A recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HandRecording {
    frames: Vec<HandFrame>,
}

impl HandRecording {
    /// Reads all of it; empty lines are passed over.
    ///
    /// # Errors
    /// [`RecordingError::Line`] names what isn't a frame, and frames that go back in time.
    pub fn read(from: impl BufRead) -> Result<Self, RecordingError> {
        let mut frames: Vec<HandFrame> = Vec::new();
        for (line, text) in (1..).zip(from.lines()) {
            let text = text?;
            if text.trim().is_empty() {
                continue;
            }
            let read = serde_json::from_str::<FileFrame>(&text).map_err(|e| e.to_string());
            let frame = read.and_then(FileFrame::frame);
            let frame = frame.map_err(|reason| RecordingError::Line { line, reason })?;
            let last = frames.last().map_or(f64::NEG_INFINITY, |last| last.time);
            if frame.time.partial_cmp(&last) != Some(std::cmp::Ordering::Greater) {
                let reason = format!("its time {} s isn't after the former, {last} s", frame.time);
                return Err(RecordingError::Line { line, reason });
            }
            frames.push(frame);
        }
        Ok(Self { frames })
    }

    /// Its frames, in order of time.
    pub fn frames(&self) -> &[HandFrame] {
        &self.frames
    }

    /// The last frame that was there `time` s after the first; `None` before and long after.
    pub fn at(&self, time: f64) -> Option<&HandFrame> {
        let start = self.frames.first()?.time;
        let after = self
            .frames
            .partition_point(|frame| frame.time - start <= time);
        let frame = self.frames.get(after.checked_sub(1)?)?;
        let is_over = after == self.frames.len() && time - (frame.time - start) > 0.5;
        (!is_over).then_some(frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(time: f64) -> HandFrame {
        let turn = Quat::from_rotation_x(0.3);
        let mut joints: Joints = [None; JOINT_COUNT];
        for (i, joint) in joints.iter_mut().enumerate().skip(1) {
            let place = Vec3::new(0.01 * i as f32, 0.02 * (i % 5) as f32, 0.0);
            *joint = Some(Isometry3d::new(place, turn));
        }
        HandFrame {
            time,
            head: Some(Isometry3d::from_xyz(0.0, 1.6, 0.0)),
            hands: [
                HandData::Joints(Box::new(joints)),
                HandData::Poses(Hand {
                    grip: Some(Isometry3d::new(Vec3::ONE, turn)),
                    aim: None,
                    squeeze: 0.25,
                    poke: Some(Vec3::X),
                }),
            ],
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let frames = [
            frame(1.0),
            HandFrame {
                time: 1.5,
                ..Default::default()
            },
        ];
        let mut bytes = Vec::new();
        let mut recorder = HandRecorder::new(&mut bytes);
        for frame in &frames {
            recorder.write(frame).expect("room");
        }
        let read = HandRecording::read(&*bytes).expect("it was written so");
        for (read, written) in read.frames().iter().zip(&frames) {
            assert_eq!(read.time, written.time);
            let [a, b] = [read, written].map(|frame| frame.hands());
            for (a, b) in a.0.iter().zip(&b.0) {
                assert_eq!((a.squeeze, a.poke), (b.squeeze, b.poke));
                let places = |hand: &Hand| hand.grip.map(|grip| grip.translation);
                assert_eq!(places(a), places(b));
            }
        }
        assert_eq!(read.frames().len(), 2);
        assert!(read.frames()[0].hands().0[0].grip.is_some(), "from joints");
    }

    #[test]
    fn the_frame_of_a_time_is_the_last_before() {
        let recording = HandRecording {
            frames: vec![frame(3.0), frame(3.1), frame(3.4)],
        };
        let time = |at: f64| recording.at(at).map(|frame| frame.time);
        assert_eq!(time(-0.1), None);
        assert_eq!(time(0.0), Some(3.0));
        assert_eq!(time(0.25), Some(3.1));
        assert_eq!(time(0.6), Some(3.4));
        assert_eq!(time(2.0), None);
        assert_eq!(HandRecording::default().at(0.0), None);
    }

    #[test]
    fn mistakes_are_errors_that_name_the_line() {
        let good = r#"{"time":1,"hands":[null,null]}"#;
        let wrong = |line: &str| {
            let text = format!("{good}\n\n{line}\n");
            HandRecording::read(text.as_bytes())
                .expect_err("it is wrong")
                .to_string()
        };
        for (line, part) in [
            ("{", "line 3"),
            (r#"{"time":1,"hands":[null,null]}"#, "isn't after"),
            (r#"{"time":2,"hands":[null]}"#, "line 3"),
            (
                r#"{"time":2,"hands":[null,{"joints":[]}]}"#,
                "26 joints, not 0",
            ),
            (
                r#"{"time":2,"hands":[null,{"grip":[0,0,0,0,0,0,0]}]}"#,
                "length 1",
            ),
            (r#"{"time":2,"hands":[null,{"thumb":1}]}"#, "thumb"),
            (
                r#"{"time":2,"hands":[{"joints":[],"squeeze":1},null]}"#,
                "not both",
            ),
        ] {
            let message = wrong(line);
            assert!(
                message.contains(part) && message.contains("line 3"),
                "{message}"
            );
        }
    }
}

//! A folder with a small scene in it, and the command to run there.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Value, json};

/// A scene of 12³ voxels under constant light, in a folder of its own.
pub struct Bench {
    pub folder: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let bench = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let sphere = |index: i32| {
            let from_centre = |i: i32| (f64::from(i) - 5.5).powi(2);
            let square =
                from_centre(index % 12) + from_centre(index / 12 % 12) + from_centre(index / 144);
            (255.0 * (1.0 - square / 36.0).max(0.0)) as u8
        };
        let voxels: Vec<u8> = (0..12 * 12 * 12).map(sphere).collect();
        bench.write("sphere.nrrd", &nrrd("uint8", "12 12 12", &voxels));
        bench.write_scene("scene.json", &scene());
        bench
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).unwrap();
    }

    pub fn write_scene(&self, name: &str, scene: &Value) {
        self.write(name, scene.to_string().as_bytes());
    }

    /// Runs `holovol` in the folder.
    pub fn run(&self, args: &[&str]) -> Output {
        self.command().args(args).output().unwrap()
    }

    pub fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_holovol"));
        command.current_dir(self.folder.path());
        command
    }

    /// Runs what must succeed; gives its standard output.
    #[track_caller]
    pub fn output(&self, args: &[&str]) -> String {
        let output = self.run(args);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{args:?}: {stderr}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs what must print one line of JSON.
    #[track_caller]
    pub fn json(&self, args: &[&str]) -> Value {
        let stdout = self.output(args);
        assert_eq!(stdout.matches('\n').count(), 1, "{stdout:?}");
        assert!(stdout.ends_with('\n'));
        serde_json::from_str(&stdout).unwrap()
    }
}

/// An attached NRRD file without compression.
pub fn nrrd(kind: &str, sizes: &str, voxels: &[u8]) -> Vec<u8> {
    let header = format!(
        "NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {sizes}\nspacings: 1 1 1\nencoding: raw\nendian: little\n\n"
    );
    [header.as_bytes(), voxels].concat()
}

pub fn scene() -> Value {
    json!({
        "version": 1,
        "volume": { "path": "sphere.nrrd", "window": [0, 255] },
        "transfer_function": { "points": [
            { "s": 0.0, "sigma_t": 0.0, "albedo": [0.9, 0.7, 0.5] },
            { "s": 1.0, "sigma_t": 800.0, "albedo": [0.9, 0.7, 0.5] }
        ] },
        "environment": { "constant": [1.0, 1.0, 1.0] },
        "camera": { "eye": [0.0, 0.0, 0.04], "target": [0, 0, 0], "up": [0, 1, 0],
                    "fov_y_deg": 25, "width": 24, "height": 16 }
    })
}

pub fn exists(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|metadata| metadata.len() > 0)
}

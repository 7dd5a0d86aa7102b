//! A headset without a headset: Monado with a simulated one, for trying things out and for tests.

use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The service's program, and where Debian has the runtime's manifest.
const SERVICE: &str = "monado-service";
const MANIFEST: &str = "/usr/share/openxr/1/openxr_monado.json";
/// What the service listens on.
const SOCKET: &str = "monado_comp_ipc";
const PATIENCE: Duration = Duration::from_secs(20);

/// Why there is no simulated headset.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// Monado isn't installed.
    #[error(
        "there is no {program} ({error}); install Monado: `apt install monado-service \
         libopenxr1-monado libopenxr-loader1` on Debian 13 and Ubuntu 24.04; in a checkout, \
         `scripts/xr-runtime COMMAND` brings its own"
    )]
    NoMonado {
        /// What was to be run.
        program: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// It was started and isn't there.
    #[error("{SERVICE} does not listen; it said:\n{0}")]
    NoAnswer(String),
    /// The environment can be changed by a single thread only.
    #[error("a headset can be simulated only from a program's first thread, before all others")]
    TooLate,
    /// A folder for its socket could not be made.
    #[error("{path}: {error}", path = path.display())]
    Folder {
        /// Where.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
}

/// A running service with a simulated headset; ends when dropped.
///
/// Linux only. The headset moves by itself, has no hands, and is [opaque](super::HeadsetBlend).
pub struct SimulatedHeadset {
    service: Option<Child>,
    folder: PathBuf,
}

impl SimulatedHeadset {
    /// Starts the service in a folder of its own, and makes it this process's runtime. `turns`: the
    /// head turns about itself instead of swaying.
    ///
    /// `HOLOVOL_MONADO_SERVICE` names another program than `monado-service`; `XR_RUNTIME_JSON` stays
    /// if it is set. The service's own settings can be given by its environment variables.
    ///
    /// # Errors
    /// If Monado isn't there, or if this process has other threads already.
    #[expect(
        unsafe_code,
        reason = "changing the environment, which the loader reads"
    )]
    pub fn start(turns: bool) -> Result<Self, SimulationError> {
        if !is_single_threaded() {
            return Err(SimulationError::TooLate);
        }
        // Short: sockets' paths have 107 bytes at most.
        let folder = PathBuf::from(format!("/tmp/holovol-xr-{}", std::process::id()));
        make_private(&folder).map_err(|error| SimulationError::Folder {
            path: folder.clone(),
            error,
        })?;
        // SAFETY: there is no other thread that could read the environment.
        unsafe {
            std::env::set_var("XDG_RUNTIME_DIR", &folder);
            set_default("XR_RUNTIME_JSON", MANIFEST);
            set_default("SIMULATED_ENABLE", "1");
            set_default("SIMULATED_ROTATE", if turns { "1" } else { "0" });
        }
        let mut simulation = Self {
            service: None,
            folder,
        };
        simulation.restart()?;
        Ok(simulation)
    }

    /// Ends the service, at once and without a word to its programs.
    pub fn kill(&mut self) {
        if let Some(mut service) = self.service.take() {
            let _ = service.kill();
            let _ = service.wait();
        }
    }

    /// Starts the service, after the end of the one before.
    ///
    /// # Errors
    /// If it doesn't start.
    pub fn restart(&mut self) -> Result<(), SimulationError> {
        self.kill();
        let socket = self.folder.join(SOCKET);
        let _ = std::fs::remove_file(&socket);
        let log = self.folder.join("log");
        let program = std::env::var_os("HOLOVOL_MONADO_SERVICE");
        let program = program.as_deref().unwrap_or(OsStr::new(SERVICE));
        let output = || File::create(&log).map_or_else(|_| Stdio::null(), Stdio::from);
        let service = Command::new(program)
            .env("XRT_COMPOSITOR_NULL", "1")
            .env("XRT_NO_STDIN", "1")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(output())
            .spawn()
            .map_err(|error| SimulationError::NoMonado {
                program: program.to_string_lossy().into_owned(),
                error,
            })?;
        let service = self.service.insert(service);
        let start = Instant::now();
        while !socket.exists() {
            let has_ended = service.try_wait().is_ok_and(|status| status.is_some());
            if has_ended || start.elapsed() > PATIENCE {
                return Err(SimulationError::NoAnswer(last_lines(&log)));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

impl Drop for SimulatedHeadset {
    fn drop(&mut self) {
        self.kill();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// # Safety
/// There must be no other thread.
#[expect(unsafe_code, reason = "changing the environment")]
unsafe fn set_default(name: &str, value: &str) {
    if std::env::var_os(name).is_none() {
        // SAFETY: as the caller's.
        unsafe { std::env::set_var(name, value) };
    }
}

/// Linux tells; elsewhere there is no Monado.
fn is_single_threaded() -> bool {
    std::fs::read_dir("/proc/self/task").is_ok_and(|tasks| tasks.count() == 1)
}

fn make_private(folder: &Path) -> std::io::Result<()> {
    let mut builder = std::fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    // What a former process with this number has left behind.
    let _ = std::fs::remove_dir_all(folder);
    builder.create(folder)
}

fn last_lines(log: &Path) -> String {
    let text = std::fs::read(log).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let lines: Vec<_> = text.lines().collect();
    lines[lines.len().saturating_sub(10)..].join("\n")
}

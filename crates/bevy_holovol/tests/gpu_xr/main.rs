//! A headset that Monado simulates: sessions, pictures, and what may go wrong.
//!
//! Run through `scripts/xr-runtime` where Monado isn't installed. Without it the tests are ignored,
//! or fail when `HOLOVOL_REQUIRE_XR=1`.

mod allocations;
mod app;
mod depth;
mod hands;
mod pictures;
mod sessions;
mod sight;

use std::process::ExitCode;
use std::sync::Mutex;

use bevy_holovol::xr::{SimulatedHeadset, SimulationError};
use libtest_mimic::{Arguments, Failed, Trial};

type Test = (&'static str, fn());

/// The service, which a test may kill.
static SIMULATION: Mutex<Option<SimulatedHeadset>> = Mutex::new(None);

fn main() {
    let mut args = Arguments::from_args();
    // One runtime, one device.
    args.test_threads = Some(1);
    let missing = match (args.list, SimulatedHeadset::start(false)) {
        (true, _) => None,
        (_, Ok(simulation)) => {
            *SIMULATION.lock().expect("no panic") = Some(simulation);
            None
        }
        (_, Err(error)) => Some(error),
    };
    let is_required = std::env::var_os("HOLOVOL_REQUIRE_XR").is_some_and(|value| value == "1");
    let is_absent = matches!(missing, Some(SimulationError::NoMonado { .. }));
    let is_ignored = is_absent && !is_required;
    if let Some(error) = &missing {
        eprintln!("{error}");
    }
    let missing = missing.map(|error| error.to_string());
    let tests: Vec<Test> = [
        sessions::TESTS,
        pictures::TESTS,
        depth::TESTS,
        sight::TESTS,
        hands::TESTS,
    ]
    .concat();
    let trials = tests.into_iter().map(|(name, body)| {
        let missing = missing.clone();
        Trial::test(name, move || {
            if let Some(missing) = missing {
                return Err(Failed::from(missing));
            }
            body();
            Ok(())
        })
        .with_ignored_flag(is_ignored)
    });
    let conclusion = libtest_mimic::run(&args, trials.collect());
    drop(SIMULATION.lock().expect("no panic").take());
    leave(conclusion.exit_code());
}

/// Without what libraries do at a process's end: Bevy's workers may still be compiling, which Vulkan's
/// validation layer does not survive.
#[cfg(unix)]
#[expect(unsafe_code, reason = "a call to the C library")]
fn leave(code: ExitCode) -> ! {
    unsafe extern "C" {
        safe fn _exit(status: std::ffi::c_int) -> !;
    }
    _exit(i32::from(code != ExitCode::SUCCESS))
}

#[cfg(not(unix))]
fn leave(code: ExitCode) -> ! {
    std::process::exit(i32::from(code != ExitCode::SUCCESS))
}

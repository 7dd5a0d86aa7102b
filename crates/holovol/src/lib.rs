//! The `holovol` command: renders volumes as if they stood in the light of a room.
//!
//! `holovol render SCENE.json --out OUT.exr` is its main job; `holovol --help` tells the rest. Each
//! subcommand is a module here, [`cli`] says what they are asked, [`Exit`] what their exit codes
//! mean. Standard output holds results only (one line of JSON where a program may read them),
//! standard error everything for people.

mod backend;
mod bench;
pub mod cli;
mod compare;
mod convert;
mod demo;
mod failure;
mod info;
mod interrupt;
#[cfg(feature = "preview")]
mod kinds;
mod light;
mod live;
mod output;
mod picture;
#[cfg(feature = "preview")]
mod preview;
mod progress;
mod render;
mod render_live;
#[cfg(feature = "preview")]
mod room_camera;
mod thumbnail;
#[cfg(feature = "xr")]
mod xr;

pub use failure::{Exit, Failure};

use std::io::Write;
use std::process::ExitCode;

use clap::{CommandFactory, Parser};

use cli::{Cli, Command};

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("error: {failure}");
            failure.exit.into()
        }
    }
}

/// Does what a command line asks for.
///
/// # Errors
/// See [`Exit`] for the kinds of failure.
pub fn run(cli: Cli) -> Result<(), Failure> {
    match cli.command {
        Command::Render(args) => render::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Convert(args) => convert::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Light(args) => light::run(&args),
        Command::Stitch(args) => light::stitch::run(&args),
        Command::Calibrate(args) => light::stitch::calibrate(&args),
        #[cfg(feature = "preview")]
        Command::Preview(args) => preview::run(&args),
        #[cfg(feature = "xr")]
        Command::Xr(args) => xr::run(&args),
        Command::Bench(command) => bench::run(&command),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "holovol", &mut script);
            print_bytes(&script)
        }
    }
}

/// Writes a result to standard output.
fn print_bytes(bytes: &[u8]) -> Result<(), Failure> {
    let mut stdout = std::io::stdout().lock();
    let written = stdout.write_all(bytes).and_then(|()| stdout.flush());
    // A reader that has seen enough is no failure.
    if matches!(&written, Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe) {
        return Ok(());
    }
    written.map_err(|error| Failure::new(Exit::Output, format!("standard output: {error}")))
}

/// Writes a result to standard output as one line of JSON.
fn print_json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let mut line = serde_json::to_string(value)
        .map_err(|error| Failure::new(Exit::Internal, error.to_string()))?;
    line.push('\n');
    print_bytes(line.as_bytes())
}

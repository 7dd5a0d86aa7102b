//! `holovol demo`: a phantom in a room, both made here, to see that all works.

mod phantom;
mod room;
mod shapes;

use std::time::Instant;

use holovol_scene::{
    Background, CameraEntry, EnvironmentEntry, IntegratorEntry, OutputEntry, SceneFile, Sequence,
    ToneMapping, TransferFunctionEntry, VolumeEntry,
};

use crate::backend::{Device, Goal};
use crate::cli::{Backend, DemoArgs, DeviceArgs, EffortArgs};
use crate::progress::Bar;
use crate::{Exit, Failure, interrupt, output, picture, print_bytes};

/// Unless the user says otherwise tracing ends at the first of these.
const DEFAULT_SPP: u32 = 64;
const DEFAULT_SECONDS: f64 = 60.0;

pub(crate) fn run(args: &DemoArgs) -> Result<(), Failure> {
    output::check(&args.out, "png", "--out")?;
    let started = Instant::now();
    let device = open(&args.device)?;
    eprintln!("note: making a head phantom and a room, then tracing for up to a minute");
    let volume = phantom::volume()?;
    let file = scene(args.size);
    let sequence = Sequence::with_data(&file, volume, room::environment())?;
    let scene = sequence.frame(0)?;

    let bar = Bar::new("rendering");
    let goal = match args.effort {
        EffortArgs {
            spp: None,
            seconds: None,
        } => Goal {
            spp: DEFAULT_SPP,
            seconds: DEFAULT_SECONDS,
        },
        effort => effort.into(),
    };
    let traced = device.trace(&scene, 0, goal, &mut |part, spp| {
        bar.set(part, &format!("{spp} spp"));
    })?;
    drop(bar);
    let settings = file.output.unwrap_or_default();
    let picture = picture::develop(&traced.image, &settings, &scene.camera, &scene.environment);
    output::write_png(&picture, &args.out)?;

    let path = std::path::absolute(&args.out).unwrap_or_else(|_| args.out.clone());
    let text = format!(
        "{}\n{} × {} pixels, {} samples per pixel, traced in {:.1} s of {:.1} s on {}\n",
        path.display(),
        args.size,
        args.size,
        traced.spp,
        traced.seconds,
        started.elapsed().as_secs_f64(),
        device.adapter(),
    );
    print_bytes(text.as_bytes())?;
    if let Ok(command) = std::env::current_exe() {
        eprintln!(
            "note: the command is {}; --help tells what else it does",
            command.display()
        );
    }
    if interrupt::is_asked() {
        return Err(Failure::new(
            Exit::Interrupted,
            "stopped; the picture is as far as it got",
        ));
    }
    if traced.faults.is_empty() {
        Ok(())
    } else {
        Err(Failure::new(Exit::Inexact, traced.faults.join("; ")))
    }
}

/// Opens the device; without any adapter the demo goes on on the CPU.
fn open(args: &DeviceArgs) -> Result<Device, Failure> {
    match Device::open(args) {
        Err(failure) if failure.exit == Exit::NoAdapter && args.adapter.is_none() => {
            eprintln!("note: {failure}; going on with the slow CPU reference");
            Device::open(&DeviceArgs {
                backend: Backend::Reference,
                ..args.clone()
            })
        }
        opened => opened,
    }
}

/// Phantom and room, of the usual size.
#[cfg(feature = "preview")]
pub(crate) fn scene_in_memory() -> Result<holovol_scene::Scene, Failure> {
    let sequence = Sequence::with_data(&scene(512), phantom::volume()?, room::environment())?;
    Ok(sequence.frame(0)?)
}

/// The room alone.
#[cfg(feature = "preview")]
pub(crate) fn environment() -> holovol_light::EnvironmentMap {
    room::environment()
}

fn scene(size: u32) -> SceneFile {
    SceneFile {
        version: SceneFile::VERSION,
        volume: VolumeEntry {
            path: "phantom".into(),
            choice: None,
            window: Some([0.0, 1.0]),
            world_from_unit_cube: None,
        },
        transfer_function: TransferFunctionEntry {
            points: phantom::transfer_function(),
        },
        phase_g: 0.0,
        gradient_factor: 4.0,
        clip: Vec::new(),
        environment: EnvironmentEntry::from_path("room"),
        camera: CameraEntry {
            eye: [0.34, 0.07, 0.62],
            target: [0.0, -0.008, 0.0],
            up: [0.0, 1.0, 0.0],
            fov_y_deg: 23.0,
            width: size,
            height: size,
        },
        integrator: IntegratorEntry {
            max_scatters: Some(1),
        },
        stereo: None,
        animation: None,
        output: Some(OutputEntry {
            exposure_ev: None,
            tone_mapping: ToneMapping::Neutral,
            background: Background::Environment,
        }),
    }
}

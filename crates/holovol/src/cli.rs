//! What the command line may ask for.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;

const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  a mistake of holovol itself
  2  the command line makes no sense
  3  an input file is missing, damaged or says something impossible
  4  the output can't be written (found out before rendering)
  5  no graphics adapter fits
  6  the graphics device was lost, or has not enough memory
  7  the image was written, but one of the renderer's own checks failed

Examples:
  holovol demo
      renders a phantom that needs no file, to see that all works
  holovol info scan.nii.gz --thumbnail scan.png
      shows what is in a scan
  holovol render scene.json --out image.exr --png image.png --spp 256
      renders a scene to linear radiance and to a picture
  holovol compare image.exr reference.exr
      says how far an image is from a reference";

/// Renders scientific and medical volumes as if they stood in the light of a real room.
///
/// Results go to standard output, everything else to standard error.
#[derive(Debug, Parser)]
#[command(name = "holovol", version, max_term_width = 100, after_long_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Render a scene file to an OpenEXR image
    Render(RenderArgs),
    /// Measure how far one OpenEXR image is from another
    Compare(CompareArgs),
    /// Tell what is in a volume or a scene file
    Info(InfoArgs),
    /// Render a phantom that holovol makes itself: no file, GPU or display needed
    Demo(DemoArgs),
    /// Open a window on scans, scenes, transfer functions and light maps
    #[cfg(feature = "preview")]
    Preview(PreviewArgs),
    /// Measure speed and error on this machine
    #[command(subcommand)]
    Bench(BenchCommand),
    /// Print a completion script for a shell
    #[command(after_long_help = "\
Example, for bash:
  holovol completions bash > ~/.local/share/bash-completion/completions/holovol")]
    Completions {
        /// The shell.
        shell: Shell,
    },
}

/// Where paths are traced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Backend {
    /// On a graphics adapter, or on software Vulkan where there is none
    #[default]
    Gpu,
    /// On the CPU in double precision: slow, and simple enough to be trusted
    Reference,
}

/// How values between voxel centres are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Interpolation {
    /// In 32-bit float: unbiased
    #[default]
    Exact,
    /// By the texture unit, with 8-bit weights on most GPUs: faster, slightly biased
    Hardware,
}

/// `holovol preview`
#[cfg(feature = "preview")]
#[derive(Debug, Args)]
#[command(after_long_help = "\
Without a file it shows a head phantom in a living room, both made by holovol itself. Files and
folders can also be dropped on the window. The panel (Tab) lists the keys.

Examples:
  holovol preview
  holovol preview scan.nii.gz
  holovol preview scan.nii.gz bone.tf.json room.hdr
  holovol preview scene.json")]
pub struct PreviewArgs {
    /// Scans, folders of DICOM files, scenes, *.tf.json, *.hdr, *.exr
    #[arg(value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Size of the window, logical pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x800", value_parser = window_size)]
    pub size: [u32; 2],
    /// Close the window after as many frames
    #[arg(long, value_name = "N", hide = true)]
    pub frames: Option<u32>,
}

#[cfg(feature = "preview")]
fn window_size(text: &str) -> Result<[u32; 2], String> {
    let parse = |n: &str| n.parse().ok().filter(|n| (64..=16384).contains(n));
    text.split_once('x')
        .and_then(|(width, height)| Some([parse(width)?, parse(height)?]))
        .ok_or_else(|| "expected two numbers from 64 to 16384, such as 1280x800".to_owned())
}

/// `holovol render`
#[derive(Debug, Args)]
#[command(after_long_help = "\
The image is linear radiance (Rec. 709), premultiplied, with opacity, as 32-bit float. It is
unbiased: twice as many samples make the error 1/√2 of what it was.

A scene with `stereo` gives OUT.left.exr and OUT.right.exr, one with `animation` OUT.0000.exr,
OUT.0001.exr and so on, one with both OUT.left.0000.exr and so on; likewise for --png.

On standard output comes one line of JSON: adapter, driver, backend, interpolation, spp, seconds
(tracing only), load_seconds (reading, uploading, compiling), samples_per_second (pixels × spp /
seconds), mean_rgb, mean_opacity, seed, width, height, images.

Examples:
  holovol render scene.json --out image.exr
  holovol render scene.json --out image.exr --png image.png --seconds 10
  holovol render scene.json --out truth.exr --backend reference --spp 1024 --seed 7
  holovol render scene.json --out small.exr --width 320 --adapter llvmpipe")]
pub struct RenderArgs {
    /// The scene file (JSON)
    #[arg(value_name = "SCENE.json")]
    pub scene: PathBuf,
    /// The image to write
    #[arg(long, value_name = "OUT.exr")]
    pub out: PathBuf,
    /// Also write a picture for display, made as the scene's `output` says
    ///
    /// Without `output`, the 99th percentile of the volume's luminance becomes white, tones are
    /// mapped by the Khronos PBR Neutral curve, and the background is black.
    #[arg(long, value_name = "OUT.png")]
    pub png: Option<PathBuf>,
    /// How long to trace.
    #[command(flatten)]
    pub effort: EffortArgs,
    /// Images of different seeds have independent noise; the same seed gives the same image
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// What to trace on.
    #[command(flatten)]
    pub device: DeviceArgs,
    /// Pixels across, instead of the scene's; the height follows unless it is given too
    #[arg(long, value_name = "PIXELS")]
    pub width: Option<u32>,
    /// Pixels down, instead of the scene's; the width follows unless it is given too
    #[arg(long, value_name = "PIXELS")]
    pub height: Option<u32>,
    /// Number of frames over the scene's animation, instead of the scene's own
    #[arg(long, value_name = "N")]
    pub frames: Option<u32>,
}

/// How long to trace.
#[derive(Clone, Copy, Debug, Args)]
#[group(multiple = false)]
pub struct EffortArgs {
    /// Samples per pixel; 64 unless --seconds is given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub spp: Option<u32>,
    /// Trace each image for this long, loading and compiling not counted
    #[arg(long, value_name = "S", value_parser = parse_seconds, allow_negative_numbers = true)]
    pub seconds: Option<f64>,
}

/// What to trace on.
#[derive(Clone, Debug, Args)]
pub struct DeviceArgs {
    /// What traces the paths
    #[arg(long, value_enum, default_value_t)]
    pub backend: Backend,
    /// Use the graphics adapter whose name or driver contains this
    #[arg(long, value_name = "NAME")]
    pub adapter: Option<String>,
    /// How values between voxels are found
    #[arg(long, value_enum, default_value_t)]
    pub interpolation: Interpolation,
}

/// `holovol compare`
#[derive(Debug, Args)]
#[command(after_long_help = "\
On standard output comes one line of JSON: relmse, mse and rmse of premultiplied linear radiance
(0 if equal); flip (0 if equal), ssim (1 if equal) and psnr (dB; null if equal) of what a person
sees: over black, the reference's 99th luminance percentile mapped to 1, 8-bit sRGB; and the means
of both images (R, G, B, opacity).

Example:
  holovol compare image.exr reference.exr")]
pub struct CompareArgs {
    /// The image to judge
    #[arg(value_name = "IMAGE.exr")]
    pub image: PathBuf,
    /// What it should be
    #[arg(value_name = "REFERENCE.exr")]
    pub reference: PathBuf,
}

/// `holovol info`
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  holovol info scan.nii.gz
  holovol info scan.nrrd --json
  holovol info scene.json --thumbnail scene.png")]
pub struct InfoArgs {
    /// A volume, or a scene file
    pub file: PathBuf,
    /// Print one line of JSON instead of text
    #[arg(long)]
    pub json: bool,
    /// Also write a picture: middle slices above, projections below; seen from the front (+z),
    /// from the side (+x) and from above (+y)
    #[arg(long, value_name = "OUT.png")]
    pub thumbnail: Option<PathBuf>,
}

/// `holovol demo`
#[derive(Debug, Args)]
#[command(after_long_help = "\
Unless --spp or --seconds is given, tracing ends after 64 samples per pixel or a minute.

Example:
  holovol demo --out demo.png --size 1024 --spp 128")]
pub struct DemoArgs {
    /// The picture to write
    #[arg(long, value_name = "OUT.png", default_value = "holovol-demo.png")]
    pub out: PathBuf,
    /// Width and height of the picture in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 512, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub size: u32,
    /// How long to trace.
    #[command(flatten)]
    pub effort: EffortArgs,
    /// What to trace on.
    #[command(flatten)]
    pub device: DeviceArgs,
}

/// `holovol bench`
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// The tracer against variants of itself, taking turns
    Trace(BenchTraceArgs),
}

/// `holovol bench trace`
#[derive(Debug, Args)]
#[command(after_long_help = "\
Measures, for each scene: lookups and cells per sample; lookups per second, as a share of what a
kernel that does nothing else reaches; time, error and efficiency against one majorant cell,
hardware interpolation, plain random numbers, and one lit collision per flight. Then the cost of
the first scene's field on 64³ to 512³ voxels. On standard output comes one line of JSON.

Example:
  holovol bench trace iguana_studio.json heptane_linear.json --report trace.md")]
pub struct BenchTraceArgs {
    /// Scene files
    #[arg(value_name = "SCENE.json", required = true)]
    pub scenes: Vec<PathBuf>,
    /// Rounds; each runs everything once
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(2..))]
    pub rounds: u32,
    /// Samples per pixel of each run
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    pub spp: u32,
    /// Leave out the measurement over volume sizes
    #[arg(long)]
    pub no_sizes: bool,
    /// Also write the results as a Markdown page
    #[arg(long, value_name = "OUT.md")]
    pub report: Option<PathBuf>,
    /// Use the graphics adapter whose name or driver contains this
    #[arg(long, value_name = "NAME")]
    pub adapter: Option<String>,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    /// A week.
    const LONGEST: f64 = 7.0 * 86400.0;
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds <= LONGEST => Ok(seconds),
        _ => Err(format!("expected seconds, above 0 and at most {LONGEST}")),
    }
}

//! What `holovol bench` may be asked for.

use std::path::PathBuf;

use clap::builder::NonEmptyStringValueParser;
use clap::{Args, Subcommand};

/// `holovol bench`
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// The tracer against variants of itself, taking turns
    Trace(BenchTraceArgs),
    /// The estimation of light against panoramas whose light is known
    Light(BenchLightArgs),
    /// The denoisers against converged images and Open Image Denoise
    Denoise(BenchDenoiseArgs),
    /// Two eyes against one, at equal error
    Stereo(BenchStereoArgs),
}

/// `holovol bench light`
#[derive(Debug, Args)]
#[command(after_long_help = "\
Each panorama is turned 4 times and exposed so that 0.5, 2 and 8 % of it clip; the prior is fitted
without the panorama that is measured. Errors: irradiance over 512 normals, unscaled, relative to
the truth (RMSE); log₂ of mean irradiance over the true one (EV bias); angle between the dominant
lights. On standard output comes one line of JSON.

Example:
  holovol bench light *.hdr --report light.md")]
pub struct BenchLightArgs {
    /// HDR panoramas, at least 3
    #[arg(value_name = "PANO.hdr", required = true)]
    pub panoramas: Vec<PathBuf>,
    /// Turns of each panorama
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub rotations: u32,
    /// First of the 64 seeds that rooms and days at random are made from
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub imagined_seed: u32,
    /// Also write the results as a Markdown page
    #[arg(long, value_name = "OUT.md")]
    pub report: Option<PathBuf>,
}

/// `holovol bench denoise`
#[derive(Debug, Args)]
#[command(after_long_help = "\
For each scene, seen by two eyes: relMSE and FLIP after 1, 2, 8 and 32 frames at rest, with a slow
and a fast head, a turning volume and a turning light; ghosts after a lamp and a transfer function
have switched; how far the eyes are apart, contrast at the scale of a pixel, flicker, places that
come into view; time per stage. On standard output comes one line of JSON.

Example:
  holovol bench denoise iguana_studio.json --oidn oidnDenoise --report denoise.md")]
pub struct BenchDenoiseArgs {
    /// Scene files
    #[arg(value_name = "SCENE.json", required = true)]
    pub scenes: Vec<PathBuf>,
    /// Samples per pixel, eye and frame
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..))]
    pub spp: u32,
    /// Samples per pixel of each of the reference's two halves
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..))]
    pub reference_spp: u32,
    /// Width and height in pixels, instead of the scene's
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub size: Option<u32>,
    /// Only cases whose name contains this, or `switch`; may be repeated
    #[arg(long = "case", value_name = "CASE")]
    pub cases: Vec<String>,
    /// Seed of the noisy frames
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Measure flicker in motion too, which takes another reference per case
    #[arg(long)]
    pub flicker: bool,
    /// The program of Open Image Denoise, to compare with
    #[arg(long, value_name = "oidnDenoise")]
    pub oidn: Option<PathBuf>,
    /// Write the left eye's images into this folder
    #[arg(long, value_name = "FOLDER")]
    pub pictures: Option<PathBuf>,
    /// Also write the results as Markdown tables
    #[arg(long, value_name = "OUT.md")]
    pub report: Option<PathBuf>,
    /// Use the graphics adapter whose name or driver contains this
    #[arg(long, value_name = "NAME")]
    pub adapter: Option<String>,
}

/// `holovol bench stereo`
#[derive(Debug, Args)]
#[command(after_long_help = "\
The left eye's error in the last of some frames with a slow head (5 mm a frame), denoised alone and
together with the right one, over samples per pixel; and what frames cost. From both curves: how
many times the cost of one eye is that of two at equal error, with two eyes of 2 samples, and with
one eye of 2 samples. On standard output comes one line of JSON.

Example:
  holovol bench stereo iguana_studio.json --size 128 --report stereo.md")]
pub struct BenchStereoArgs {
    /// Scene files
    #[arg(value_name = "SCENE.json", required = true)]
    pub scenes: Vec<PathBuf>,
    /// Frames of a run
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(2..))]
    pub frames: u32,
    /// Runs whose errors are averaged
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub rounds: u32,
    /// Samples per pixel of each of the reference's two halves
    #[arg(long, value_name = "N", default_value_t = 96, value_parser = clap::value_parser!(u32).range(1..))]
    pub reference_spp: u32,
    /// Width and height in pixels, instead of the scene's
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub size: Option<u32>,
    /// The head is at rest
    #[arg(long)]
    pub rest: bool,
    /// Also write the results as a Markdown table
    #[arg(long, value_name = "OUT.md")]
    pub report: Option<PathBuf>,
    /// Use the graphics adapter whose name or driver contains this
    #[arg(long, value_name = "NAME")]
    pub adapter: Option<String>,
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
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    pub adapter: Option<String>,
}

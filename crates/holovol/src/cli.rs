//! What the command line may ask for.

mod bench;
#[cfg(feature = "preview")]
mod window;

use std::path::PathBuf;
use std::str::FromStr;

use clap::builder::NonEmptyStringValueParser;
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use holovol_volume::{Endian, NumberType, RawLayout, ReadOptions};

pub use self::bench::{
    BenchCommand, BenchDenoiseArgs, BenchLightArgs, BenchStereoArgs, BenchTraceArgs,
};
#[cfg(feature = "preview")]
pub use self::window::PreviewArgs;
#[cfg(feature = "xr")]
pub use self::window::{XrArgs, XrBlend};

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
  130  stopped by Ctrl-C; what was traced by then is written

Examples:
  holovol demo
      renders a phantom that needs no file, to see that all works
  holovol info scan.nii.gz --thumbnail scan.png
      shows what is in a scan
  holovol convert dicom_folder scan.nrrd
      writes a scan in another format, exactly
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
    /// Write a volume in another format, exactly
    Convert(ConvertArgs),
    /// Render a phantom that holovol makes itself: no file, GPU or display needed
    Demo(DemoArgs),
    /// Estimate HDR light from LDR panoramas
    Light(LightArgs),
    /// Join the pictures of a dual-fisheye camera to one panorama
    Stitch(StitchArgs),
    /// Find a camera's lens parameters and its response
    Calibrate(CalibrateArgs),
    /// Open a window on scans, scenes, transfer functions and light maps
    #[cfg(feature = "preview")]
    Preview(PreviewArgs),
    /// Show scans in a headset, in the user's own room
    #[cfg(feature = "xr")]
    Xr(XrArgs),
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

/// `holovol render`
#[derive(Debug, Args)]
#[command(after_long_help = "\
The image is linear radiance (Rec. 709), premultiplied, with opacity, as 32-bit float. It is
unbiased: twice as many samples make the error 1/√2 of what it was.

A scene with `stereo` gives OUT.left.exr and OUT.right.exr, one with `animation` OUT.0000.exr,
OUT.0001.exr and so on, one with both OUT.left.0000.exr and so on; likewise for --png.

On standard output comes one line of JSON: adapter, driver, backend, interpolation, spp, seconds
(tracing only), load_seconds (reading, uploading, compiling), samples_per_second (pixels × spp /
seconds), mean_rgb, mean_opacity, seed, width, height, images, files (the images written).

Ctrl-C while tracing writes the samples made so far; a second one ends at once.
docs/scenes.md describes scene files key by key.

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
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
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
    /// Play the frames through the real-time pipeline, and write the last
    ///
    /// Each frame has --spp-per-frame samples and what is kept of those before it. A scene without
    /// `animation` rests for --frames frames. The line of JSON has seconds_per_frame by stage.
    #[arg(long, value_enum, conflicts_with_all = ["spp", "seconds"])]
    pub denoise: Option<Denoise>,
    /// Samples per pixel, eye and frame, with --denoise
    #[arg(long, value_name = "N", default_value_t = 2, requires = "denoise", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub spp_per_frame: u32,
    /// Write every frame, not only the last, with --denoise
    #[arg(long, requires = "denoise")]
    pub all_frames: bool,
}

/// How noise is taken out of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Denoise {
    /// Not at all: each frame as it was traced
    Off,
    /// As Cheng et al. 2023
    Paper,
    /// By this project's own denoiser
    Holovol,
}

/// How long to trace.
#[derive(Clone, Copy, Debug, Args)]
#[group(multiple = false)]
pub struct EffortArgs {
    /// Samples per pixel; 64 unless --seconds is given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), allow_negative_numbers = true)]
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
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    pub adapter: Option<String>,
    /// How values between voxels are found
    #[arg(long, value_enum, default_value_t)]
    pub interpolation: Interpolation,
    /// Fail rather than reduce a volume that the adapter can't hold whole
    #[arg(long)]
    pub exact_volume: bool,
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
  holovol info dicom_folder
  holovol info dicom_folder --choice 2
  holovol info field.raw --raw-dims 256,256,120 --raw-type u16 --raw-spacing 0.7,0.7,1.5
  holovol info scene.json --thumbnail scene.png")]
pub struct InfoArgs {
    /// A volume, a folder or ZIP archive of DICOM files, or a scene file
    pub file: PathBuf,
    /// How to read it.
    #[command(flatten)]
    pub input: InputArgs,
    /// Print one line of JSON instead of text
    #[arg(long)]
    pub json: bool,
    /// Also write a picture: middle slices above, projections below; seen from the front (+z),
    /// from the side (+x) and from above (+y)
    #[arg(long, value_name = "OUT.png")]
    pub thumbnail: Option<PathBuf>,
}

/// `holovol convert`
#[derive(Debug, Args)]
#[command(after_long_help = "\
The name of OUT says the format: .nrrd, .nii, .nii.gz or .raw (with a sidecar .raw.json). Voxels,
scaling, spacing and orientation come out exactly, or the command refuses. Names and identifiers of
patients are never read, so that none can get into OUT.

Examples:
  holovol convert dicom_folder scan.nrrd
  holovol convert dicom.zip scan.nii.gz --choice 2
  holovol convert smoke.vdb smoke.raw --choice density")]
pub struct ConvertArgs {
    /// A volume, or a folder or ZIP archive of DICOM files
    #[arg(value_name = "IN")]
    pub file: PathBuf,
    /// The file to write: .nrrd, .nii, .nii.gz or .raw
    #[arg(value_name = "OUT")]
    pub out: PathBuf,
    /// How to read it.
    #[command(flatten)]
    pub input: InputArgs,
    /// Write what was rounded, interpolated or replaced when it was read, and leave out what OUT
    /// can't hold
    #[arg(long)]
    pub lossy: bool,
}

/// Three numbers along x, y, z, with commas between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triple<T>(pub [T; 3]);

impl<T: FromStr> FromStr for Triple<T> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<T>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        let three = numbers.and_then(|numbers| <[T; 3]>::try_from(numbers).ok());
        three
            .map(Self)
            .ok_or_else(|| "expected three numbers such as 256,256,120".into())
    }
}

/// How to read a volume.
#[derive(Clone, Debug, Default, Args)]
pub struct InputArgs {
    /// Which of several series, grids, channels or volumes: a number from 1, or a name
    #[arg(long, value_name = "N|NAME")]
    pub choice: Option<String>,
    /// Interpolate the slices that a DICOM series lacks
    #[arg(long)]
    pub fill_missing_slices: bool,
    /// Voxels along x, y, z of a file without a header
    #[arg(long, value_name = "X,Y,Z", requires = "raw_type")]
    pub raw_dims: Option<Triple<u32>>,
    /// Type of its numbers: u8, i8, u16, i16, u32, i32, u64, i64, f32 or f64
    #[arg(long, value_name = "TYPE", requires = "raw_dims")]
    pub raw_type: Option<NumberType>,
    /// Its spacing along x, y, z in mm; 1 if left out
    #[arg(long, value_name = "X,Y,Z", requires = "raw_dims")]
    pub raw_spacing: Option<Triple<f64>>,
    /// Bytes before its first voxel
    #[arg(long, value_name = "BYTES", default_value_t = 0, requires = "raw_dims")]
    pub raw_offset: u64,
    /// Its numbers begin with their highest byte
    #[arg(long, requires = "raw_dims")]
    pub raw_big_endian: bool,
}

impl InputArgs {
    /// The same for the reader.
    pub fn options(&self) -> ReadOptions {
        let mut options = ReadOptions::default().with_fill_missing_slices(self.fill_missing_slices);
        if let Some(choice) = &self.choice {
            options = options.with_choice(choice);
        }
        if let (Some(Triple(dims)), Some(number)) = (self.raw_dims, self.raw_type) {
            let mut layout = RawLayout::new(dims, number);
            layout.offset = self.raw_offset;
            layout.spacing_mm = self.raw_spacing.map(|Triple(spacing)| spacing);
            if self.raw_big_endian {
                layout.endian = Endian::Big;
            }
            options = options.with_raw(layout);
        }
        options
    }
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

/// `holovol light`
#[derive(Debug, Args)]
#[command(after_long_help = "\
Radiance is in units in which 1 is where the first frame clips; its orientation is kept. Frames
after the first say how much less light they let through: dark.png@-6 has 1/64 of it. A picture
with radiance above 1 (HDR or EXR) is HDR already: it is given alone, and passed through.

Evidence that contradicts the rest is left out, or trusted less; notes and sigma_ev say so.

On standard output comes one line of JSON, which --report writes too: rung (which evidence was
used), sigma_ev (one standard deviation of all light, in EV), ceiling (radiance at which the
darkest frame clips), clipped (share of the sphere), sky, lights (class, direction, solid_angle in
sr, intensity: irradiance facing it, radiance, sigma_ev, disc), sh9 (spherical harmonics to order
2, RGB), seconds (of the estimate), notes.

Examples:
  holovol light --ldr room.jpg --out room.exr
  holovol light --ldr room.jpg --ldr dark.jpg@-6 --lux 2.1 --out room.exr --preview lights.png")]
pub struct LightArgs {
    /// A panorama (PNG, JPEG, HDR, EXR), with @EV if it is darker than the first
    #[arg(long, value_name = "PANO[@EV]", required = true)]
    pub ldr: Vec<String>,
    /// Luminous irradiance from above, in units of the first frame: lux over the luminance
    /// (cd/m²) at which it clips
    #[arg(long, value_name = "E", allow_negative_numbers = true)]
    pub lux: Option<f64>,
    /// Irradiance of a diffuse probe: JSON list of {"normal": [x, y, z], "irradiance": [r, g, b]}
    #[arg(long, value_name = "PROBE.json")]
    pub probe: Option<PathBuf>,
    /// Camera response: srgb, gamma:NUMBER, or a response or calibration file
    #[arg(long, value_name = "CRF", default_value = "srgb")]
    pub crf: String,
    /// What is believed of clipped lights, in place of the built-in prior: a prior as `holovol
    /// bench light` prints it for panoramas of your own
    #[arg(long, value_name = "PRIOR.json")]
    pub prior: Option<PathBuf>,
    /// The radiance map to write: .exr or .hdr
    #[arg(long, value_name = "OUT.exr")]
    pub out: PathBuf,
    /// Also write the report to a file
    #[arg(long, value_name = "OUT.json")]
    pub report: Option<PathBuf>,
    /// Also write the first frame with its lights marked
    #[arg(long, value_name = "OUT.png")]
    pub preview: Option<PathBuf>,
}

/// `holovol stitch`
#[derive(Debug, Args)]
#[command(after_long_help = "\
The panorama looks ahead (−z) at its centre. Both lenses are brought to one brightness where they
overlap. What neither lens sees is black; its share of the sphere is noted, and on standard output
it is unseen.

Example:
  holovol stitch front.png back.png --calibration camera.json --out pano.png")]
pub struct StitchArgs {
    /// The front lens's picture
    #[arg(value_name = "A")]
    pub a: PathBuf,
    /// The back lens's picture
    #[arg(value_name = "B")]
    pub b: PathBuf,
    /// The camera's calibration file; without it, equidistant lenses back to back are assumed
    #[arg(long, value_name = "CAMERA.json")]
    pub calibration: Option<PathBuf>,
    /// Field of view of each lens in degrees, where there is no calibration
    #[arg(long, value_name = "DEGREES", default_value_t = 195.0, value_parser = parse_fov)]
    pub fov: f64,
    /// The panorama to write
    #[arg(long, value_name = "OUT.png")]
    pub out: PathBuf,
    /// Width of the panorama; its height is half of it
    #[arg(long, value_name = "PIXELS", default_value_t = 2048, value_parser = clap::value_parser!(u32).range(2..=16384))]
    pub width: u32,
}

/// `holovol calibrate`
#[derive(Debug, Args)]
#[command(after_long_help = "\
From one pair of pictures: rotation, centres and focal length, refined until both lenses agree in
their overlap; where nothing in the overlap tells the pose, nothing is written. From an exposure
series of a scene that stands still: the camera's response. With --series and no lenses (--pair,
--start, --insta360), the file is a response, which --crf reads.

Examples:
  holovol calibrate --pair front.png back.png --fov 195 --out camera.json
  holovol calibrate --series a.png@0 b.png@-2 c.png@-4 --out response.json
  holovol calibrate --start camera.json --series a.png@0 b.png@-2 c.png@-4 --out camera.json")]
pub struct CalibrateArgs {
    /// Pictures of the front and the back lens, taken at once
    #[arg(long, value_names = ["A", "B"], num_args = 2)]
    pub pair: Vec<PathBuf>,
    /// A calibration file to start from
    #[arg(long, value_name = "CAMERA.json")]
    pub start: Option<PathBuf>,
    /// An Insta360 offset string to start from
    #[arg(long, value_name = "OFFSET")]
    pub insta360: Option<String>,
    /// Field of view of each lens in degrees, where nothing else is known
    #[arg(long, value_name = "DEGREES", default_value_t = 195.0, value_parser = parse_fov)]
    pub fov: f64,
    /// An exposure series for the response, as PNG: JPEG's coding bends the fit
    #[arg(long, value_name = "PICTURE@EV", num_args = 1..)]
    pub series: Vec<String>,
    /// Camera response, if known: srgb, gamma:NUMBER, or a file
    #[arg(long, value_name = "CRF")]
    pub crf: Option<String>,
    /// The calibration (or response) file to write
    #[arg(long, value_name = "OUT.json")]
    pub out: PathBuf,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    /// A week.
    const LONGEST: f64 = 7.0 * 86400.0;
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds <= LONGEST => Ok(seconds),
        _ => Err(format!("expected seconds, above 0 and at most {LONGEST}")),
    }
}

fn parse_fov(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(fov) if fov > 90.0 && fov <= 300.0 => Ok(fov),
        _ => Err("expected degrees, above 90 and at most 300".into()),
    }
}

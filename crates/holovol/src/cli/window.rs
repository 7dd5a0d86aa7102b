//! What `holovol preview` and `holovol xr` may be asked for.

use std::path::PathBuf;

use clap::Args;
#[cfg(feature = "xr")]
use clap::ValueEnum;

/// `holovol preview`
#[derive(Clone, Debug, Args)]
#[command(after_long_help = "\
Without a file it shows a head phantom in a living room, both made by holovol itself. Files and
folders can also be dropped on the window. The panel (Tab) lists the keys.

Examples:
  holovol preview
  holovol preview scan.nii.gz
  holovol preview scan.nii.gz bone.tf.json room.hdr
  holovol preview scan.nii.gz --camera virtual:room.hdr
  holovol preview scene.json")]
pub struct PreviewArgs {
    /// Scans, folders of DICOM files, scenes, *.tf.json, panoramas (*.hdr, *.exr, *.png, *.jpg)
    #[arg(value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Light by a 360° camera: a panorama or a folder of them, played again and again; `virtual` or
    /// `virtual:ROOM.hdr` is one that isn't there, in a room that is a map
    #[arg(long, value_name = "URI")]
    pub camera: Option<String>,
    /// Size of the window, logical pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x800", value_parser = window_size)]
    pub size: [u32; 2],
    /// Close the window after as many frames
    #[arg(long, value_name = "N", hide = true)]
    pub frames: Option<u32>,
    /// Take over from a window whose graphics device was lost
    #[arg(long, value_name = "FILE", hide = true)]
    pub restore: Option<PathBuf>,
}

/// `holovol xr`
#[cfg(feature = "xr")]
#[derive(Debug, Args)]
#[command(after_long_help = "\
Takes any headset whose runtime speaks OpenXR and Vulkan: SteamVR, WiVRn, Monado, Quest Link. Where
there is a display, the preview's window stands beside it. See docs/headsets.md.

Examples:
  holovol xr
  holovol xr scan.nii.gz room.hdr
  holovol xr scan.nii.gz --camera virtual:room.hdr
  holovol xr --simulate --out pictures/xr     # no headset needed: writes what both eyes see")]
pub struct XrArgs {
    /// Scans, folders of DICOM files, scenes, *.tf.json, panoramas (*.hdr, *.exr, *.png, *.jpg)
    #[arg(value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Light by a 360° camera: a panorama or a folder of them, played again and again; `virtual` or
    /// `virtual:ROOM.hdr` is one that isn't there, in a room that is a map
    #[arg(long, value_name = "URI")]
    pub camera: Option<String>,
    /// How the camera is turned against the headset's space, degrees about the vertical
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub camera_turn: f32,
    /// Open the panel in the room at once
    #[arg(long)]
    pub panel: bool,
    /// Play recorded hands (lines of JSON) instead of the headset's
    #[arg(long, value_name = "FILE")]
    pub hands: Option<PathBuf>,
    /// Start Monado with a headset that moves by itself; without a display, writes pictures
    #[arg(long)]
    pub simulate: bool,
    /// Write PREFIX.left.png and PREFIX.right.png, then end
    #[arg(long, value_name = "PREFIX")]
    pub out: Option<PathBuf>,
    /// Open the preview's window if there is no headset
    #[arg(long)]
    pub window: bool,
    /// Open no window beside the headset
    #[arg(long, conflicts_with = "window")]
    pub no_window: bool,
    /// Samples per pixel and frame
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub samples: u32,
    /// Pixels drawn per pixel that the runtime recommends, along each axis, 0.1 to 8
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub resolution: f32,
    /// Draw as for a headset that shows the room in this way, whatever it does
    #[arg(long, value_name = "HOW", hide = true)]
    pub blend: Option<XrBlend>,
    /// Frames before the end, or before the pictures
    #[arg(long, value_name = "N", hide = true)]
    pub frames: Option<u32>,
}

/// How a headset shows the room.
#[cfg(feature = "xr")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum XrBlend {
    /// Behind what is drawn
    Alpha,
    /// Added to what is drawn
    Additive,
    /// Not at all
    Opaque,
}

fn window_size(text: &str) -> Result<[u32; 2], String> {
    let parse = |n: &str| n.parse().ok().filter(|n| (64..=16384).contains(n));
    text.split_once('x')
        .and_then(|(width, height)| Some([parse(width)?, parse(height)?]))
        .ok_or_else(|| "expected two numbers from 64 to 16384, such as 1280x800".to_owned())
}

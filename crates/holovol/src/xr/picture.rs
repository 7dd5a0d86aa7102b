//! What both eyes were given, as PNGs.

use std::path::{Path, PathBuf};

use bevy::prelude::*;
use bevy::render::render_resource::TextureFormat;
use bevy_holovol::VolumeStatistics;
use bevy_holovol::prelude::LiveLight;
use bevy_holovol::xr::{CapturedFrame, EyeCapture, HeadsetBlend, HeadsetRequest, HeadsetStatus};
use image::{DynamicImage, RgbaImage};

use crate::preview::Refused;
use crate::preview::open::Opening;

/// Pictures that are still to be taken.
#[derive(Resource)]
pub(super) struct Wanted {
    prefix: PathBuf,
    /// Frames to wait for once the volume is seen.
    frames: u32,
    is_requested: bool,
}

impl Wanted {
    pub(super) fn new(prefix: PathBuf, frames: u32) -> Self {
        Self {
            prefix,
            frames,
            is_requested: false,
        }
    }
}

/// Takes them when everything is seen, and ends the session.
#[expect(clippy::too_many_arguments, reason = "all that has to be ready")]
pub(super) fn take(
    mut commands: Commands,
    wanted: Option<ResMut<Wanted>>,
    statistics: Res<VolumeStatistics>,
    opening: Res<Opening>,
    live: Option<Res<LiveLight>>,
    status: Res<HeadsetStatus>,
    capture: Res<EyeCapture>,
    refused: Res<Refused>,
    mut requests: MessageWriter<HeadsetRequest>,
) {
    let Some(mut wanted) = wanted else {
        return;
    };
    let statistics = statistics.get();
    if !wanted.is_requested {
        let is_lit = live.is_none_or(|live| live.uploads > 0);
        let is_traced = statistics.dispatches > 0 && !statistics.is_waiting;
        if is_traced && is_lit && status.is_tracked && !opening.is_busy() {
            wanted.frames = wanted.frames.saturating_sub(1);
        }
        if wanted.frames == 0 {
            wanted.is_requested = true;
            capture.request();
        }
        return;
    }
    let Some(frame) = capture.take() else {
        return;
    };
    match write(&wanted.prefix, &frame, status.blend) {
        Ok(paths) => {
            for path in paths {
                println!("{}", path.display());
            }
        }
        // The program ends with it.
        Err(error) => {
            if let Ok(mut refused) = refused.0.lock() {
                refused.get_or_insert(error);
            }
        }
    }
    commands.remove_resource::<Wanted>();
    requests.write(HeadsetRequest::Stop);
}

fn write(
    prefix: &Path,
    frame: &CapturedFrame,
    blend: HeadsetBlend,
) -> Result<[PathBuf; 2], String> {
    let [width, height] = frame.size;
    let mut paths = ["left", "right"].map(|eye| {
        let mut name = prefix.as_os_str().to_owned();
        name.push(format!(".{eye}.png"));
        PathBuf::from(name)
    });
    for (path, pixels) in paths.iter_mut().zip(&frame.pixels) {
        let mut pixels = pixels.clone();
        match frame.format.remove_srgb_suffix() {
            TextureFormat::Rgba8Unorm => {}
            TextureFormat::Bgra8Unorm => pixels.chunks_exact_mut(4).for_each(|p| p.swap(0, 2)),
            other => return Err(format!("{other:?} makes no PNG")),
        }
        let picture = RgbaImage::from_raw(width, height, pixels)
            .ok_or_else(|| format!("{width} × {height} pixels make no PNG"))?;
        let picture = DynamicImage::from(picture);
        let picture = if blend == HeadsetBlend::Alpha {
            picture
        } else {
            // Opacity says nothing.
            picture.to_rgb8().into()
        };
        picture
            .save(&*path)
            .map_err(|error| format!("{}: {error}", path.display()))?;
    }
    Ok(paths)
}

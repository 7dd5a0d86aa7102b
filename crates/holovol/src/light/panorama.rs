//! A panorama of any kind as light.

use std::path::Path;

use holovol_light::EnvironmentMap;
use holovol_light::estimate::{Estimator, Evidence, Exposure, Prior};
use holovol_light::response::Response;

use super::input;
use crate::Failure;

/// Light from a file.
pub(crate) struct Panorama {
    pub(crate) map: EnvironmentMap,
    /// What its user should know.
    pub(crate) notes: Vec<String>,
}

/// Radiance of `.hdr` and `.exr` as it is, or estimated from a picture with the curve of sRGB.
///
/// # Errors
/// If the file can't be read.
pub(crate) fn panorama(path: &Path) -> Result<Panorama, Failure> {
    let picture = input::linear(path, &Response::Srgb)?;
    let (width, height) = (picture.width, picture.height);
    let mut notes = picture.notes;
    if width != 2 * height {
        notes.push(format!(
            "{width} × {height} pixels is not 2 : 1; taken for the whole sphere, stretched"
        ));
    }
    if picture.is_linear {
        let map = EnvironmentMap::new(width, height, picture.texels);
        return Ok(Panorama { map, notes });
    }
    let mut estimator = Estimator::new(width, height, Prior::default());
    estimator.estimate(&Evidence {
        frames: &[Exposure {
            ev: 0.0,
            radiance: &picture.texels,
        }],
        meter: None,
        probe: None,
    });
    let mut texels = Vec::new();
    estimator.write_map(&mut texels);
    notes.push(format!(
        "the light beyond white is estimated from this one picture, to about ± {:.1} stops",
        estimator.sigma_ev().hypot(picture.unseen_sigma_ev)
    ));
    let map = EnvironmentMap::new(width, height, texels);
    Ok(Panorama { map, notes })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(map: &EnvironmentMap) -> f64 {
        let sum: f64 = map.texels().iter().flatten().map(|&c| f64::from(c)).sum();
        sum / (3 * map.texels().len()) as f64
    }

    #[test]
    fn a_picture_gets_the_light_that_it_clips() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.png");
        // A grey room with a lamp that is only white.
        let pixel = |x: u32, y: u32| {
            let is_lamp = (x as f32 - 90.0).hypot(y as f32 - 20.0) < 4.0;
            image::Rgb(if is_lamp { [255; 3] } else { [110, 105, 100] })
        };
        image::RgbImage::from_fn(128, 64, pixel)
            .save(&path)
            .unwrap();
        let panorama = panorama(&path).unwrap();
        let lamp = panorama.map.texel(90, 20);
        assert!(lamp[0] > 2.0, "{lamp:?}");
        let wall = panorama.map.texel(30, 40);
        assert!(
            (wall[0] - 0.156).abs() < 0.005,
            "linear light of 110: {wall:?}"
        );
        assert!(
            panorama.notes[0].contains("estimated"),
            "{:?}",
            panorama.notes
        );

        let hdr = folder.path().join("room.exr");
        let image = holovol_reference::Image::new(4, 2, vec![[0.25, 0.25, 0.25, 1.0]; 8]);
        crate::output::write_exr(&image, &hdr).unwrap();
        let dim = super::panorama(&hdr).unwrap();
        assert!(
            (mean(&dim.map) - 0.25).abs() < 1e-6,
            "radiance stays as it is"
        );
        assert!(dim.notes.is_empty(), "{:?}", dim.notes);
    }

    #[test]
    fn what_is_no_picture_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("room.jpg");
        std::fs::write(&path, b"no picture").unwrap();
        let failure = panorama(&path).err().expect("a failure");
        assert!(failure.to_string().contains("room.jpg"), "{failure}");
    }
}

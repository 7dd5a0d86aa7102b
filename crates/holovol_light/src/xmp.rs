//! What a photo sphere's metadata says (Google's GPano schema).

/// The fields of GPano that place a picture on the sphere.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhotoSphere {
    /// Size of the whole panorama, pixels.
    pub full: Option<[usize; 2]>,
    /// Where the picture lies in it: left, top, width, height.
    pub crop: Option<[usize; 4]>,
    /// Heading of the picture's centre, degrees clockwise from north.
    pub heading_deg: Option<f64>,
    /// Pitch and roll of the camera, degrees.
    pub pitch_roll_deg: Option<[f64; 2]>,
    /// Whether it names a crop that can't be read: a field is missing, negative, or no number.
    pub unreadable_crop: bool,
}

/// Why metadata don't say where a picture lies on the sphere.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CropError {
    /// A field of the crop is missing, negative, or no number.
    #[error("a size or place of its crop is missing, negative, or no number")]
    Unreadable,
    /// The crop is empty or not within the whole.
    #[error(
        "its crop of {} × {} pixels at {}, {} is not within the whole of {} × {}",
        crop[2], crop[3], crop[0], crop[1], full[0], full[1]
    )]
    Outside {
        /// Left, top, width, height, pixels.
        crop: [usize; 4],
        /// Size of the whole, pixels.
        full: [usize; 2],
    },
    /// The crop has another shape than the picture.
    #[error("its crop of {} × {} pixels has another shape than the picture of {} × {}", crop[0], crop[1], picture[0], picture[1])]
    Shape {
        /// Width and height, pixels.
        crop: [usize; 2],
        /// The same of the picture.
        picture: [usize; 2],
    },
    /// The whole would be too large.
    #[error("the whole would have {} × {} pixels; at most 16384 × 8192 are possible", whole[0], whole[1])]
    Size {
        /// Width and height, pixels.
        whole: [usize; 2],
    },
}

/// A picture in its place on the whole sphere.
#[derive(Clone, Debug, PartialEq)]
pub struct Whole {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Row-major; what the picture does not show repeats its edge.
    pub texels: Vec<[f32; 3]>,
    /// Share of the sphere that it does not show, above the horizon and below it.
    pub unseen: [f64; 2],
}

/// Standard deviation of all light, EV, for what is above the horizon and below it, by the root of
/// its share of the sphere. Of eleven of Poly Haven's panoramas, cropped in twelve ways, the upper
/// half was off by 1.9 EV, bands by 2.1 to 2.8 times the root, the lower half by 0.2 EV.
const UNSEEN_SIGMA: [f64; 2] = [2.5, 0.4];

impl Whole {
    /// One standard deviation of all light for what the picture does not show, EV.
    pub fn unseen_sigma_ev(&self) -> f64 {
        let [above, below] = self.unseen.map(f64::sqrt);
        (UNSEEN_SIGMA[0] * above).hypot(UNSEEN_SIGMA[1] * below)
    }
}

/// Bytes of a file that are searched for metadata.
const SEARCHED: usize = 1 << 20;

/// Looks for GPano fields in the first megabyte of a picture file, as attributes or as elements.
pub fn photo_sphere(file: &[u8]) -> Option<PhotoSphere> {
    let head = &file[..file.len().min(SEARCHED)];
    let number = |name: &str| -> Option<f64> {
        let key = format!("GPano:{name}");
        let start = find(head, key.as_bytes())? + key.len();
        let rest = &head[start..head.len().min(start + 64)];
        // `="123"` or `>123<`.
        let text: String = rest
            .iter()
            .map(|&b| b as char)
            .skip_while(|c| matches!(c, '=' | '"' | '\'' | '>' | ' '))
            .take_while(|c| c.is_ascii_digit() || matches!(c, '.' | '-' | '+'))
            .collect();
        text.parse().ok().filter(|n: &f64| n.is_finite())
    };
    let pixels = |name: &str| {
        let n = number(name)?;
        (0.0..=1e6).contains(&n).then_some(n as usize)
    };
    let pair = |a: Option<usize>, b: Option<usize>| Some([a?, b?]);
    let full = pair(
        pixels("FullPanoWidthPixels"),
        pixels("FullPanoHeightPixels"),
    );
    let crop = pair(
        pixels("CroppedAreaLeftPixels"),
        pixels("CroppedAreaTopPixels"),
    )
    .zip(pair(
        pixels("CroppedAreaImageWidthPixels"),
        pixels("CroppedAreaImageHeightPixels"),
    ))
    .map(|([left, top], [width, height])| [left, top, width, height]);
    let found = PhotoSphere {
        full,
        crop,
        heading_deg: number("PoseHeadingDegrees"),
        pitch_roll_deg: number("PosePitchDegrees")
            .zip(number("PoseRollDegrees"))
            .map(Into::into),
        unreadable_crop: (full.is_none() || crop.is_none())
            && find(head, b"GPano:CroppedArea").is_some(),
    };
    (found != PhotoSphere::default()).then_some(found)
}

fn find(haystack: &[u8], needle: &[u8]) -> Option<usize> {
    haystack
        .windows(needle.len())
        .position(|window| window == needle)
}

impl PhotoSphere {
    /// Places a cropped picture of `width` × `height` on the whole panorama, scaled to the
    /// picture's own resolution. What was cropped away gets the nearest row's or column's value.
    ///
    /// `None` if there is no crop.
    ///
    /// # Errors
    /// If there is one that can't be, or is not the picture's.
    pub fn uncrop(
        &self,
        width: usize,
        height: usize,
        texels: &[[f32; 3]],
    ) -> Result<Option<Whole>, CropError> {
        if self.unreadable_crop {
            return Err(CropError::Unreadable);
        }
        let (Some(full), Some(crop)) = (self.full, self.crop) else {
            return Ok(None);
        };
        let ([full_width, full_height], [left, top, crop_width, crop_height]) = (full, crop);
        let within = crop_width > 0
            && crop_height > 0
            && left + crop_width <= full_width
            && top + crop_height <= full_height;
        if !within {
            return Err(CropError::Outside { crop, full });
        }
        if (crop_width, crop_height) == (full_width, full_height) {
            return Ok(None);
        }
        let scale = width as f64 / crop_width as f64;
        let to = |n: usize| (n as f64 * scale).round() as usize;
        // Rounding may take a pixel; larger differences mean that the metadata is another's.
        if (to(crop_height) as f64 - height as f64).abs() > 2.0 || texels.len() != width * height {
            return Err(CropError::Shape {
                crop: [crop_width, crop_height],
                picture: [width, height],
            });
        }
        let whole = [to(full_width), to(full_height)];
        let largest = crate::EnvironmentMap::MAX_WIDTH;
        if whole[0] > largest || whole[1] > largest / 2 {
            return Err(CropError::Size { whole });
        }
        let (left, top) = (to(left), to(top));
        let mut out = Vec::with_capacity(whole[0] * whole[1]);
        for y in 0..whole[1] {
            let row = y.saturating_sub(top).min(height - 1) * width;
            for x in 0..whole[0] {
                out.push(texels[row + x.saturating_sub(left).min(width - 1)]);
            }
        }
        // Cosines of the polar angles of its upper and lower edge.
        let edge = |y: usize| (y as f64 / full_height as f64 * std::f64::consts::PI).cos();
        let [upper, lower] = [edge(crop[1]), edge(crop[1] + crop_height)];
        let across = crop_width as f64 / full_width as f64;
        let seen = |from: f64, to: f64| 0.5 * across * (from - to);
        Ok(Some(Whole {
            width: whole[0],
            height: whole[1],
            texels: out,
            unseen: [
                0.5 - seen(upper.max(0.0), lower.max(0.0)),
                0.5 - seen(upper.min(0.0), lower.min(0.0)),
            ]
            .map(|share| share.max(0.0)),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_and_elements_are_read() {
        let attributes =
            br#"<rdf:Description GPano:FullPanoWidthPixels="400" GPano:FullPanoHeightPixels="200"
            GPano:CroppedAreaLeftPixels="0" GPano:CroppedAreaTopPixels="50"
            GPano:CroppedAreaImageWidthPixels="400" GPano:CroppedAreaImageHeightPixels="100"
            GPano:PoseHeadingDegrees="-12.5"/>"#;
        let found = photo_sphere(attributes).unwrap();
        assert_eq!(
            (found.full, found.crop),
            (Some([400, 200]), Some([0, 50, 400, 100]))
        );
        assert_eq!(found.heading_deg, Some(-12.5));
        let element = b"<GPano:PoseHeadingDegrees>90</GPano:PoseHeadingDegrees>";
        assert_eq!(photo_sphere(element).unwrap().heading_deg, Some(90.0));
        assert_eq!(photo_sphere(b"no metadata"), None);
        assert_eq!(photo_sphere(b"GPano:PoseHeadingDegrees=\"north\""), None);
    }

    #[test]
    fn a_crop_is_put_back_in_its_place() {
        let sphere = PhotoSphere {
            full: Some([8, 4]),
            crop: Some([0, 1, 8, 2]),
            ..Default::default()
        };
        let picture: Vec<[f32; 3]> = (0..16).map(|i| [i as f32; 3]).collect();
        let whole = sphere.uncrop(8, 2, &picture).unwrap().unwrap();
        assert_eq!((whole.width, whole.height), (8, 4));
        let column: Vec<f32> = (0..4).map(|y| whole.texels[y * 8 + 3][0]).collect();
        assert_eq!(column, [3.0, 3.0, 11.0, 11.0]);
        // Rows from 45° up to 45° down.
        let cap = 0.5 * (1.0 - 0.5_f64.sqrt());
        assert!(whole.unseen.iter().all(|share| (share - cap).abs() < 1e-9));
        let uncropped = |full, crop, unreadable_crop, [width, height]: [usize; 2]| {
            let sphere = PhotoSphere {
                full: Some(full),
                crop: Some(crop),
                unreadable_crop,
                ..Default::default()
            };
            sphere.uncrop(width, height, &vec![[0.0; 3]; width * height])
        };
        let crop = [0, 1, 8, 2];
        assert_eq!(
            uncropped([8, 2], [0, 0, 8, 2], false, [8, 2]),
            Ok(None),
            "all of it"
        );
        let fails = [
            uncropped([8, 4], crop, false, [8, 5]),
            uncropped([8, 4], [0, 3, 8, 2], false, [8, 2]),
            uncropped([8, 4], [0, 1, 0, 2], false, [8, 2]),
            uncropped([0, 0], crop, false, [8, 2]),
            uncropped([80_000, 4], crop, false, [8, 2]),
            uncropped([8, 4], crop, true, [8, 2]),
        ];
        use CropError::{Outside, Shape, Size, Unreadable};
        assert!(
            matches!(
                fails,
                [
                    Err(Shape { .. }),
                    Err(Outside { .. }),
                    Err(Outside { .. }),
                    Err(Outside { .. }),
                    Err(Size { .. }),
                    Err(Unreadable),
                ]
            ),
            "{fails:?}"
        );
    }

    #[test]
    fn crops_that_can_not_be_read_are_told_from_none() {
        let whole = r#"GPano:FullPanoWidthPixels="400" GPano:FullPanoHeightPixels="200" "#;
        let crop = |left: &str, rest: &str| {
            let crop = format!(
                r#"GPano:CroppedAreaLeftPixels="{left}" GPano:CroppedAreaTopPixels="0"
                GPano:CroppedAreaImageWidthPixels="400" {rest}"#
            );
            photo_sphere((whole.to_string() + &crop).as_bytes()).unwrap()
        };
        let height = r#"GPano:CroppedAreaImageHeightPixels="100""#;
        assert!(!crop("0", height).unreadable_crop);
        assert!(!photo_sphere(whole.as_bytes()).unwrap().unreadable_crop);
        for broken in [crop("-5", height), crop("none", height), crop("0", "")] {
            assert!(broken.unreadable_crop, "{broken:?}");
            assert_eq!(broken.uncrop(1, 1, &[[0.0; 3]]), Err(CropError::Unreadable));
        }
    }
}

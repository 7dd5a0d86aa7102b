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
    let found = PhotoSphere {
        full: pair(
            pixels("FullPanoWidthPixels"),
            pixels("FullPanoHeightPixels"),
        ),
        crop: pair(
            pixels("CroppedAreaLeftPixels"),
            pixels("CroppedAreaTopPixels"),
        )
        .zip(pair(
            pixels("CroppedAreaImageWidthPixels"),
            pixels("CroppedAreaImageHeightPixels"),
        ))
        .map(|([left, top], [width, height])| [left, top, width, height]),
        heading_deg: number("PoseHeadingDegrees"),
        pitch_roll_deg: number("PosePitchDegrees")
            .zip(number("PoseRollDegrees"))
            .map(Into::into),
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
    /// `None` if there is no crop, or one that does not fit the picture.
    pub fn uncrop(
        &self,
        width: usize,
        height: usize,
        texels: &[[f32; 3]],
    ) -> Option<(usize, usize, Vec<[f32; 3]>)> {
        let ([full_width, full_height], [left, top, crop_width, crop_height]) =
            (self.full?, self.crop?);
        let fits = crop_width > 0
            && crop_height > 0
            && left + crop_width <= full_width
            && top + crop_height <= full_height
            && texels.len() == width * height;
        if !fits || (crop_width, crop_height) == (full_width, full_height) {
            return None;
        }
        let scale = width as f64 / crop_width as f64;
        let to = |n: usize| (n as f64 * scale).round() as usize;
        let (out_width, out_height) = (to(full_width), to(full_height));
        // Rounding may take a pixel; larger differences mean that the metadata is another's.
        let off = (to(crop_height) as f64 - height as f64).abs();
        let largest = crate::EnvironmentMap::MAX_WIDTH;
        if off > 2.0 || out_width > largest || out_height > largest / 2 {
            return None;
        }
        let (left, top) = (to(left), to(top));
        let mut out = Vec::with_capacity(out_width * out_height);
        for y in 0..out_height {
            let row = y.saturating_sub(top).min(height - 1) * width;
            for x in 0..out_width {
                out.push(texels[row + x.saturating_sub(left).min(width - 1)]);
            }
        }
        Some((out_width, out_height, out))
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
        let (width, height, out) = sphere.uncrop(8, 2, &picture).unwrap();
        assert_eq!((width, height), (8, 4));
        let column: Vec<f32> = (0..4).map(|y| out[y * 8 + 3][0]).collect();
        assert_eq!(column, [3.0, 3.0, 11.0, 11.0]);
        assert!(
            sphere.uncrop(8, 5, &[[0.0; 3]; 40]).is_none(),
            "another picture's metadata"
        );
    }
}

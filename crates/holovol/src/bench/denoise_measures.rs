//! What `holovol bench denoise` measures of images.
//!
//! A reference is two independent halves: a product of differences to each leaves out the noise of
//! the reference itself.

use glam::DMat3;
use holovol_reference::{Image, measures};
use holovol_render::View;

/// Two halves of each eye's reference.
pub(super) type Reference = [[Image; 2]; 2];

pub(super) fn middle(halves: &[Image; 2]) -> Image {
    let pixels = halves[0].pixels().iter().zip(halves[1].pixels());
    let pixels = pixels
        .map(|(a, b)| std::array::from_fn(|c| 0.5 * (a[c] + b[c])))
        .collect();
    Image::new(halves[0].width(), halves[0].height(), pixels)
}

pub(super) fn both(
    images: &[Image],
    reference: &Reference,
    of: fn(&Image, &[Image; 2]) -> f64,
) -> f64 {
    let sum: f64 = images
        .iter()
        .zip(reference)
        .map(|(image, halves)| of(image, halves))
        .sum();
    sum / images.len().max(1) as f64
}

/// Without the reference's noise: see the module.
pub(super) fn relmse(image: &Image, halves: &[Image; 2]) -> f64 {
    let [one, two] = halves;
    let mut sum = 0.0;
    for ((a, r), s) in image.pixels().iter().zip(one.pixels()).zip(two.pixels()) {
        for c in 0..3 {
            let (a, r, s) = (f64::from(a[c]), f64::from(r[c]), f64::from(s[c]));
            let b = 0.5 * (r + s);
            sum += (a - r) * (a - s) / (b * b + 0.01);
        }
    }
    sum / (3 * image.pixels().len()) as f64
}

pub(super) fn flip(image: &Image, halves: &[Image; 2]) -> f64 {
    measures::flip(image, &middle(halves)).unwrap_or(f64::NAN)
}

/// Coefficient of (output − new) on (old − new); the halves keep the reference's noise out.
pub(super) fn ghost(image: &Image, halves: &[Image; 2], old: &Image) -> f64 {
    let (mut top, mut bottom) = (0.0, 0.0);
    let [one, two] = halves;
    for (i, a) in image.pixels().iter().enumerate() {
        for c in 0..3 {
            let [a, r, s, o] = [a, &one.pixels()[i], &two.pixels()[i], &old.pixels()[i]]
                .map(|pixel| f64::from(pixel[c]));
            top += (a - r) * (o - s);
            bottom += (o - r) * (o - s);
        }
    }
    top / bottom.max(1e-30)
}

/// Root mean square of how much the error changes from one image to the next; each has a reference
/// of its own.
pub(super) fn error_change(images: [&Image; 2], references: [&[Image; 2]; 2]) -> f64 {
    let mut sum = 0.0;
    let pixels = images[0].pixels().len();
    for i in 0..pixels {
        for c in 0..3 {
            let at = |image: &Image| f64::from(image.pixels()[i][c]);
            let change = at(images[1]) - at(images[0]);
            let [r, s] = [0, 1].map(|half| at(&references[1][half]) - at(&references[0][half]));
            sum += (change - r) * (change - s);
        }
    }
    (sum / (3 * pixels.max(1)) as f64).max(0.0).sqrt()
}

/// Where the places that one view sees at these depths (metres, 0 for nothing) are seen by another
/// view: pixel and depth there, if any.
pub(super) fn correspondences(
    from: &View,
    depths: &[[f32; 2]],
    to: &View,
) -> Vec<Option<(usize, f64)>> {
    let rays = DMat3::from_cols(to.direction_dx, to.direction_dy, to.direction);
    let inverse = rays.inverse();
    let width = from.size[0] as usize;
    let of = |(i, &[depth, _]): (usize, &[f32; 2])| {
        let [x, y] = [i % width, i / width].map(|n| n as f64 + 0.5);
        let ray = from.direction + x * from.direction_dx + y * from.direction_dy;
        let place = from.origin + f64::from(depth) * ray;
        let seen = inverse * (place - to.origin);
        let [x, y] = [seen.x / seen.z, seen.y / seen.z];
        let is_inside = depth > 0.0
            && seen.z > 0.0
            && (0.0..f64::from(to.size[0])).contains(&x)
            && (0.0..f64::from(to.size[1])).contains(&y);
        is_inside.then(|| (x as usize + to.size[0] as usize * y as usize, seen.z))
    };
    depths.iter().enumerate().map(of).collect()
}

/// Root mean square, over places that both eyes see, of the difference of their relative errors.
pub(super) fn disagreement(
    images: &[Image],
    reference: &Reference,
    places: &[Option<(usize, f64)>],
) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (left, right) in places.iter().enumerate() {
        let Some((right, _)) = *right else { continue };
        for c in 0..3 {
            let of = |eye: usize, pixel: usize| {
                let [a, r, s] = [&images[eye], &reference[eye][0], &reference[eye][1]]
                    .map(|image| f64::from(image.pixels()[pixel][c]));
                let scale = (0.25 * (r + s) * (r + s) + 0.01).sqrt();
                [(a - r) / scale, (a - s) / scale]
            };
            let (l, r) = (of(0, left), of(1, right));
            sum += (l[0] - r[0]) * (l[1] - r[1]);
            count += 1.0;
        }
    }
    (sum / f64::max(count, 1.0)).max(0.0).sqrt()
}

/// Pixels whose place an earlier view did not see: it was out of that view, or behind what was seen
/// there by more than the spreads of both depths and two pixels.
pub(super) fn disoccluded(
    now: &View,
    depths_now: &[[f32; 2]],
    before: &View,
    depths_before: &[[f32; 2]],
) -> Vec<bool> {
    let places = correspondences(now, depths_now, before);
    let pixel = before.direction_dx.length();
    places
        .iter()
        .zip(depths_now)
        .map(|(place, &[depth, spread])| match *place {
            _ if depth <= 0.0 => false,
            None => true,
            Some((at, z)) => {
                let [seen, seen_spread] = depths_before[at].map(f64::from);
                let slack = f64::from(spread) + seen_spread + 2.0 * pixel * z;
                seen <= 0.0 || z - seen > slack
            }
        })
        .collect()
}

/// relMSE over some pixels only.
pub(super) fn relmse_where(image: &Image, halves: &[Image; 2], wanted: &[bool]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (i, _) in wanted.iter().enumerate().filter(|&(_, &wanted)| wanted) {
        for c in 0..3 {
            let [a, r, s] = [image, &halves[0], &halves[1]].map(|m| f64::from(m.pixels()[i][c]));
            let b = 0.5 * (r + s);
            sum += (a - r) * (a - s) / (b * b + 0.01);
            count += 1.0;
        }
    }
    sum / f64::max(count, 1.0)
}

/// How much of the reference's contrast at the scale of a pixel an image keeps, 1 for all: the
/// coefficient of its differences to the mean of 3 × 3 pixels on the reference's.
pub(super) fn contrast(image: &Image, halves: &[Image; 2]) -> f64 {
    let [a, r, s] = [image, &halves[0], &halves[1]].map(details);
    let top: f64 = a
        .iter()
        .zip(r.iter().zip(&s))
        .map(|(a, (r, s))| 0.5 * a * (r + s))
        .sum();
    let bottom: f64 = r.iter().zip(&s).map(|(r, s)| r * s).sum();
    top / bottom.max(1e-30)
}

/// Mean of R, G, B less its mean over 3 × 3 pixels, in the inside.
fn details(image: &Image) -> Vec<f64> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let at = |x: usize, y: usize| {
        let [r, g, b, _] = image.pixels()[x + width * y].map(f64::from);
        (r + g + b) / 3.0
    };
    let mut details = Vec::new();
    for y in 1..height.max(1) - 1 {
        for x in 1..width.max(1) - 1 {
            let sum: f64 = (0..9).map(|k| at(x + k % 3 - 1, y + k / 3 - 1)).sum();
            details.push(at(x, y) - sum / 9.0);
        }
    }
    details
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(of: impl Fn(usize, usize) -> f32) -> Image {
        let pixels = (0..64).map(|i| [of(i % 8, i / 8); 4]).collect();
        Image::new(8, 8, pixels)
    }

    #[test]
    fn blur_loses_contrast_and_a_constant_does_not() {
        let stripes = |x: usize, _| (x % 2) as f32;
        let halves = [image(stripes), image(stripes)];
        let brighter = image(|x, y| stripes(x, y) + 3.0);
        assert!((contrast(&brighter, &halves) - 1.0).abs() < 1e-6);
        let blurred = image(|x, y| 0.25 + 0.5 * stripes(x, y));
        assert!((contrast(&blurred, &halves) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn a_ghost_is_the_share_of_the_old_image() {
        let (new, old) = (image(|x, _| x as f32), image(|_, y| y as f32));
        let mixed = image(|x, y| 0.8 * x as f32 + 0.2 * y as f32);
        let halves = [new.clone(), new];
        assert!((ghost(&mixed, &halves, &old) - 0.2).abs() < 1e-6);
    }

    #[test]
    fn eyes_that_err_alike_agree() {
        let truth = || [image(|x, _| x as f32), image(|x, _| x as f32)];
        let reference = [truth(), truth()];
        let places: Vec<_> = (0..64).map(|i| Some((i, 1.0))).collect();
        let off = |e: f32| image(move |x, _| x as f32 + e * ((x * x) as f32 + 0.01).sqrt());
        let alike = disagreement(&[off(0.1), off(0.1)], &reference, &places);
        assert!(alike < 1e-6, "{alike}");
        let apart = disagreement(&[off(0.1), off(-0.1)], &reference, &places);
        assert!((apart - 0.2).abs() < 1e-5, "{apart}");
    }

    #[test]
    fn what_was_behind_something_is_disoccluded() {
        use holovol_scene::Camera;
        let camera = Camera {
            eye: glam::DVec3::new(0.0, 0.0, 2.0),
            target: glam::DVec3::ZERO,
            up: glam::DVec3::Y,
            fov_y: 0.5,
            width: 8,
            height: 8,
        };
        let view = View::from_camera(&camera);
        let now = vec![[2.0, 0.0]; 64];
        let mut before = now.clone();
        before[11] = [1.5, 0.0];
        before[12] = [0.0, 0.0];
        before[13] = [1.5, 0.6];
        let found = disoccluded(&view, &now, &view, &before);
        let places: Vec<_> = (0..64).filter(|&i| found[i]).collect();
        assert_eq!(places, [11, 12]);
    }
}

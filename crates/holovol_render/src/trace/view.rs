use glam::{DMat2, DMat4, DVec2, DVec3, DVec4};
use holovol_scene::Camera;

/// What an image is seen from: rays as linear functions of the pixel position.
///
/// The ray through pixel position (x, y), (0, 0) being the top left corner, is
/// `origin + x·origin_dx + y·origin_dy + t·(direction + x·direction_dx + y·direction_dy)`, in world
/// metres; t is the depth along `forward`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Where the ray through the top left corner starts.
    pub origin: DVec3,
    /// Its change per pixel to the right; zero for a pinhole.
    pub origin_dx: DVec3,
    /// Its change per pixel downwards; zero for a pinhole.
    pub origin_dy: DVec3,
    /// Direction at the top left corner, of length 1 along `forward`.
    pub direction: DVec3,
    /// Change of direction per pixel to the right.
    pub direction_dx: DVec3,
    /// Change of direction per pixel downwards.
    pub direction_dy: DVec3,
    /// The camera's axis, of length 1.
    pub forward: DVec3,
    /// Pixels across and down.
    pub size: [u32; 2],
}

impl View {
    /// That of a scene's camera.
    pub fn from_camera(camera: &Camera) -> Self {
        let rays = camera.pixel_rays(DMat4::IDENTITY);
        let [_, _, forward] = camera.axes();
        Self {
            origin: rays.origin,
            origin_dx: DVec3::ZERO,
            origin_dy: DVec3::ZERO,
            direction: rays.direction,
            direction_dx: rays.direction_dx,
            direction_dy: rays.direction_dy,
            forward,
            size: [camera.width, camera.height],
        }
    }

    /// That of a projection matrix to clip space (x right, y up, both −1 … 1), perspective of any
    /// frustum or orthographic, seen along −z of a rigid `world_from_view`.
    pub fn from_projection(world_from_view: DMat4, clip_from_view: DMat4, size: [u32; 2]) -> Self {
        // Rows x, y and w of a projection see x, y and depth apart: X = x·a + z·b + c.
        let [x, y, w] = [0, 1, 3].map(|row| clip_from_view.row(row));
        let ray = |ndc: [f64; 2]| {
            let solve = |row: DVec4, scale: f64, ndc: f64, at: f64| {
                // row · (…, −t, 1) = ndc · w(t), solved for the one free coordinate at depth t.
                let clip_w = w.w - w.z * at;
                (ndc * clip_w + row.z * at - row.w) / scale
            };
            let at = |t: f64| DVec3::new(solve(x, x.x, ndc[0], t), solve(y, y.y, ndc[1], t), -t);
            (at(0.0), at(1.0) - at(0.0))
        };
        let (origin, direction) = ray([-1.0, 1.0]);
        let (right, right_direction) = ray([1.0, 1.0]);
        let (below, below_direction) = ray([-1.0, -1.0]);
        let [width, height] = size.map(|n| f64::from(n.max(1)));
        let turn = |v| world_from_view.transform_vector3(v);
        Self {
            origin: world_from_view.transform_point3(origin),
            origin_dx: turn((right - origin) / width),
            origin_dy: turn((below - origin) / height),
            direction: turn(direction),
            direction_dx: turn((right_direction - direction) / width),
            direction_dy: turn((below_direction - direction) / height),
            forward: turn(DVec3::NEG_Z),
            size,
        }
    }

    /// The same view with another number of pixels.
    pub fn resized(&self, size: [u32; 2]) -> Self {
        let [x, y] = [0, 1].map(|i| f64::from(self.size[i]) / f64::from(size[i].max(1)));
        Self {
            origin_dx: self.origin_dx * x,
            origin_dy: self.origin_dy * y,
            direction_dx: self.direction_dx * x,
            direction_dy: self.direction_dy * y,
            size,
            ..*self
        }
    }

    /// Pixels [left, top, right, bottom) in which points within the convex hull of `corners` can
    /// be seen; `None` if there are none.
    pub fn bounds(&self, corners: &[DVec3]) -> Option<[u32; 4]> {
        let [width, height] = self.size.map(f64::from);
        let everywhere = Some([0, 0, self.size[0], self.size[1]]);
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for &corner in corners {
            let from_origin = corner - self.origin;
            let depth = from_origin.dot(self.forward);
            // Parallel rays see what is beside their origins.
            let is_perspective = self.origin_dx == DVec3::ZERO;
            if is_perspective && depth <= 0.0 {
                return everywhere;
            }
            let a = self.origin_dx + depth * self.direction_dx;
            let b = self.origin_dy + depth * self.direction_dy;
            let rest = from_origin - depth * self.direction;
            let gram = DMat2::from_cols_array(&[a.dot(a), a.dot(b), a.dot(b), b.dot(b)]);
            let pixel = gram.inverse() * DVec2::new(a.dot(rest), b.dot(rest));
            if !pixel.is_finite() {
                return everywhere;
            }
            low = low.min(pixel);
            high = high.max(pixel);
        }
        // A pixel more, for rounding.
        let low = (low - 1.0).floor().max(DVec2::ZERO);
        let high = (high + 1.0).ceil().min(DVec2::new(width, height));
        let is_seen = low.x < high.x && low.y < high.y;
        is_seen.then_some([low.x as u32, low.y as u32, high.x as u32, high.y as u32])
    }

    /// Whether rays can be made of it.
    pub fn is_valid(&self) -> bool {
        let vectors = [
            self.origin,
            self.origin_dx,
            self.origin_dy,
            self.direction,
            self.direction_dx,
            self.direction_dy,
            self.forward,
        ];
        vectors.iter().all(|v| v.is_finite())
            && self.size.iter().all(|&n| n > 0)
            && self.direction != DVec3::ZERO
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    fn camera() -> Camera {
        Camera {
            eye: DVec3::new(0.3, -0.2, 1.5),
            target: DVec3::new(0.1, 0.05, -0.4),
            up: DVec3::Y,
            fov_y: 0.7,
            width: 320,
            height: 200,
        }
    }

    fn world_from_view(camera: &Camera) -> DMat4 {
        let [right, up, forward] = camera.axes();
        let rotation = DQuat::from_mat3(&glam::DMat3::from_cols(right, up, -forward));
        DMat4::from_rotation_translation(rotation, camera.eye)
    }

    fn ray(view: &View, x: f64, y: f64) -> [DVec3; 2] {
        [
            view.origin + x * view.origin_dx + y * view.origin_dy,
            view.direction + x * view.direction_dx + y * view.direction_dy,
        ]
    }

    #[test]
    fn projections_see_what_cameras_see() {
        let camera = camera();
        let projection = DMat4::perspective_infinite_reverse_rh(camera.fov_y, 1.6, 0.1);
        let size = [camera.width, camera.height];
        let view = View::from_projection(world_from_view(&camera), projection, size);
        let expected = View::from_camera(&camera);
        for [x, y] in [[0.0, 0.0], [320.0, 0.0], [11.0, 190.0], [160.0, 100.0]] {
            let pairs = ray(&view, x, y).into_iter().zip(ray(&expected, x, y));
            for (a, b) in pairs {
                assert!(a.distance(b) < 1e-12, "{a} {b}");
            }
        }
        assert!(view.forward.distance(expected.forward) < 1e-12);
    }

    /// Any projection: a point on a pixel's ray is projected to that pixel, at its depth.
    #[test]
    fn rays_meet_what_is_projected_to_their_pixels() {
        let world_from_view = world_from_view(&camera());
        let off_axis = DMat4::frustum_rh(-0.03, 0.08, -0.05, 0.02, 0.1, 50.0);
        let orthographic = DMat4::orthographic_rh(-2.0, 1.0, -0.5, 0.75, 20.0, 0.1);
        for projection in [off_axis, orthographic] {
            let view = View::from_projection(world_from_view, projection, [300, 125]);
            for [x, y, depth] in [[0.0, 0.0, 1.0], [13.0, 99.0, 4.0], [300.0, 125.0, 0.5]] {
                let [origin, direction] = ray(&view, x, y);
                let point = origin + depth * direction;
                assert!(((point - view.origin).dot(view.forward) - depth).abs() < 1e-9);
                let clip = projection * world_from_view.inverse() * point.extend(1.0);
                let ndc = clip.truncate() / clip.w;
                let pixel = [(ndc.x + 1.0) * 150.0, (1.0 - ndc.y) * 62.5];
                assert!(
                    (pixel[0] - x).abs() < 1e-6 && (pixel[1] - y).abs() < 1e-6,
                    "{pixel:?}"
                );
            }
        }
    }

    #[test]
    fn bounds_hold_all_that_is_seen_and_little_more() {
        let corners: [DVec3; 8] = std::array::from_fn(|i| {
            0.1 * DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64)
        });
        let size = [300, 200];
        let pose = DMat4::from_translation(DVec3::new(0.05, 0.05, 2.0));
        let perspective = DMat4::perspective_infinite_reverse_rh(0.5, 1.5, 0.01);
        let view = View::from_projection(pose, perspective, size);
        let [left, top, right, bottom] = view.bounds(&corners).expect("it is in view");
        // 0.1 m at 1.9 m of 2·1.9·tan(0.25) m over 200 pixels.
        let pixels = 0.1 / (3.8 * 0.25f64.tan()) * 200.0;
        let [width, height] = [right - left, bottom - top].map(f64::from);
        assert!(
            (pixels..pixels + 4.0).contains(&width),
            "{width} of {pixels}"
        );
        assert!((pixels..pixels + 4.0).contains(&height));
        assert!((149..=151).contains(&((left + right) / 2)));
        let aside = pose * DMat4::from_translation(DVec3::new(3.0, 0.0, 0.0));
        let view = View::from_projection(aside, perspective, size);
        assert_eq!(view.bounds(&corners), None);
        let inside = DMat4::from_translation(DVec3::splat(0.05));
        let view = View::from_projection(inside, perspective, size);
        assert_eq!(view.bounds(&corners), Some([0, 0, 300, 200]));
        let orthographic = DMat4::orthographic_rh(-0.15, 0.15, -0.1, 0.1, 9.0, 0.1);
        let view = View::from_projection(pose, orthographic, size);
        let [left, top, right, bottom] = view.bounds(&corners).expect("it is in view");
        assert!((100..=104).contains(&(right - left)), "{left} {right}");
        assert!((100..=104).contains(&(bottom - top)), "{top} {bottom}");
    }
}

use glam::{DMat4, DVec3};

/// A pinhole camera; pixel (0, 0) is top left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Position, world metres.
    pub eye: DVec3,
    /// A point the camera looks at.
    pub target: DVec3,
    /// A direction that is up in the image.
    pub up: DVec3,
    /// Vertical field of view over the whole image height, radians.
    pub fov_y: f64,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
}

impl Camera {
    /// Right, up and forward, orthonormal, in world directions.
    pub fn axes(&self) -> [DVec3; 3] {
        let forward = (self.target - self.eye).normalize();
        let right = forward.cross(self.up).normalize();
        [right, right.cross(forward), forward]
    }

    /// The left and the right eye: moved by half of `ipd` metres along the camera's right, axes
    /// parallel.
    pub fn stereo(&self, ipd: f64) -> [Self; 2] {
        let [right, _, _] = self.axes();
        [-0.5, 0.5].map(|side| Self {
            eye: self.eye + right * (side * ipd),
            target: self.target + right * (side * ipd),
            ..*self
        })
    }

    /// World direction (unit) through image position (x, y) in pixels; (0.5, 0.5) is the centre
    /// of the top left pixel.
    pub fn direction(&self, x: f64, y: f64) -> DVec3 {
        let rays = self.pixel_rays(DMat4::IDENTITY);
        (rays.direction + x * rays.direction_dx + y * rays.direction_dy).normalize()
    }

    /// The camera's rays in another frame, as linear functions of the pixel position.
    ///
    /// `frame_from_world` is composed here in f64 so that kernels in f32 lose nothing far from
    /// the origin.
    pub fn pixel_rays(&self, frame_from_world: DMat4) -> PixelRays {
        let [right, up, forward] = self.axes();
        let height = f64::from(self.height);
        let half = (0.5 * self.fov_y).tan();
        let per_pixel = 2.0 * half / height;
        let corner = forward - right * (half * f64::from(self.width) / height) + up * half;
        PixelRays {
            origin: frame_from_world.transform_point3(self.eye),
            direction: frame_from_world.transform_vector3(corner),
            direction_dx: frame_from_world.transform_vector3(right * per_pixel),
            direction_dy: frame_from_world.transform_vector3(-up * per_pixel),
        }
    }
}

/// Camera rays: `origin + t · (direction + x·direction_dx + y·direction_dy)` for pixel position
/// (x, y); the direction has length 1 along the camera's forward axis, in world metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelRays {
    /// Where all rays start.
    pub origin: DVec3,
    /// Direction at the image's top left corner.
    pub direction: DVec3,
    /// Change of direction per pixel to the right.
    pub direction_dx: DVec3,
    /// Change of direction per pixel downwards.
    pub direction_dy: DVec3,
}

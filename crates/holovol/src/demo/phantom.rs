//! A head in layers, as anatomical models show it: the right half in its skin, the left without
//! it, and there the skull opened over the brain and its vessels. Built of distance functions.

use glam::{DMat3, DVec3, Vec3, vec3};
use holovol_volume::{Geometry, TransferPoint, Volume, VolumeError, Voxels};
use rayon::prelude::*;

use super::shapes::{Hash, capsule, carve, ellipsoid, join, noise, smoothstep};

/// Voxels along x (to the head's left), y (up), z (to the front).
const DIMS: [usize; 3] = [144, 192, 168];
/// Head units per voxel, and metres per head unit.
const VOXEL: f32 = 0.0122;
const METRES: f32 = 0.125;
/// The place of the grid's centre, head units.
const CENTRE: Vec3 = vec3(0.0, -0.1, 0.06);
/// Voxels over which one material goes over into another.
const RAMP: f32 = 1.6;

// The values of the materials. Interpolation passes through all values between two neighbours:
// air (0) stands between skin and bone so that neither is coated by the other; brain, and blood
// after it, lie so far out that the coat of the materials before them is thin.
const SKIN: f32 = -1.0;
const BONE: f32 = 1.0;
const BRAIN: f32 = -10.0;
const BLOOD: f32 = -300.0;

/// Values are stored in steps of this.
const STEP: f64 = 0.01;

/// Half spaces of the cuts: skin goes at x > 0, bone there above this height.
const SKULL_CUT: f32 = 0.24;

/// The phantom, its values being s already: the window is 0 … 1.
pub(super) fn volume() -> Result<Volume, VolumeError> {
    let vessels = Vessels::grow();
    let [nx, ny, nz] = DIMS;
    let voxels: Vec<i16> = (0..nx * ny * nz)
        .into_par_iter()
        .map(|index| {
            let place = [index % nx, index / nx % ny, index / (nx * ny)];
            let value = value(position(place), &vessels);
            (f64::from(value) / STEP).round() as i16
        })
        .collect();
    // The head looks along +z and has its left at +x, as patients stand in the world.
    let metres = f64::from(VOXEL * METRES);
    let ras = DMat3::from_cols(DVec3::NEG_X, DVec3::Z, DVec3::Y) * metres;
    let geometry = Geometry::from_ras(ras, DVec3::ZERO);
    Volume::new(
        Voxels::I16(voxels),
        DIMS.map(|n| n as u32),
        STEP,
        0.0,
        geometry,
    )
}

/// What the materials look like.
pub(super) fn transfer_function() -> Vec<TransferPoint> {
    let point = |s: f64, sigma_t: f64, albedo: [f64; 3], specular: f64| TransferPoint {
        s,
        sigma_t,
        albedo,
        emission: [0.0; 3],
        roughness: 0.45,
        specular,
    };
    let blood = [0.7, 0.07, 0.06];
    let brain = [0.92, 0.66, 0.62];
    let skin = [0.9, 0.68, 0.56];
    let bone = [0.95, 0.91, 0.82];
    vec![
        point(-14.0, 4000.0, blood, 0.05),
        point(-12.0, 3500.0, brain, 0.04),
        point(-2.0, 3500.0, brain, 0.04),
        point(-1.6, 2500.0, skin, 0.03),
        point(-0.65, 2500.0, skin, 0.03),
        point(-0.4, 0.0, skin, 0.03),
        point(0.4, 0.0, bone, 0.04),
        point(0.65, 4000.0, bone, 0.04),
    ]
}

fn position([i, j, k]: [usize; 3]) -> Vec3 {
    let index = vec3(i as f32, j as f32, k as f32);
    let dims = vec3(DIMS[0] as f32, DIMS[1] as f32, DIMS[2] as f32);
    CENTRE + (index + 0.5 - 0.5 * dims) * VOXEL
}

fn value(p: Vec3, vessels: &Vessels) -> f32 {
    let skull = skull(p);
    let skin = skin(p, skull);
    // Nothing but air is outside of the skin by more than the widest ramp.
    if skin > 4.0 * VOXEL {
        return 0.0;
    }
    let cavity = ellipsoid(p, CRANIUM, CRANIUM_RADII - 0.075);
    let opening = (-p.x).max(SKULL_CUT - p.y);
    let bone = carve(skull, cavity, 0.01).max(-opening);
    let flesh = flesh(p, skin).max(0.03 - ellipsoid(p, CRANIUM, CRANIUM_RADII));
    // The skin of one half, and what it covers.
    let cover = skin.max(p.x).max(-(cavity - 0.03));

    let layers = [
        (BLOOD, flesh),
        (SKIN, cover),
        (BONE, bone),
        (BRAIN, brain(p)),
        (BLOOD, vessels.distance(p)),
    ];
    layers.into_iter().fold(0.0, |value, (material, distance)| {
        let coverage = (0.5 - distance / (RAMP * VOXEL)).clamp(0.0, 1.0);
        value + (material - value) * coverage
    })
}

const CRANIUM: Vec3 = vec3(0.0, 0.27, -0.08);
const CRANIUM_RADII: Vec3 = vec3(0.57, 0.62, 0.74);

/// The solid skull: the cranial cavity is not hollowed yet.
fn skull(p: Vec3) -> f32 {
    let q = vec3(p.x.abs(), p.y, p.z);
    let mut d = ellipsoid(p, CRANIUM, CRANIUM_RADII);
    // Upper jaw, cheekbones with their arches, brows, bridge of the nose.
    d = join(
        d,
        ellipsoid(p, vec3(0.0, -0.25, 0.4), vec3(0.25, 0.24, 0.24)),
        0.12,
    );
    d = join(
        d,
        ellipsoid(q, vec3(0.33, -0.14, 0.42), vec3(0.15, 0.1, 0.16)),
        0.08,
    );
    d = join(
        d,
        capsule(
            q,
            vec3(0.42, -0.14, 0.36),
            vec3(0.56, -0.05, -0.02),
            0.042,
            0.036,
        ),
        0.05,
    );
    d = join(
        d,
        capsule(
            q,
            vec3(0.06, 0.15, 0.62),
            vec3(0.44, 0.07, 0.42),
            0.07,
            0.055,
        ),
        0.08,
    );
    d = join(
        d,
        capsule(p, vec3(0.0, 0.1, 0.62), vec3(0.0, -0.09, 0.75), 0.05, 0.045),
        0.06,
    );
    // Eye sockets, nose, temples.
    d = carve(
        d,
        ellipsoid(q, vec3(0.225, -0.005, 0.62), vec3(0.145, 0.12, 0.3)),
        0.05,
    );
    let nose = ellipsoid(q, vec3(0.035, -0.23, 0.66), vec3(0.06, 0.13, 0.22));
    d = carve(d, nose, 0.03);
    d = carve(
        d,
        ellipsoid(q, vec3(0.62, 0.08, 0.34), vec3(0.14, 0.2, 0.2)),
        0.1,
    );
    // Lower jaw: chin, body, branch.
    let mut jaw = capsule(
        q,
        vec3(0.05, -0.76, 0.52),
        vec3(0.2, -0.73, 0.42),
        0.09,
        0.085,
    );
    jaw = join(
        jaw,
        capsule(
            q,
            vec3(0.2, -0.73, 0.42),
            vec3(0.42, -0.58, 0.02),
            0.085,
            0.07,
        ),
        0.04,
    );
    jaw = join(
        jaw,
        capsule(
            q,
            vec3(0.42, -0.58, 0.02),
            vec3(0.5, -0.12, -0.03),
            0.07,
            0.05,
        ),
        0.05,
    );
    let spine = vec3(0.0, p.y, -0.3 - 0.1 * (p.y + 0.6));
    let vertebra = 0.02 * (p.y * 42.0).sin();
    let spine = ((p - spine).length() - 0.13 - vertebra).max(p.y + 0.35);
    d.min(jaw).min(teeth(q)).min(spine)
}

fn teeth(q: Vec3) -> f32 {
    let mut d = f32::INFINITY;
    if q.y > -0.36 || q.y < -0.74 {
        return 1.0;
    }
    for tooth in 0..6 {
        let angle = 0.13 + 0.25 * tooth as f32;
        let (sin, cos) = angle.sin_cos();
        let radius = 0.04 - 0.002 * (2 - tooth.min(2)) as f32;
        let upper = vec3(0.215 * sin, -0.44, 0.37 + 0.235 * cos);
        let lower = vec3(0.2 * sin, -0.6, 0.37 + 0.215 * cos);
        let down = vec3(0.0, -0.075, 0.0);
        d = d.min(capsule(q, upper, upper + down, radius, radius * 0.8));
        d = d.min(capsule(
            q,
            lower - down * 0.5,
            lower + down,
            radius * 0.8,
            radius,
        ));
    }
    d
}

/// The whole head in its skin; it covers the skull everywhere.
fn skin(p: Vec3, skull: f32) -> f32 {
    let q = vec3(p.x.abs(), p.y, p.z);
    let mut d = ellipsoid(p, CRANIUM, CRANIUM_RADII + 0.055);
    d = join(
        d,
        ellipsoid(p, vec3(0.0, -0.26, 0.24), vec3(0.47, 0.56, 0.46)),
        0.2,
    );
    d = join(
        d,
        ellipsoid(p, vec3(0.0, -0.74, 0.48), vec3(0.2, 0.14, 0.15)),
        0.2,
    );
    let neck = capsule(
        p,
        vec3(0.0, -0.5, -0.16),
        vec3(0.0, -1.5, -0.26),
        0.37,
        0.42,
    );
    d = join(d, neck, 0.16);
    d = join(d, skull - 0.05, 0.1);
    // Nose: bridge, tip, wings, nostrils.
    d = join(
        d,
        capsule(
            p,
            vec3(0.0, 0.08, 0.66),
            vec3(0.0, -0.26, 0.88),
            0.05,
            0.085,
        ),
        0.09,
    );
    d = join(
        d,
        ellipsoid(q, vec3(0.075, -0.29, 0.78), vec3(0.065, 0.06, 0.09)),
        0.05,
    );
    d = carve(
        d,
        ellipsoid(q, vec3(0.045, -0.345, 0.83), vec3(0.026, 0.04, 0.04)),
        0.02,
    );
    // Closed eyes: the hollow, the ball under its lid, the crease.
    d = carve(
        d,
        ellipsoid(q, vec3(0.225, 0.0, 0.72), vec3(0.15, 0.1, 0.12)),
        0.12,
    );
    d = join(
        d,
        ellipsoid(q, vec3(0.225, -0.01, 0.54), vec3(0.125, 0.105, 0.125)),
        0.03,
    );
    let lid_line = vec3(q.x, -0.055 + 1.6 * (q.x - 0.225) * (q.x - 0.225), q.z);
    let on_lid = (q.x - 0.225).abs() < 0.11 && q.z > 0.5;
    if on_lid {
        d += 0.014 * (1.0 - smoothstep(0.0, 0.018, (q - lid_line).length()));
    }
    // Lips and the line between them, the groove above.
    let mouth = |y: f32, z: f32, r: f32| {
        capsule(q, vec3(0.0, y, z), vec3(0.15, -0.525, z - 0.085), r, 0.02)
    };
    d = join(d, mouth(-0.49, 0.7, 0.042), 0.04);
    d = join(d, mouth(-0.575, 0.69, 0.05), 0.04);
    d = carve(d, mouth(-0.528, 0.775, 0.012), 0.03);
    d = carve(
        d,
        capsule(
            p,
            vec3(0.0, -0.36, 0.82),
            vec3(0.0, -0.45, 0.78),
            0.018,
            0.02,
        ),
        0.03,
    );
    // Ears: a bent disc with a hollow.
    let ear = q - vec3(0.62, -0.02, -0.12);
    let ear = vec3(
        ear.x - 0.35 * (-ear.z).max(0.0),
        ear.y,
        ear.z + 0.25 * ear.y,
    );
    let mut shell = ellipsoid(ear, Vec3::ZERO, vec3(0.055, 0.2, 0.13));
    shell = carve(
        shell,
        ellipsoid(ear, vec3(0.06, 0.02, 0.0), vec3(0.05, 0.14, 0.075)),
        0.03,
    );
    join(d, shell, 0.03)
}

/// Muscle under the skin, in strands.
fn flesh(p: Vec3, skin: f32) -> f32 {
    let angle = (p.x).atan2(p.z + 0.2);
    let strands = 0.012 * (angle * 26.0 + 3.0 * p.y).sin();
    // Shallow in the neck, below the bones of the face.
    let depth = 0.05 + 0.1 * smoothstep(-0.9, -0.7, p.y);
    let mouth = ellipsoid(p, vec3(0.0, -0.55, 0.55), vec3(0.3, 0.13, 0.34));
    carve(skin + depth + strands, mouth, 0.04)
}

/// Hemispheres with their folds, and the cerebellum.
fn brain(p: Vec3) -> f32 {
    let hull = ellipsoid(p, CRANIUM, CRANIUM_RADII - 0.1);
    if hull > 0.1 {
        return hull;
    }
    let side = p.x.signum() * 11.3;
    let warp = vec3(noise(p * 2.6), noise(p * 2.6 + 17.0), noise(p * 2.6 + 31.0)) * 0.16;
    let folds = noise((p + warp) * 5.6 + side);
    // A furrow wherever the noise changes its sign.
    let furrow = 1.0 - smoothstep(0.0, 0.16, folds.abs());
    let mut d = hull + 0.075 * furrow - 0.012;
    d = carve(d, (p.x.abs() - 0.012).max(0.05 - p.y), 0.05);
    d = d.max(-0.14 - p.y);
    let lobes = vec3(p.x.abs(), p.y, p.z);
    let cerebellum = ellipsoid(lobes, vec3(0.2, -0.16, -0.46), vec3(0.24, 0.16, 0.2));
    d.min(cerebellum + 0.012 * (p.y * 110.0).sin())
}

/// Arteries on the brain: a tree of tapering segments.
struct Vessels {
    segments: Vec<[Vec3; 2]>,
    radii: Vec<[f32; 2]>,
}

impl Vessels {
    fn grow() -> Self {
        let mut vessels = Self {
            segments: Vec::new(),
            radii: Vec::new(),
        };
        let mut hash = Hash::new([3, 1, 4]);
        for (y, z, heading) in [
            (0.0, 0.3, 1.1),
            (-0.02, 0.0, 1.5),
            (0.02, -0.3, 1.9),
            (0.1, 0.45, 0.7),
        ] {
            vessels.branch(&mut hash, vec3(0.6, y, z), heading, 0.026, 0);
        }
        vessels
    }

    /// Walks over the brain; `heading` is 0 to the front and π/2 upwards.
    fn branch(&mut self, hash: &mut Hash, start: Vec3, heading: f32, radius: f32, depth: u32) {
        const STEP: f32 = 0.045;
        const THINNEST: f32 = 0.009;
        let (mut p, mut heading, mut radius) = (on_brain(start), heading, radius);
        for step in 0..40 {
            heading += 0.9 * (hash.next() - 0.5);
            let normal = (p - CRANIUM).normalize();
            let front = (Vec3::Z - normal * normal.z).normalize_or_zero();
            let up = normal.cross(front);
            let (sin, cos) = heading.sin_cos();
            let up = if up.y < 0.0 { -up } else { up };
            let next = on_brain(p + (front * cos + up * sin) * STEP);
            if next.x < 0.03 || radius < THINNEST {
                return;
            }
            let thinner = radius * 0.965;
            self.segments.push([p, next]);
            self.radii.push([radius, thinner]);
            (p, radius) = (next, thinner);
            if depth < 3 && step % 5 == 4 {
                let turn = if hash.next() < 0.5 { 0.8 } else { -0.8 };
                self.branch(hash, p, heading + turn, radius * 0.72, depth + 1);
            }
        }
    }

    fn distance(&self, p: Vec3) -> f32 {
        let far = ellipsoid(p, CRANIUM, CRANIUM_RADII - 0.1).abs();
        if far > 0.1 || p.x < 0.0 {
            return far;
        }
        let segments = self.segments.iter().zip(&self.radii);
        segments
            .map(|(&[a, b], &[ra, rb])| capsule(p, a, b, ra, rb))
            .fold(f32::INFINITY, f32::min)
    }
}

/// The point on the brain's surface in the direction of `p`.
fn on_brain(p: Vec3) -> Vec3 {
    let radii = CRANIUM_RADII - 0.085;
    CRANIUM + ((p - CRANIUM) / radii).normalize_or(Vec3::Y) * radii
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f32, y: f32, z: f32) -> f32 {
        value(vec3(x, y, z), &Vessels::grow())
    }

    #[test]
    fn layers_lie_where_anatomy_has_them() {
        assert_eq!(at(0.0, 1.0, 0.9), 0.0, "air");
        assert_eq!(at(-0.61, 0.3, -0.08), SKIN, "skin of the right half");
        assert_eq!(at(-0.535, 0.3, -0.08), BONE, "skull below it");
        assert_eq!(at(0.535, 0.1, -0.08), BONE, "skull of the left half");
        assert_eq!(at(0.535, 0.4, -0.08), 0.0, "opened above");
        assert_eq!(
            at(-0.2, 0.3, -0.08).min(at(-0.25, 0.33, -0.02)),
            BRAIN,
            "brain"
        );
        assert_eq!(at(0.225, 0.0, 0.6), 0.0, "left eye socket");
    }

    #[test]
    fn nothing_reaches_the_border() {
        let volume = volume().unwrap();
        let [nx, ny, nz] = DIMS.map(|n| n as i64);
        for (a, b) in (0..ny).flat_map(|y| (0..nz).map(move |z| (y, z))) {
            assert_eq!(volume.value([0, a, b]), 0.0);
            assert_eq!(volume.value([nx - 1, a, b]), 0.0);
        }
        for (a, b) in (0..nx).flat_map(|x| (0..ny).map(move |y| (x, y))) {
            assert_eq!(volume.value([a, b, 0]), 0.0);
            assert_eq!(volume.value([a, b, nz - 1]), 0.0);
        }
    }
}

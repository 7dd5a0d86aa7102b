//! What the eyes see of their images: nothing behind the optics' edge, little beside the gaze.

use std::sync::Arc;

use bevy::math::Isometry3d;
use bevy::prelude::*;
use openxr::{AnyGraphics, Session, VisibilityMaskTypeKHR};

use super::cost::FrameCost;
use super::eyes::EyeCamera;
use super::pose::{EyeView, FieldOfView};
use super::runtime::{Runtime, STEREO};
use super::session::CurrentFrame;
use super::{Foveation, MixedRealitySettings};
use crate::VolumeSampling;

/// Triangles as tangents of angles: x to the right, y up.
pub(crate) type HiddenParts = Arc<[[Vec2; 3]]>;

/// Of an eye's image, moves of the gaze that make another map, heights of the image.
const GAZE_STEP: f32 = 1.0 / 64.0;

/// What the runtime says that nobody sees; nothing where it says nothing.
pub(crate) fn hidden_parts(
    runtime: &Runtime,
    session: &Session<AnyGraphics>,
    eye: u32,
) -> HiddenParts {
    if !runtime.has_visibility_mask {
        return Arc::new([]);
    }
    let kind = VisibilityMaskTypeKHR::HIDDEN_TRIANGLE_MESH;
    let Ok(mask) = session.get_visibility_mask_khr(STEREO, eye, kind) else {
        return Arc::new([]);
    };
    let vertices: Vec<_> = mask.vertices.iter().map(|v| Vec2::new(v.x, v.y)).collect();
    triangles(&vertices, &mask.indices)
}

/// Those that are there and finite.
fn triangles(vertices: &[Vec2], indices: &[u32]) -> HiddenParts {
    let corner = |index: &u32| vertices.get(*index as usize).filter(|v| v.is_finite());
    let triangle = |corners: &[u32]| match corners {
        [a, b, c] => Some([*corner(a)?, *corner(b)?, *corner(c)?]),
        _ => None,
    };
    indices.chunks(3).filter_map(triangle).collect()
}

/// Where in an image a direction is seen, of its tangents: (0, 0) top left.
fn place_in_image(fov: FieldOfView, tangents: Vec2) -> Vec2 {
    let [left, right, up, down] = [fov.left, fov.right, fov.up, fov.down].map(f32::tan);
    Vec2::new(
        (tangents.x - left) / (right - left),
        (up - tangents.y) / (up - down),
    )
}

/// Tangents of where the eyes look, seen from one of them; `None` for what is behind it.
fn tangents_of(eye: &EyeView, gaze: Isometry3d) -> Option<Vec2> {
    let ahead = eye.pose.rotation.inverse() * (gaze.rotation * Vec3::NEG_Z);
    let tangents = Vec2::new(ahead.x, ahead.y) / -ahead.z;
    (ahead.z < -0.1 && tangents.is_finite()).then_some(tangents)
}

/// How an eye's samples are spread.
fn sampling(
    eye: &EyeView,
    hidden: &HiddenParts,
    foveation: Option<&Foveation>,
    gaze: Option<Isometry3d>,
    former: &VolumeSampling,
    former_hidden: Option<&(FieldOfView, HiddenParts)>,
) -> VolumeSampling {
    let fov = eye.fov;
    let is_same =
        former_hidden.is_some_and(|(other, parts)| *other == fov && Arc::ptr_eq(parts, hidden));
    let hidden = if is_same {
        Arc::clone(&former.hidden)
    } else {
        let triangles = hidden.iter();
        triangles
            .map(|corners| corners.map(|corner| place_in_image(fov, corner)))
            .collect()
    };
    let Some(foveation) = foveation else {
        return VolumeSampling {
            gaze: former.gaze,
            fovea: former.fovea,
            far: former.far,
            periphery: 1.0,
            hidden,
        };
    };
    let gaze = gaze.filter(|_| foveation.follows_gaze);
    let tangents = gaze.and_then(|gaze| tangents_of(eye, gaze));
    let gaze = place_in_image(fov, tangents.unwrap_or(Vec2::ZERO));
    let height = fov.up.tan() - fov.down.tan();
    let radius = |angle: f32| angle.clamp(0.0, 1.5).tan() / height;
    // A gaze that rests makes no other map.
    let moves = gaze.distance(former.gaze) > GAZE_STEP || tangents.is_none();
    VolumeSampling {
        gaze: if moves { gaze } else { former.gaze },
        fovea: radius(foveation.fovea),
        far: radius(foveation.far),
        periphery: foveation.periphery,
        hidden,
    }
}

/// `First`, after the eyes are placed.
pub(crate) fn update(
    frame: Res<CurrentFrame>,
    settings: Res<MixedRealitySettings>,
    mut eyes: Query<(&EyeCamera, &mut VolumeSampling)>,
    mut former: Local<[Option<(FieldOfView, HiddenParts)>; 2]>,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let (Some(shared), Some(views)) = (&frame.shared, &frame.views) else {
        return;
    };
    let synthetic = settings.synthetic_sight.as_deref();
    let hidden = match synthetic {
        Some(synthetic) => synthetic.hidden.clone(),
        None => shared.hidden(),
    };
    let gaze = synthetic.map_or(frame.gaze, |synthetic| synthetic.gaze);
    for (eye, mut current) in &mut eyes {
        let (Some(view), Some(parts)) = (views.get(eye.0), hidden.get(eye.0)) else {
            continue;
        };
        let foveation = settings.foveation.as_ref();
        let was = former[eye.0].as_ref();
        let wanted = sampling(view, parts, foveation, gaze, &current, was);
        former[eye.0] = Some((view.fov, Arc::clone(parts)));
        if *current != wanted {
            *current = wanted;
        }
    }
}

/// Instead of what the runtime says of sight: for tests.
#[doc(hidden)]
#[derive(Clone, Debug)]
pub struct SyntheticSight {
    /// Left and right; triangles of tangents.
    pub hidden: [Arc<[[Vec2; 3]]>; 2],
    /// In tracking space, −z.
    pub gaze: Option<Isometry3d>,
}

#[cfg(test)]
mod tests {
    use super::*;

    const FOV: FieldOfView = FieldOfView {
        left: -0.9,
        right: 0.6,
        up: 0.7,
        down: -0.8,
    };

    fn eye(rotation: Quat) -> EyeView {
        EyeView {
            pose: Isometry3d::new(Vec3::new(0.03, 1.6, 0.0), rotation),
            fov: FOV,
        }
    }

    #[test]
    fn edges_of_the_field_of_view_are_edges_of_the_image() {
        let corner = |x: f32, y: f32| place_in_image(FOV, Vec2::new(x.tan(), y.tan()));
        assert!(corner(FOV.left, FOV.up).distance(Vec2::ZERO) < 1e-6);
        assert!(corner(FOV.right, FOV.down).distance(Vec2::ONE) < 1e-6);
    }

    #[test]
    fn what_isnt_a_triangle_is_left_out() {
        let vertices = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::NAN];
        let found = triangles(&vertices, &[0, 1, 2, 0, 1, 3, 0, 1, 9, 2, 1]);
        assert_eq!(*found, [[Vec2::ZERO, Vec2::X, Vec2::Y]]);
    }

    #[test]
    fn the_fovea_follows_the_gaze_as_the_eye_sees_it() {
        let foveation = Foveation::default();
        let turned = Quat::from_rotation_y(0.2);
        let none: HiddenParts = Arc::new([]);
        let former = VolumeSampling::default();
        let of = |rotation: Quat, gaze: Option<Quat>| {
            let gaze = gaze.map(Isometry3d::from_rotation);
            sampling(&eye(rotation), &none, Some(&foveation), gaze, &former, None)
        };
        // The eye's turn takes the gaze along; a gaze to the left of it is left in the image.
        let ahead = place_in_image(FOV, Vec2::ZERO);
        assert!(of(turned, None).gaze.distance(ahead) < 1e-6);
        assert!(of(turned, Some(turned)).gaze.distance(ahead) < 1e-5);
        let left = of(Quat::IDENTITY, Some(Quat::from_rotation_y(0.3))).gaze;
        let expected = place_in_image(FOV, Vec2::new(-0.3_f32.tan(), 0.0));
        assert!(left.distance(expected) < 1e-5 && left.x < ahead.x);
        // Behind the eye there is nothing to follow.
        let behind = of(Quat::IDENTITY, Some(Quat::from_rotation_y(3.0)));
        assert!(behind.gaze.distance(ahead) < 1e-6);
        let fixed = Foveation {
            follows_gaze: false,
            ..foveation
        };
        let gaze = Some(Isometry3d::from_rotation(Quat::from_rotation_y(0.3)));
        let fixed = sampling(
            &eye(Quat::IDENTITY),
            &none,
            Some(&fixed),
            gaze,
            &former,
            None,
        );
        assert!(fixed.gaze.distance(ahead) < 1e-6);
    }

    #[test]
    fn a_gaze_that_hardly_moves_makes_no_other_map() {
        let foveation = Foveation::default();
        let none: HiddenParts = Arc::new([]);
        let look = |angle: f32, former: &VolumeSampling| {
            let gaze = Some(Isometry3d::from_rotation(Quat::from_rotation_y(angle)));
            sampling(
                &eye(Quat::IDENTITY),
                &none,
                Some(&foveation),
                gaze,
                former,
                None,
            )
        };
        let first = look(0.2, &VolumeSampling::default());
        assert_eq!(look(0.205, &first), first);
        assert_ne!(look(0.3, &first), first);
    }
}

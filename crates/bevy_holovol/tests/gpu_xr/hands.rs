//! What hands do is seen, by both eyes.

use bevy::math::{DVec2, Isometry3d};
use bevy::prelude::*;
use bevy_holovol::Graspable;
use bevy_holovol::interaction::{Hand, Hands, InteractionMarks, InteractionSystems};
use bevy_holovol::xr::CapturedFrame;

use crate::app::*;

pub const TESTS: &[crate::Test] = &[(
    "boxes_and_rays_are_seen_in_both_eyes_and_hidden_by_volumes",
    boxes_and_rays_are_seen,
)];

/// The volume's middle and half its size, m; the simulated head is 1.6 m above the floor.
const MIDDLE: Vec3 = Vec3::new(0.0, 1.6, -0.8);
const HALF: Vec3 = Vec3::new(0.15, 0.12, 0.1);
const HAND: Vec3 = Vec3::new(0.15, 1.5, -0.45);

/// How near the colours around a place come to one.
fn distance(frame: &CapturedFrame, eye: usize, at: Vec3, color: Color) -> f32 {
    let picture = linear(frame, eye);
    let [x, y] = project(&frame.views[eye], frame.size, at).map(|n| n as usize);
    let around = (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| (x, y)));
    let wanted = color.to_linear().to_vec3();
    around
        .map(|(x, y)| picture[y * frame.size[0] as usize + x])
        .map(|[r, g, b, _]| Vec3::new(r, g, b).distance(wanted))
        .fold(f32::INFINITY, f32::min)
}

/// Whether a corner of the back is seen well within the front's edges and beside the ray, wherever
/// the simulated head has got to.
fn is_behind(frame: &CapturedFrame, eye: usize, back: Vec3) -> bool {
    let place = |at: Vec3| DVec2::from(project(&frame.views[eye], frame.size, at));
    let at = place(back);
    let around = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let around = around.map(|(x, y)| place(MIDDLE + 1.05 * HALF * Vec3::new(x, y, 1.0)));
    let inside = (0..4).all(|i| {
        let [from, to] = [around[i], around[(i + 1) % 4]];
        // Pixel rows go down: the corners go round clockwise.
        (to - from).normalize().perp_dot(at - from) < -4.0
    });
    let [from, to] = [HAND, MIDDLE].map(place);
    let part = ((at - from).dot(to - from) / from.distance_squared(to)).clamp(0.0, 1.0);
    inside && at.distance(from.lerp(to, part)) > 6.0
}

fn boxes_and_rays_are_seen() {
    let mut app = app(settings());
    let place = Transform::from_translation(MIDDLE);
    // Black, and nothing is seen through it.
    let matter = function(4000.0, [0.0; 3]);
    let volume = spawn_volume(&mut app, solid(2.0 * HALF), matter, place);
    app.world_mut()
        .entity_mut(volume)
        .insert(Graspable::default());
    #[derive(Resource, Default)]
    struct Shown(Hands);
    app.init_resource::<Shown>().add_systems(
        PreUpdate,
        (|shown: Res<Shown>, mut hands: ResMut<Hands>| *hands = shown.0).before(InteractionSystems),
    );
    show(&mut app);
    let aim = Transform::from_translation(HAND).looking_at(MIDDLE, Vec3::Y);
    let hand = Hand {
        aim: Some(aim.to_isometry()),
        grip: Some(Isometry3d::from_translation(HAND)),
        ..default()
    };
    let marks = InteractionMarks::default();
    let corner = |x: f32, y: f32, z: f32| MIDDLE + 1.05 * HALF * Vec3::new(x, y, z);
    let front = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
    // Of what the volume doesn't hide.
    let seen = |frame: &CapturedFrame, eye: usize| {
        let corners = front.map(|(x, y)| distance(frame, eye, corner(x, y, 1.0), marks.idle));
        let hidden: Vec<f32> = front
            .map(|(x, y)| corner(x, y, -1.0))
            .into_iter()
            .filter(|back| is_behind(frame, eye, *back))
            .map(|back| distance(frame, eye, back, marks.idle))
            .collect();
        let ray = distance(frame, eye, HAND.lerp(MIDDLE, 0.4), marks.hover);
        let grip = distance(frame, eye, HAND, marks.hover);
        eprintln!("eye {eye}: {corners:.2?}, hidden {hidden:.2?}, ray {ray:.2}, {grip:.2}");
        (corners, hidden, ray.max(grip))
    };
    for is_there in [false, true, false] {
        let mut shown = Hands::default();
        if is_there {
            shown.0[1] = hand;
        }
        app.insert_resource(Shown(shown));
        for _ in 0..3 {
            app.update();
        }
        let behind = |frame: &CapturedFrame, eye: usize| {
            front
                .map(|(x, y)| corner(x, y, -1.0))
                .iter()
                .any(|back| is_behind(frame, eye, *back))
        };
        let mut frame = capture(&mut app);
        for _ in 0..200 {
            if (0..2).all(|eye| behind(&frame, eye)) {
                break;
            }
            frame = capture(&mut app);
        }
        for eye in 0..2 {
            let (corners, hidden, ray) = seen(&frame, eye);
            assert!(!hidden.is_empty(), "the head stays where it sees all sides");
            assert!(hidden.iter().all(|d| *d > 0.4), "behind a volume");
            if is_there {
                assert!(corners.iter().all(|d| *d < 0.1) && ray < 0.25);
            } else {
                assert!(corners.iter().all(|d| *d > 0.5) && ray > 0.5);
            }
        }
    }
}

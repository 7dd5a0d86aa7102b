//! Streams of hands, made up, and what they must do.

use std::f32::consts::{FRAC_PI_2, PI};

use super::*;

const DT: f32 = 1.0 / 90.0;

fn cube() -> Grabbable {
    Grabbable {
        placement: Placement::IDENTITY,
        half_size: Vec3::splat(0.1),
        has_handles: true,
        scale_limits: [0.1, 10.0],
    }
}

/// A hand that grasps at a place, and points nowhere.
fn hand(place: Vec3, squeeze: f32) -> Hand {
    Hand {
        grip: Some(Isometry3d::from_translation(place)),
        aim: None,
        squeeze,
        poke: None,
    }
}

fn turned(place: Vec3, rotation: Quat, squeeze: f32) -> Hand {
    Hand {
        grip: Some(Isometry3d::new(place, rotation)),
        ..hand(place, squeeze)
    }
}

fn instant() -> Interaction {
    Interaction {
        settings: InteractionSettings {
            smoothing: 0.0,
            ..Default::default()
        },
        ..Default::default()
    }
}

const AWAY: Hand = Hand {
    grip: None,
    aim: None,
    squeeze: 0.0,
    poke: None,
};

fn left(hand: Hand) -> Hands {
    Hands([hand, AWAY])
}

#[track_caller]
fn assert_at(thing: &Grabbable, place: Vec3) {
    let found = thing.placement.translation;
    assert!(found.distance(place) < 1e-4, "{found}, expected {place}");
}

#[test]
fn one_hand_moves_and_turns_with_the_offset_that_it_had() {
    let mut things = [cube()];
    let mut interaction = instant();
    let start = Vec3::new(0.05, 0.0, 0.0);
    interaction.update(&left(hand(start, 0.0)), &mut things, DT);
    interaction.update(&left(hand(start, 1.0)), &mut things, DT);
    assert_at(&things[0], Vec3::ZERO);
    assert_eq!(interaction.held(0), Some(0));
    let moved = start + Vec3::new(0.3, 0.2, -0.1);
    interaction.update(&left(hand(moved, 1.0)), &mut things, DT);
    assert_at(&things[0], Vec3::new(0.3, 0.2, -0.1));
    let turn = Quat::from_rotation_y(FRAC_PI_2);
    interaction.update(&left(turned(start, turn, 1.0)), &mut things, DT);
    // The middle was 5 cm to the left of the hand; now that is 5 cm behind it.
    assert_at(&things[0], start + turn * Vec3::new(-0.05, 0.0, 0.0));
    assert!(things[0].placement.rotation.angle_between(turn) < 1e-3);
    interaction.update(&left(hand(start, 0.2)), &mut things, DT);
    assert_eq!(interaction.held(0), None);
    let before = things[0];
    interaction.update(&left(hand(Vec3::ONE, 0.2)), &mut things, DT);
    assert_eq!(things[0], before, "let go");
}

#[test]
fn squeezes_between_the_thresholds_change_nothing() {
    let mut things = [cube()];
    let mut interaction = instant();
    let mut squeeze = |value: f32| {
        interaction.update(&left(hand(Vec3::ZERO, value)), &mut things, DT);
        interaction.held(0).is_some()
    };
    assert!(!squeeze(0.0));
    assert!(!squeeze(0.7), "not yet");
    assert!(squeeze(0.85));
    assert!(squeeze(0.6), "still");
    assert!(!squeeze(0.4));
    assert!(!squeeze(0.7), "not again");
    assert!(!squeeze(f32::NAN));
}

#[test]
fn a_fist_that_comes_along_takes_nothing() {
    let mut things = [cube()];
    let mut interaction = instant();
    interaction.update(&left(hand(Vec3::ONE, 1.0)), &mut things, DT);
    interaction.update(&left(hand(Vec3::ZERO, 1.0)), &mut things, DT);
    assert_eq!(interaction.held(0), None);
}

#[test]
fn things_follow_smoothly_whatever_the_frame_rate() {
    let after = |frames: u32| {
        let mut things = [cube()];
        let mut interaction = Interaction::default();
        interaction.update(&left(hand(Vec3::ZERO, 0.0)), &mut things, DT);
        interaction.update(&left(hand(Vec3::ZERO, 1.0)), &mut things, DT);
        for _ in 0..frames {
            let moved = left(hand(Vec3::X, 1.0));
            interaction.update(&moved, &mut things, 0.04 / frames as f32);
        }
        things[0].placement.translation.x
    };
    let expected = 1.0 - (-1.0_f32).exp();
    for frames in [1, 4, 40] {
        assert!((after(frames) - expected).abs() < 1e-3, "{frames} frames");
    }
}

#[test]
fn two_hands_move_scale_and_turn_about_their_middle() {
    let mut things = [cube()];
    let mut interaction = instant();
    let at = |a: Vec3, b: Vec3, squeeze| Hands([hand(a, squeeze), hand(b, squeeze)]);
    let (a, b) = (Vec3::new(-0.09, 0.0, 0.02), Vec3::new(0.09, 0.0, 0.02));
    interaction.update(&at(a, b, 0.0), &mut things, DT);
    interaction.update(&at(a, b, 1.0), &mut things, DT);
    assert_at(&things[0], Vec3::ZERO);
    // Twice as far apart: the middle between the hands stays where it is in the thing.
    interaction.update(&at(2.0 * a, 2.0 * b, 1.0), &mut things, DT);
    let placement = things[0].placement;
    assert!((placement.scale - 2.0).abs() < 1e-4);
    let middle = Vec3::new(0.0, 0.0, 0.04);
    assert!((placement.to_world((a + b) / 2.0) - middle).length() < 1e-4);
    // Three quarters of a turn about +y, in steps.
    for step in 0..=27 {
        let turn = Quat::from_rotation_y(1.5 * PI * step as f32 / 27.0);
        interaction.update(&at(turn * a, turn * b, 1.0), &mut things, DT);
    }
    let expected = Quat::from_rotation_y(1.5 * PI);
    let placement = things[0].placement;
    assert!((placement.scale - 1.0).abs() < 1e-3);
    assert!(placement.rotation.angle_between(expected) < 1e-2);
    // Each hand's point of the thing is still under it.
    assert!((placement.to_world(a) - expected * a).length() < 1e-3);
}

#[test]
fn letting_go_with_one_of_two_hands_does_not_jump() {
    let mut things = [cube()];
    let mut interaction = instant();
    let (a, b) = (Vec3::new(-0.05, 0.0, 0.0), Vec3::new(0.05, 0.0, 0.0));
    interaction.update(&Hands([hand(a, 0.0), hand(b, 0.0)]), &mut things, DT);
    interaction.update(&Hands([hand(a, 1.0), hand(b, 1.0)]), &mut things, DT);
    let wide = Vec3::new(0.2, 0.1, 0.0);
    interaction.update(&Hands([hand(a, 1.0), hand(wide, 1.0)]), &mut things, DT);
    let before = things[0].placement;
    interaction.update(&Hands([hand(a, 0.0), hand(wide, 1.0)]), &mut things, DT);
    let after = things[0].placement;
    assert!(before.translation.distance(after.translation) < 1e-5);
    assert!((before.scale - after.scale).abs() < 1e-5);
    assert_eq!((interaction.held(0), interaction.held(1)), (None, Some(0)));
    let moved = hand(wide + Vec3::Y, 1.0);
    interaction.update(&Hands([hand(a, 0.0), moved]), &mut things, DT);
    assert_at(&things[0], before.translation + Vec3::Y);
}

#[test]
fn scale_stays_within_its_limits() {
    let mut things = [Grabbable {
        scale_limits: [0.5, 2.0],
        ..cube()
    }];
    let mut interaction = instant();
    let at = |span: f32, squeeze| {
        let half = Vec3::X * span / 2.0;
        Hands([hand(-half, squeeze), hand(half, squeeze)])
    };
    interaction.update(&at(0.1, 0.0), &mut things, DT);
    interaction.update(&at(0.1, 1.0), &mut things, DT);
    for (span, scale) in [(1.0, 2.0), (0.03, 0.5), (0.0, 0.5), (0.1, 1.0)] {
        interaction.update(&at(span, 1.0), &mut things, DT);
        let found = things[0].placement.scale;
        assert!((found - scale).abs() < 1e-4, "{span} m: {found}");
    }
}

#[test]
fn a_ray_takes_from_afar_and_keeps_its_length() {
    let mut things = [cube()];
    let mut interaction = instant();
    let from = Vec3::new(0.0, 0.0, 2.0);
    let ray = |rotation: Quat, squeeze| Hand {
        grip: Some(Isometry3d::from_translation(from)),
        aim: Some(Isometry3d::new(from, rotation)),
        squeeze,
        poke: None,
    };
    interaction.update(&left(ray(Quat::IDENTITY, 0.0)), &mut things, DT);
    interaction.update(&left(ray(Quat::IDENTITY, 1.0)), &mut things, DT);
    assert_eq!(interaction.held(0), Some(0));
    assert_at(&things[0], Vec3::ZERO);
    let aside = Quat::from_rotation_y(0.3);
    interaction.update(&left(ray(aside, 1.0)), &mut things, DT);
    assert_at(&things[0], from + aside * Vec3::new(0.0, 0.0, -2.0));
    // Past it, nothing is taken.
    let mut interaction = instant();
    let up = Quat::from_rotation_x(0.5);
    interaction.update(&left(ray(up, 0.0)), &mut things, DT);
    interaction.update(&left(ray(up, 1.0)), &mut things, DT);
    assert_eq!(interaction.held(0), None);
}

#[test]
fn the_nearer_of_two_things_is_taken() {
    let mut near = cube();
    near.placement.translation = Vec3::new(0.0, 0.0, 1.0);
    let mut things = [cube(), near];
    let mut interaction = instant();
    let from = Vec3::new(0.0, 0.0, 3.0);
    let ray = |squeeze| Hand {
        aim: Some(Isometry3d::from_translation(from)),
        ..hand(from, squeeze)
    };
    interaction.update(&left(ray(0.0)), &mut things, DT);
    interaction.update(&left(ray(1.0)), &mut things, DT);
    assert_eq!(interaction.held(0), Some(1));
}

#[test]
fn a_corner_scales_about_the_opposite_one() {
    let mut things = [cube()];
    let mut interaction = instant();
    let corner = Vec3::splat(0.1);
    interaction.update(&left(hand(corner, 0.0)), &mut things, DT);
    let hovered = Interaction::hovered(&hand(corner, 0.0), &things);
    let hovered = hovered.map(|reached| (reached.thing, reached.handle, reached.far));
    assert_eq!(hovered, Some((0, Some(Handle::Corner(7)), None)));
    interaction.update(&left(hand(corner, 1.0)), &mut things, DT);
    // The diagonal from the opposite corner becomes three times as long.
    let pulled = -corner + 3.0 * (2.0 * corner);
    interaction.update(&left(hand(pulled, 1.0)), &mut things, DT);
    let placement = things[0].placement;
    assert!((placement.scale - 3.0).abs() < 1e-4);
    assert!(placement.to_world(-corner).distance(-corner) < 1e-4);
    assert!(placement.to_world(corner).distance(pulled) < 1e-4);
}

#[test]
fn an_edge_turns_about_its_own_direction() {
    let mut things = [cube()];
    let mut interaction = instant();
    let edge = Vec3::new(0.1, 0.0, 0.1);
    interaction.update(&left(hand(edge, 0.0)), &mut things, DT);
    interaction.update(&left(hand(edge, 1.0)), &mut things, DT);
    for step in 1..=10 {
        let turn = Quat::from_rotation_y(0.1 * step as f32);
        // Farther out and higher up: only the angle counts.
        let place = turn * (1.5 * edge) + 0.2 * Vec3::Y;
        interaction.update(&left(hand(place, 1.0)), &mut things, DT);
    }
    let placement = things[0].placement;
    let expected = Quat::from_rotation_y(1.0);
    assert!(placement.rotation.angle_between(expected) < 1e-3);
    assert_at(&things[0], Vec3::ZERO);
    assert_eq!(placement.scale, 1.0);
}

#[test]
fn a_lost_hand_holds_on_for_a_while() {
    let mut things = [cube()];
    let mut interaction = instant();
    interaction.update(&left(hand(Vec3::ZERO, 0.0)), &mut things, DT);
    interaction.update(&left(hand(Vec3::ZERO, 1.0)), &mut things, DT);
    for _ in 0..20 {
        interaction.update(&left(AWAY), &mut things, 0.01);
    }
    assert_eq!(interaction.held(0), Some(0), "0.2 s");
    interaction.update(&left(hand(0.1 * Vec3::X, 1.0)), &mut things, DT);
    assert_at(&things[0], 0.1 * Vec3::X);
    for _ in 0..40 {
        interaction.update(&left(AWAY), &mut things, 0.01);
    }
    assert_eq!(interaction.held(0), None, "0.4 s");
    assert_at(&things[0], 0.1 * Vec3::X);
}

#[test]
fn garbage_changes_nothing() {
    let mut things = [cube()];
    let mut interaction = Interaction::default();
    interaction.update(&left(hand(Vec3::ZERO, 0.0)), &mut things, DT);
    interaction.update(&left(hand(Vec3::ZERO, 1.0)), &mut things, DT);
    let before = things[0];
    let nan = Vec3::splat(f32::NAN);
    for (place, rotation) in [
        (nan, Quat::IDENTITY),
        (Vec3::ONE, Quat::from_xyzw(0.0, 0.0, 0.0, 0.0)),
        (Vec3::ONE, Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0)),
        (Vec3::INFINITY, Quat::IDENTITY),
    ] {
        let grip = Isometry3d {
            translation: place.into(),
            rotation,
        };
        let garbage = Hand {
            grip: Some(grip),
            aim: Some(grip),
            squeeze: 1.0,
            poke: None,
        };
        interaction.update(&Hands([garbage, garbage]), &mut things, f32::NAN);
        interaction.update(&Hands([garbage, garbage]), &mut things, 0.001);
        assert!(things[0].placement.is_valid());
        assert_at(&things[0], before.placement.translation);
    }
}

#[test]
fn things_may_go_while_they_are_held() {
    let mut things = vec![cube()];
    let mut interaction = instant();
    interaction.update(&left(hand(Vec3::ZERO, 0.0)), &mut things, DT);
    interaction.update(&left(hand(Vec3::ZERO, 1.0)), &mut things, DT);
    things.clear();
    interaction.update(&left(hand(Vec3::X, 1.0)), &mut things, DT);
    interaction.update(&left(AWAY), &mut things, DT);
    assert_eq!(interaction.held(0), None);
}

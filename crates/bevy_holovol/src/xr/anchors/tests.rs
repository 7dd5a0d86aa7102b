//! Anchors of made-up runtimes: no real one that has any was at hand.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use super::*;

/// A room in which tracking space can shift.
#[derive(Default)]
struct Room {
    /// The present tracking space from the one at first.
    shift: Cell<Isometry3d>,
    is_tracked: Cell<bool>,
    refuses: Cell<bool>,
    set: RefCell<Vec<Isometry3d>>,
    alive: Rc<Cell<i32>>,
}

struct Stone {
    pose: Isometry3d,
    alive: Rc<Cell<i32>>,
}

impl Drop for Stone {
    fn drop(&mut self) {
        self.alive.set(self.alive.get() - 1);
    }
}

impl AnchorSource for Room {
    type Anchor = Stone;

    fn set(&self, pose: Isometry3d) -> Option<Stone> {
        if self.refuses.get() {
            return None;
        }
        self.set.borrow_mut().push(pose);
        self.alive.set(self.alive.get() + 1);
        Some(Stone {
            pose: self.shift.get().inverse() * pose,
            alive: Rc::clone(&self.alive),
        })
    }

    fn find(&self, stone: &Stone) -> Option<Isometry3d> {
        self.is_tracked.get().then(|| self.shift.get() * stone.pose)
    }
}

struct Stage {
    world: World,
    room: Room,
    anchors: Anchors<Stone>,
    place: Isometry3d,
    held: Option<Entity>,
}

impl Stage {
    fn new() -> Self {
        let room = Room::default();
        room.is_tracked.set(true);
        let turned = Quat::from_rotation_y(0.4);
        Self {
            world: World::new(),
            room,
            anchors: Anchors::default(),
            place: Isometry3d::new(Vec3::new(1.0, 0.2, -3.0), turned),
            held: None,
        }
    }

    fn spawn(&mut self, place: Vec3) -> Entity {
        let transform = Transform::from_translation(place).with_scale(Vec3::splat(2.0));
        self.world.spawn(transform).id()
    }

    /// Frames of 0.1 s.
    fn run(&mut self, frames: u32) {
        for _ in 0..frames {
            let (room, anchors, place) = (&self.room, &mut self.anchors, self.place);
            let held = self.held;
            let mut things = self.world.query::<(Entity, &mut Transform)>();
            let things = things.iter_mut(&mut self.world);
            let things = things.map(|(entity, t)| (entity, held == Some(entity), t));
            anchors.update(room, place, 0.1, things);
        }
    }

    fn at(&self, entity: Entity) -> Transform {
        *self.world.get::<Transform>(entity).expect("there")
    }

    fn shift(&mut self, by: Vec3, turn: f32) {
        let shift = Isometry3d::new(by, Quat::from_rotation_y(turn));
        self.room.shift.set(shift);
    }

    fn anchors_set(&self) -> usize {
        self.room.set.borrow().len()
    }
}

#[track_caller]
fn assert_near(a: Vec3, b: Vec3) {
    assert!(a.distance(b) < 1e-4, "{a} {b}");
}

#[test]
fn what_rests_follows_the_room() {
    let mut stage = Stage::new();
    let thing = stage.spawn(Vec3::new(0.0, 1.0, -2.0));
    stage.run(4);
    assert_eq!(stage.anchors_set(), 0, "it might still move");
    stage.run(3);
    assert_eq!(stage.anchors_set(), 1);
    let in_tracking = stage.place.inverse() * Vec3::new(0.0, 1.0, -2.0);
    assert_near(stage.room.set.borrow()[0].translation.into(), in_tracking);
    // Tracking space shifts; in it the thing goes to where the room is now.
    stage.shift(Vec3::new(0.05, 0.0, 0.02), 0.03);
    stage.run(1);
    let moved = stage.at(thing);
    let shift = stage.room.shift.get();
    assert_near(moved.translation, stage.place * (shift * in_tracking));
    let turned = moved.rotation.to_euler(EulerRot::YXZ).0;
    assert!((turned - 0.03).abs() < 1e-4, "{turned}");
    assert_eq!(moved.scale, Vec3::splat(2.0));
    // Having followed isn't having been moved.
    stage.run(20);
    assert_eq!(stage.anchors_set(), 1);
    stage.shift(Vec3::ZERO, 0.0);
    stage.run(1);
    assert_near(stage.at(thing).translation, Vec3::new(0.0, 1.0, -2.0));
}

#[test]
fn what_is_moved_gets_another_anchor_where_it_is_put_down() {
    let mut stage = Stage::new();
    let thing = stage.spawn(Vec3::ZERO);
    stage.run(10);
    assert_eq!((stage.anchors_set(), stage.room.alive.get()), (1, 1));
    stage
        .world
        .get_mut::<Transform>(thing)
        .expect("there")
        .translation = Vec3::X;
    stage.run(1);
    assert_eq!(
        stage.room.alive.get(),
        0,
        "the old one is given back at once"
    );
    assert_near(stage.at(thing).translation, Vec3::X);
    stage.run(10);
    assert_eq!((stage.anchors_set(), stage.room.alive.get()), (2, 1));
    // In a hand nothing rests, and nothing pulls at it.
    stage.held = Some(thing);
    stage.shift(Vec3::Y, 0.0);
    stage.run(20);
    assert_eq!((stage.anchors_set(), stage.room.alive.get()), (2, 0));
    assert_near(stage.at(thing).translation, Vec3::X);
    stage.world.despawn(thing);
    stage.held = None;
    stage.run(1);
    assert!(stage.anchors.0.is_empty());
}

#[test]
fn what_cannot_be_found_stays() {
    let mut stage = Stage::new();
    let thing = stage.spawn(Vec3::Z);
    stage.run(10);
    stage.room.is_tracked.set(false);
    stage.shift(Vec3::X, 0.0);
    stage.run(5);
    assert_near(stage.at(thing).translation, Vec3::Z);
    assert_eq!(stage.room.alive.get(), 1, "it may be found again");
    stage.room.is_tracked.set(true);
    stage.run(1);
    let in_tracking = stage.place.inverse() * Vec3::Z;
    assert_near(
        stage.at(thing).translation,
        stage.place * (in_tracking + Vec3::X),
    );
}

#[test]
fn a_refused_anchor_is_asked_for_again_but_not_in_every_frame() {
    let mut stage = Stage::new();
    stage.spawn(Vec3::Z);
    stage.room.refuses.set(true);
    stage.run(7);
    stage.room.refuses.set(false);
    stage.run(10);
    assert_eq!(stage.anchors_set(), 0);
    stage.run(15);
    assert_eq!(stage.anchors_set(), 1);
}

#[test]
fn tremor_moves_nothing() {
    let mut stage = Stage::new();
    let thing = stage.spawn(Vec3::Z);
    stage.run(10);
    let changed = |stage: &Stage| {
        let thing = stage.world.entity(thing);
        thing.get_ref::<Transform>().expect("there").last_changed()
    };
    let before = changed(&stage);
    stage.world.increment_change_tick();
    stage.shift(Vec3::splat(5e-5), 2e-5);
    stage.run(3);
    assert_eq!(changed(&stage), before, "images would begin anew");
    assert_near(stage.at(thing).translation, Vec3::Z);
}

/// The runtime's side of the extension; handles are numbers.
#[expect(unsafe_code, reason = "a made-up runtime's functions")]
mod extension {
    use std::sync::atomic::{AtomicI32, Ordering};

    use super::*;

    static ANCHORS: AtomicI32 = AtomicI32::new(0);

    unsafe extern "system" fn create_anchor(
        session: sys::Session,
        info: *const sys::SpatialAnchorCreateInfoMSFT,
        anchor: *mut sys::SpatialAnchorMSFT,
    ) -> sys::Result {
        // SAFETY: as the specification has it.
        let info = unsafe { &*info };
        assert_eq!(session.into_raw(), 5);
        assert_eq!(info.ty, sys::StructureType::SPATIAL_ANCHOR_CREATE_INFO_MSFT);
        assert!(info.next.is_null());
        assert_eq!(info.space.into_raw(), 6);
        assert_eq!(info.time.as_nanos(), 99);
        let (q, p) = (info.pose.orientation, info.pose.position);
        assert_eq!(
            [p.x, p.y, p.z, q.x, q.y, q.z, q.w],
            [1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 0.0]
        );
        ANCHORS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: room for a handle.
        unsafe { *anchor = sys::SpatialAnchorMSFT::from_raw(7) };
        sys::Result::SUCCESS
    }

    unsafe extern "system" fn refuse_anchor(
        _: sys::Session,
        _: *const sys::SpatialAnchorCreateInfoMSFT,
        _: *mut sys::SpatialAnchorMSFT,
    ) -> sys::Result {
        sys::Result::ERROR_CREATE_SPATIAL_ANCHOR_FAILED_MSFT
    }

    unsafe extern "system" fn create_space(
        session: sys::Session,
        info: *const sys::SpatialAnchorSpaceCreateInfoMSFT,
        space: *mut sys::Space,
    ) -> sys::Result {
        // SAFETY: as the specification has it.
        let info = unsafe { &*info };
        assert_eq!(session.into_raw(), 5);
        assert_eq!(
            info.ty,
            sys::StructureType::SPATIAL_ANCHOR_SPACE_CREATE_INFO_MSFT
        );
        assert_eq!(info.anchor.into_raw(), 7);
        assert_eq!(info.pose_in_anchor_space.orientation.w, 1.0);
        // SAFETY: room for a handle.
        unsafe { *space = sys::Space::from_raw(8) };
        sys::Result::SUCCESS
    }

    unsafe extern "system" fn refuse_space(
        _: sys::Session,
        _: *const sys::SpatialAnchorSpaceCreateInfoMSFT,
        _: *mut sys::Space,
    ) -> sys::Result {
        sys::Result::ERROR_OUT_OF_MEMORY
    }

    unsafe extern "system" fn destroy_anchor(anchor: sys::SpatialAnchorMSFT) -> sys::Result {
        assert_eq!(anchor.into_raw(), 7);
        ANCHORS.fetch_sub(1, Ordering::Relaxed);
        sys::Result::SUCCESS
    }

    #[test]
    fn the_extension_is_asked_as_it_specifies() {
        let functions = raw::SpatialAnchorMSFT {
            create_spatial_anchor: create_anchor,
            create_spatial_anchor_space: create_space,
            destroy_spatial_anchor: destroy_anchor,
        };
        let (session, space) = (sys::Session::from_raw(5), sys::Space::from_raw(6));
        let pose = Isometry3d::new(
            Vec3::new(1.0, 2.0, 3.0),
            Quat::from_xyzw(0.0, 1.0, 0.0, 0.0),
        );
        let (pose, time) = (posef(&pose), Time::from_nanos(99));
        let ask = |functions: &raw::SpatialAnchorMSFT| {
            // SAFETY: the functions above take these numbers.
            unsafe { set(functions, session, space, pose, time) }
        };
        let (handle, made) = ask(&functions).expect("made");
        assert_eq!(made.into_raw(), 8);
        assert_eq!(ANCHORS.load(Ordering::Relaxed), 1);
        drop(handle);
        assert_eq!(ANCHORS.load(Ordering::Relaxed), 0);
        let result = |functions| ask(&functions).map(|_| ()).expect_err("refused");
        let refused = sys::Result::ERROR_CREATE_SPATIAL_ANCHOR_FAILED_MSFT;
        assert_eq!(
            result(raw::SpatialAnchorMSFT {
                create_spatial_anchor: refuse_anchor,
                ..functions
            }),
            refused
        );
        let full = sys::Result::ERROR_OUT_OF_MEMORY;
        assert_eq!(
            result(raw::SpatialAnchorMSFT {
                create_spatial_anchor_space: refuse_space,
                ..functions
            }),
            full
        );
        assert_eq!(
            ANCHORS.load(Ordering::Relaxed),
            0,
            "no anchor without a space"
        );
    }
}

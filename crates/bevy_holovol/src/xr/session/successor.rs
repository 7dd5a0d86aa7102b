//! Another graphics device for Bevy while the app runs: the one that a runtime found again wants.
//!
//! Bevy can go on with a new device after it has lost one. So it loses the one it has, and is given
//! the new one when it asks what to do.

use bevy::prelude::*;
use bevy::render::error_handler::{RenderError, RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::PollType;
use bevy::render::renderer::RenderDevice;
use bevy::render::sync_world::{RenderEntity, SyncToRenderWorld};

use super::super::graphics::DeviceParts;

type Handler = for<'a> fn(&'a RenderError, &'a mut World, &'a mut World) -> RenderErrorPolicy;

/// What Bevy is to go on with.
#[derive(Resource)]
pub(crate) struct Successor {
    coming: Option<DeviceParts>,
    /// What the app does about errors.
    app_handler: Handler,
}

impl Default for Successor {
    fn default() -> Self {
        Self {
            coming: None,
            app_handler: RenderErrorHandler::default().0,
        }
    }
}

impl Successor {
    /// Whether errors go to the app at once.
    pub(super) fn is_bypassed(handler: &RenderErrorHandler) -> bool {
        let ours: Handler = handle;
        !std::ptr::fn_addr_eq(handler.0, ours)
    }

    /// Hears of errors before the app does, which may change its mind at any time.
    pub(super) fn listen(&mut self, handler: &mut RenderErrorHandler) {
        if Self::is_bypassed(handler) {
            self.app_handler = handler.0;
            handler.0 = handle;
        }
    }

    /// Takes Bevy's device away. Between two frames only: within one Bevy doesn't expect it.
    pub(super) fn announce(&mut self, parts: DeviceParts, former: &RenderDevice) {
        self.coming = Some(parts);
        self.take_away(former);
    }

    /// Takes one away that isn't the one to come.
    pub(super) fn take_away(&self, former: &RenderDevice) {
        let former = former.wgpu_device();
        // What Bevy reads back doesn't expect it either. One that is lost already has nothing to
        // wait for.
        let _ = former.poll(PollType::wait_indefinitely());
        former.destroy();
        // Only then do those who asked hear of it.
        let _ = former.poll(PollType::Poll);
    }

    /// Bevy has it: errors are the app's again.
    pub(super) fn arrive(&mut self) {
        self.coming = None;
    }
}

/// May be asked more than once: what still used the former device says so, too.
fn handle(error: &RenderError, world: &mut World, render_world: &mut World) -> RenderErrorPolicy {
    let Some(successor) = world.get_resource::<Successor>() else {
        return RenderErrorHandler::default().0(error, world, render_world);
    };
    let policy = match &successor.coming {
        Some(parts) => RenderErrorPolicy::Recover(parts.clone().into_creation()),
        None => (successor.app_handler)(error, world, render_world),
    };
    if matches!(policy, RenderErrorPolicy::Recover(_)) {
        forget_views(world);
    }
    policy
}

/// In the render world all views begin anew. Bevy 0.19 keeps buffers of views that aren't drawn for
/// now, as those of the eyes without a session, and would write into them though their device is
/// gone. Only now is nothing under way that concerns the views in the render world.
fn forget_views(world: &mut World) {
    let mut views = world.query_filtered::<Entity, (With<Camera>, With<RenderEntity>)>();
    let views: Vec<_> = views.iter(world).collect();
    for view in views {
        let mut view = world.entity_mut(view);
        view.remove::<SyncToRenderWorld>();
        view.remove::<RenderEntity>();
        view.insert(SyncToRenderWorld);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::render::error_handler::ErrorType;

    #[derive(Resource)]
    struct Asked(u32);

    #[test]
    fn other_errors_are_the_apps() {
        let mut handler = RenderErrorHandler(|_, world, _| {
            world.resource_mut::<Asked>().0 += 1;
            RenderErrorPolicy::Ignore
        });
        let mut successor = Successor::default();
        // Twice: what is ours already isn't the app's.
        successor.listen(&mut handler);
        successor.listen(&mut handler);
        let [mut main, mut render] = [World::new(), World::new()];
        main.insert_resource(successor);
        main.insert_resource(Asked(0));
        let error = RenderError {
            ty: ErrorType::DeviceLost,
            description: String::new(),
            source: None,
        };
        let policy = handler.0(&error, &mut main, &mut render);
        assert!(matches!(policy, RenderErrorPolicy::Ignore));
        assert_eq!(main.resource::<Asked>().0, 1);
    }
}

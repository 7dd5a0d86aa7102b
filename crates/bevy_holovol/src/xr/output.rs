//! Pictures that meet a real room: takes the place of Bevy's tone mapping in views whose opacity
//! counts.

use bevy::prelude::*;
use bevy::render::extract_component::ExtractComponent;
use bevy::render::renderer::{RenderContext, RenderDevice, ViewQuery};
use bevy::render::view::ViewTarget;

use super::cost::FrameCost;
use super::screen::{Screen, ScreenPass};

/// On a camera without tone mapping of its own: its picture is laid over a room.
#[derive(Component, ExtractComponent, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum RoomOutput {
    /// Premultiplied by opacity, which comes along.
    Alpha,
    /// Premultiplied; light that is added needs no opacity.
    Additive,
}

impl RoomOutput {
    fn pass(self) -> ScreenPass {
        match self {
            Self::Alpha => ScreenPass::Alpha,
            Self::Additive => ScreenPass::Additive,
        }
    }
}

/// `Core3d`, where Bevy maps tones.
pub(crate) fn map_tones(
    view: ViewQuery<(&ViewTarget, &RoomOutput)>,
    mut screen: ResMut<Screen>,
    device: Res<RenderDevice>,
    mut ctx: RenderContext,
    cost: Res<FrameCost>,
) {
    let _counting = cost.count();
    let (target, output) = view.into_inner();
    let (pass, format) = (output.pass(), target.main_texture_format());
    let post_process = target.post_process_write();
    let source = post_process.source;
    if let Err(error) = screen.prepare(device.wgpu_device(), pass, source, format) {
        error_once!("{error}");
        return;
    }
    let _in_driver = cost.in_driver();
    let target = post_process.destination;
    screen.draw(ctx.command_encoder(), pass, source, target, format);
}

//! What both eyes see, in the window beside the headset.

use bevy::prelude::*;
use bevy_egui::{EguiContexts, EguiPrimaryContextPass, EguiTextureHandle, egui};
use bevy_holovol::xr::{EyeImages, HeadsetStatus};

/// Points that an eye is wide.
const WIDTH: f32 = 240.0;

/// Shows the eyes' images in the preview's window.
pub(super) struct MirrorPlugin {
    /// From the beginning; else folded.
    pub(super) is_open: bool,
}

#[derive(Resource)]
struct Mirror {
    is_open: bool,
    /// Those that egui knows.
    images: [Handle<Image>; 2],
}

impl Plugin for MirrorPlugin {
    fn build(&self, app: &mut App) {
        app.insert_resource(Mirror {
            is_open: self.is_open,
            images: default(),
        })
        .add_systems(EguiPrimaryContextPass, draw);
    }
}

fn draw(
    mut contexts: EguiContexts,
    mut mirror: ResMut<Mirror>,
    eyes: Res<EyeImages>,
    status: Res<HeadsetStatus>,
) -> Result {
    if mirror.images != eyes.images {
        for image in &mirror.images {
            contexts.remove_image(image);
        }
        mirror.images.clone_from(&eyes.images);
    }
    let textures = eyes
        .images
        .each_ref()
        .map(|image| contexts.add_image(EguiTextureHandle::Weak(image.id())));
    let size = status.eye_size.max(UVec2::ONE).as_vec2();
    let shown = egui::vec2(WIDTH, WIDTH * size.y / size.x);
    let context = contexts.ctx_mut()?;
    egui::Window::new("Eyes")
        .default_open(mirror.is_open)
        .default_pos([16.0, 16.0])
        .resizable(false)
        .show(context, |ui| {
            ui.horizontal(|ui| {
                for (texture, name) in textures.into_iter().zip(["Left", "Right"]) {
                    ui.image((texture, shown)).on_hover_text(name);
                }
            });
        });
    Ok(())
}

//! The tracer of live views gives what the offline one gives, and does no more than it must.

use std::sync::Arc;

use glam::{DMat4, DVec3, DVec4};
use holovol_render::testing::beginning_seed;
use holovol_render::wgpu;
use holovol_render::{
    DepthSource, FrameTracer, FrameWork, Gpu, GpuEnvironment, GpuVolume, Interpolation, Kernels,
    Medium, MeshDepth, TraceOptions, Tracer, View, ViewFrame,
};
use holovol_scene::{Camera, Scene};
use holovol_volume::{TransferFunction, Voxels};

use super::scenes;

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

fn tracer(gpu: &Gpu, scene: &Scene, options: &TraceOptions) -> Result<FrameTracer, String> {
    let kernels = Arc::new(Kernels::new(gpu).map_err(text)?);
    let volume = GpuVolume::new(gpu, &scene.volume, Interpolation::Exact, false).map_err(text)?;
    let environment = GpuEnvironment::new(gpu, &scene.environment.map).map_err(text)?;
    let tracer = FrameTracer::new(
        gpu,
        Arc::clone(&kernels),
        Arc::new(volume),
        Arc::new(environment),
        Medium::from_scene(scene),
        options.clone(),
    )
    .map_err(text)?;
    kernels.wait();
    Ok(tracer)
}

fn view(slot: usize, camera: &Camera, samples: u32, max_samples: u32) -> ViewFrame {
    ViewFrame {
        slot,
        view: View::from_camera(camera),
        samples,
        max_samples,
        restart: false,
        mesh_depth: None,
    }
}

/// One frame, submitted and waited for.
fn frame(
    gpu: &Gpu,
    tracer: &mut FrameTracer,
    views: &[ViewFrame],
    depth: Option<&MeshDepth>,
) -> Result<FrameWork, String> {
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    let mut work = tracer.record(&mut encoder, views, depth).map_err(text)?;
    if work.is_waiting {
        tracer.wait_for_kernels();
        work = tracer.record(&mut encoder, views, depth).map_err(text)?;
    }
    gpu.queue.submit([encoder.finish()]);
    let wait = wgpu::PollType::wait_indefinitely();
    gpu.device.poll(wait).map_err(text)?;
    Ok(work)
}

fn bits(image: &[[f32; 4]]) -> Vec<[u32; 4]> {
    image.iter().map(|pixel| pixel.map(f32::to_bits)).collect()
}

fn offline(gpu: &Gpu, scene: &Scene, seed: u64, spp: u32) -> Result<Vec<[u32; 4]>, String> {
    let options = TraceOptions {
        seed,
        ..Default::default()
    };
    let mut tracer = Tracer::new(gpu, scene, &options).map_err(text)?;
    tracer.accumulate(spp).map_err(text)?;
    Ok(bits(&tracer.read_image().map_err(text)?))
}

/// Two views in one dispatch, hurried so that paths go on in further dispatches, are bit by bit what the
/// offline tracer makes of each; then nothing is left to do.
pub fn equal_the_offline_tracer(gpu: &Gpu) -> Result<(), String> {
    let scene = scenes::scene();
    let other = Camera {
        eye: DVec3::new(-0.3, 0.2, 0.2),
        width: 31,
        height: 17,
        ..scene.camera
    };
    let options = TraceOptions {
        budget: 7,
        ..Default::default()
    };
    let mut tracer = tracer(gpu, &scene, &options)?;
    let cameras = [scene.camera, other];
    let rooms = cameras.map(|camera| [camera.width + 3, camera.height]);
    tracer.set_views(&rooms).map_err(text)?;
    // More than what is spread over neighbours, which the offline tracer doesn't do.
    let views = [view(0, &scene.camera, 4, 17), view(1, &other, 6, 29)];
    for _ in 0..5 {
        frame(gpu, &mut tracer, &views, None)?;
    }
    for (slot, (camera, samples)) in cameras.into_iter().zip([17, 29]).enumerate() {
        let scene = Scene {
            camera,
            ..scene.clone()
        };
        let expected = offline(gpu, &scene, beginning_seed(0, slot as u64 + 1), samples)?;
        let found = bits(&tracer.read_image(slot).map_err(text)?);
        if expected.iter().all(|pixel| *pixel == expected[0]) {
            return Err("the image is empty".into());
        }
        let differ = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
        if found.len() != expected.len() || differ > 0 {
            return Err(format!("view {slot}: {differ} pixels differ"));
        }
    }
    let counters = tracer.counters();
    if counters.nonfinite_samples + counters.majorant_violations != 0 {
        return Err(format!("{counters:?}"));
    }
    let idle = frame(gpu, &mut tracer, &views, None)?;
    if idle != FrameWork::default() {
        return Err(format!("a finished image costs {idle:?}"));
    }
    Ok(())
}

/// Samples of an image of few are spread over neighbours: pixels have the mean and the noise that they
/// have alone, means over 8 × 8 of them have less. Two frames of four give what one of eight gives, and
/// so do paths that go on in further dispatches.
pub fn few_samples_are_spread(gpu: &Gpu) -> Result<(), String> {
    const SIDE: u32 = 32;
    const SEEDS: u64 = 16;
    let mut scene = scenes::scene();
    scene.camera.width = SIDE;
    scene.camera.height = SIDE;
    scene.integrator.max_scatters = Some(1);
    // Of one density, so that the first point of a path decides about its collision.
    scene.volume = scenes::random_volume([21, 9, 14], 1, 0.0);
    scene.transfer_function = TransferFunction::new(vec![scenes::point(0.0, 8.0)]).map_err(text)?;
    let image = |seed, budget, samples, frames, most| {
        let options = TraceOptions {
            seed,
            budget,
            ..Default::default()
        };
        let mut tracer = tracer(gpu, &scene, &options)?;
        tracer.set_views(&[[SIDE; 2]]).map_err(text)?;
        let views = [view(0, &scene.camera, samples, most)];
        for _ in 0..frames {
            frame(gpu, &mut tracer, &views, None)?;
        }
        tracer.read_image(0).map_err(text)
    };
    let budget = TraceOptions::default().budget;
    let whole = bits(&image(1, budget, 8, 1, 8)?);
    if bits(&image(1, budget, 4, 2, 8)?) != whole || bits(&image(1, 7, 8, 8, 8)?) != whole {
        return Err("eight samples depend on how they are taken".into());
    }
    // Three points that follow each other are no net: a pixel may have somewhat more noise.
    for (samples, within) in [(2, 0.1), (3, 0.3)] {
        let images = |most| -> Result<Vec<_>, String> {
            let images = (0..SEEDS).map(|seed| image(seed + 1, budget, samples, 1, most));
            images.collect()
        };
        let (spread, alone) = (images(samples)?, images(u32::MAX)?);
        for (channel, gain) in [(1, 0.85), (3, 0.6)] {
            let of = |side| {
                let [a, b] =
                    [&spread, &alone].map(|images| mean_and_noise(images, SIDE, side, channel));
                [a[0] / b[0], a[1] / b[1]]
            };
            let ([mean, pixels], [_, squares]) = (of(1), of(8));
            let same = (mean - 1.0).abs() < 0.02 && (pixels - 1.0).abs() < within;
            eprintln!("{samples} samples, channel {channel}: {mean}, {pixels}, {squares}");
            if !same || squares > gain {
                return Err(format!(
                    "{samples} samples, channel {channel}, spread of alone: mean {mean}, noise of \
                     pixels {pixels}, of squares {squares}"
                ));
            }
        }
    }
    Ok(())
}

/// Mean over the image, and the variance over seeds of what squares of `side` × `side` pixels have as
/// their means.
fn mean_and_noise(images: &[Vec<[f32; 4]>], width: u32, side: u32, channel: usize) -> [f64; 2] {
    let across = width / side;
    let squares = (0..across * across).map(|square| {
        let corner = [square % across * side, square / across * side];
        let values = images.iter().map(|image| {
            let inside = (0..side * side).map(|i| {
                let pixel = corner[0] + i % side + width * (corner[1] + i / side);
                f64::from(image[pixel as usize][channel])
            });
            inside.sum::<f64>() / f64::from(side * side)
        });
        let values: Vec<_> = values.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let squared = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        [mean, squared / (values.len() - 1) as f64]
    });
    let sums = squares.fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    sums.map(|sum| sum / f64::from(across * across))
}

/// A frame that is split into many dispatches is bit by bit the one that isn't.
pub fn parts_equal_the_whole(gpu: &Gpu) -> Result<(), String> {
    let scene = scenes::scene();
    let other = Camera {
        eye: DVec3::new(-0.3, 0.2, 0.2),
        width: 31,
        height: 37,
        ..scene.camera
    };
    let cameras = [scene.camera, other];
    let rooms = cameras.map(|camera| [camera.width, camera.height]);
    let mut images = Vec::new();
    for most in [u64::MAX, 700] {
        let options = TraceOptions {
            budget: 7,
            ..Default::default()
        };
        let mut tracer = tracer(gpu, &scene, &options)?;
        tracer.split_at(most);
        tracer.set_views(&rooms).map_err(text)?;
        let views = [view(0, &scene.camera, 3, 5), view(1, &other, 2, 7)];
        let mut dispatches = 0;
        for _ in 0..4 {
            dispatches += frame(gpu, &mut tracer, &views, None)?.dispatches;
        }
        images.push([0, 1].map(|slot| tracer.read_image(slot).map(|image| bits(&image))));
        let is_split = dispatches > 4 * 5;
        if is_split != (most == 700) {
            return Err(format!("{dispatches} dispatches of {most} samples"));
        }
    }
    for (slot, (a, b)) in images[0].iter().zip(&images[1]).enumerate() {
        let [a, b] = [a, b].map(|image| image.as_ref().map_err(text));
        let (a, b) = (a?, b?);
        let differ = a.iter().zip(b).filter(|(a, b)| a != b).count();
        if a.is_empty() || a.len() != b.len() || differ > 0 {
            return Err(format!("view {slot}: {differ} pixels differ"));
        }
    }
    Ok(())
}

/// The variant that serves until the right one is compiled gives the same light.
pub fn general_kernels_equal_special_ones(gpu: &Gpu) -> Result<(), String> {
    for (max_scatters, gradient_factor, planes) in [
        (Some(1), 0.0, vec![]),
        (None, 0.8, vec![DVec4::new(1.0, 0.5, 0.0, 0.01)]),
    ] {
        let mut scene = scenes::scene();
        scene.integrator.max_scatters = max_scatters;
        scene.gradient_factor = gradient_factor;
        let mut medium = Medium::from_scene(&scene);
        medium.clip_planes = planes;
        let mut means = Vec::new();
        for general in [false, true] {
            let mut tracer = tracer(gpu, &scene, &TraceOptions::default())?;
            tracer.set_medium(&medium).map_err(text)?;
            tracer.use_general_kernels(general);
            let camera = &scene.camera;
            tracer
                .set_views(&[[camera.width, camera.height]])
                .map_err(text)?;
            let views = [view(0, camera, 64, 256)];
            for _ in 0..4 {
                frame(gpu, &mut tracer, &views, None)?;
            }
            let image = tracer.read_image(0).map_err(text)?;
            let mean = image.iter().map(|p| f64::from(p[0] + p[3])).sum::<f64>();
            means.push(mean / image.len() as f64);
        }
        // 480 pixels of 256 samples: half a per cent is several standard deviations.
        if !(means[0] > 0.01 && (means[0] / means[1] - 1.0).abs() < 0.02) {
            return Err(format!("mean radiance and opacity {means:?}"));
        }
    }
    Ok(())
}

/// 1 m of 2 /m, seen head-on from 2 m before its front.
fn slab() -> Scene {
    let points = vec![scenes::point(0.5, 2.0)];
    Scene {
        volume: scenes::volume(Voxels::U8(vec![7; 64]), [4, 4, 4]),
        window: [0.0, 255.0],
        world_from_unit_cube: DMat4::from_translation(DVec3::splat(-0.5)),
        transfer_function: TransferFunction::new(points).expect("a point"),
        gradient_factor: 0.0,
        camera: Camera {
            eye: DVec3::new(0.0, 0.0, 2.5),
            target: DVec3::ZERO,
            up: DVec3::Y,
            fov_y: 0.02,
            width: 16,
            height: 16,
        },
        ..scenes::scene()
    }
}

fn mean_opacity(tracer: &FrameTracer, slot: usize) -> Result<f64, String> {
    let image = tracer.read_image(slot).map_err(text)?;
    let sum: f64 = image.iter().map(|pixel| f64::from(pixel[3])).sum();
    Ok(sum / image.len() as f64)
}

const NEAR: f64 = 0.1;

/// A depth buffer with a mesh `metres` away all over, of any number of samples per pixel.
fn depth_buffer(gpu: &Gpu, size: [u32; 2], samples: u32, metres: f64) -> wgpu::TextureView {
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d {
            width: size[0],
            height: size[1],
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: samples,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Depth32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    let view = texture.create_view(&Default::default());
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: None,
        color_attachments: &[],
        depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
            view: &view,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Clear((NEAR / metres) as f32),
                store: wgpu::StoreOp::Store,
            }),
            stencil_ops: None,
        }),
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    gpu.queue.submit([encoder.finish()]);
    view
}

/// Opacity of what lies before a mesh: 1 − exp(−σ·d), with and without multisampling, in views of
/// other resolutions than the depth buffer, and beside a view without meshes.
pub fn paths_end_at_meshes(gpu: &Gpu) -> Result<(), String> {
    let scene = slab();
    let mut tracer = tracer(gpu, &scene, &TraceOptions::default())?;
    let sizes = [[16, 16], [8, 8], [16, 16]];
    tracer.set_views(&sizes).map_err(text)?;
    let clip_from_view = DMat4::perspective_infinite_reverse_rh(0.02, 1.0, NEAR);
    for (behind_front, samples) in [(-0.5f64, 1), (0.25, 4), (0.6, 1), (9.0, 4)] {
        let mut depth = MeshDepth::new(gpu).map_err(text)?;
        depth.reserve([16, 16], 2 * samples).map_err(text)?;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut layers = Vec::new();
        for (i, metres) in [2.0 + behind_front, 2.1].into_iter().enumerate() {
            let texture = depth_buffer(gpu, [40, 30], samples, metres);
            let source = DepthSource {
                texture: &texture,
                samples,
                viewport: [10, 5, 16, 16],
                clip_from_view,
            };
            let first = i as u32 * samples;
            layers.push(depth.record(&mut encoder, &source, first).map_err(text)?);
        }
        gpu.queue.submit([encoder.finish()]);
        let views: Vec<_> = (0..3)
            .map(|slot| ViewFrame {
                view: View::from_camera(&scene.camera).resized(sizes[slot]),
                mesh_depth: layers.get(slot).copied(),
                restart: true,
                ..view(slot, &scene.camera, 256, 256)
            })
            .collect();
        frame(gpu, &mut tracer, &views, Some(&depth))?;
        for (slot, before_mesh) in [behind_front.clamp(0.0, 1.0), 0.1, 1.0].iter().enumerate() {
            let found = mean_opacity(&tracer, slot)?;
            let expected = 1.0 - (-2.0 * before_mesh).exp();
            // Standard deviation of 64 or 256 pixels × 256 well-spread samples: below 1e-3.
            if (found - expected).abs() > 4e-3 {
                return Err(format!(
                    "view {slot}, mesh {behind_front} m behind the front, {samples} samples: \
                     opacity {found} instead of {expected}"
                ));
            }
        }
    }
    Ok(())
}

/// An image goes on where its depth comes to lie in other layers, and reads them there.
pub fn depth_moves_between_layers(gpu: &Gpu) -> Result<(), String> {
    let scene = slab();
    let mut tracer = tracer(gpu, &scene, &TraceOptions::default())?;
    tracer.set_views(&[[16, 16]]).map_err(text)?;
    let clip_from_view = DMat4::perspective_infinite_reverse_rh(0.02, 1.0, NEAR);
    let metres = [2.6, 2.1];
    let mut depth = MeshDepth::new(gpu).map_err(text)?;
    depth.reserve([16, 16], 2).map_err(text)?;
    for own in [0, 1] {
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut layers = Vec::new();
        for (i, metres) in metres.into_iter().enumerate() {
            let texture = depth_buffer(gpu, [16, 16], 1, metres);
            let source = DepthSource {
                texture: &texture,
                samples: 1,
                viewport: [0, 0, 16, 16],
                clip_from_view,
            };
            let layer = if own == 0 { i as u32 } else { 1 - i as u32 };
            layers.push(depth.record(&mut encoder, &source, layer).map_err(text)?);
        }
        gpu.queue.submit([encoder.finish()]);
        let views = [ViewFrame {
            view: View::from_camera(&scene.camera).resized([16, 16]),
            mesh_depth: Some(layers[0]),
            ..view(0, &scene.camera, 128, 256)
        }];
        frame(gpu, &mut tracer, &views, Some(&depth))?;
    }
    let samples = tracer.image(0).map(|image| image.samples);
    if samples != Some(256) {
        return Err(format!("{samples:?} samples, not 2 × 128"));
    }
    let (found, expected) = (mean_opacity(&tracer, 0)?, 1.0 - f64::exp(-2.0 * 0.6));
    if (found - expected).abs() > 4e-3 {
        return Err(format!("opacity {found} instead of {expected}"));
    }
    tracer.forget_view(0);
    match tracer.image(0) {
        None => Ok(()),
        Some(image) => Err(format!("{image:?} was forgotten")),
    }
}

/// What clip planes leave of the slab has the opacity of its thickness.
pub fn clip_planes_cut(gpu: &Gpu) -> Result<(), String> {
    let scene = slab();
    let mut tracer = tracer(gpu, &scene, &TraceOptions::default())?;
    tracer.set_views(&[[16, 16]]).map_err(text)?;
    let views = [view(0, &scene.camera, 256, 256)];
    let cases = [
        // Behind z = 0.2 stays, whatever the normal's length.
        (vec![DVec4::new(0.0, 0.0, -3.0, 0.6)], 0.7),
        (vec![DVec4::new(0.0, 0.0, 1.0, 0.1)], 0.6),
        (
            vec![
                DVec4::new(0.0, 0.0, -1.0, 0.2),
                DVec4::new(0.0, 0.0, 1.0, 0.1),
            ],
            0.3,
        ),
        // Parallel to the rays: all or nothing.
        (vec![DVec4::new(1.0, 0.0, 0.0, 0.4)], 1.0),
        (vec![DVec4::new(1.0, 0.0, 0.0, -0.4)], 0.0),
    ];
    for (clip_planes, left) in cases {
        let medium = Medium {
            clip_planes,
            ..Medium::from_scene(&scene)
        };
        if !tracer.set_medium(&medium).map_err(text)? || tracer.set_medium(&medium).map_err(text)? {
            return Err("a medium is new once".into());
        }
        frame(gpu, &mut tracer, &views, None)?;
        let found = mean_opacity(&tracer, 0)?;
        let expected = 1.0 - f64::exp(-2.0 * left);
        if (found - expected).abs() > 4e-3 {
            return Err(format!(
                "{:?}: opacity {found} instead of {expected}",
                medium.clip_planes
            ));
        }
    }
    let mut medium = Medium::from_scene(&scene);
    medium.clip_planes = vec![DVec4::Z; Medium::MAX_CLIP_PLANES + 1];
    match tracer.set_medium(&medium) {
        Err(error) if error.to_string().contains("clip") => Ok(()),
        other => Err(format!("nine planes: {other:?}")),
    }
}

/// Other matter, light or pose begin anew and need nothing uploaded twice; the same go on.
pub fn only_changes_begin_anew(gpu: &Gpu) -> Result<(), String> {
    let scene = slab();
    let mut tracer = tracer(gpu, &scene, &TraceOptions::default())?;
    tracer.set_views(&[[16, 16]]).map_err(text)?;
    let mut views = [view(0, &scene.camera, 4, 1000)];
    let samples = |tracer: &FrameTracer| tracer.image(0).map_or(0, |image| image.samples);
    let expect = |tracer: &mut FrameTracer, views: &[ViewFrame], expected, what: &str| {
        frame(gpu, tracer, views, None)?;
        let found = samples(tracer);
        let is_right = found == expected;
        is_right
            .then_some(())
            .ok_or(format!("{what}: {found} samples, not {expected}"))
    };
    expect(&mut tracer, &views, 4, "first frame")?;
    expect(&mut tracer, &views, 8, "second frame")?;
    tracer.set_views(&[[16, 16]]).map_err(text)?;
    expect(&mut tracer, &views, 12, "the same views")?;
    let mut medium = Medium::from_scene(&scene);
    tracer.set_medium(&medium).map_err(text)?;
    expect(&mut tracer, &views, 16, "the same medium")?;
    medium.transfer_function = medium.transfer_function.scaled(2.0);
    tracer.set_medium(&medium).map_err(text)?;
    expect(&mut tracer, &views, 4, "twice as dense")?;
    for _ in 0..63 {
        frame(gpu, &mut tracer, &views, None)?;
    }
    let dense = mean_opacity(&tracer, 0)?;
    if (dense - (1.0 - (-4f64).exp())).abs() > 4e-3 {
        return Err(format!("opacity {dense} of twice the density"));
    }
    let environment = GpuEnvironment::new(gpu, &scene.environment.map).map_err(text)?;
    tracer
        .set_environment(&Arc::new(environment))
        .map_err(text)?;
    expect(&mut tracer, &views, 4, "another environment")?;
    views[0].restart = true;
    expect(&mut tracer, &views, 4, "asked to")?;
    views[0].restart = false;
    views[0].view.origin.x += 1e-6;
    expect(&mut tracer, &views, 4, "moved by a micrometre")?;
    views[0].view = views[0].view.resized([5, 3]);
    expect(&mut tracer, &views, 4, "resized")?;
    let image = tracer.read_image(0).map_err(text)?;
    if image.len() != 15 {
        return Err(format!("{} pixels of 5 × 3", image.len()));
    }
    Ok(())
}

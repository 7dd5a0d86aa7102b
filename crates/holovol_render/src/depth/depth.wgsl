// Turns a view's depth buffer into metres along the camera's axis, one layer for each sample.

struct Source {
    // Row of the matrix that turns clip space into view space, for z and for w.
    view_z: vec4<f32>,
    view_w: vec4<f32>,
    // x, y: first pixel of the viewport; z, w: its size.
    viewport: vec4<u32>,
    // x: first layer; y: samples.
    layers: vec4<u32>,
}

@group(0) @binding(0) var<uniform> source: Source;
#if MULTISAMPLED == 1
@group(0) @binding(1) var depth_texture: texture_depth_multisampled_2d;
#else
@group(0) @binding(1) var depth_texture: texture_depth_2d;
#endif
@group(0) @binding(2) var metres: texture_storage_2d_array<r32float, write>;

// Farther than anything: nothing is there.
const NOTHING: f32 = 3e38;

@compute @workgroup_size(8, 8)
fn depth(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= source.viewport.zw) {
        return;
    }
    let pixel = source.viewport.xy + id.xy;
    let size = vec2<f32>(source.viewport.zw);
    let ndc = (vec2<f32>(id.xy) + 0.5) / size * vec2<f32>(2.0, -2.0) + vec2<f32>(-1.0, 1.0);
    for (var i = 0u; i < source.layers.y; i += 1u) {
#if MULTISAMPLED == 1
        let stored = textureLoad(depth_texture, pixel, i32(i));
#else
        let stored = textureLoad(depth_texture, pixel, 0);
#endif
        let clip = vec4<f32>(ndc, stored, 1.0);
        let w = dot(source.view_w, clip);
        // Bevy clears to 0: the far plane, which may lie at infinity.
        var value = NOTHING;
        if stored > 0.0 && w != 0.0 {
            value = -dot(source.view_z, clip) / w;
        }
        textureStore(metres, id.xy, source.layers.x + i, vec4<f32>(value, 0.0, 0.0, 0.0));
    }
}

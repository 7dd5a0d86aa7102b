// Copies an eye's image into the headset's, whatever their sizes and formats.

@group(0) @binding(0) var source: texture_2d<f32>;
@group(0) @binding(1) var linear: sampler;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) uv: vec2<f32>,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    // One triangle over all.
    let corner = 2.0 * vec2<f32>(f32(index & 1u), f32(index >> 1u));
    var result: Corner;
    result.position = vec4<f32>(2.0 * corner - 1.0, 0.0, 1.0);
    result.uv = vec2<f32>(corner.x, 1.0 - corner.y);
    return result;
}

@fragment
fn fragment(corner: Corner) -> @location(0) vec4<f32> {
    return textureSampleLevel(source, linear, corner.uv, 0.0);
}

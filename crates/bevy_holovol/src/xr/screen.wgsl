// Passes over whole images: copies of an eye's image, and the tones of views that are laid over the
// room.

@group(0) @binding(0) var source: texture_2d<f32>;
@group(0) @binding(1) var linear: sampler;

// Light is added to the room's: opacity can't hold any of it back, and says nothing.
override is_additive: bool = false;

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

// Whatever the sizes and formats.
@fragment
fn copy(corner: Corner) -> @location(0) vec4<f32> {
    return textureSampleLevel(source, linear, corner.uv, 0.0);
}

// Khronos PBR Neutral Tone Mapper, specification 1.0: keeps base colours up to START, compresses
// what is brighter, and fades that to white.
const START: f32 = 0.8 - 0.04;
const DESATURATION: f32 = 0.15;

fn neutral(color_in: vec3<f32>) -> vec3<f32> {
    let low = min(color_in.r, min(color_in.g, color_in.b));
    let offset = select(0.04, low - 6.25 * low * low, low < 0.08);
    let color = color_in - offset;
    let peak = max(color.r, max(color.g, color.b));
    if peak < START {
        return color;
    }
    let d = 1.0 - START;
    let new_peak = 1.0 - d * d / (peak + d - START);
    let g = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    return mix(color * new_peak / peak, vec3<f32>(new_peak), g);
}

// Colours are mapped as they are where they are opaque, and made faint again by their opacity.
// Mapping premultiplied colours instead brightens or darkens every edge.
@fragment
fn room(corner: Corner) -> @location(0) vec4<f32> {
    let view = textureLoad(source, vec2<i32>(corner.position.xy), 0);
    let opacity = clamp(view.a, 0.0, 1.0);
    // What shines without hiding anything has its colour as it is.
    let weight = select(1.0, opacity, opacity > 1e-4);
    // NaN comes from targets of 16 bits whose infinities met; it shows as nothing.
    let color = clamp(view.rgb / weight, vec3<f32>(0.0), vec3<f32>(65000.0));
    let mapped = neutral(color) * weight;
    return vec4<f32>(mapped, select(opacity, 0.0, is_additive));
}

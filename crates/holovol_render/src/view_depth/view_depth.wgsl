// Depth of what a view sees, for compositors that move pictures to later poses: that of its opaque
// meshes, and of volumes where they are opaque enough the mean over what makes them so. One ray
// through the middle of each pixel, marched with fixed steps through cells that are not empty.

#import holovol_render::bindings::{scene, views}
#import holovol_render::field::field_at
#import holovol_render::transfer_function::transfer_sigma_t
#import holovol_render::walk::{walk_start, walk_majorant, load_occupied}

struct ViewDepth {
    // Clip z = x * depth + y, clip w = z * depth + w.
    clip: vec4<f32>,
    // x, y: pixels of the target; z: which of the tracer's views; w: 1 if there are meshes.
    place: vec4<u32>,
}

@group(0) @binding(16) var<uniform> view_depth: ViewDepth;
// Of opaque meshes, as the target's.
@group(0) @binding(17) var mesh_texture: texture_depth_2d;

// Texels of a step, and evaluations of the transfer function in it.
const STEP: f32 = 2.0;
const PARTS: u32 = 3u;
// Steps at most: a volume of 4096 texels a side is crossed; longer ones in longer steps.
const MAX_STEPS: f32 = 4096.0;
// What is left behind this transmittance is taken to be as what is in front.
const OPAQUE: f32 = 0.04;
// Fainter volumes have no depth: what is behind them stands still for the eye.
const LEAST_OPACITY: f32 = #{LEAST_OPACITY_PERCENT}.0 / 100.0;
const CELL_SIZE: f32 = #{CELL_SIZE}.0;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // One triangle over all.
    let corner = vec2<f32>(f32(index & 1u), f32(index >> 1u));
    return vec4<f32>(4.0 * corner - 1.0, 0.0, 1.0);
}

// 0: no mesh.
fn mesh_at(position: vec2<f32>) -> f32 {
    if view_depth.place.w == 0u {
        return 0.0;
    }
    let size = textureDimensions(mesh_texture);
    let pixel = vec2<u32>(position / vec2<f32>(view_depth.place.xy) * vec2<f32>(size));
    return textureLoad(mesh_texture, min(pixel, size - 1u), 0);
}

@fragment
fn meshes(@builtin(position) fragment: vec4<f32>) -> @builtin(frag_depth) f32 {
    return mesh_at(fragment.xy);
}

// Where light is absorbed within a segment of this optical depth on average, as a part of it.
fn mean_part(optical_depth: f32) -> f32 {
    if optical_depth < 0.1 {
        return 0.5 - optical_depth / 12.0;
    }
    return 1.0 / optical_depth - 1.0 / (exp(min(optical_depth, 60.0)) - 1.0);
}

@fragment
fn volume(@builtin(position) fragment: vec4<f32>) -> @builtin(frag_depth) f32 {
    load_occupied();
    let slot = view_depth.place.z;
    let image = vec2<f32>(views[slot].image.xy);
    let p = fragment.xy / vec2<f32>(view_depth.place.xy) * image;
    let origin = (views[slot].ray_origin + p.x * views[slot].ray_origin_dx + p.y * views[slot].ray_origin_dy).xyz;
    let texel = (views[slot].ray_texel + p.x * views[slot].ray_texel_dx + p.y * views[slot].ray_texel_dy).xyz;
    let world = (views[slot].ray_world + p.x * views[slot].ray_world_dx + p.y * views[slot].ray_world_dy).xyz;
    // Distances along the ray are depths along the eye's axis, from near on.
    let near = views[slot].forward.w;
    let metres_per_depth = length(world);
    let walk = walk_start(origin, texel, 0.0, 0.0);
    var t_end = walk.t_end;
    let mesh = mesh_at(fragment.xy);
    let clip = view_depth.clip;
    if mesh > 0.0 {
        t_end = min(t_end, (mesh * clip.w - clip.y) / (clip.x - mesh * clip.z) - near);
    }
    let range = t_end - walk.t_cell;
    let dt = max(STEP / max(length(texel), 1e-30), range / MAX_STEPS);
    let inverse = 1.0 / select(texel, vec3<f32>(1e-30), abs(texel) < vec3<f32>(1e-30));
    let ahead = select(vec3<f32>(0.0), vec3<f32>(1.0), texel > vec3<f32>(0.0));
    let last_cell = vec3<i32>(scene.cells.xyz) - 1;
    var transmittance = 1.0;
    var sum = 0.0;
    var t = walk.t_cell;
    var s = 0.0;
    var known = false;
    var steps = 0.0;
    while t < t_end && transmittance > OPAQUE && steps < 2.0 * MAX_STEPS && range > 0.0 {
        steps += 1.0;
        let at = origin + (t + 0.5 * dt) * texel;
        let cell = clamp(vec3<i32>(floor(at / CELL_SIZE)), vec3<i32>(0), last_cell);
        if walk_majorant(cell) <= 0.0 {
            let exits = (CELL_SIZE * (vec3<f32>(cell) + ahead) - origin) * inverse;
            let t_exit = min(exits.x, min(exits.y, exits.z));
            t += dt * max(1.0, floor((t_exit - t) / dt));
            known = false;
            continue;
        }
        if !known {
            s = field_at(origin + t * texel);
        }
        let next = field_at(origin + (t + dt) * texel);
        let part = min(dt, t_end - t) / f32(PARTS);
        for (var k = 0u; k < PARTS; k += 1u) {
            let value = mix(s, next, (f32(k) + 0.5) * part / dt);
            let optical_depth = transfer_sigma_t(value) * part * metres_per_depth;
            let weight = transmittance * (1.0 - exp(-optical_depth));
            sum += weight * (t - walk.t_cell + (f32(k) + mean_part(optical_depth)) * part);
            transmittance -= weight;
        }
        s = next;
        known = true;
        t += dt;
    }
    let opacity = 1.0 - transmittance;
    if !(opacity >= LEAST_OPACITY) {
        discard;
    }
    let depth = near + walk.t_cell + sum / max(opacity, 1e-6);
    let z = clip.x * depth + clip.y;
    let w = clip.z * depth + clip.w;
    // Nearer than the near plane is on it.
    return select(1.0, clamp(z / w, 0.0, 1.0), w > 0.0);
}

// The two-step denoiser of Cheng et al. 2023 (Fig. 3, 4, Eqs. 2 to 5), as printed. What the paper
// leaves open is in denoise.bias: x: sigma of the spatial filter, pixels; y, z, w: how fast the
// bilateral weight falls with albedo, gradient direction and depth.

#import holovol_render::denoise::common::{
    denoise, state, lights, keys, noisy, output, Key, unpack_key, half_now, half_before, albedo_at,
    scratch_at, all_finite, HISTORY_NONE, TILE,
}

const RADIUS: i32 = #{RADIUS};
// D2: lambda = ALPHA * (BETA - exp(-|albedo difference|)).
const ALPHA: f32 = 0.5;
const BETA: f32 = 2.0;

fn pixel_of(group: vec3<u32>, local: u32) -> vec2<u32> {
    return TILE * group.xy + vec2<u32>(local % TILE, local / TILE);
}

fn first_step_at(pixel: u32) -> u32 { return 2u * denoise.counts.y + pixel; }

// zeta: 1 for equal guides.
fn bilateral(a: Key, b: Key, albedo_a: vec3<f32>, albedo_b: vec3<f32>, pixel_size: f32) -> f32 {
    let albedo = albedo_a - albedo_b;
    let depth = (a.depth - b.depth) / (a.spread + b.spread + 2.0 * pixel_size * a.depth + 1e-30);
    let exponent = denoise.bias.y * dot(albedo, albedo)
        + denoise.bias.z * (1.0 - dot(a.normal, b.normal))
        + denoise.bias.w * min(depth * depth, 1e4);
    return exp(-exponent);
}

fn sample_of(eye: u32, pixel: u32) -> vec4<f32> {
    let in_eye = pixel - denoise.eyes[eye].image.w + denoise.eyes[eye].image.z;
    let sum = noisy[2u * in_eye] + noisy[2u * in_eye + 1u];
    let mean = sum / f32(max(denoise.eyes[eye].frame.x, 1u));
    if all_finite(mean) { return mean; }
    return vec4<f32>(0.0, 0.0, 0.0, -1.0);
}

// The pixel of an image (pixels across and down, first pixel) that a place falls into, or -1.
fn pixel_at(image: vec3<u32>, place: vec3<f32>) -> i32 {
    let size = vec2<i32>(image.xy);
    if !(place.z > 0.0) {
        return -1;
    }
    let at = place.xy / place.z;
    if !(all(at >= vec2<f32>(0.0)) && all(at < vec2<f32>(size))) {
        return -1;
    }
    let p = min(vec2<i32>(at), size - 1);
    return i32(image.z) + p.x + size.x * p.y;
}

fn position_of(eye: u32, pixel: vec2<u32>, depth: f32) -> vec4<f32> {
    let p = vec2<f32>(pixel) + 0.5;
    let ray = denoise.eyes[eye].direction + p.x * denoise.eyes[eye].direction_dx
        + p.y * denoise.eyes[eye].direction_dy;
    return vec4<f32>(depth * ray.xyz, 1.0);
}

fn other_place(eye: u32, here: vec4<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot(denoise.eyes[eye].other_x, here),
        dot(denoise.eyes[eye].other_y, here),
        dot(denoise.eyes[eye].other_depth, here),
    );
}

// D1, first part: the neighbourhood in the same image.
@compute @workgroup_size(64)
fn near(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let position = pixel_of(group, local);
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let first = denoise.eyes[eye].image.w;
    let pixel = first + position.x + size.x * position.y;
    let key = unpack_key(keys[half_now() + pixel]);
    let albedo = lights[albedo_at(pixel)].rgb;
    let pixel_size = denoise.eyes[eye].turn_x.w;
    var sum = vec4<f32>(0.0);
    var total = 0.0;
    let low = max(vec2<i32>(position) - RADIUS, vec2<i32>(0));
    let high = min(vec2<i32>(position) + RADIUS, vec2<i32>(size) - 1);
    let falloff = 0.5 / max(denoise.bias.x * denoise.bias.x, 1e-6);
    for (var y = low.y; y <= high.y; y += 1) {
        for (var x = low.x; x <= high.x; x += 1) {
            let at = first + u32(x) + size.x * u32(y);
            let value = sample_of(eye, at);
            let offset = vec2<f32>(vec2<i32>(x, y) - vec2<i32>(position));
            let there = unpack_key(keys[half_now() + at]);
            let w = exp(-falloff * dot(offset, offset))
                * bilateral(key, there, albedo, lights[albedo_at(at)].rgb, pixel_size);
            if value.a >= 0.0 {
                sum += w * value;
                total += w;
            }
        }
    }
    lights[scratch_at(pixel)] = select(vec4<f32>(0.0), sum / total, total > 0.0);
}

// D1, second and third part: the other eye, then the last frame.
@compute @workgroup_size(64)
fn first_step(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let position = pixel_of(group, local);
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let pixel = denoise.eyes[eye].image.w + position.x + size.x * position.y;
    let key = unpack_key(keys[half_now() + pixel]);
    let albedo = lights[albedo_at(pixel)].rgb;
    let pixel_size = denoise.eyes[eye].turn_x.w;
    var value = lights[scratch_at(pixel)];
    let here = position_of(eye, position, key.depth);
    if key.albedo > 0.0 && denoise.counts.x == 2u {
        let place = other_place(eye, here);
        let there = pixel_at(denoise.eyes[1u - eye].image.xyw, place);
        if there >= 0 {
            var expected = key;
            expected.depth = place.z;
            let at = u32(there);
            let zeta = bilateral(expected, unpack_key(keys[half_now() + at]), albedo, lights[albedo_at(at)].rgb, pixel_size);
            value = (value + zeta * lights[scratch_at(at)]) / (1.0 + zeta);
        }
    }
    let change = denoise.eyes[eye].history.z;
    if denoise.eyes[eye].frame.y != HISTORY_NONE && change < 1.0 && key.albedo > 0.0 {
        let place = vec3<f32>(
            dot(denoise.eyes[eye].previous_x, here),
            dot(denoise.eyes[eye].previous_y, here),
            dot(denoise.eyes[eye].previous_depth, here),
        );
        let there = pixel_at(denoise.eyes[eye].place.yzw, place);
        if there >= 0 {
            var expected = key;
            expected.depth = place.z;
            expected.normal = vec3<f32>(
                dot(denoise.eyes[eye].turn_x.xyz, key.normal),
                dot(denoise.eyes[eye].turn_y.xyz, key.normal),
                dot(denoise.eyes[eye].turn_z.xyz, key.normal),
            );
            let at = u32(there);
            // The last frame's albedo isn't kept: its mean is in the key.
            let before = unpack_key(keys[half_before() + at]);
            let mean = (albedo.r + albedo.g + albedo.b) / 3.0;
            let zeta = bilateral(expected, before, vec3<f32>(mean), vec3<f32>(before.albedo), pixel_size);
            let weight = zeta / (1.0 + exp(-1.0 / (change - 1.0)));
            value = (value + weight * state[half_before() + at]) / (1.0 + weight);
        }
    }
    lights[first_step_at(pixel)] = value;
}

// D2: between the eyes.
@compute @workgroup_size(64)
fn second_step(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let position = pixel_of(group, local);
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let pixel = denoise.eyes[eye].image.w + position.x + size.x * position.y;
    let key = unpack_key(keys[half_now() + pixel]);
    var value = lights[first_step_at(pixel)];
    if key.albedo > 0.0 && denoise.counts.x == 2u {
        let place = other_place(eye, position_of(eye, position, key.depth));
        let there = pixel_at(denoise.eyes[1u - eye].image.xyw, place);
        if there >= 0 {
            let at = u32(there);
            let difference = lights[albedo_at(pixel)].rgb - lights[albedo_at(at)].rgb;
            let lambda = ALPHA * (BETA - exp(-length(difference)));
            value = mix(lights[first_step_at(at)], value, lambda);
        }
    }
    state[half_now() + pixel] = value;
    output[pixel] = vec4<f32>(max(value.rgb, vec3<f32>(0.0)), clamp(value.a, 0.0, 1.0));
}

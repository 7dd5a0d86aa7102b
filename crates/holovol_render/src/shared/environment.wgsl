// Light from all around: a latitude-longitude map, drawn in proportion to its bilinear importance.
#define_import_path holovol_render::environment

#import holovol_render::bindings::{scene, environment_texture, environment_alias}
#import holovol_render::random::{unit_float}
#import holovol_render::phase_function::PI

struct LightSample {
    wi: vec3<f32>,
    radiance: vec3<f32>,
    // Over solid angle.
    pdf: f32,
}

// What densities of light samples are proportional to: all channels' errors count alike.
fn importance(rgb: vec3<f32>) -> f32 {
    return (rgb.r + rgb.g + rgb.b) * (1.0 / 3.0);
}

fn environment_texel(x: i32, y: i32, size: vec2<i32>) -> vec3<f32> {
    let wrapped = select(x, x - size.x, x >= size.x);
    let column = select(wrapped, wrapped + size.x, wrapped < 0);
    return textureLoad(environment_texture, vec2<i32>(column, clamp(y, 0, size.y - 1))).rgb;
}

// Mean of sin(theta) over the strip between the texel rows that v lies in: what the alias table
// weighs patches by. row -1 and row H-1 are half strips at the poles.
fn strip_sine(row: i32, height: i32) -> f32 {
    let v0 = max((f32(row) + 0.5) / f32(height), 0.0);
    let v1 = min((f32(row) + 1.5) / f32(height), 1.0);
    // (cos a - cos b) / (b - a), by its half-angle form: no cancellation.
    let half_width = 0.5 * PI * (v1 - v0);
    return sin(0.5 * PI * (v0 + v1)) * sin(half_width) / half_width;
}

// Radiance from a world direction, and the density with which environment_sample draws it.
fn environment_eval(wi: vec3<f32>) -> LightSample {
#if CONSTANT_ENVIRONMENT == 1
    return LightSample(wi, scene.environment_size.xyz, 0.0);
#else
    let c = scene.environment.x;
    let s = scene.environment.y;
    let d = vec3<f32>(c * wi.x - s * wi.z, wi.y, s * wi.x + c * wi.z);
    let size = vec2<i32>(scene.environment_size.xy);
    let u = 0.5 + atan2(d.x, -d.z) / (2.0 * PI);
    let sin_theta = sqrt(d.x * d.x + d.z * d.z);
    let v = atan2(sin_theta, d.y) / PI;
    let texel = vec2<f32>(u, v) * scene.environment_size.xy - 0.5;
    let base = floor(texel);
    let weight = texel - base;
    let i = vec2<i32>(base);
    let top = mix(environment_texel(i.x, i.y, size), environment_texel(i.x + 1, i.y, size), weight.x);
    let bottom = mix(
        environment_texel(i.x, i.y + 1, size),
        environment_texel(i.x + 1, i.y + 1, size),
        weight.x,
    );
    let radiance = mix(top, bottom, weight.y);
    let density = importance(radiance) * scene.environment_size.z * strip_sine(i.y, size.y);
    let pdf = density / (2.0 * PI * PI * max(sin_theta, 1e-9));
    return LightSample(wi, radiance * scene.environment.z, pdf);
#endif
}

// Position in [0, 1] with density proportional to a + (b - a) x.
fn sample_linear(a: f32, b: f32, xi: f32) -> f32 {
    let scale = 1.0 / max(max(a, b), 1e-37);
    let low = a * scale;
    let high = b * scale;
    let root = sqrt(mix(low * low, high * high, xi));
    return clamp(xi * (low + high) / max(low + root, 1e-12), 0.0, 1.0);
}

// High and low word of the 64-bit product.
fn multiply_wide(a: u32, b: u32) -> vec2<u32> {
    let a0 = a & 0xffffu;
    let a1 = a >> 16u;
    let b0 = b & 0xffffu;
    let b1 = b >> 16u;
    let middle = a1 * b0 + ((a0 * b0) >> 16u);
    let middle_low = (middle & 0xffffu) + a0 * b1;
    return vec2<u32>(a1 * b1 + (middle >> 16u) + (middle_low >> 16u), a * b);
}

// Draws a direction: bits choose band and column, v the row in the band, xi.x between that patch
// and its alias, xi.yz the place in it.
fn environment_sample(bits: u32, v: f32, xi: vec3<f32>) -> LightSample {
#if CONSTANT_ENVIRONMENT == 1
    return environment_eval(vec3<f32>(0.0, 1.0, 0.0));
#else
    let size = vec2<i32>(scene.environment_size.xy);
    let band_rows = scene.environment_size.w;
    let band = multiply_wide(bits, #{LIGHT_BANDS}u);
    let band_row = min(floor(v * band_rows), band_rows - 1.0);
    var column = i32(multiply_wide(band.y, u32(size.x)).x);
    var row = i32(f32(band.x) * band_rows + band_row);
    let alias_entry = textureLoad(environment_alias, vec2<i32>(column, row)).xy;
    if xi.x >= bitcast<f32>(alias_entry.x) {
        column = i32(alias_entry.y & 0xffffu);
        row = i32(alias_entry.y >> 16u);
    }
    row -= 1;
    let l00 = environment_texel(column, row, size);
    let l10 = environment_texel(column + 1, row, size);
    let l01 = environment_texel(column, row + 1, size);
    let l11 = environment_texel(column + 1, row + 1, size);
    let top = vec2<f32>(importance(l00), importance(l10));
    let bottom = vec2<f32>(importance(l01), importance(l11));
    let y = sample_linear(top.x + top.y, bottom.x + bottom.y, xi.z);
    let left_right = mix(top, bottom, y);
    let x = sample_linear(left_right.x, left_right.y, xi.y);
    let uv = (vec2<f32>(f32(column), f32(row)) + 0.5 + vec2<f32>(x, y)) / scene.environment_size.xy;
    // The half strips at the poles hold half of a patch that is constant in v: mirror into them.
    let mirrored = select(select(uv.y, 2.0 - uv.y, uv.y > 1.0), -uv.y, uv.y < 0.0);
    let radiance = mix(mix(l00, l10, x), mix(l01, l11, x), y);
    let theta = mirrored * PI;
    let phi = (uv.x - 0.5) * 2.0 * PI;
    let sin_theta = sin(theta);
    let d = vec3<f32>(sin_theta * sin(phi), cos(theta), -sin_theta * cos(phi));
    let c = scene.environment.x;
    let s = scene.environment.y;
    let wi = vec3<f32>(c * d.x + s * d.z, d.y, c * d.z - s * d.x);
    let density = importance(radiance) * scene.environment_size.z * strip_sine(row, size.y);
    let pdf = density / (2.0 * PI * PI * max(sin_theta, 1e-9));
    return LightSample(wi, radiance * scene.environment.z, pdf);
#endif
}

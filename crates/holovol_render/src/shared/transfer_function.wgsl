// The transfer function, evaluated from its points after interpolation.
#define_import_path holovol_render::transfer_function

#import holovol_render::bindings::{scene, transfer_points}

struct Material {
    albedo: vec3<f32>,
    emission: vec3<f32>,
    roughness: f32,
    specular: f32,
}

// The last point at or below s, else the first; of coincident points the later one holds.
fn transfer_segment(s: f32) -> u32 {
#if TRANSFER_POINTS > 0
    var segment = 0u;
    for (var i = 1u; i < #{TRANSFER_POINTS}u; i += 1u) {
        segment = select(segment, i, s >= scene.transfer_density[i].x);
    }
    return segment;
#else
    var low = 0u;
    var high = scene.dims.w;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if s >= transfer_points[middle].density.x { low = middle; } else { high = middle; }
    }
    return low;
#endif
}

fn transfer_weight(s: f32, density: vec4<f32>) -> f32 {
    return clamp((s - density.x) * density.w, 0.0, 1.0);
}

// Extinction at s, 1/m.
fn transfer_sigma_t(s: f32) -> f32 {
#if TRANSFER_POINTS > 0
    // Few points: selecting their values beats indexing, which would be a gather.
    var density = scene.transfer_density[0];
    for (var i = 1u; i < #{TRANSFER_POINTS}u; i += 1u) {
        let candidate = scene.transfer_density[i];
        density = select(density, candidate, s >= candidate.x);
    }
#else
    let density = transfer_points[transfer_segment(s)].density;
#endif
    return density.y + density.z * transfer_weight(s, density);
}

fn transfer_emission(s: f32) -> vec3<f32> {
    let i = transfer_segment(s);
    let next = min(i + 1u, scene.dims.w - 1u);
    let t = transfer_weight(s, transfer_points[i].density);
    return mix(transfer_points[i].emission.rgb, transfer_points[next].emission.rgb, t);
}

fn transfer_material(s: f32) -> Material {
    let i = transfer_segment(s);
    let next = min(i + 1u, scene.dims.w - 1u);
    let t = transfer_weight(s, transfer_points[i].density);
    let albedo = mix(transfer_points[i].albedo, transfer_points[next].albedo, t);
    let emission = mix(transfer_points[i].emission, transfer_points[next].emission, t);
    return Material(albedo.rgb, emission.rgb, albedo.w, emission.w);
}

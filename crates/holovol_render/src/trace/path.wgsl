// The state of a path, which can be saved between two rounds of the tracer's loop.
#define_import_path holovol_render::path

#import holovol_render::bindings::{resumed, saved}
#import holovol_render::walk::{Walk, walk_start, walk_next, walk_majorant}

const PICKS: u32 = #{PICKS}u;
// A saved path keeps its pick in the bits below.
const VIEW_SHIFT: u32 = 8u;

struct Path {
    stage: u32,
    view: u32,
    // In its view.
    pixel: u32,
    // Not saved: which sequence of well-spread points the pixel has, and from where on.
    sequence: u32,
    first_point: u32,
    sample: u32,
    sample_end: u32,
    // Scatterings so far, and plain random numbers used so far.
    depth: u32,
    counter: u32,
    key: vec2<u32>,
    walk: Walk,
    transmittance: f32,
    // Flight: total weight of its tentative collisions, those chosen, and the numbers that choose.
    weight_sum: f32,
    chosen_distance: array<f32, PICKS>,
    chosen_s: array<f32, PICKS>,
    xi: array<f32, PICKS>,
    // Which of the chosen is being lit.
    pick: u32,
    flight_origin: vec3<f32>,
    wo: vec3<f32>,
    next_wi: vec3<f32>,
    throughput: vec3<f32>,
    light: vec3<f32>,
    radiance: vec3<f32>,
    opacity: f32,
#if LIGHT_GRID == 1
    // Of the pick that is being lit: what of its light comes back to the eye; 0 for later ones.
    light_share: f32,
#endif
}

fn save_path(path: Path, slot: u32) {
    let walk = path.walk;
    saved[slot].words[0] = vec4<u32>(path.stage, path.pixel, path.sample, path.sample_end);
    saved[slot].words[1] = vec4<u32>(path.depth, path.counter, path.key);
    saved[slot].words[2] = bitcast<vec4<u32>>(vec4<f32>(walk.origin, walk.t_cell));
    saved[slot].words[3] = bitcast<vec4<u32>>(vec4<f32>(walk.direction, walk.tau));
    saved[slot].words[4] = vec4<u32>(
        bitcast<vec3<u32>>(walk.cell), path.pick | path.view << VIEW_SHIFT,
    );
    saved[slot].words[5] = bitcast<vec4<u32>>(
        vec4<f32>(path.transmittance, path.weight_sum, walk.t_end, 0.0),
    );
    saved[slot].words[6] = bitcast<vec4<u32>>(vec4<f32>(path.wo, path.opacity));
    saved[slot].words[7] = bitcast<vec4<u32>>(vec4<f32>(path.next_wi, 0.0));
    saved[slot].words[8] = bitcast<vec4<u32>>(vec4<f32>(path.throughput, 0.0));
#if LIGHT_GRID == 1
    saved[slot].words[9] = bitcast<vec4<u32>>(vec4<f32>(path.light, path.light_share));
#else
    saved[slot].words[9] = bitcast<vec4<u32>>(vec4<f32>(path.light, 0.0));
#endif
    saved[slot].words[10] = bitcast<vec4<u32>>(vec4<f32>(path.radiance, 0.0));
    saved[slot].words[11] = bitcast<vec4<u32>>(vec4<f32>(path.flight_origin, 0.0));
    for (var k = 0u; k < PICKS; k += 1u) {
        saved[slot].words[12u + k] = bitcast<vec4<u32>>(
            vec4<f32>(path.chosen_distance[k], path.chosen_s[k], path.xi[k], 0.0),
        );
    }
}

fn restore_path(slot: u32) -> Path {
    var path: Path;
    let w0 = resumed[slot].words[0];
    let w1 = resumed[slot].words[1];
    let w2 = bitcast<vec4<f32>>(resumed[slot].words[2]);
    let w3 = bitcast<vec4<f32>>(resumed[slot].words[3]);
    let w4 = resumed[slot].words[4];
    let w5 = bitcast<vec4<f32>>(resumed[slot].words[5]);
    path.stage = w0.x;
    path.pixel = w0.y;
    path.sample = w0.z;
    path.sample_end = w0.w;
    path.depth = w1.x;
    path.counter = w1.y;
    path.key = w1.zw;
    path.walk = walk_start(w2.xyz, w3.xyz, 0.0, w3.w);
    path.walk.t_cell = w2.w;
    path.walk.cell = bitcast<vec3<i32>>(w4.xyz);
    path.walk.t_next = walk_next(path.walk);
    path.walk.sigma_maj = walk_majorant(path.walk.cell);
    path.pick = w4.w & ((1u << VIEW_SHIFT) - 1u);
    path.view = w4.w >> VIEW_SHIFT;
    // A mesh may have ended it before the volume does.
    path.walk.t_end = w5.z;
    path.transmittance = w5.x;
    path.weight_sum = w5.y;
    let w6 = bitcast<vec4<f32>>(resumed[slot].words[6]);
    path.wo = w6.xyz;
    path.opacity = w6.w;
    path.next_wi = bitcast<vec4<f32>>(resumed[slot].words[7]).xyz;
    path.throughput = bitcast<vec4<f32>>(resumed[slot].words[8]).xyz;
    let w9 = bitcast<vec4<f32>>(resumed[slot].words[9]);
    path.light = w9.xyz;
#if LIGHT_GRID == 1
    path.light_share = w9.w;
#endif
    path.radiance = bitcast<vec4<f32>>(resumed[slot].words[10]).xyz;
    path.flight_origin = bitcast<vec4<f32>>(resumed[slot].words[11]).xyz;
    for (var k = 0u; k < PICKS; k += 1u) {
        let chosen = bitcast<vec4<f32>>(resumed[slot].words[12u + k]);
        path.chosen_distance[k] = chosen.x;
        path.chosen_s[k] = chosen.y;
        path.xi[k] = chosen.z;
    }
    return path;
}

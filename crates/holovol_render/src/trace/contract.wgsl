// Single functions of the tracer's kernel, one call per lane: tests compare them with CPU twins.
// A lane reads four vectors and writes four; integers travel as the bits of floats.

#import holovol_render::bindings::{scene, dispatch, accumulators, guides}
#import holovol_render::random::{
    pcg3d, sobol_pair, z_order, owen_scramble_reversed, sobol_second_reversed,
}
#import holovol_render::field::{field_at, field_gradient}
#import holovol_render::transfer_function::{transfer_sigma_t, transfer_emission, transfer_material}
#import holovol_render::phase_function::{phase_eval, phase_sample}
#import holovol_render::surface::{Surface, scatter_eval, scatter_pdf, scatter_sample, fresnel}
#import holovol_render::environment::{environment_eval, environment_sample}
#import holovol_render::scattering::choose_light
#import holovol_render::walk::{walk_start, walk_advance, walk_distance, walk_majorant, load_occupied, low_cell, high_cell, WALK_MOVING}

const WALK_MISSED: u32 = 3u;
// More rounds than a walk through any test's grid takes.
const WALK_ROUNDS: u32 = 4096u;

fn input(lane: u32, i: u32) -> vec4<f32> {
    return accumulators[4u * lane + i];
}

fn output(lane: u32, i: u32, value: vec4<f32>) {
    guides[4u * lane + i] = value;
}

fn idle(lane: u32) -> bool {
    return lane >= dispatch.budget;
}

@compute @workgroup_size(#{WORKGROUP_SIZE})
fn random(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    let words = bitcast<vec4<u32>>(input(id.x, 0u));
    output(id.x, 0u, bitcast<vec4<f32>>(vec4<u32>(pcg3d(words.xyz), 0u)));
    output(id.x, 1u, vec4<f32>(sobol_pair(words.x, words.y), 0.0, 0.0));
    let scrambled = owen_scramble_reversed(words.x, words.y);
    let second = sobol_second_reversed(words.x);
    output(id.x, 2u, bitcast<vec4<f32>>(vec4<u32>(scrambled, second, z_order(words.xy), 0u)));
}

// (wo, g), (xi, 0, 0), (wi, 0): (drawn wi, its density), (density of wi, 0, 0, 0).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn phase(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    let wo = input(id.x, 0u);
    let wi = phase_sample(wo.w, wo.xyz, input(id.x, 1u).xy);
    output(id.x, 0u, vec4<f32>(wi, phase_eval(wo.w, wo.xyz, wi)));
    output(id.x, 1u, vec4<f32>(phase_eval(wo.w, wo.xyz, input(id.x, 2u).xyz), 0.0, 0.0, 0.0));
}

// (normal, P), (wo, g), (xi, specular), (wi, alpha): (drawn wi, f), (its density, f and density
// of wi, reflectance at n.wo).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn surface(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    let a = input(id.x, 0u);
    let b = input(id.x, 1u);
    let c = input(id.x, 2u);
    let d = input(id.x, 3u);
    let surface = Surface(a.xyz, a.w, c.w, d.w);
    let wi = scatter_sample(b.w, surface, b.xyz, c.xyz);
    output(id.x, 0u, vec4<f32>(wi, scatter_eval(b.w, surface, b.xyz, wi)));
    output(id.x, 1u, vec4<f32>(
        scatter_pdf(b.w, surface, b.xyz, wi),
        scatter_eval(b.w, surface, b.xyz, d.xyz),
        scatter_pdf(b.w, surface, b.xyz, d.xyz),
        fresnel(c.w, dot(a.xyz, b.xyz)),
    ));
}

// (xi, bits), (wi, v): (drawn wi, density), (its radiance, density of drawn wi as evaluated),
// (radiance of wi, density).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn light(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    let xi = input(id.x, 0u);
    let wi = input(id.x, 1u);
    let drawn = environment_sample(bitcast<u32>(xi.w), wi.w, xi.xyz);
    output(id.x, 0u, vec4<f32>(drawn.wi, drawn.pdf));
    output(id.x, 1u, vec4<f32>(drawn.radiance, environment_eval(drawn.wi).pdf));
    let given = environment_eval(wi.xyz);
    output(id.x, 2u, vec4<f32>(given.radiance, given.pdf));
}

// (s, 0, 0, 0): (sigma_t, emission by itself), (albedo, roughness), (emission, specular).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn transfer(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    let s = input(id.x, 0u).x;
    let material = transfer_material(s);
    output(id.x, 0u, vec4<f32>(transfer_sigma_t(s), transfer_emission(s)));
    output(id.x, 1u, vec4<f32>(material.albedo, material.roughness));
    output(id.x, 2u, vec4<f32>(material.emission, material.specular));
}

// (texel, 0): (gradient, s).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn field(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    let texel = input(id.x, 0u).xyz;
    output(id.x, 0u, vec4<f32>(field_gradient(texel), field_at(texel)));
}

// (cell, 0): (sigma_maj, 0, 0, 0), (lowest occupied cell, 0), (one past the highest, 0).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn majorant(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    load_occupied();
    let cell = vec3<i32>(input(id.x, 0u).xyz);
    output(id.x, 0u, vec4<f32>(walk_majorant(cell), 0.0, 0.0, 0.0));
    output(id.x, 1u, bitcast<vec4<f32>>(vec4<i32>(low_cell, 0)));
    output(id.x, 2u, bitcast<vec4<f32>>(vec4<i32>(high_cell, 0)));
}

// (origin, tau), (direction, t_start): (event, distance, t_cell, t_end), (cell, 0).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn walk(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    load_occupied();
    let a = input(id.x, 0u);
    let b = input(id.x, 1u);
    var walk = walk_start(a.xyz, b.xyz, b.w, a.w);
    if !(walk.t_end > walk.t_cell) {
        output(id.x, 0u, vec4<f32>(f32(WALK_MISSED), 0.0, 0.0, 0.0));
        return;
    }
    var event = WALK_MOVING;
    for (var i = 0u; i < WALK_ROUNDS && event == WALK_MOVING; i += 1u) {
        event = walk_advance(&walk, #{STEPS_PER_ROUND}u);
    }
    output(id.x, 0u, vec4<f32>(f32(event), walk_distance(walk), walk.t_cell, walk.t_end));
    output(id.x, 1u, vec4<f32>(vec3<f32>(walk.cell), 0.0));
}

// (normal, P), (wo, g), (first, specular, alpha), (key, 0): (wi, 0), (weight, 0).
@compute @workgroup_size(#{WORKGROUP_SIZE})
fn choice(@builtin(global_invocation_id) id: vec3<u32>) {
    if idle(id.x) { return; }
    let a = input(id.x, 0u);
    let b = input(id.x, 1u);
    let c = input(id.x, 2u);
    let key = bitcast<vec4<u32>>(input(id.x, 3u));
    let choice = choose_light(b.w, Surface(a.xyz, a.w, c.z, c.w), b.xyz, c.xy, key.xyz);
    output(id.x, 0u, vec4<f32>(choice.wi, 0.0));
    output(id.x, 1u, vec4<f32>(choice.weight, 0.0));
}

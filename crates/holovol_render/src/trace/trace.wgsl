// The volume path tracer. Each invocation makes the samples of one pixel, one after the other, in
// one loop whose round is a few steps of a walk: so lanes of a subgroup stay busy though their paths
// differ, and a path can be saved after any round and go on in the next dispatch.
//
// A flight goes on through the volume after its tentative collisions, weighs each by the
// transmittance in front of it, and scatters at one of them, chosen by weight: its opacity is an
// expectation instead of a coin toss (Novak et al. 2014, ratio tracking).

#import holovol_render::bindings::{
    scene, views, dispatch, accumulators, counters, guides, mesh_depth_texture, shares_texture,
}
#import holovol_render::path::{Path, save_path, restore_path}
#import holovol_render::random::{pcg3d, sobol_pair, z_order, unit_float, unit_float_pair, unit_float_triple}
#import holovol_render::field::{field_at, field_gradient}
#import holovol_render::transfer_function::{
    transfer_sigma_t, transfer_emission, transfer_material,
}
#import holovol_render::surface::{Surface, scatter_eval, scatter_pdf, scatter_sample}
#import holovol_render::scattering::choose_light
#if LIGHT_GRID == 1
#import holovol_render::light_grid::insert::add_light
#endif
#import holovol_render::walk::{
    Walk, walk_start, walk_advance, walk_deepen, walk_distance, WALK_COLLISION, WALK_LEFT, NEVER,
    load_occupied, walk_cells_entered,
}

// What a lane does next.
const STAGE_START: u32 = 0u;
const STAGE_FLIGHT: u32 = 1u;
const STAGE_SHADOW: u32 = 2u;
const STAGE_SCATTER: u32 = 3u;
const STAGE_BOUNCE: u32 = 4u;
const STAGE_FINISH: u32 = 5u;

// Below this transmittance a walk lives on by chance.
const ROULETTE_TRANSMITTANCE: f32 = 0.2;
// 2^32 / golden ratio: multiples of it spread well.
const GOLDEN_STEP: u32 = 0x9e3779b9u;
// 2^-12: what f32 can take off a transmittance again and again without rounding that tells.
const SMALLEST_WEIGHT: f32 = 0.000244140625;
// Until then all roundings together stay below 1e-4.
const MANY_COLLISIONS: u32 = 1024u;
// Collisions of the camera's flight that are lit.
const PICKS: u32 = #{PICKS}u;
// Pixels along a side of a block that shares its samples.
const SHARE_BLOCK: u32 = #{SHARE_BLOCK}u;
const FOLD_SAMPLES: u32 = #{FOLD_SAMPLES}u;
// Steps of a walk before lanes ask again who waits: asking costs about as much as half a step.
const WALKS_PER_ROUND: u32 = 4u;
// Well-spread dimensions: pixel position, first collision, and from here two for each scattering.
const DIMENSION_PIXEL: u32 = 0u;
const DIMENSION_FLIGHT: u32 = 1u;
const DIMENSION_LIGHT: u32 = 2u;
// Pixels along a side of a block that shares a sequence of points: those of z_order.
const SPREAD_BLOCK: u32 = 16u;
// Streams of plain random numbers, by the key's last word.
const STREAM_SCATTER: u32 = 0x40000000u;
const STREAM_STRIDE: u32 = 16u;

fn path_random(path: ptr<function, Path>) -> vec3<f32> {
    let bits = pcg3d(vec3<u32>((*path).key, (*path).counter));
    (*path).counter += 1u;
    return unit_float_triple(bits);
}

fn path_key(view: u32, pixel: u32, sample: u32) -> vec2<u32> {
    return pcg3d(vec3<u32>(pixel, sample, views[view].image.w)).xy;
}

// Pixels of few samples share the sequence of their block, which goes along a Z-shaped curve: those next
// to each other have points far apart, so that a mean over neighbours knows more than as many samples of
// one of them. Ahmed and Wonka 2020, "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error via
// Hierarchical Ordering of Pixels"; blocks of their own, so that no bad draw is that of a whole image.
fn begin_sequence(path: ptr<function, Path>) {
    let width = views[(*path).view].image.x;
    let pixel = vec2<u32>((*path).pixel % width, (*path).pixel / width);
    let samples = views[(*path).view].samples.z;
    let block = pixel / SPREAD_BLOCK;
    (*path).sequence = select((*path).pixel, block.x + width * block.y, samples > 0u);
    (*path).first_point = samples * z_order(pixel);
}

// Of each sequence, view and dimension.
fn well_spread_seeds(path: Path, dimension: u32) -> vec3<u32> {
    return pcg3d(vec3<u32>(path.sequence, views[path.view].image.w ^ 0x85ebca6bu, dimension));
}

// per_sample: how many points of this dimension a sample takes.
fn point_of(path: Path, index: u32, per_sample: u32) -> u32 {
    return per_sample * path.first_point + index;
}

fn well_spread(path: Path, index: u32, dimension: u32, per_sample: u32) -> vec2<f32> {
#if WHITE_NOISE == 1
    let view_seed = views[path.view].image.w;
    return unit_float_pair(pcg3d(vec3<u32>(path.pixel, index, view_seed ^ (0x85ebca6bu * (dimension + 1u)))).xy);
#else
    return sobol_pair(point_of(path, index, per_sample), well_spread_seeds(path, dimension).x);
#endif
}

// One more number beside those two: a rotated lattice, by another seed.
fn well_spread_third(path: ptr<function, Path>, index: u32, dimension: u32, per_sample: u32) -> f32 {
#if WHITE_NOISE == 1
    return path_random(path).x;
#else
    let point = point_of(*path, index, per_sample);
    return unit_float(well_spread_seeds(*path, dimension).y + GOLDEN_STEP * point);
#endif
}

fn texel_from_world(direction: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot(scene.texel_from_world_x.xyz, direction),
        dot(scene.texel_from_world_y.xyz, direction),
        dot(scene.texel_from_world_z.xyz, direction),
    );
}

fn optical_depth_draw(xi: f32) -> f32 {
    // log is least exact near 1, where drivers are allowed an absolute error.
    let series = xi * (1.0 + xi * (0.5 + xi * (1.0 / 3.0 + xi * 0.25)));
    return select(-log(1.0 - xi), series, xi < 0.02);
}

fn begin_walk(path: ptr<function, Path>, stage: u32, walk: Walk) {
    (*path).walk = walk;
    (*path).stage = stage;
    (*path).transmittance = 1.0;
}

fn begin_flight(path: ptr<function, Path>, origin: vec3<f32>, direction: vec3<f32>, xi: vec2<f32>) {
    (*path).weight_sum = 0.0;
    (*path).pick = 0u;
    (*path).flight_origin = origin;
    for (var k = 0u; k < PICKS; k += 1u) {
        (*path).xi[k] = fract(xi.y + f32(k) / f32(PICKS));
    }
    begin_walk(path, STAGE_FLIGHT, walk_start(origin, direction, 0.0, optical_depth_draw(xi.x)));
}

#if MESH_DEPTH == 1
// Metres along the camera's axis to the first opaque mesh. Samples take turns with those of
// multisampling, and so do frames that begin anew with their first sample.
fn mesh_depth(view: u32, position: vec2<f32>, sample: u32) -> f32 {
    let map = views[view].mesh_depth;
    if map.w == 0u {
        return NEVER;
    }
    let size = vec2<f32>(map.xy);
    let texel = clamp(position * size / vec2<f32>(views[view].image.xy), vec2<f32>(0.0), size - 1.0);
    return textureLoad(mesh_depth_texture, vec2<u32>(texel), map.z + (sample + views[view].image.w) % map.w, 0).x;
}
#endif

fn start_sample(path: ptr<function, Path>) {
    if (*path).sample >= (*path).sample_end {
        return;
    }
    (*path).key = path_key((*path).view, (*path).pixel, (*path).sample);
    (*path).counter = 0u;
    (*path).depth = 0u;
    (*path).throughput = vec3<f32>(1.0);
    (*path).radiance = vec3<f32>(0.0);
    (*path).opacity = 0.0;
    let view = (*path).view;
    let width = views[view].image.x;
    let corner = vec2<f32>(f32((*path).pixel % width), f32((*path).pixel / width));
    let position = corner + well_spread(*path, (*path).sample, DIMENSION_PIXEL, 1u);
    let origin = views[view].ray_origin + position.x * views[view].ray_origin_dx
        + position.y * views[view].ray_origin_dy;
    let texel = views[view].ray_texel + position.x * views[view].ray_texel_dx
        + position.y * views[view].ray_texel_dy;
    let world = views[view].ray_world + position.x * views[view].ray_world_dx
        + position.y * views[view].ray_world_dy;
    let metres_per_depth = length(world.xyz);
    (*path).wo = -world.xyz / metres_per_depth;
    let flight = well_spread(*path, (*path).sample, DIMENSION_FLIGHT, 1u);
    begin_flight(path, origin.xyz, texel.xyz / metres_per_depth, flight);
#if MESH_DEPTH == 1
    let depth = mesh_depth(view, position, (*path).sample) - views[view].forward.w;
    (*path).walk.t_end = min((*path).walk.t_end, depth * metres_per_depth);
#endif
    if (*path).walk.t_end <= (*path).walk.t_cell {
        (*path).stage = STAGE_FINISH;
    }
}

#if SAMPLE_SHARES == 1
// Samples that a pixel gets of those that its view is given.
fn own_samples(view: u32, pixel: vec2<u32>) -> u32 {
    let given = views[view].samples.y - views[view].samples.x;
    // A larger view without shares of its own has all everywhere.
    let block = min(pixel / SHARE_BLOCK, textureDimensions(shares_texture) - 1u);
    let share = textureLoad(shares_texture, block, view, 0).x;
    return (given * share + 254u) / 255u;
}
#endif

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn finish_sample(path: ptr<function, Path>) {
    var value = vec4<f32>((*path).radiance, (*path).opacity);
    if !(is_finite(value.x) && is_finite(value.y) && is_finite(value.z) && is_finite(value.w)) {
        // Only an overflow can cause it: radiance near the end of f32.
        value = vec4<f32>(0.0);
        atomicAdd(&counters.nonfinite_samples, 1u);
    }
#if SAMPLE_SHARES == 1
    // Fewer samples weigh more: the image is divided by those that its view is given.
    let view = (*path).view;
    let width = views[view].image.x;
    let own = own_samples(view, vec2<u32>((*path).pixel % width, (*path).pixel / width));
    value *= f32(views[view].samples.y - views[view].samples.x) / f32(max(own, 1u));
#endif
    let recent = 2u * (views[(*path).view].image.z + (*path).pixel);
    let sum = accumulators[recent] + value;
    (*path).sample += 1u;
    if (*path).sample % FOLD_SAMPLES == 0u {
        accumulators[recent + 1u] += sum;
        accumulators[recent] = vec4<f32>(0.0);
    } else {
        accumulators[recent] = sum;
    }
#if STATISTICS == 1
    if (*path).opacity > 0.0 {
        atomicAdd(&counters.covered_samples, 1u);
    }
#endif
    (*path).stage = STAGE_START;
}

fn surface_at(texel: vec3<f32>, wo: vec3<f32>, roughness: f32, specular: f32) -> Surface {
    var surface = Surface(vec3<f32>(0.0, 0.0, 1.0), 0.0, 0.0, 1.0);
#if SURFACE == 1
    let gradient = field_gradient(texel);
    let magnitude = length(gradient);
    if magnitude > 0.0 && is_finite(magnitude) {
        let normal = gradient / magnitude;
        surface.normal = select(-normal, normal, dot(normal, wo) >= 0.0);
        surface.probability = 1.0 - exp(-scene.field.w * magnitude);
        surface.specular = specular;
        surface.alpha = max(roughness * roughness, 1e-3);
    }
#endif
    return surface;
}

#if GUIDES == 1
fn add_guides(
    view: u32,
    pixel: u32,
    texel: vec3<f32>,
    wo: vec3<f32>,
    distance: f32,
    albedo: vec3<f32>,
    flight_weight: f32,
) {
    let before = views[view].forward.w / dot(-wo, views[view].forward.xyz);
    let depth = before + distance;
    let weight = flight_weight / f32(PICKS);
    let gradient = field_gradient(texel);
    let magnitude = length(gradient);
    let base = 3u * (views[view].image.z + pixel);
    // Depths from the first one on: their variance outlives the rounding of sums.
    let sums = guides[base];
    let first = select(guides[base + 1u].w, depth, sums.w == 0.0);
    let behind = depth - first;
    guides[base] = sums + weight * vec4<f32>(behind, behind * behind, magnitude, 1.0);
    guides[base + 1u] = vec4<f32>(guides[base + 1u].rgb + weight * albedo, first);
    guides[base + 2u] += weight * vec4<f32>(gradient / max(magnitude, 1e-30), 0.0);
}
#endif

// Collisions to be lit: several of the camera's flight, so that its cost is shared; one later on.
fn picks_at(depth: u32) -> u32 {
    return select(1u, PICKS, depth == 0u);
}

// At a chosen collision: light by a shadow walk; at the last one, the direction of the next flight.
fn scatter(path: ptr<function, Path>) {
    let pick = (*path).pick;
    let distance = (*path).chosen_distance[pick];
    let texel = (*path).flight_origin + distance * texel_from_world(-(*path).wo);
    let material = transfer_material((*path).chosen_s[pick]);
    let g = scene.field.z;
    let surface = surface_at(texel, (*path).wo, material.roughness, material.specular);
    let throughput = (*path).throughput * (*path).weight_sum * material.albedo;
#if GUIDES == 1
    if (*path).depth == 0u {
        add_guides(
            (*path).view, (*path).pixel, texel, (*path).wo, distance, material.albedo,
            (*path).weight_sum,
        );
    }
#endif
#if GUIDES == 1
    if scene.cells.w == 0u {
        // Emission only: nothing to light.
        (*path).pick += 1u;
        (*path).stage = select(STAGE_SCATTER, STAGE_FINISH, (*path).pick == PICKS);
        return;
    }
#endif
    let stream = STREAM_SCATTER + STREAM_STRIDE * (PICKS * (*path).depth + pick);
    let picks = picks_at((*path).depth);
    let dimension = DIMENSION_LIGHT + 2u * (*path).depth;
    let index = picks * (*path).sample + pick;
    let first = well_spread(*path, index, dimension, picks);
    let choice = choose_light(g, surface, (*path).wo, first, vec3<u32>((*path).key, stream));
    (*path).light = throughput * choice.weight / f32(picks);
#if LIGHT_GRID == 1
    let share = (*path).weight_sum * dot(material.albedo, vec3<f32>(1.0)) / f32(picks);
    (*path).light_share = select(0.0, share, (*path).depth == 0u);
#endif
    (*path).walk.origin = texel;
    (*path).stage = STAGE_BOUNCE;
    (*path).pick += 1u;
    if (*path).pick == picks {
        (*path).depth += 1u;
#if MULTIPLE_SCATTERING == 1
        let bits = pcg3d(vec3<u32>((*path).key, stream + STREAM_STRIDE - 1u));
        let uv = well_spread(*path, (*path).sample, dimension + 1u, 1u);
        let wi = scatter_sample(g, surface, (*path).wo, vec3<f32>(uv, unit_float(bits.x)));
        (*path).next_wi = wi;
        (*path).throughput = throughput;
#if SURFACE == 1
        let pdf = scatter_pdf(g, surface, (*path).wo, wi);
        (*path).throughput *= select(0.0, scatter_eval(g, surface, (*path).wo, wi) / pdf, pdf > 0.0);
#endif
        // Lives on by chance once its throughput has fallen below that of the first collision.
        let alive = max(max((*path).throughput.r, (*path).throughput.g), (*path).throughput.b);
        let lives = unit_float(bits.y) < alive;
        (*path).throughput = select(vec3<f32>(0.0), (*path).throughput / min(alive, 1.0), lives);
#endif
    }
    // Not "> 0": what is not a number must reach the check of the finished sample.
    if any((*path).light != vec3<f32>(0.0)) {
        let tau = optical_depth_draw(well_spread_third(path, index, dimension, picks));
        begin_walk(path, STAGE_SHADOW, walk_start(texel, texel_from_world(choice.wi), 0.0, tau));
        if (*path).walk.t_end <= (*path).walk.t_cell {
            (*path).radiance += (*path).light;
            (*path).stage = STAGE_BOUNCE;
        }
    }
}

fn bounce(path: ptr<function, Path>) {
#if LIGHT_GRID == 1
    if (*path).light_share > 0.0 {
        let light = dot((*path).light, vec3<f32>(1.0)) * (*path).transmittance / (*path).light_share;
        add_light((*path).walk.origin, views[(*path).view].samples.w, light);
        (*path).light_share = 0.0;
    }
#endif
    if (*path).pick < picks_at((*path).depth) {
        (*path).stage = STAGE_SCATTER;
        return;
    }
    (*path).stage = STAGE_FINISH;
#if MULTIPLE_SCATTERING == 1
#if EMISSION == 1
    let goes_on = true;
#else
    let goes_on = (*path).depth < scene.cells.w;
#endif
    if goes_on && any((*path).throughput > vec3<f32>(0.0)) {
        (*path).wo = -(*path).next_wi;
        let xi = path_random(path).xy;
        begin_flight(path, (*path).walk.origin, texel_from_world((*path).next_wi), xi);
        if (*path).walk.t_end <= (*path).walk.t_cell {
            (*path).stage = STAGE_FINISH;
        }
    }
#endif
}

// One tentative collision, or the end of the walk.
fn walk_round(path: ptr<function, Path>, lookups: ptr<function, u32>) {
    var walk = (*path).walk;
    let event = walk_advance(&walk, #{STEPS_PER_ROUND}u);
    (*path).walk = walk;
    var ended = event == WALK_LEFT;
    if event == WALK_COLLISION {
        let distance = walk_distance((*path).walk);
        let s = field_at((*path).walk.origin + distance * (*path).walk.direction);
        let sigma_t = transfer_sigma_t(s);
        *lookups += 1u;
        if sigma_t > (*path).walk.sigma_maj {
            atomicAdd(&counters.majorant_violations, 1u);
        }
        var collision_probability = min(sigma_t / (*path).walk.sigma_maj, 1.0);
        let xi = path_random(path);
        if collision_probability < SMALLEST_WEIGHT && (*path).counter > MANY_COLLISIONS {
            // So many sums and products would round such a weight away: a larger one, seldom.
            let counts = xi.z * SMALLEST_WEIGHT < collision_probability;
            collision_probability = select(0.0, SMALLEST_WEIGHT, counts);
        }
        if (*path).stage == STAGE_FLIGHT {
            let weight = (*path).transmittance * collision_probability;
            (*path).weight_sum += weight;
            // One number chooses among all: stretched after each decision, it stays uniform.
            let share = select(0.0, weight / (*path).weight_sum, weight > 0.0);
            let if_chosen = 1.0 / share;
            let if_not = 1.0 / (1.0 - share);
            for (var k = 0u; k < PICKS; k += 1u) {
                let chosen = (*path).xi[k] < share;
                (*path).chosen_distance[k] = select((*path).chosen_distance[k], distance, chosen);
                (*path).chosen_s[k] = select((*path).chosen_s[k], s, chosen);
                let above = ((*path).xi[k] - share) * if_not;
                (*path).xi[k] = select(above, (*path).xi[k] * if_chosen, chosen);
            }
#if EMISSION == 1
            (*path).radiance += (*path).throughput * weight * transfer_emission(s);
#endif
        }
        (*path).transmittance *= 1.0 - collision_probability;
        if (*path).transmittance < ROULETTE_TRANSMITTANCE {
            if xi.x * ROULETTE_TRANSMITTANCE < (*path).transmittance {
                (*path).transmittance = ROULETTE_TRANSMITTANCE;
            } else {
                (*path).transmittance = 0.0;
                ended = true;
            }
        }
        var walk = (*path).walk;
        walk_deepen(&walk, optical_depth_draw(xi.y));
        (*path).walk = walk;
    }
    if ended {
        if (*path).stage == STAGE_SHADOW {
            (*path).radiance += (*path).light * (*path).transmittance;
            (*path).stage = STAGE_BOUNCE;
        } else {
            if (*path).depth == 0u {
                (*path).opacity = (*path).weight_sum;
            }
#if GUIDES == 1
            // The guides want the first collision even where nothing scatters.
            let scatters_most = max(scene.cells.w, 1u);
#else
            let scatters_most = scene.cells.w;
#endif
            let scatters = (*path).weight_sum > 0.0 && (*path).depth < scatters_most;
            (*path).stage = select(STAGE_FINISH, STAGE_SCATTER, scatters);
        }
    }
}

#if SUBGROUPS == 1
fn count_lanes(ballot: vec4<u32>) -> u32 {
    let counts = countOneBits(ballot);
    return counts.x + counts.y + counts.z + counts.w;
}
#endif

// Runs a path, and the further samples of its pixel, to their end or until the budget is spent.
fn run(initial: Path) {
    var path = initial;
    var lookups = 0u;
    let is_unlimited = atomicLoad(&counters.unlimited) != 0u;
    var budget = select(dispatch.budget, 0xffffffffu, is_unlimited);
    // Counted in steps of walks.
    var round = 0u;
    loop {
        if path.stage == STAGE_START && path.sample >= path.sample_end {
            break;
        }
        let walking = path.stage == STAGE_FLIGHT || path.stage == STAGE_SHADOW;
        if round >= budget && walking {
            let slot = atomicAdd(&counters.saved_paths, 1u);
            if slot < dispatch.queue_capacity {
                save_path(path, slot);
                break;
            }
            // No room: going on here is slow, but right.
            budget += dispatch.budget;
        }
        round += WALKS_PER_ROUND;
        var served = !walking;
#if SUBGROUPS == 1
        // Scattering costs much: lanes wait until there are enough of them.
        let walking_lanes = count_lanes(subgroupBallot(walking));
        let waiting_lanes = count_lanes(subgroupBallot(!walking));
        served = served && waiting_lanes * #{SERVE_RATIO}u >= walking_lanes;
#endif
        if served {
            if path.stage == STAGE_BOUNCE {
                bounce(&path);
            }
            if path.stage == STAGE_SCATTER {
                scatter(&path);
            }
            if path.stage == STAGE_FINISH {
                finish_sample(&path);
            }
            if path.stage == STAGE_START {
                start_sample(&path);
            }
        }
        for (var i = 0u; i < WALKS_PER_ROUND; i += 1u) {
            if path.stage == STAGE_FLIGHT || path.stage == STAGE_SHADOW {
                walk_round(&path, &lookups);
            }
        }
    }
#if STATISTICS == 1
    atomicAdd(&counters.lookups, lookups);
    atomicAdd(&counters.cells, walk_cells_entered());
#endif
}

@compute @workgroup_size(#{WORKGROUP_SIZE})
fn trace(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    // Lanes of a subgroup lie in a compact block: 4x2, 8x4, 8x8 pixels.
    let block = vec2<u32>(
        (local & 3u) | ((local >> 1u) & 4u),
        ((local >> 2u) & 1u) | ((local >> 3u) & 6u),
    );
    let tile_pixel = 8u * group.xy + block;
    if any(tile_pixel >= dispatch.tile_size) {
        return;
    }
    let pixel = dispatch.tile_origin + tile_pixel;
    let image = views[group.z].image;
    let samples = views[group.z].samples;
    if any(pixel >= image.xy) || samples.x >= samples.y {
        return;
    }
    var path: Path;
    load_occupied();
    path.stage = STAGE_START;
    path.view = group.z;
    path.pixel = pixel.x + image.x * pixel.y;
    begin_sequence(&path);
    path.sample = samples.x;
    path.sample_end = samples.y;
#if SAMPLE_SHARES == 1
    // The last ones: sums are folded where the view's samples end.
    path.sample = samples.y - own_samples(group.z, pixel);
#endif
    run(path);
}

@compute @workgroup_size(#{WORKGROUP_SIZE})
fn resume(@builtin(global_invocation_id) invocation: vec3<u32>) {
    if invocation.x >= dispatch.resumed_paths + atomicLoad(&counters.resumed_paths) {
        return;
    }
    load_occupied();
    var path = restore_path(invocation.x);
    begin_sequence(&path);
    run(path);
}

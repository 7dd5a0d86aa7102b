// Guides without noise: one ray through the middle of each pixel, marched with fixed steps through
// cells that are not empty. The field is looked up once a step; the transfer function is evaluated
// at several places between, as if the field were linear there.

#import holovol_render::bindings::{scene, views, mesh_depth_texture}
#import holovol_render::field::{field_at, field_gradient}
#import holovol_render::transfer_function::{transfer_sigma_t, transfer_material}
#import holovol_render::walk::{walk_start, walk_majorant, load_occupied}
#import holovol_render::surface::{Surface, scatter_eval}
#import holovol_render::phase_function::PI
#if LIGHT_GRID == 1
#import holovol_render::light_grid::lookup::light_at
#endif
#import holovol_render::denoise::common::{
    denoise, lights, keys, Key, pack_key, half_now, albedo_at, mean_rgb, ALBEDO_FLOOR, LEAST_ALBEDO,
}

// Texels of a step, the second where a dominant light is followed: its shadows are as sharp as the
// place is known; and evaluations of the transfer function in it.
const STEP: vec2<f32> = vec2<f32>(2.0, 1.0);
const PARTS: u32 = 3u;
const MIDDLES: vec3<f32> = vec3<f32>(1.0 / 6.0, 0.5, 5.0 / 6.0);
// Steps at most: a volume of 4096 texels a side is crossed; longer ones in longer steps.
const MAX_STEPS: f32 = 4096.0;
// What is left behind this transmittance is taken to be as what is in front.
const OPAQUE: f32 = 0.04;
// Optical depth of a step, times transmittance, that is looked at more closely.
const CLOSER: f32 = 0.1;
// The normal is taken where this transmittance is reached.
const NORMAL_TRANSMITTANCE: f32 = 0.6;
// Transmittances at whose places light is asked for: the middles of four quarters of what a ray sees
// that nothing passes. Of others the last place counts for what there is of its quarter.
const LIT: vec4<f32> = vec4<f32>(0.875, 0.625, 0.375, 0.125);
// Steps toward a light are a texel long, and a texel longer after every FINE_TEXELS, up to
// LONGEST_STEP.
const FINE_TEXELS: f32 = 5.0;
const LONGEST_STEP: f32 = 3.0;
// Optical depth at which a ray to a light ends; a twentieth of it is left at most, and taken as it is.
const DARK: f32 = 3.0;
// Where a step can't take more of what is seen than these, by its cell's majorant, it is twice and
// four times as long, within the cell.
const THIN: vec2<f32> = vec2<f32>(0.05, 0.012);
const CELL_SIZE: f32 = #{CELL_SIZE}.0;
const NEVER: f32 = 3e38;
// Of what is seen, a step's share from which on it asks the light grid.
const LEAST_LIT: f32 = 0.002;

#if MESH_DEPTH == 1
// Depths of the nearest and of the farthest opaque mesh among a pixel's samples, and the share of
// samples that reach the farthest.
fn mesh_ends(slot: u32, position: vec2<f32>) -> vec3<f32> {
    let map = views[slot].mesh_depth;
    if map.w == 0u {
        return vec3<f32>(NEVER, NEVER, 1.0);
    }
    let size = vec2<f32>(map.xy);
    let texel = clamp(position * size / vec2<f32>(views[slot].image.xy), vec2<f32>(0.0), size - 1.0);
    var near = NEVER;
    var far = 0.0;
    for (var k = 0u; k < map.w; k += 1u) {
        let depth = textureLoad(mesh_depth_texture, vec2<u32>(texel), map.z + k, 0).x;
        near = min(near, depth);
        far = max(far, depth);
    }
    // Half way between the two, or not far behind the nearer if there is nothing behind it.
    let middle = min(0.5 * near + 0.5 * far, 2.0 * near);
    var behind = 0.0;
    for (var k = 0u; k < map.w; k += 1u) {
        let depth = textureLoad(mesh_depth_texture, vec2<u32>(texel), map.z + k, 0).x;
        behind += select(0.0, 1.0, depth >= middle);
    }
    return vec3<f32>(near, far, behind / f32(map.w));
}
#endif

// Transmittance from a place (texel coordinates) toward a light (texels per metre).
fn shadow(place: vec3<f32>, toward: vec3<f32>) -> f32 {
    let walk = walk_start(place, toward, 0.0, 0.0);
    let range = walk.t_end - walk.t_cell;
    let fine = max(1.0 / max(length(toward), 1e-30), range / MAX_STEPS);
    let inverse = 1.0 / select(toward, vec3<f32>(1e-30), abs(toward) < vec3<f32>(1e-30));
    let ahead = select(vec3<f32>(0.0), vec3<f32>(1.0), toward > vec3<f32>(0.0));
    let last_cell = vec3<i32>(scene.cells.xyz) - 1;
    var t = walk.t_cell;
    var s = 0.0;
    var known = false;
    var tau = 0.0;
    var steps = 0.0;
    while t < walk.t_end && tau < DARK && steps < 2.0 * MAX_STEPS && range > 0.0 {
        steps += 1.0;
        let longer = clamp(floor(1.0 + (t - walk.t_cell) / (FINE_TEXELS * fine)), 1.0, LONGEST_STEP);
        let dt = min(fine * longer, walk.t_end - t);
        let metres = dt / f32(PARTS);
        let at = place + (t + 0.5 * dt) * toward;
        let cell = clamp(vec3<i32>(floor(at / CELL_SIZE)), vec3<i32>(0), last_cell);
        if walk_majorant(cell) <= 0.0 {
            let exits = (CELL_SIZE * (vec3<f32>(cell) + ahead) - place) * inverse;
            let t_exit = min(exits.x, min(exits.y, exits.z));
            t += dt * max(1.0, floor((t_exit - t) / dt));
            known = false;
            continue;
        }
        if !known {
            s = field_at(place + t * toward);
        }
        let next = field_at(place + (t + dt) * toward);
        for (var k = 0u; k < PARTS; k += 1u) {
            tau += metres * transfer_sigma_t(mix(s, next, (f32(k) + 0.5) / f32(PARTS)));
        }
        s = next;
        known = true;
        t += dt;
    }
    return exp(-tau);
}

@compute @workgroup_size(64)
fn march(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let position = 8u * group.xy
        + vec2<u32>((local & 3u) | ((local >> 1u) & 4u), ((local >> 2u) & 1u) | ((local >> 3u) & 6u));
    let eye = group.z;
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let slot = denoise.eyes[eye].place.x;
    load_occupied();
    let p = vec2<f32>(position) + 0.5;
    let origin = (views[slot].ray_origin + p.x * views[slot].ray_origin_dx + p.y * views[slot].ray_origin_dy).xyz;
    let texel = (views[slot].ray_texel + p.x * views[slot].ray_texel_dx + p.y * views[slot].ray_texel_dy).xyz;
    let world = (views[slot].ray_world + p.x * views[slot].ray_world_dx + p.y * views[slot].ray_world_dy).xyz;
    // Distances along the ray are depths along the eye's axis, from near on.
    let near = views[slot].forward.w;
    let length_world = length(world);
    var walk = walk_start(origin, texel, 0.0, 0.0);
#if MESH_DEPTH == 1
    let ends = mesh_ends(slot, p) - vec3<f32>(near, near, 0.0);
    walk.t_end = min(walk.t_end, ends.y);
#endif
    let texels_per_depth = max(length(texel), 1e-30);
    let range = walk.t_end - walk.t_cell;
    let has_sun = denoise.light.x > 0.0;
    let fine = max(select(STEP.x, STEP.y, has_sun) / texels_per_depth, range / MAX_STEPS);
    let inverse = 1.0 / select(texel, vec3<f32>(1e-30), abs(texel) < vec3<f32>(1e-30));
    let ahead = select(vec3<f32>(0.0), vec3<f32>(1.0), texel > vec3<f32>(0.0));
    let last_cell = vec3<i32>(scene.cells.xyz) - 1;

    var transmittance = 1.0;
    // Of the samples that no mesh has ended.
    var left = 1.0;
    var opacity = 0.0;
    var albedo = vec3<f32>(0.0);
    // Of depths behind the entry: their variance outlives rounding.
    var sum = 0.0;
    var sum2 = 0.0;
    var normal_depth = -1.0;
#if LIGHT_GRID == 1
    // Of the light grid: albedo of what it knows, and with its light.
    var gridded = vec2<f32>(0.0);
    let asks_grid = denoise.light.y > 0.0;
#endif
    // Where light is asked for, and the field at the first place.
    var lit = vec4<f32>(-1.0);
    var lit_value = 0.0;
    var t = walk.t_cell;
    var s = 0.0;
    var known = false;
    var steps = 0.0;
    while t < walk.t_end && transmittance > OPAQUE && steps < 2.0 * MAX_STEPS && range > 0.0 {
        steps += 1.0;
        let at = origin + (t + 0.5 * fine) * texel;
        let cell = clamp(vec3<i32>(floor(at / CELL_SIZE)), vec3<i32>(0), last_cell);
        let exits = (CELL_SIZE * (vec3<f32>(cell) + ahead) - origin) * inverse;
        let t_exit = min(exits.x, min(exits.y, exits.z));
        let steps_inside = max(1.0, floor((t_exit - t) / fine));
        let majorant = walk_majorant(cell);
        if majorant <= 0.0 {
            t += fine * steps_inside;
            known = false;
            continue;
        }
        let most_taken = transmittance * majorant * fine * length_world;
        let longer = select(select(1.0, 2.0, most_taken < THIN.x), 4.0, most_taken < THIN.y);
        let dt = min(fine * min(longer, steps_inside), walk.t_end - t);
        let metres = dt * length_world / f32(PARTS);
        if !known {
            s = field_at(origin + t * texel);
        }
        let next = field_at(origin + (t + dt) * texel);
        // As if the field were linear; for shadows looked up where much of what is seen lies.
        var values = vec3<f32>(mix(s, next, 1.0 / 6.0), mix(s, next, 0.5), mix(s, next, 5.0 / 6.0));
        var sigma = vec3<f32>(
            transfer_sigma_t(values.x), transfer_sigma_t(values.y), transfer_sigma_t(values.z),
        );
        let seen_here = transmittance * metres * (sigma.x + sigma.y + sigma.z);
        if has_sun && seen_here > CLOSER {
            values = vec3<f32>(
                field_at(origin + (t + dt / 6.0) * texel),
                field_at(origin + (t + 0.5 * dt) * texel),
                field_at(origin + (t + dt * (5.0 / 6.0)) * texel),
            );
            sigma = vec3<f32>(
                transfer_sigma_t(values.x), transfer_sigma_t(values.y), transfer_sigma_t(values.z),
            );
        }
        let enters = transmittance;
        // Where there is nothing, nothing is added up.
        if sigma.x + sigma.y + sigma.z > 0.0 {
            let passed = exp(-sigma * metres);
            let before = transmittance * vec3<f32>(1.0, passed.x, passed.x * passed.y);
            let behind = before * passed;
            let depths = t - walk.t_cell + dt * MIDDLES;
#if MESH_DEPTH == 1
            // What of each part lies before the meshes.
            let parts = vec3<f32>(0.0, 1.0, 2.0);
            let near_reach = clamp((ends.x - t) / dt * f32(PARTS) - parts, vec3<f32>(0.0), vec3<f32>(1.0));
            let far_reach = clamp((ends.y - t) / dt * f32(PARTS) - parts, vec3<f32>(0.0), vec3<f32>(1.0));
            let reached = mix(exp(-sigma * metres * near_reach), exp(-sigma * metres * far_reach), ends.z);
            let weights = before * (1.0 - reached);
            left = mix(near_reach.z, far_reach.z, ends.z);
#else
            let weights = before - behind;
#endif
            let here = weights.x + weights.y + weights.z;
            opacity += here;
            let material_albedo = transfer_material(dot(weights, values) / max(here, 1e-30)).albedo;
            albedo += here * material_albedo;
#if LIGHT_GRID == 1
            if asks_grid && here > LEAST_LIT {
                let middle = walk.t_cell + dot(weights, depths) / here;
                let found = light_at(origin + middle * texel, u32(denoise.light.w));
                let known = select(0.0, here * mean_rgb(material_albedo), found.y > 0.0);
                gridded += known * vec2<f32>(1.0, found.x);
            }
#endif
            sum += dot(weights, depths);
            sum2 += dot(weights, depths * depths);
            transmittance = behind.z;
            let turns = select(select(depths.z, depths.y, behind.y < NORMAL_TRANSMITTANCE), depths.x,
                behind.x < NORMAL_TRANSMITTANCE);
            normal_depth = select(normal_depth, turns, normal_depth < 0.0 && behind.z < NORMAL_TRANSMITTANCE);
        }
        // Where light is asked for: in the part where transmittance falls so far, by its logarithm.
        let crosses = vec4<f32>(enters) >= LIT & vec4<f32>(transmittance) < LIT;
        if has_sun && any(crosses) {
            let first = vec4<f32>(sigma.x * metres);
            let second = first + sigma.y * metres;
            let wanted = log(enters / LIT);
            let in_second = wanted >= first;
            let in_third = wanted >= second;
            let sigma_t = select(select(vec4<f32>(sigma.x), vec4<f32>(sigma.y), in_second), vec4<f32>(sigma.z), in_third);
            let passed = select(select(vec4<f32>(0.0), first, in_second), second, in_third);
            let part = select(select(vec4<f32>(0.0), vec4<f32>(1.0), in_second), vec4<f32>(2.0), in_third);
            let share = (wanted - passed) / max(sigma_t * metres, vec4<f32>(1e-20));
            let place = t + dt * (part + clamp(share, vec4<f32>(0.0), vec4<f32>(1.0))) / f32(PARTS);
            lit = select(lit, place, crosses);
            let value = select(select(values.x, values.y, in_second.x), values.z, in_third.x);
            lit_value = select(lit_value, value, crosses.x);
        }
        s = next;
        known = true;
        t += dt;
    }
    let pixel = denoise.eyes[eye].image.w + position.x + size.x * position.y;
    var key = Key(0.0, vec3<f32>(0.0, 0.0, 1.0), 0.0, 0.0, 0.0, vec2<f32>(0.0));
    if opacity > 1e-4 {
        let mean = sum / opacity;
        let variance = max(sum2 / opacity - mean * mean, 0.0);
        if transmittance <= OPAQUE {
            let all = opacity + left * transmittance;
            albedo *= all / opacity;
            opacity = all;
        }
        let at = walk.t_cell + select(mean, normal_depth, normal_depth >= 0.0);
        let gradient = field_gradient(origin + at * texel);
        let magnitude = length(gradient);
        if magnitude > 0.0 && magnitude < 1e30 {
            key.normal = gradient / magnitude;
        }
        // Black media have an opacity all the same.
        key.albedo = max(mean_rgb(albedo), LEAST_ALBEDO);
        key.depth = near + walk.t_cell + mean;
        key.spread = sqrt(variance);
        if has_sun {
            let wi = denoise.sun.xyz;
            let toward = vec3<f32>(
                dot(scene.texel_from_world_x.xyz, wi),
                dot(scene.texel_from_world_y.xyz, wi),
                dot(scene.texel_from_world_z.xyz, wi),
            );
            if lit.x < 0.0 {
                lit.x = walk.t_cell + mean;
                lit_value = field_at(origin + lit.x * texel);
            }
            var reached = 0.0;
            var sum_of_weights = 0.0;
            for (var k = 0u; k < 4u && lit[k] >= 0.0; k += 1u) {
                let weight = clamp(opacity - 0.25 * f32(k), 1e-3, 0.25);
                reached += weight * shadow(origin + lit[k] * texel, toward);
                sum_of_weights += weight;
            }
            reached /= sum_of_weights;
            let wo = -world / length_world;
            var surface = Surface(vec3<f32>(0.0, 0.0, 1.0), 0.0, 0.0, 1.0);
#if SURFACE == 1
            let material = transfer_material(lit_value);
            surface.normal = select(-key.normal, key.normal, dot(key.normal, wo) >= 0.0);
            surface.probability = 1.0 - exp(-scene.field.w * min(magnitude, 1e30));
            surface.specular = material.specular;
            surface.alpha = max(material.roughness * material.roughness, 1e-3);
#endif
            let scattered = 4.0 * PI * scatter_eval(scene.field.z, surface, wo, wi);
            key.light.x = denoise.light.x * min(scattered, 1e4) * reached;
        }
#if LIGHT_GRID == 1
        if asks_grid {
            key.light.y = denoise.light.y * min(gridded.y / max(gridded.x, 1e-20), 1e4);
        }
#endif
        key.light *= key.albedo / (key.albedo + ALBEDO_FLOOR);
    } else {
        opacity = 0.0;
        albedo = vec3<f32>(0.0);
    }
    keys[half_now() + pixel] = pack_key(key);
    lights[albedo_at(pixel)] = vec4<f32>(albedo, opacity);
}

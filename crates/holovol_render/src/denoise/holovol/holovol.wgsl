// The denoiser's own mode, pass by pass; docs/denoising.md explains it.

#import holovol_render::denoise::common::{
    denoise, state, lights, keys, counts, tiles, noisy, output, Key, unpack_key, with_frames, is_met,
    guide_distance, half_now, half_before, albedo_at, scratch_at, near_at, both_at, tile_at, tile_sums,
    tile_memory, tile_result, tile_rows, light_parts, expected_light, mean_rgb, all_finite, is_marched,
    direction_of, HISTORY_MOVED, HISTORY_SAME, HISTORY_NONE, ALBEDO_FLOOR, LARGEST, TILE,
    SAMPLES_PER_FRAME, BETWEEN,
}
#import holovol_render::denoise::between::{uncovered, guide_between}

// Weights of history and of the other eye below this are nothing.
const NO_WEIGHT: f32 = 0.02;
// Of the samples' relative variance: differences of filtered light up to here are its own noise.
const LIGHT_NOISE: f32 = 0.04;
// Variances that a squared difference of near light must exceed: those of the means over 3 x 3, as
// seen there and as the tile's noise lets expect.
const NEAR_SEEN: f32 = 6.0;
const NEAR_EXPECTED: f32 = 2.0;
// Its square, times that of 9 * 60000 frames, is within f32.
const BRIGHTEST: f32 = 1e12;
// Where filtering pays less than this share, the filter becomes narrower, by its square; not at
// rest, where it pays less as the history grows.
const PAYS: f32 = 0.9;
const NARROWER: vec2<f32> = vec2<f32>(0.5, 16.0);
// Guides of the last frame need not agree more than so many times as much.
const MOST_STRICT: f32 = 8.0;
// Of the history's frames, times them and the square of the angle that a place turned by: its light
// turns with the normal, the gloss with the view, and errors add up over frames.
const TURN_LOSS: f32 = 20.0;
// T from which, and from where fully, history counts by how well it fits.
const EDIT: vec2<f32> = vec2<f32>(0.05, 0.5);
// Pixels between two whose differences tell how bright the expected light is, and what sums of
// squared expectations a tile needs to be believed by half.
const PAIR: u32 = 2u;
const SLOPE_PRIOR: f32 = 0.1;
// Likewise of squared expectations of the grid's light, to have a share of its own.
const SHARE_PRIOR: f32 = 0.03;
// Squared and relative, of pixels whose middle the medium misses: it covers anything from nothing to
// half of them, a relative variance of a third for each of two.
const COVERAGE_BIAS: f32 = 0.7;
// Pixels to each side that the last pass filters over.
const RADIUS: i32 = #{RADIUS};
// In place of an opacity: a sample was not finite.
const NOT_FINITE: f32 = -2.0;

struct Fetched {
    light: vec4<f32>,
    frames: f32,
    filtered: f32,
    // How well its guides fit, 0 to 1.
    fit: f32,
}

fn pixel_of(group: vec3<u32>, local: u32) -> vec2<u32> {
    return TILE * group.xy + vec2<u32>(local % TILE, local / TILE);
}

// Bilinear over four pixels whose guides fit; their weight is that of the history. image: pixels
// across and down, and where the first one is in keys, state and counts. gain: see light_gain.
fn fetch(
    key: Key, position: vec3<f32>, image: vec3<u32>, pixel_size: f32, strictness: f32, gain: vec4<f32>,
) -> Fetched {
    var found = Fetched(vec4<f32>(0.0), 0.0, 0.0, 0.0);
    let size = vec2<i32>(image.xy);
    var here = key;
    here.depth = position.z;
    let place = position.xy / position.z - 0.5;
    if !(position.z > 0.0) || !(all(place > vec2<f32>(-1.0)) && all(place < vec2<f32>(size))) {
        return found;
    }
    let base = floor(place);
    let weight = place - base;
    var total = 0.0;
    for (var k = 0; k < 4; k += 1) {
        let offset = vec2<i32>(k & 1, k >> 1u);
        let at = vec2<i32>(base) + offset;
        if any(at < vec2<i32>(0)) || any(at >= size) {
            continue;
        }
        let pixel = image.z + u32(at.x + size.x * at.y);
        let there = unpack_key(keys[pixel]);
        if there.albedo <= 0.0 || there.frames <= 0.0 {
            continue;
        }
        let side = select(1.0 - weight, weight, offset == vec2<i32>(1));
        let w = side.x * side.y / (1.0 + strictness * guide_distance(here, there, pixel_size));
        let count = counts[pixel];
        total += w;
        let change = gain.rgb * expected_light(key.light - there.light, gain.w);
        found.light += w * (state[pixel] + vec4<f32>(change, 0.0));
        found.frames += w * count.x;
        found.filtered += w * (count.y + mean_rgb(change));
    }
    if total < NO_WEIGHT {
        return Fetched(vec4<f32>(0.0), 0.0, 0.0, 0.0);
    }
    found.light = vec4<f32>(max(found.light.rgb / total, vec3<f32>(0.0)), found.light.a / total);
    found.filtered = max(found.filtered / total, 0.0);
    found.fit = total;
    return found;
}

// Light per unit of what guides expect, as samples around have shown; w: the grid's share of that.
fn light_gain(eye: u32, position: vec2<u32>) -> vec4<f32> {
    var gain = vec4<f32>(0.0);
    if denoise.sun.w > 0.0 {
        gain = tile_at(eye, position, 2u);
    }
    return gain;
}

fn position_of(eye: u32, pixel: vec2<u32>, depth: f32) -> vec4<f32> {
    let p = vec2<f32>(pixel) + 0.5;
    let ray = denoise.eyes[eye].direction + p.x * denoise.eyes[eye].direction_dx
        + p.y * denoise.eyes[eye].direction_dy;
    return vec4<f32>(depth * ray.xyz, 1.0);
}

// This frame's light of a pixel, and its opacity less that of its guide: what is kept of opacity is
// what guides don't know. NOT_FINITE if a sample was not.
fn new_light(eye: u32, pixel: u32, guide: vec4<f32>) -> vec4<f32> {
    let in_eye = pixel - denoise.eyes[eye].image.w + denoise.eyes[eye].image.z;
    let sum = noisy[2u * in_eye] + noisy[2u * in_eye + 1u];
    let mean = sum / f32(max(denoise.eyes[eye].frame.x, 1u));
    if !all_finite(mean) {
        return vec4<f32>(0.0, 0.0, 0.0, NOT_FINITE);
    }
    let light = clamp(mean.rgb / (guide.rgb + ALBEDO_FLOOR), vec3<f32>(0.0), vec3<f32>(LARGEST));
    return vec4<f32>(light, mean.a - guide.a);
}

// Frames that this frame counts for.
fn worth_of(eye: u32) -> f32 {
    return f32(max(denoise.eyes[eye].frame.x, 1u)) / SAMPLES_PER_FRAME;
}

// 1. What this frame's samples and the history say of each pixel, and of each row of a tile. A lane
// takes the eight pixels of such a row: sums need no other lane.
@compute @workgroup_size(64)
fn reproject(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let row = vec2<u32>(TILE * group.x + local / TILE, TILE * group.y + local % TILE);
    let size = denoise.eyes[eye].image.xy;
    let across = denoise.eyes[eye].frame.w;
    if row.x >= across || group.y * TILE >= size.y {
        return;
    }
    var sums = array<vec4<f32>, 6>(
        vec4<f32>(0.0), vec4<f32>(0.0), vec4<f32>(0.0), vec4<f32>(0.0), vec4<f32>(0.0), vec4<f32>(0.0),
    );
    let end = select(min(TILE * (row.x + 1u), size.x), 0u, row.y >= size.y);
    if end > 0u && denoise.halves.w != 0u {
        let wanted = uncovered(eye, row, end);
        for (var x = TILE * row.x; x < end && wanted != 0u; x += 1u) {
            if (wanted >> (x - TILE * row.x) & 1u) != 0u {
                guide_between(eye, vec2<u32>(x, row.y));
            }
        }
    }
    for (var x = TILE * row.x; x < end; x += 1u) {
        let position = vec2<u32>(x, row.y);
        let pixel = denoise.eyes[eye].image.w + position.x + size.x * position.y;
        let before = history_of(eye, position, pixel);
        lights[scratch_at(pixel)] = before.light;
        counts[both_at(pixel)] = vec2<f32>(before.frames, before.filtered);
        let words = keys[half_now() + pixel];
        if is_met(words) && before.frames > 0.0 {
            let guide = lights[albedo_at(pixel)];
            let scale = guide.rgb + ALBEDO_FLOOR;
            let light = new_light(eye, pixel, guide);
            let old = before.light.rgb * scale;
            let difference = light.rgb * scale - old;
            let d = mean_rgb(difference);
            let mean = mean_rgb(old);
            let filtered = before.filtered * mean_rgb(scale);
            let by_filter = filtered - mean;
            let w = worth_of(eye) / (filtered * filtered + denoise.tiles.z);
            if light.a > NOT_FINITE {
                sums[0] += vec4<f32>(difference, d * d);
                sums[1] += vec4<f32>(old, mean * mean);
                sums[2] += vec4<f32>(d * by_filter * w, by_filter * by_filter * w, d * d * w, 1.0);
            }
        }
    }
    if denoise.sun.w > 0.0 {
        for (var x = TILE * row.x; x < end; x += 1u) {
            let slope = light_slope(eye, vec2<u32>(x, row.y));
            sums[3] += slope.of_source;
            sums[4] += slope.of_grid;
            sums[5].x += slope.both;
        }
    }
    let tile = denoise.eyes[eye].frame.z + row.x + across * group.y;
    for (var k = 0u; k < 6u; k += 1u) {
        tiles[tile_rows(k) + TILE * tile + local % TILE] = sums[k];
    }
}

// Sums of least squares: what two pixels' samples differ (rgb) on what their guides expect of the
// dominant source and of the grid, and squares of that; both: of the product.
struct Slope {
    of_source: vec4<f32>,
    of_grid: vec4<f32>,
    both: f32,
}

// Every second pixel looks across, the others down.
fn light_slope(eye: u32, position: vec2<u32>) -> Slope {
    let size = denoise.eyes[eye].image.xy;
    let is_across = ((position.x ^ position.y) & 1u) == 0u;
    let there = position + select(vec2<u32>(0u, PAIR), vec2<u32>(PAIR, 0u), is_across);
    var slope = Slope(vec4<f32>(0.0), vec4<f32>(0.0), 0.0);
    if all(there < size) {
        let a = denoise.eyes[eye].image.w + position.x + size.x * position.y;
        let b = denoise.eyes[eye].image.w + there.x + size.x * there.y;
        let words_a = keys[half_now() + a];
        let words_b = keys[half_now() + b];
        let expected = light_parts(words_a) - light_parts(words_b);
        let are_marched = is_marched(words_a.x) && is_marched(words_b.x);
        if are_marched && any(expected != vec2<f32>(0.0)) {
            let light_a = new_light(eye, a, lights[albedo_at(a)]);
            let light_b = new_light(eye, b, lights[albedo_at(b)]);
            if light_a.a > NOT_FINITE && light_b.a > NOT_FINITE {
                let seen = light_a.rgb - light_b.rgb;
                slope.of_source = expected.x * vec4<f32>(seen, expected.x);
                slope.of_grid = expected.y * vec4<f32>(seen, expected.y);
                slope.both = expected.x * expected.y;
            }
        }
    }
    return slope;
}

fn history_of(eye: u32, position: vec2<u32>, pixel: u32) -> Fetched {
    let history = denoise.eyes[eye].frame.y;
    var before = Fetched(vec4<f32>(0.0), 0.0, 0.0, 0.0);
    if history == HISTORY_SAME {
        let count = counts[half_before() + pixel];
        before = Fetched(state[half_before() + pixel], count.x, count.y, 1.0);
    } else if history == HISTORY_MOVED {
        let words = keys[half_now() + pixel];
        if is_met(words) {
            let key = unpack_key(words);
            let here = position_of(eye, position, key.depth);
            let there = vec3<f32>(
                dot(denoise.eyes[eye].previous_x, here),
                dot(denoise.eyes[eye].previous_y, here),
                dot(denoise.eyes[eye].previous_depth, here),
            );
            var turned = key;
            turned.normal = vec3<f32>(
                dot(denoise.eyes[eye].turn_x.xyz, key.normal),
                dot(denoise.eyes[eye].turn_y.xyz, key.normal),
                dot(denoise.eyes[eye].turn_z.xyz, key.normal),
            );
            let last = denoise.eyes[eye].place.yzw + vec3<u32>(0u, 0u, half_before());
            // What is seen from elsewhere has changed more than its guides tell.
            let was = here.xyz - denoise.eyes[eye].before.xyz;
            let turn = length(cross(direction_of(here.xyz), direction_of(was)));
            let strictness = denoise.across.x * clamp(denoise.edges.z * turn, 1.0, MOST_STRICT);
            // The tiles' last word on it; new ones come after this.
            let known = denoise.eyes[eye].history.w * denoise.light.z;
            let gain = light_gain(eye, position) * vec4<f32>(vec3<f32>(known), 1.0);
            before = fetch(turned, there, last, denoise.eyes[eye].turn_x.w, strictness, gain);
            before.frames /= 1.0 + TURN_LOSS * turn * turn * before.frames;
        }
    }
    before.frames = min(before.frames * denoise.eyes[eye].history.y, denoise.eyes[eye].history.x);
    // After an edit what is left is for pixels that it did not touch.
    let edited = smoothstep(EDIT.x, EDIT.y, denoise.eyes[eye].history.z);
    before.frames *= mix(1.0, before.fit * before.fit, edited);
    return before;
}

// 2a. Rows of a tile together.
@compute @workgroup_size(64)
fn add_rows(@builtin(global_invocation_id) invocation: vec3<u32>) {
    if invocation.x >= denoise.counts.z {
        return;
    }
    for (var k = 0u; k < 6u; k += 1u) {
        var sum = vec4<f32>(0.0);
        for (var row = 0u; row < TILE; row += 1u) {
            sum += tiles[tile_rows(k) + TILE * invocation.x + row];
        }
        tiles[tile_sums(k) + invocation.x] = sum;
    }
}

// 2b. How far the history lags behind around each tile, its noise, and whether filtering paid.
@compute @workgroup_size(64)
fn judge(@builtin(global_invocation_id) invocation: vec3<u32>) {
    let eye = invocation.y;
    let across = denoise.eyes[eye].frame.w;
    let down = (denoise.eyes[eye].image.y + TILE - 1u) / TILE;
    if invocation.x >= across * down {
        return;
    }
    let place = vec2<i32>(i32(invocation.x % across), i32(invocation.x / across));
    let last = vec2<i32>(i32(across), i32(down)) - 1;
    let first = denoise.eyes[eye].frame.z;
    let memory_factor = denoise.tiles.w * denoise.eyes[eye].history.w;
    var difference = vec4<f32>(0.0);
    var old = vec4<f32>(0.0);
    var variance = 0.0;
    var memory = vec4<f32>(0.0);
    var own = vec4<f32>(0.0);
    var slope = array<vec4<f32>, 3>(vec4<f32>(0.0), vec4<f32>(0.0), vec4<f32>(0.0));
    // Under another light what was is no measure.
    let slope_factor = memory_factor * (1.0 - denoise.eyes[eye].history.z) * denoise.light.z;
    for (var k = 0; k < 9; k += 1) {
        let offset = vec2<i32>(k % 3, k / 3) - 1;
        let at = clamp(place + offset, vec2<i32>(0), last);
        let tile = first + u32(at.x) + across * u32(at.y);
        let side = vec2<f32>(2.0 - abs(vec2<f32>(offset)));
        let w = side.x * side.y / 16.0;
        let sums = tiles[tile_sums(0u) + tile];
        difference += w * sums;
        variance += w * w * sums.w;
        old += w * tiles[tile_sums(1u) + tile];
        var remembered = tiles[tile_sums(2u) + tile];
        if denoise.eyes[eye].frame.y != HISTORY_NONE {
            remembered += memory_factor * tiles[tile_memory(false, 0u) + tile];
        }
        memory += w * remembered;
        for (var part = 0u; part < 3u; part += 1u) {
            var expected = tiles[tile_sums(3u + part) + tile];
            if denoise.eyes[eye].frame.y != HISTORY_NONE {
                expected += slope_factor * tiles[tile_memory(false, 1u + part) + tile];
            }
            slope[part] += w * expected;
            if k == 4 {
                tiles[tile_memory(true, 1u + part) + first + invocation.x] = expected;
            }
        }
        if k == 4 {
            own = remembered;
        }
    }
    tiles[tile_memory(true, 0u) + first + invocation.x] = own;

    // A lag that noise explains is none.
    let lag = mean_rgb(difference.rgb);
    let significance = lag * lag / max(variance, 1e-30) - 1.0;
    let gain = max(significance, 0.0) / (max(significance, 0.0) + denoise.tiles.x);
    var correction = gain * difference.rgb / max(old.rgb, vec3<f32>(1e-20));
    correction = clamp(correction, vec3<f32>(-0.9), vec3<f32>(4.0));
    correction = select(vec3<f32>(0.0), correction, old.rgb > vec3<f32>(1e-20));
    var shortening = min(mean_rgb(abs(correction)), 1.0) * denoise.tiles.y;
    if denoise.eyes[eye].frame.y == HISTORY_SAME {
        correction = vec3<f32>(0.0);
        shortening = 0.0;
    }
    // Least squares of the new samples on what the filter had changed: they share no noise.
    let prior = 1e-3 * memory.z + 1e-20;
    let weight = clamp((memory.x + prior) / (memory.y + prior), 0.0, 1.0);
    let measured = worth_of(eye) * difference.w / max(old.w, 1e-30);
    let noise = select(denoise.across.w, measured, old.w > 1e-30);
    tiles[tile_result(0u) + first + invocation.x] = vec4<f32>(correction, shortening);
    tiles[tile_result(1u) + first + invocation.x] =
        vec4<f32>(weight, clamp(noise, 0.003, 1.0), 0.0, 0.0);
    let share = grid_share(slope[0], slope[1], slope[2].x);
    let a = 2.0 * (1.0 - share);
    let b = 2.0 * share;
    let squares = a * a * slope[0].w + 2.0 * a * b * slope[2].x + b * b * slope[1].w;
    let light = max(a * slope[0].rgb + b * slope[1].rgb, vec3<f32>(0.0));
    let light_gain = light / (squares + SLOPE_PRIOR);
    tiles[tile_result(2u) + first + invocation.x] =
        select(vec4<f32>(0.0), vec4<f32>(light_gain, share), denoise.sun.w > 0.0);
}

// What share of the expected light is the grid's: least squares of what samples differ on both parts,
// drawn toward equal factors.
fn grid_share(of_source: vec4<f32>, of_grid: vec4<f32>, both: f32) -> f32 {
    if denoise.light.x == 0.0 || denoise.light.y == 0.0 {
        return 0.5;
    }
    let together = of_source.w + 2.0 * both + of_grid.w + SLOPE_PRIOR;
    let mixed = both + of_grid.w;
    let grid = of_grid.w + SHARE_PRIOR;
    let u = mean_rgb(of_source.rgb + of_grid.rgb);
    let v = mean_rgb(of_grid.rgb);
    // Both times their system's determinant, which their ratio doesn't need.
    let gain = grid * u - mixed * v;
    let more = together * v - mixed * u;
    let factors = max(vec2<f32>(gain, gain + more), vec2<f32>(0.0));
    let sum = factors.x + factors.y;
    return select(0.5, factors.y / max(sum, 1e-30), sum > 1e-20);
}

// 3. The new samples join the corrected history.
@compute @workgroup_size(64)
fn blend(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let position = pixel_of(group, local);
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let pixel = denoise.eyes[eye].image.w + position.x + size.x * position.y;
    let light = new_light(eye, pixel, lights[albedo_at(pixel)]);
    var old = lights[scratch_at(pixel)];
    let count = counts[both_at(pixel)];
    var frames = count.x;
    if denoise.eyes[eye].frame.y == HISTORY_MOVED && frames > 0.0 {
        let tile = tile_at(eye, position, 0u);
        old = vec4<f32>(old.rgb * (1.0 + tile.rgb), old.a);
        frames /= 1.0 + frames * tile.w;
    }
    if light.a > NOT_FINITE {
        let worth = worth_of(eye);
        old += worth * (light - old) / (frames + worth);
        frames += worth;
    } else if frames == 0.0 {
        old = vec4<f32>(0.0);
    }
    state[half_now() + pixel] = old;
    counts[half_now() + pixel] = vec2<f32>(frames, 0.0);
    keys[half_now() + pixel] = with_frames(keys[half_now() + pixel], frames);
}

// 4. What the other eye has of the same place.
@compute @workgroup_size(64)
fn stereo(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let position = pixel_of(group, local);
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let pixel = denoise.eyes[eye].image.w + position.x + size.x * position.y;
    let words = keys[half_now() + pixel];
    let key = unpack_key(words);
    var light = state[half_now() + pixel];
    var frames = counts[half_now() + pixel].x;
    if denoise.counts.x == 2u && key.albedo > 0.0 {
        let here = position_of(eye, position, key.depth);
        let there = vec3<f32>(
            dot(denoise.eyes[eye].other_x, here),
            dot(denoise.eyes[eye].other_y, here),
            dot(denoise.eyes[eye].other_depth, here),
        );
        let image = denoise.eyes[1u - eye].image.xyw + vec3<u32>(0u, 0u, half_now());
        let gain = light_gain(eye, position);
        let other = fetch(key, there, image, denoise.eyes[1u - eye].turn_x.w, denoise.across.y, gain);
        if other.frames > 0.0 {
            // However many frames it has, it may be off by its bias.
            let noise = tile_at(eye, position, 1u).y;
            let worth = other.frames / (1.0 + other.frames * denoise.across.z / noise);
            light = mix(light, other.light, worth / (frames + worth));
            frames += worth;
        }
    }
    lights[scratch_at(pixel)] = light;
    keys[both_at(pixel)] = with_frames(words, frames);
}

// What the last frame's filter found says where light changes though guides don't: shadows.
// Guides are (frames, filtered light) of the history.
// expected: what the guide of light explains of it.
fn light_distance(a: vec2<f32>, b: vec2<f32>, expected: f32, noise: f32) -> f32 {
    let difference = a.y - b.y - expected;
    let trust = min(0.5 * min(a.x, b.x), 1.0);
    let mean = 0.5 * (a.y * a.y + b.y * b.y) + denoise.tiles.z;
    return denoise.edges.x * trust * max(difference * difference / mean - LIGHT_NOISE * noise, 0.0);
}

// 5. A mean over 3 x 3, for the weights of the last pass: where light changes though guides don't.
// Its variance is that of its nine.
@compute @workgroup_size(64)
fn prefilter(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let position = pixel_of(group, local);
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let first = denoise.eyes[eye].image.w;
    let pixel = first + position.x + size.x * position.y;
    let words = keys[both_at(pixel)];
    var near = vec4<f32>(0.0);
    if is_met(words) {
        let pixel_size = denoise.eyes[eye].turn_x.w;
        let key = unpack_key(words);
        let inverse_noise = 1.0 / tile_at(eye, position, 1u).y;
        let gains = light_gain(eye, position);
        let gain = mean_rgb(gains.rgb);
        let low = max(vec2<i32>(position) - 1, vec2<i32>(0));
        let high = min(vec2<i32>(position) + 1, vec2<i32>(size) - 1);
        // Weights with light to the power of 0 and 1, squared weights with 0, 1 and 2.
        var sums = vec2<f32>(0.0);
        var squares = vec3<f32>(0.0);
        for (var y = low.y; y <= high.y; y += 1) {
            for (var x = low.x; x <= high.x; x += 1) {
                let at = first + u32(x) + size.x * u32(y);
                let there = unpack_key(keys[both_at(at)]);
                let bias = guide_distance(key, there, pixel_size);
                let fits = 1.0 / (1.0 + bias * there.frames * inverse_noise);
                let w = fits * fits * there.frames;
                let explained = gain * expected_light(key.light - there.light, gains.w);
                let all = mean_rgb(lights[scratch_at(at)].rgb) + explained;
                let light = clamp(all, -BRIGHTEST, BRIGHTEST);
                sums += w * vec2<f32>(1.0, light);
                squares += w * w * vec3<f32>(1.0, light, light * light);
            }
        }
        let total = max(sums.x, 1e-10);
        let mean = sums.y / total;
        let spread = squares.z - 2.0 * mean * squares.y + mean * mean * squares.x;
        near = vec4<f32>(mean, max(spread, 0.0) / (total * total), total, 0.0);
    }
    lights[near_at(pixel)] = near;
}

// Of two such means (mean, variance, frames).
fn near_distance(a: vec4<f32>, b: vec4<f32>, explained: f32, noise: f32) -> f32 {
    let difference = a.x - b.x - explained;
    let mean = 0.5 * (a.x * a.x + b.x * b.x) + denoise.tiles.z;
    let seen = NEAR_SEEN * (a.y + b.y);
    let expected = NEAR_EXPECTED * noise * (1.0 / max(a.z, 0.1) + 1.0 / max(b.z, 0.1));
    return denoise.edges.y * max((difference * difference - seen) / mean - expected, 0.0)
        + denoise.edges.w * explained * explained / mean;
}

// 6. A filter over neighbours, each weighed by its noise and by what its guides differ.
@compute @workgroup_size(64)
fn gather(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let eye = group.z;
    let position = pixel_of(group, local);
    let size = denoise.eyes[eye].image.xy;
    if any(position >= size) {
        return;
    }
    let first = denoise.eyes[eye].image.w;
    let pixel = first + position.x + size.x * position.y;
    let own = state[half_now() + pixel];
    let albedo = lights[albedo_at(pixel)];
    let scale = albedo.rgb + ALBEDO_FLOOR;
    let words = keys[both_at(pixel)];
    var result = own;
    var filtered = own;
    if is_met(words) {
        let pixel_size = denoise.eyes[eye].turn_x.w;
        let key = unpack_key(words);
        let tile = tile_at(eye, position, 1u);
        let own_frames = counts[half_now() + pixel].x;
        let centre = max(key.frames, 0.5);
        let gain = light_gain(eye, position);
        let mean_gain = mean_rgb(gain.rgb);
        var light = centre * lights[scratch_at(pixel)];
        var total = centre;
        let low = max(vec2<i32>(position) - RADIUS, vec2<i32>(0));
        let high = min(vec2<i32>(position) + RADIUS, vec2<i32>(size) - 1);
        let pays = PAYS / max(tile.x, 0.05);
        let moves = denoise.eyes[eye].frame.y != HISTORY_SAME;
        let narrower = select(1.0, clamp(pays * pays, NARROWER.x, NARROWER.y), moves) / tile.y;
        let guide = counts[both_at(pixel)];
        let near = lights[near_at(pixel)];
        for (var y = low.y; y <= high.y; y += 1) {
            // Corners are cut: an octagon.
            let reach = RADIUS - max(0, abs(y - i32(position.y)) - RADIUS / 2);
            let left = max(low.x, i32(position.x) - reach);
            let right = min(high.x, i32(position.x) + reach);
            for (var x = left; x <= right; x += 1) {
                let at = first + u32(x) + size.x * u32(y);
                let words_there = keys[both_at(at)];
                let there = unpack_key(words_there);
                let is_covered = ((words.x | words_there.x) & BETWEEN) == 0u;
                let offset = vec2<f32>(vec2<i32>(x, y) - vec2<i32>(position));
                let r2 = dot(offset, offset);
                // What the guide of light explains of the difference.
                let explained = expected_light(key.light - there.light, gain.w);
                let bias = select(COVERAGE_BIAS, 0.0, is_covered) + denoise.bias.x * r2
                    + guide_distance(key, there, pixel_size)
                    + light_distance(guide, counts[both_at(at)], mean_gain * explained, tile.y)
                    + near_distance(near, lights[near_at(at)], mean_gain * explained, tile.y);
                let fits = 1.0 / (1.0 + bias * there.frames * narrower);
                let w = select(0.0, fits * fits * there.frames, r2 > 0.0);
                total += w;
                light += w * (lights[scratch_at(at)] + vec4<f32>(gain.rgb * explained, 0.0));
            }
        }
        filtered = vec4<f32>(max(light.rgb / total, vec3<f32>(0.0)), light.a / total);
        // However sure the tile is, its error must fall with the noise of the samples.
        let weight = min(tile.x, #{FADE_FRAMES}.0 / (#{FADE_FRAMES}.0 + own_frames));
        result = mix(own, filtered, weight);
    }
    counts[half_now() + pixel].y = mean_rgb(filtered.rgb * scale) / mean_rgb(scale);
    output[pixel] = vec4<f32>(result.rgb * scale, clamp(result.a + albedo.a, 0.0, 1.0));
}

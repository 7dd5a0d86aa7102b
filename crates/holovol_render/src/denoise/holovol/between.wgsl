// Guides of pixels whose middle the medium misses but not a neighbour's: a part of them may be covered,
// and without guides they would have neither history nor neighbours.
#define_import_path holovol_render::denoise::between

#import holovol_render::denoise::common::{
    denoise, keys, lights, Key, pack_key, unpack_key, is_marched, direction_of, half_now, albedo_at,
    ALBEDO_FLOOR, LEAST_ALBEDO, BETWEEN, TILE,
}

// Those of a row of a tile, a bit each.
fn uncovered(eye: u32, row: vec2<u32>, end: u32) -> u32 {
    let size = denoise.eyes[eye].image.xy;
    let first = half_now() + denoise.eyes[eye].image.w;
    // Bit 0 is the pixel before the row's first.
    var marched = 0u;
    var missed = 0u;
    for (var y = max(row.y, 1u) - 1u; y <= min(row.y + 1u, size.y - 1u); y += 1u) {
        for (var k = 0u; k < TILE + 2u; k += 1u) {
            let x = min(max(TILE * row.x + k, 1u) - 1u, size.x - 1u);
            let word = keys[first + x + size.x * y].x;
            marched |= select(0u, 1u << k, is_marched(word));
            missed |= select(0u, 1u << k, y == row.y && (word & 0xffffu) == 0u);
        }
    }
    return (missed & (marched | marched << 1u | marched >> 1u)) >> 1u;
}

// What pixels around would cover of one between them.
fn guide_between(eye: u32, position: vec2<u32>) {
    let size = denoise.eyes[eye].image.xy;
    let first = denoise.eyes[eye].image.w;
    let low = max(vec2<i32>(position) - 1, vec2<i32>(0));
    let high = min(vec2<i32>(position) + 1, vec2<i32>(size) - 1);
    var albedo = vec4<f32>(0.0);
    var normal = vec3<f32>(0.0);
    // Weights, with depth behind the first, with its square; light before its share of albedo.
    var sums = vec4<f32>(0.0);
    var nearest = 0.0;
    var sum_of_light = vec2<f32>(0.0);
    for (var y = low.y; y <= high.y; y += 1) {
        for (var x = low.x; x <= high.x; x += 1) {
            let at = first + u32(x) + size.x * u32(y);
            let words = keys[half_now() + at];
            if is_marched(words.x) {
                let there = unpack_key(words);
                nearest = select(nearest, there.depth, sums.x == 0.0);
                let side = vec2<f32>(2 - abs(vec2<i32>(x, y) - vec2<i32>(position)));
                let share = side.x * side.y / 16.0;
                let w = share * there.albedo;
                let behind = there.depth - nearest;
                let light = there.light * (there.albedo + ALBEDO_FLOOR);
                albedo += share * lights[albedo_at(at)];
                normal += w * there.normal;
                sums += vec4<f32>(
                    w, w * behind, w * (behind * behind + there.spread * there.spread), 0.0,
                );
                sum_of_light += share * light;
            }
        }
    }
    let mean = sums.y / max(sums.x, 1e-20);
    var key = Key(max(sums.x, LEAST_ALBEDO), direction_of(normal), nearest + mean, 0.0, 0.0, vec2<f32>(0.0));
    key.spread = sqrt(max(sums.z / max(sums.x, 1e-20) - mean * mean, 0.0));
    key.light = sum_of_light / (key.albedo + ALBEDO_FLOOR);
    let words = pack_key(key);
    keys[half_now() + first + position.x + size.x * position.y] =
        vec4<u32>(words.x | BETWEEN, words.yzw);
    lights[albedo_at(first + position.x + size.x * position.y)] = albedo;
}

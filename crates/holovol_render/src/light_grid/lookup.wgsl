// What the march finds in the light grid.
#define_import_path holovol_render::light_grid::lookup

#import holovol_render::bindings::scene
#import holovol_render::light_grid::cells::{grid_size, cell_number}

// Per cell: mean light, in the environment's mean radiance, and the picks that it is of.
@group(0) @binding(24) var<storage, read> settled_light: array<vec2<f32>>;

// Trilinear between the cells that are known, and their weight, 0 to 1.
fn light_at(place: vec3<f32>, texels_per_cell: u32) -> vec2<f32> {
    if texels_per_cell == 0u {
        return vec2<f32>(0.0);
    }
    let size = grid_size(scene.dims.xyz, texels_per_cell);
    let p = place / f32(texels_per_cell) - 0.5;
    let base = floor(p);
    let f = p - base;
    var sum = vec2<f32>(0.0);
    for (var k = 0; k < 8; k += 1) {
        let offset = vec3<i32>(k & 1, (k >> 1u) & 1, k >> 2u);
        let side = select(1.0 - f, f, offset == vec3<i32>(1));
        let cell = clamp(vec3<i32>(base) + offset, vec3<i32>(0), vec3<i32>(size) - 1);
        let there = settled_light[cell_number(vec3<u32>(cell), size)];
        let w = select(0.0, side.x * side.y * side.z, there.y > 0.0);
        sum += w * vec2<f32>(there.x, 1.0);
    }
    return vec2<f32>(sum.x / max(sum.y, 1e-20), sum.y);
}

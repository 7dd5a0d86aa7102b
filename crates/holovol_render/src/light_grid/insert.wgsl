// What the tracer adds to the light grid.
#define_import_path holovol_render::light_grid::insert

#import holovol_render::bindings::scene
#import holovol_render::light_grid::cells::{
    grid_size, cell_number, LIGHT_STEPS, BRIGHTEST_PICK, PICKS_OF_FRAME,
}

// Per cell: picks of this frame, and the sum of their light.
@group(0) @binding(17) var<storage, read_write> fresh_light: array<atomic<u32>>;

// place: texel coordinates; light: what is scattered toward the eye there, per albedo.
fn add_light(place: vec3<f32>, texels_per_cell: u32, light: f32) {
    let of_mean = light * scene.environment.w;
    if texels_per_cell == 0u || !(of_mean >= 0.0) {
        return;
    }
    let size = grid_size(scene.dims.xyz, texels_per_cell);
    let cell = min(vec3<u32>(max(place, vec3<f32>(0.0))) / texels_per_cell, size - 1u);
    let first = 2u * cell_number(cell, size);
    let steps = u32(LIGHT_STEPS * min(of_mean, BRIGHTEST_PICK) + 0.5);
    if atomicAdd(&fresh_light[first], 1u) < PICKS_OF_FRAME && steps > 0u {
        atomicAdd(&fresh_light[first + 1u], steps);
    }
}

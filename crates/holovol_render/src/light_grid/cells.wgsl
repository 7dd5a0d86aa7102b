// The light grid: cells of the volume, some texels wide, with the light that samples have found there.
#define_import_path holovol_render::light_grid::cells

// Sums are of whole numbers: steps of the environment's mean radiance, and what a pick counts for
// at most in it. A guide may miss what is brighter.
const LIGHT_STEPS: f32 = 128.0;
const BRIGHTEST_PICK: f32 = 256.0;
// Picks of a frame that a cell takes: their sum is within 32 bits.
const PICKS_OF_FRAME: u32 = 65536u;

fn grid_size(texels: vec3<u32>, texels_per_cell: u32) -> vec3<u32> {
    return (texels + texels_per_cell - 1u) / texels_per_cell;
}

fn cell_number(cell: vec3<u32>, size: vec3<u32>) -> u32 {
    return cell.x + size.x * (cell.y + size.y * cell.z);
}

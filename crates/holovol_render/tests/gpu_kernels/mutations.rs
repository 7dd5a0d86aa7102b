//! Damage to the kernels, and the check that must notice it.

use holovol_render::Gpu;
use holovol_render::testing::Mutation;

use super::{
    Check, denoise, denoise_march, denoise_sun, denoise_twins, determinism, draws, frames,
    functions, grids, guides, light_grid,
};

/// How a failure to compose or compile a kernel begins, see `RenderError::Internal`.
const INVALID: &str = "internal error in";

/// One damage and who catches it.
pub struct Caught {
    damage: Mutation,
    by: Check,
}

impl Caught {
    pub fn name(&self) -> String {
        let Mutation { path, from, to } = self.damage;
        format!("caught: {path}: `{from}` as `{to}`")
    }

    pub fn is_caught(&self, gpu: &Gpu) -> Result<(), String> {
        match self.damage.during(|| (self.by)(gpu)) {
            // A damage that no compiler accepts shows nothing of the check.
            Err(found) if found.contains(INVALID) => {
                Err(format!("the damaged kernel is not valid: {found}"))
            }
            Err(found) => {
                eprintln!("{}: {found}", self.name());
                Ok(())
            }
            Ok(()) => Err("the kernel is wrong and nothing shows it".into()),
        }
    }
}

const fn caught(path: &'static str, from: &'static str, to: &'static str, by: Check) -> Caught {
    Caught {
        damage: Mutation { path, from, to },
        by,
    }
}

const RANDOM: &str = "shared/random.wgsl";
const PHASE: &str = "shared/phase_function.wgsl";
const SURFACE: &str = "shared/surface.wgsl";
const LIGHT: &str = "shared/environment.wgsl";
const CHOICE: &str = "shared/scattering.wgsl";
const TRANSFER: &str = "shared/transfer_function.wgsl";
const FIELD: &str = "shared/field.wgsl";
const WALK: &str = "shared/walk.wgsl";
const MAJORANT: &str = "majorant.wgsl";
const TRACE: &str = "trace.wgsl";
const PATH: &str = "path.wgsl";

const DENOISE: &str = "holovol/holovol.wgsl";
const BETWEEN: &str = "denoise/holovol/between.wgsl";
const GUIDE_KEYS: &str = "denoise/common.wgsl";
const PAPER: &str = "paper/paper.wgsl";
const MARCH: &str = "guides/guides.wgsl";

const SETTLE: &str = "settle.wgsl";
const LIGHT_CELLS: &str = "light_grid/cells.wgsl";
const LIGHT_INSERT: &str = "light_grid/insert.wgsl";
const LIGHT_LOOKUP: &str = "light_grid/lookup.wgsl";

pub const MUTATIONS: &[Caught] = &[
    caught(
        SETTLE,
        "f32(min(found.x, PICKS_OF_FRAME))",
        "f32(found.x)",
        light_grid::settles_like_the_twin,
    ),
    caught(
        SETTLE,
        "min(before.y, settle_by.kept)",
        "before.y",
        light_grid::settles_like_the_twin,
    ),
    caught(
        SETTLE,
        "min(all, settle_by.most)",
        "all",
        light_grid::settles_like_the_twin,
    ),
    caught(
        SETTLE,
        "- picks * before.x)",
        "- before.x)",
        light_grid::settles_like_the_twin,
    ),
    caught(
        SETTLE,
        "sum += there.y * vec2<f32>(there.x, 1.0);",
        "sum += vec2<f32>(there.x, 1.0);",
        light_grid::settles_like_the_twin,
    ),
    caught(
        SETTLE,
        "min(at + 1u, size - 1u)",
        "min(at + 1u, size - 2u)",
        light_grid::settles_like_the_twin,
    ),
    caught(
        SETTLE,
        "own.y + AROUND);",
        "own.y + 30.0);",
        light_grid::settles_like_the_twin,
    ),
    caught(
        DENOISE,
        "(1.0 - denoise.eyes[eye].history.z) * denoise.light.z",
        "(1.0 - denoise.eyes[eye].history.z)",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "denoise.eyes[eye].history.w * denoise.light.z",
        "denoise.eyes[eye].history.w",
        denoise_twins::holovol,
    ),
    caught(
        LIGHT_INSERT,
        "< PICKS_OF_FRAME &&",
        "< 4000000000u &&",
        light_grid::cells_know_the_light,
    ),
    caught(
        LIGHT_INSERT,
        "light * scene.environment.w",
        "light",
        light_grid::cells_know_the_light,
    ),
    caught(
        LIGHT_CELLS,
        "cell.x + size.x * (cell.y",
        "cell.x + size.y * (cell.y",
        light_grid::cells_know_the_light,
    ),
    caught(
        TRACE,
        "dot((*path).light, vec3<f32>(1.0)) * (*path).transmittance",
        "dot((*path).light, vec3<f32>(1.0))",
        light_grid::cells_know_the_light,
    ),
    caught(
        TRACE,
        "select(0.0, share, (*path).depth == 0u)",
        "share",
        light_grid::cells_know_the_light,
    ),
    caught(
        LIGHT_LOOKUP,
        "f32(texels_per_cell) - 0.5",
        "f32(texels_per_cell)",
        light_grid::guides_see_the_grid,
    ),
    caught(
        LIGHT_LOOKUP,
        "select(0.0, side.x * side.y * side.z, there.y > 0.0)",
        "side.x * side.y * side.z",
        light_grid::guides_see_the_grid,
    ),
    caught(
        MARCH,
        "gridded.y / max(gridded.x, 1e-20)",
        "gridded.y",
        light_grid::guides_see_the_grid,
    ),
    caught(
        MARCH,
        "walk.t_cell + dot(weights, depths) / here;",
        "dot(weights, depths) / here;",
        light_grid::guides_see_the_grid,
    ),
    caught(
        PAPER,
        "let falloff = 0.5 /",
        "let falloff = 0.52 /",
        denoise_twins::paper,
    ),
    caught(
        PAPER,
        "exp(-1.0 / (change - 1.0))",
        "exp(1.0 / (change - 1.0))",
        denoise_twins::paper,
    ),
    caught(
        PAPER,
        "const BETA: f32 = 2.0;",
        "const BETA: f32 = 1.98;",
        denoise_twins::paper,
    ),
    caught(
        GUIDE_KEYS,
        "let t = max(-z, 0.0);",
        "let t = 0.0;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let by_filter = filtered - mean;",
        "let by_filter = filtered;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "row < TILE; row",
        "row < TILE - 1u; row",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "variance += w * w * sums.w;",
        "variance += w * sums.w;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "frames /= 1.0 + frames * tile.w;",
        "frames /= 1.0 + tile.w;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "worth / (frames + worth)",
        "worth / (frames + 1.0)",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let w = select(0.0, fits * fits",
        "let w = select(0.0, fits",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "mix(1.0, before.fit * before.fit, edited)",
        "mix(1.0, before.fit, edited)",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "(light - old) / (frames + worth)",
        "(light - old) / frames",
        denoise::upheavals_leave_no_trace,
    ),
    caught(
        DENOISE,
        "var result = own;",
        "var result = own + 1e-3;",
        denoise::upheavals_leave_no_trace,
    ),
    caught(
        DENOISE,
        "frames += worth;\n    } else",
        "frames = min(frames + worth, 64.0);\n    } else",
        denoise::resting_view_is_consistent,
    ),
    caught(
        DENOISE,
        "worth_of(eye) * difference.w",
        "difference.w",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let change = gain.rgb * expected_light(key.light - there.light, gain.w);",
        "let change = gain.rgb * expected_light(there.light - key.light, gain.w);",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let seen = light_a.rgb - light_b.rgb;",
        "let seen = light_b.rgb - light_a.rgb;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "slope.of_grid = expected.y * vec4<f32>(seen, expected.y);",
        "slope.of_grid = expected.x * vec4<f32>(seen, expected.y);",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let mixed = both + of_grid.w;",
        "let mixed = of_grid.w;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let more = together * v - mixed * u;",
        "let more = 0.0;",
        denoise_twins::holovol,
    ),
    caught(
        GUIDE_KEYS,
        "2.0 * mix(light.x, light.y, share)",
        "2.0 * mix(light.y, light.x, share)",
        denoise_twins::holovol,
    ),
    caught(
        GUIDE_KEYS,
        "u32(round(255.0 * key.light.x",
        "u32(round(255.0 * key.light.y",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "vec4<f32>(gain.rgb * explained, 0.0)",
        "vec4<f32>(0.0)",
        denoise_twins::holovol,
    ),
    caught(
        BETWEEN,
        "marched | marched << 1u | marched >> 1u",
        "marched | marched >> 1u",
        denoise_twins::holovol,
    ),
    caught(
        BETWEEN,
        "words.x | BETWEEN",
        "words.x",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let wanted = uncovered(eye, row, end);",
        "let wanted = 0u * uncovered(eye, row, end);",
        denoise_sun::pixels_beside_silhouettes_have_a_history,
    ),
    caught(
        DENOISE,
        "select(COVERAGE_BIAS, 0.0, is_covered)",
        "select(0.0, COVERAGE_BIAS, is_covered)",
        denoise_twins::holovol,
    ),
    caught(
        MARCH,
        "passed.x * passed.y);",
        "passed.x * passed.x);",
        denoise_march::equals_quadrature,
    ),
    caught(
        MARCH,
        "sum2 += dot(weights, depths * depths);",
        "sum2 += dot(weights, depths * depths) * 1.01;",
        denoise_march::equals_quadrature,
    ),
    caught(
        MARCH,
        "dot(weights, values) / max(here, 1e-30)",
        "values.x",
        denoise_march::equals_quadrature,
    ),
    caught(
        MARCH,
        "let dt = min(fine * longer, walk.t_end - t);",
        "let dt = fine * longer;",
        denoise_march::sunlight_equals_quadrature,
    ),
    caught(
        MARCH,
        "vec4<f32>(0.875, 0.625, 0.375, 0.125)",
        "vec4<f32>(0.78, 0.35, 1e-9, 1e-9)",
        denoise_march::sunlight_equals_quadrature,
    ),
    caught(
        MARCH,
        "let weight = clamp(opacity - 0.25 * f32(k), 1e-3, 0.25);",
        "let weight = 0.25;",
        denoise_march::sunlight_equals_quadrature,
    ),
    caught(
        MARCH,
        "let place = t + dt * (part",
        "let place = t + 3.0 * dt * (part",
        denoise_sun::shadows_stay_sharp,
    ),
    caught(
        MARCH,
        "dot(scene.texel_from_world_y.xyz, wi),",
        "-dot(scene.texel_from_world_y.xyz, wi),",
        denoise_sun::shadows_stay_sharp,
    ),
    caught(
        MARCH,
        "min(scattered, 1e4) * reached",
        "min(scattered, 1e4)",
        denoise_sun::shadows_stay_sharp,
    ),
    caught(
        DENOISE,
        "denoise.edges.z * turn",
        "denoise.edges.z * turn * turn",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "TURN_LOSS * turn * turn",
        "TURN_LOSS * turn",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "let seen = NEAR_SEEN * (a.y + b.y);",
        "let seen = NEAR_SEEN * a.y;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "mean * mean * squares.x;",
        "mean * mean * sums.x;",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "clamp(pays * pays,",
        "clamp(pays,",
        denoise_twins::holovol,
    ),
    caught(
        DENOISE,
        "if !all_finite(mean) {",
        "if false {",
        denoise::wild_samples_are_lost,
    ),
    caught(
        DENOISE,
        "let image = denoise.eyes[1u - eye].image.xyw",
        "let image = denoise.eyes[0u].image.xyw",
        denoise::swapped_eyes_swap_images,
    ),
    caught(
        DENOISE,
        "result = mix(own, filtered, weight);",
        "result = mix(own, filtered, weight * f32(eye));",
        denoise::equal_eyes_get_equal_images,
    ),
    caught(
        DENOISE,
        "clamp(mean.rgb / (guide.rgb",
        "clamp(1.03 * mean.rgb / (guide.rgb",
        denoise::the_mean_is_kept,
    ),
    caught(
        RANDOM,
        "v = (v | v << vec2<u32>(1u))",
        "v = (v | v << vec2<u32>(3u))",
        functions::random_numbers,
    ),
    caught(
        TRACE,
        "samples * z_order(pixel);",
        "samples * z_order(pixel.xx);",
        frames::few_samples_are_spread,
    ),
    caught(
        TRACE,
        "block.x + width * block.y, samples > 0u);",
        "(*path).pixel, samples > 0u);",
        frames::few_samples_are_spread,
    ),
    caught(RANDOM, "1664525u", "1664527u", functions::random_numbers),
    caught(
        RANDOM,
        "0x05526c56u",
        "0x05526c57u",
        functions::random_numbers,
    ),
    caught(
        RANDOM,
        "0xcccccccc",
        "0xccccccc8",
        functions::random_numbers,
    ),
    caught(
        PHASE,
        "INV_4PI *",
        "1.05 * INV_4PI *",
        functions::phase_function,
    ),
    caught(
        PHASE,
        "select(wo, -wo, g >= 0.0)",
        "select(-wo, wo, g >= 0.0)",
        functions::phase_function,
    ),
    caught(
        PHASE,
        "(1.0 - xi.x)",
        "(1.0 - 0.95 * xi.x)",
        draws::phase_function,
    ),
    caught(SURFACE, "m2 * m2 * m;", "m2 * m2;", functions::surface),
    caught(
        SURFACE,
        "return 0.5 / max(d",
        "return 0.525 / max(d",
        functions::surface,
    ),
    caught(
        SURFACE,
        "(1.0 - specular) * max(n_i, 0.0) / PI",
        "max(n_i, 0.0) / PI",
        functions::surface,
    ),
    caught(
        SURFACE,
        " && dot(surface.normal, half) > 0.0",
        "",
        functions::surface,
    ),
    caught(
        SURFACE,
        "let radius = sqrt(xi.x)",
        "let radius = xi.x",
        draws::surface,
    ),
    caught(
        LIGHT,
        "(2.0 * PI * PI *",
        "(1.9 * PI * PI *",
        functions::environment,
    ),
    caught(
        LIGHT,
        "select(uv.y, 2.0 - uv.y, uv.y > 1.0)",
        "uv.y",
        functions::environment,
    ),
    caught(
        LIGHT,
        "c * d.x + s * d.z",
        "c * d.x - s * d.z",
        functions::environment,
    ),
    caught(
        LIGHT,
        "f32(band.x) * band_rows + band_row",
        "f32(band.x) * band_rows",
        draws::environment,
    ),
    caught(
        LIGHT,
        "alias_entry.y >> 16u",
        "alias_entry.y >> 17u",
        draws::environment,
    ),
    caught(
        LIGHT,
        "xi.x >= bitcast",
        "xi.x < bitcast",
        draws::environment,
    ),
    caught(
        CHOICE,
        "pdf += scatter_share",
        "pdf += 0.95 * scatter_share",
        functions::light_choice,
    ),
    caught(
        TRANSFER,
        "s >= candidate.x",
        "s > candidate.x",
        functions::transfer_function,
    ),
    caught(
        TRANSFER,
        "min(i + 1u, scene",
        "min(i, scene",
        functions::transfer_function,
    ),
    caught(
        TRANSFER,
        "middle].density.x { low",
        "middle].density.x + 1e-3 { low",
        functions::transfer_function,
    ),
    caught(
        FIELD,
        "let corner = texel - 0.5;",
        "let corner = texel - 0.45;",
        functions::field,
    ),
    caught(FIELD, "let d = 0.5 *", "let d = 0.52 *", functions::field),
    caught(
        FIELD,
        "d.y * scene.texel_from_world_y",
        "d.y * scene.texel_from_world_z",
        functions::field,
    ),
    caught(
        WALK,
        "if (*walk).tau < tau_exit",
        "if (*walk).tau < 0.95 * tau_exit",
        functions::walks,
    ),
    caught(
        WALK,
        "const PARALLEL: f32 = 1e-30",
        "const PARALLEL: f32 = 20.0",
        functions::walks,
    ),
    caught(
        MAJORANT,
        "vec3<i32>(cell) - 1,",
        "vec3<i32>(cell),",
        grids::cell_ranges,
    ),
    caught(
        MAJORANT,
        "+ CELL_SIZE, last",
        "+ CELL_SIZE - 1, last",
        grids::cell_ranges,
    ),
    caught(MAJORANT, "1.000001", "0.99", grids::majorants),
    caught(
        MAJORANT,
        "RANGE_MARGIN: f32 = 1e-6",
        "RANGE_MARGIN: f32 = 1e-2",
        grids::majorants,
    ),
    caught(
        MAJORANT,
        "range_maximum[row + first]",
        "0.0",
        grids::majorants,
    ),
    caught(
        MAJORANT,
        "0.0, low == high",
        "RANGE_MARGIN, low == high",
        grids::empty_cells,
    ),
    caught(
        MAJORANT,
        "if sigma_maj > 0.0",
        "if sigma_maj >= 0.0",
        grids::empty_cells,
    ),
    caught(
        PATH,
        "path.counter = w1.y",
        "path.counter = 0u",
        determinism::same_bits,
    ),
    caught(
        TRACE,
        "let depth = before + distance",
        "let depth = distance",
        guides::slab,
    ),
    caught(
        TRACE,
        "gradient / max(magnitude",
        "-gradient / max(magnitude",
        guides::ramp,
    ),
    // Kernels of live views are compiled on another thread, which damage doesn't reach; these are
    // not.
    caught(
        "depth.wgsl",
        "-dot(source.view_z, clip) / w",
        "-0.95 * dot(source.view_z, clip) / w",
        frames::paths_end_at_meshes,
    ),
    caught(
        "depth.wgsl",
        "source.layers.x + i",
        "i",
        frames::paths_end_at_meshes,
    ),
    caught(
        "resume.wgsl",
        "(saved + size - 1u) / size",
        "saved / size",
        frames::equal_the_offline_tracer,
    ),
];

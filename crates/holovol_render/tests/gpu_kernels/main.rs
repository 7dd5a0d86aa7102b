//! Runs the shipped kernels, function by function, on the GPU: they must equal their CPU twins,
//! draw what they evaluate, and bound what they skip. Then damages them, to see that it shows.

mod denoise;
mod denoise_march;
mod denoise_sun;
mod denoise_twins;
mod determinism;
mod draws;
mod frames;
mod functions;
mod grids;
mod guides;
mod light_grid;
mod mutations;
mod scenes;

use std::sync::Arc;

use holovol_render::Gpu;
use libtest_mimic::{Arguments, Failed, Trial};

/// Finds something wrong, or not.
type Check = fn(&Gpu) -> Result<(), String>;

type Body = Box<dyn FnOnce(&Gpu) -> Result<(), String> + Send>;

const CHECKS: &[(&str, Check)] = &[
    ("random_numbers_equal_the_twin", functions::random_numbers),
    ("phase_function_equals_the_twin", functions::phase_function),
    ("surface_equals_the_twin", functions::surface),
    ("environment_equals_the_twin", functions::environment),
    ("light_choice_equals_the_twin", functions::light_choice),
    (
        "transfer_function_equals_the_twin",
        functions::transfer_function,
    ),
    ("field_equals_the_twin", functions::field),
    ("walks_equal_the_twin", functions::walks),
    (
        "phase_function_draws_what_it_evaluates",
        draws::phase_function,
    ),
    ("surface_draws_what_it_evaluates", draws::surface),
    ("environment_draws_what_it_evaluates", draws::environment),
    ("cell_ranges_equal_the_volumes", grids::cell_ranges),
    (
        "majorants_equal_the_twin_and_bound_the_field",
        grids::majorants,
    ),
    ("empty_cells_are_left_out", grids::empty_cells),
    ("same_seed_gives_the_same_bits", determinism::same_bits),
    ("few_samples_are_spread", frames::few_samples_are_spread),
    ("guides_describe_a_slab", guides::slab),
    ("guides_give_the_gradient_of_a_ramp", guides::ramp),
    (
        "frames_equal_the_offline_tracer",
        frames::equal_the_offline_tracer,
    ),
    (
        "a_frame_in_parts_equals_the_whole",
        frames::parts_equal_the_whole,
    ),
    (
        "general_kernels_equal_special_ones",
        frames::general_kernels_equal_special_ones,
    ),
    ("paths_end_at_meshes", frames::paths_end_at_meshes),
    (
        "depth_moves_between_layers",
        frames::depth_moves_between_layers,
    ),
    ("clip_planes_cut", frames::clip_planes_cut),
    ("only_changes_begin_anew", frames::only_changes_begin_anew),
    ("denoise_paper_equals_the_twin", denoise_twins::paper),
    ("denoise_holovol_equals_the_twin", denoise_twins::holovol),
    (
        "denoised_resting_view_is_consistent",
        denoise::resting_view_is_consistent,
    ),
    (
        "denoiser_loses_wild_samples",
        denoise::wild_samples_are_lost,
    ),
    (
        "denoiser_swaps_images_with_eyes",
        denoise::swapped_eyes_swap_images,
    ),
    (
        "denoiser_gives_equal_eyes_equal_images",
        denoise::equal_eyes_get_equal_images,
    ),
    (
        "denoiser_outlives_upheavals",
        denoise::upheavals_leave_no_trace,
    ),
    ("march_equals_quadrature", denoise_march::equals_quadrature),
    (
        "march_finds_sunlight_as_quadrature_does",
        denoise_march::sunlight_equals_quadrature,
    ),
    (
        "light_grid_settles_like_the_twin",
        light_grid::settles_like_the_twin,
    ),
    (
        "light_grid_knows_the_light",
        light_grid::cells_know_the_light,
    ),
    (
        "gathering_changes_no_image",
        light_grid::gathering_changes_no_image,
    ),
    ("light_grid_forgets", light_grid::the_grid_forgets),
    ("guides_see_the_light_grid", light_grid::guides_see_the_grid),
    ("denoiser_keeps_the_mean", denoise::the_mean_is_kept),
    (
        "denoiser_keeps_history_at_other_resolutions",
        denoise::resolutions_share_history,
    ),
    (
        "denoiser_keeps_shadows_of_a_sun_sharp",
        denoise_sun::shadows_stay_sharp,
    ),
    (
        "denoiser_gives_pixels_beside_silhouettes_a_history",
        denoise_sun::pixels_beside_silhouettes_have_a_history,
    ),
    (
        "denoiser_notices_another_sun",
        denoise_sun::another_sun_is_another_frame,
    ),
    (
        "denoiser_refuses_wrong_eyes",
        denoise::wrong_eyes_are_refused,
    ),
];

fn main() {
    let mut args = Arguments::from_args();
    // The device takes all cores.
    args.test_threads = Some(1);
    let gpu = if args.list {
        Err("not opened for a list".to_owned())
    } else {
        Gpu::new(None).map_err(|error| error.to_string())
    };
    let is_required = std::env::var_os("HOLOVOL_REQUIRE_GPU").is_some_and(|value| value == "1");
    let is_ignored = gpu.is_err() && !is_required && !args.list;
    let gpu = Arc::new(gpu);
    let trial = |name: String, body: Body| {
        let gpu = Arc::clone(&gpu);
        Trial::test(name, move || match gpu.as_ref() {
            Ok(gpu) => body(gpu).map_err(Failed::from),
            Err(problem) => Err(Failed::from(problem.clone())),
        })
        .with_ignored_flag(is_ignored)
    };
    let checks = CHECKS
        .iter()
        .map(|&(name, check)| trial(name.into(), Box::new(check)));
    // Wrong kernels are for our own machines, not for users' drivers.
    let is_nightly = std::env::var_os("HOLOVOL_NIGHTLY").is_some_and(|value| value == "1");
    let mutations = mutations::MUTATIONS.iter().map(|mutation| {
        let body = move |gpu: &Gpu| mutation.is_caught(gpu);
        trial(mutation.name(), Box::new(body))
    });
    let mutations = mutations.map(|trial| {
        let is_ignored = is_ignored || !(is_required || is_nightly);
        trial.with_ignored_flag(is_ignored)
    });
    let trials = checks.chain(mutations).collect();
    libtest_mimic::run(&args, trials).exit();
}

//! Volumes in Bevy's frame, without a window: what cameras see must be what physics says.

mod app;
mod assets;
mod denoise;
mod frame;
mod light;
mod live;
mod meshes;
mod scenes;
mod staying;
mod views;

use libtest_mimic::{Arguments, Failed, Trial};

type Test = (&'static str, fn());

fn main() {
    let mut args = Arguments::from_args();
    // The device takes all cores, and each app has one of its own.
    args.test_threads = Some(1);
    let has_adapter = args.list || holovol_render::Gpu::new(None).is_ok();
    let is_required = std::env::var_os("HOLOVOL_REQUIRE_GPU").is_some_and(|value| value == "1");
    let is_ignored = !has_adapter && !is_required;
    let tests: Vec<Test> = [
        assets::TESTS,
        denoise::TESTS,
        frame::TESTS,
        light::TESTS,
        live::TESTS,
        meshes::TESTS,
        scenes::TESTS,
        staying::TESTS,
        views::TESTS,
    ]
    .concat();
    let trials = tests.into_iter().map(|(name, body)| {
        Trial::test(name, move || {
            if !has_adapter {
                return Err(Failed::from("there is no graphics adapter"));
            }
            body();
            Ok(())
        })
        .with_ignored_flag(is_ignored)
    });
    libtest_mimic::run(&args, trials.collect()).exit();
}

//! Each pass of both denoisers on anything its buffers may hold, against its twin.

use holovol_render::testing::denoise::{Before, Memory};
use holovol_render::{DenoiseMode, DenoiseSettings, Gpu, PaperSettings};

use super::scenes::numbers;

/// With a change of light T, as the passes are told.
const CASES: [(Before, f32); 4] = [
    (Before::Nothing, 0.0),
    (Before::Moved, 0.0),
    (Before::Moved, 0.4),
    (Before::Same, 0.0),
];

fn check(gpu: &Gpu, mode: DenoiseMode) -> Result<(), String> {
    let settings = DenoiseSettings {
        mode,
        ..Default::default()
    };
    for (case, (before, light_change)) in (0..).zip(CASES) {
        let mut drawn = 0;
        let mut number = || {
            drawn += 1;
            numbers(drawn, case)[0]
        };
        let start = Memory::random(&settings, before, light_change, &mut number);
        for pass in start.passes() {
            let mut kernel = start.clone();
            kernel.run_kernel(gpu, pass).map_err(|e| e.to_string())?;
            let mut twin = start.clone();
            twin.run_twin(pass);
            let changed = kernel
                .compare(&twin, &start)
                .map_err(|e| format!("{pass}, {before:?}: {e}"))?;
            // A pass that does nothing would equal a twin that does nothing.
            if changed < 100 {
                return Err(format!("{pass}, {before:?}: {changed} values have changed"));
            }
        }
    }
    Ok(())
}

/// Mode `paper`.
pub fn paper(gpu: &Gpu) -> Result<(), String> {
    check(gpu, DenoiseMode::Paper(PaperSettings::default()))
}

/// Mode `holovol`.
pub fn holovol(gpu: &Gpu) -> Result<(), String> {
    check(gpu, DenoiseMode::Holovol)
}

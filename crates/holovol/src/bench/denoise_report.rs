//! The results of `holovol bench denoise` as a page.

use std::collections::BTreeMap;

use super::denoise::{Outcome, Report};

/// Tables in Markdown.
pub(super) fn markdown(report: &Report) -> String {
    use std::fmt::Write;
    let mut page = format!(
        "{}, {}; {} samples per pixel, eye and frame; references of {} samples per pixel.\n",
        report.adapter, report.driver, report.spp, report.reference_spp
    );
    page.push_str("\n| scene | case | noisy | OIDN | mode | relMSE after 1, 2, 8, 32 frames | FLIP after 1, 2, 8, 32 frames |\n|---|---|---|---|---|---|---|\n");
    for scene in &report.scenes {
        for case in &scene.cases {
            for mode in ["holovol", "paper"] {
                let row = |of: fn(&Outcome) -> f64| {
                    let of_mode = case.results.iter().filter(|r| r.mode == mode);
                    let cells: Vec<_> = of_mode.map(|r| format!("{:.5}", of(r))).collect();
                    cells.join(", ")
                };
                let oidn = case.oidn.as_ref().map_or("—".into(), |(name, relmse, _)| {
                    format!("{relmse:.5} ({name})")
                });
                // Writing to a string can't fail.
                let _ = writeln!(
                    page,
                    "| {} | {} | {:.4} | {oidn} | {mode} | {} | {} |",
                    scene.scene,
                    case.case,
                    case.noisy_relmse,
                    row(|r| r.relmse),
                    row(|r| r.flip)
                );
            }
        }
    }
    page.push_str("\n| scene | case | trace, ms | guides, ms | filter, ms | share | paper's filter, ms |\n|---|---|---|---|---|---|---|\n");
    for scene in &report.scenes {
        for case in &scene.cases {
            let _ = writeln!(
                page,
                "| {} | {} | {:.1} | {:.1} | {:.1} | {:.2} | {:.1} |",
                scene.scene,
                case.case,
                1e3 * case.seconds.trace,
                1e3 * case.seconds.guides,
                1e3 * case.seconds.filter,
                case.cost_share,
                1e3 * case.paper_seconds.filter
            );
        }
    }
    page.push_str(
        "\n| scene | switch | mode | frames | ghost | relMSE |\n|---|---|---|---|---|---|\n",
    );
    for scene in &report.scenes {
        for s in &scene.switches {
            let _ = writeln!(
                page,
                "| {} | {} | {} | {} | {:.3} | {:.5} |",
                scene.scene, s.switch, s.mode, s.frames, s.ghost, s.relmse
            );
        }
    }
    page.push_str("\n| scene | case | eyes apart | contrast at a pixel | flicker | disoccluded: pixels, error, of a fresh start |\n|---|---|---|---|---|---|\n");
    for scene in &report.scenes {
        for case in &scene.cases {
            let list = |values: &BTreeMap<&'static str, f64>, digits: usize| {
                let cells: Vec<_> = values
                    .iter()
                    .map(|(name, value)| format!("{name} {value:.digits$}"))
                    .collect();
                cells.join(", ")
            };
            let disoccluded = case.disoccluded.as_ref().map_or("—".into(), |d| {
                format!("{}, {:.5}, {:.5}", d.pixels, d.relmse, d.fresh)
            });
            let _ = writeln!(
                page,
                "| {} | {} | {} | {} | {} | {disoccluded} |",
                scene.scene,
                case.case,
                list(&case.disagreement, 4),
                list(&case.contrast, 3),
                list(&case.flicker, 5),
            );
        }
    }
    page
}

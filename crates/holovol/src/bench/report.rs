use std::fmt::Write;

use super::trace::Report;

/// The report as a Markdown page; its maker adds date, commit and command.
pub(super) fn markdown(report: &Report) -> String {
    let mut page = String::new();
    // Writing to a String cannot fail.
    page_into(report, &mut page).ok();
    page
}

fn page_into(report: &Report, page: &mut String) -> std::fmt::Result {
    writeln!(page, "# Tracer\n")?;
    writeln!(
        page,
        "{}, {}; medians of {} rounds that take turns, {} samples per pixel each.",
        report.adapter, report.driver, report.rounds, report.spp
    )?;
    writeln!(page, "\n## Lookups\n")?;
    writeln!(
        page,
        "| scene | format | lookups per covered sample | cells per covered sample | M lookups/s | bare random fetch, M/s | ratio |"
    )?;
    writeln!(page, "|---|---|---|---|---|---|---|")?;
    for scene in &report.scenes {
        writeln!(
            page,
            "| {} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.2} |",
            scene.scene,
            scene.texture_format,
            scene.lookups_per_covered_sample,
            scene.cells_per_covered_sample,
            scene.lookups_per_second / 1e6,
            scene.bare_lookups_per_second / 1e6,
            scene.lookup_rate_ratio,
        )?;
    }
    writeln!(
        page,
        "\nA sample is one flight through the volume and its shadow walks."
    )?;
    writeln!(page, "\n## Variants\n")?;
    writeln!(
        page,
        "Gain: how many times as efficient, 1/(relMSE × seconds), the default is. The last column is the relMSE between the mean images: a bias, or what chance leaves of it.\n"
    )?;
    writeln!(
        page,
        "| scene | variant | k samples/s | relMSE × spp | seconds ÷ default's | gain of the default | relMSE to default |"
    )?;
    writeln!(page, "|---|---|---|---|---|---|---|")?;
    for scene in &report.scenes {
        for variant in &scene.variants {
            writeln!(
                page,
                "| {} | {} | {:.0} | {:.4} | {:.2} | {:.2} | {:.2e} |",
                scene.scene,
                variant.name,
                variant.samples_per_second / 1e3,
                variant.relmse_times_spp,
                variant.seconds_ratio,
                variant.default_gain,
                variant.relmse_to_default,
            )?;
        }
    }
    if report.sizes.is_empty() {
        return Ok(());
    }
    writeln!(page, "\n## Volume size\n")?;
    writeln!(page, "The first scene's field on side³ voxels of 8 bits.\n")?;
    writeln!(
        page,
        "| side | k samples/s | cost ÷ that of half the side |"
    )?;
    writeln!(page, "|---|---|---|")?;
    for size in &report.sizes {
        writeln!(
            page,
            "| {} | {:.0} | {:.2} |",
            size.side,
            size.samples_per_second / 1e3,
            size.cost_growth
        )?;
    }
    Ok(())
}

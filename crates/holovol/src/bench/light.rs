//! `holovol bench light`: the ladder of evidence against panoramas whose light is known.

use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use holovol_light::EnvironmentMap;
use holovol_light::change::ChangeDetector;
use holovol_light::estimate::{Estimator, Evidence, Exposure, Observation, Prior};
use holovol_light::evaluate::{
    CLIPPED_SHARES, Case, Given, cells_of, fit, median, observe, quantile, rank_correlation,
};
use holovol_light::measure::{FluxCells, LightError512, spherical_harmonics};
use holovol_light::temporal::TemporalFilter;
use rayon::prelude::*;
use serde::Serialize;

use super::changes::{self, Change};
use super::light_path::{self, EndToEnd};
use crate::cli::BenchLightArgs;
use crate::progress::Bar;
use crate::{Exit, Failure, output, print_json};

#[derive(Serialize)]
struct Report {
    cases: usize,
    rungs: Vec<RungReport>,
    milliseconds_512x256: f64,
    end_to_end: EndToEnd,
    changes: Vec<Change>,
    /// Fitted on all.
    prior: Prior,
}

#[derive(Serialize)]
struct RungReport {
    evidence: &'static str,
    plain: Figures,
    estimate: Figures,
    inside_two_sigma: f64,
    rank_correlation: f64,
    panoramas: Vec<PanoramaReport>,
}

#[derive(Serialize)]
struct PanoramaReport {
    name: String,
    /// What was fitted without it.
    prior: Prior,
    plain: Figures,
    estimate: Figures,
    sigma_ev: f64,
}

/// Median, mean and 90th percentile.
#[derive(Serialize)]
pub(super) struct Spread {
    pub(super) median: f64,
    pub(super) mean: f64,
    pub(super) p90: f64,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.collect();
        Self {
            mean: values.iter().sum::<f64>() / values.len().max(1) as f64,
            median: median(values.clone()),
            p90: quantile(values, 0.9),
        }
    }
}

#[derive(Serialize)]
pub(super) struct Figures {
    pub(super) irradiance_rmse: Spread,
    pub(super) abs_ev_bias: Spread,
    pub(super) direction_deg: Spread,
}

impl Figures {
    pub(super) fn of(errors: &[LightError512]) -> Self {
        Self {
            irradiance_rmse: Spread::of(errors.iter().map(|e| e.irradiance_rmse)),
            abs_ev_bias: Spread::of(errors.iter().map(|e| e.ev_bias.abs())),
            direction_deg: Spread::of(errors.iter().map(|e| e.direction.to_degrees())),
        }
    }
}

/// One case on one rung.
struct Outcome {
    plain: LightError512,
    estimate: LightError512,
    sigma_ev: f64,
}

pub(super) fn run(args: &BenchLightArgs) -> Result<(), Failure> {
    if let Some(report) = &args.report {
        output::check(report, "md", "--report")?;
    }
    if args.panoramas.len() < 3 {
        return Err(Failure::new(
            Exit::Usage,
            "expected at least 3 panoramas: the prior is fitted on all but one",
        ));
    }
    let maps: Vec<EnvironmentMap> = args
        .panoramas
        .iter()
        .map(|path| Ok(EnvironmentMap::load(path)?))
        .collect::<Result<_, Failure>>()?;
    let bar = Bar::new("light");
    // The prior is fitted on one turn of each: turns tell it nothing new.
    let fitted: Vec<(Case, Vec<Observation>)> = (0..maps.len() * CLIPPED_SHARES.len())
        .into_par_iter()
        .map(|i| {
            let (panorama, share) = (i / CLIPPED_SHARES.len(), i % CLIPPED_SHARES.len());
            let case = Case::new(panorama, &maps[panorama], 0, CLIPPED_SHARES[share]);
            let observed = observe(&case);
            (case, observed)
        })
        .collect();
    let prior_without = |left_out: usize| {
        let rest = fitted.iter().filter(|(case, _)| case.panorama != left_out);
        let rest: Vec<(&Case, &[Observation])> = rest.map(|(c, o)| (c, o.as_slice())).collect();
        fit(&rest)
    };
    let priors: Vec<Prior> = (0..=maps.len())
        .map(|left_out| {
            bar.set(0.5 * left_out as f64 / maps.len() as f64, "fitting priors");
            prior_without(left_out)
        })
        .collect();
    drop(fitted);

    let rotations = args.rotations as usize;
    let outcomes: Vec<Vec<(usize, Vec<Outcome>)>> = maps
        .iter()
        .enumerate()
        .map(|(panorama, map)| {
            bar.set(
                0.5 + 0.5 * panorama as f64 / maps.len() as f64,
                "estimating",
            );
            let turns = (0..rotations * CLIPPED_SHARES.len()).into_par_iter();
            turns
                .map(|i| {
                    let share = CLIPPED_SHARES[i % CLIPPED_SHARES.len()];
                    let case = Case::new(panorama, map, i / CLIPPED_SHARES.len(), share);
                    (panorama, measure(&case, priors[panorama]))
                })
                .collect()
        })
        .collect();
    let outcomes: Vec<(usize, Vec<Outcome>)> = outcomes.into_iter().flatten().collect();
    let prior = priors[maps.len()];
    let report = Report {
        cases: outcomes.len(),
        rungs: (0..Given::ALL.len())
            .map(|rung| summarise(rung, &outcomes, &args.panoramas, &priors))
            .collect(),
        milliseconds_512x256: time_update(&maps[0], prior),
        end_to_end: light_path::end_to_end(&maps, &priors, rotations)
            .map_err(|problem| Failure::new(Exit::Internal, problem))?,
        changes: changes::changes(&maps, args.imagined_seed.into()),
        prior,
    };
    if let Some(path) = &args.report {
        let mut page = String::new();
        // Writing to a String cannot fail.
        markdown(&report, &mut page).ok();
        output::write_text(&page, path)?;
    }
    print_json(&report)
}

fn measure(case: &Case, prior: Prior) -> Vec<Outcome> {
    let (width, height) = (case.map.width(), case.map.height());
    Given::ALL
        .into_iter()
        .map(|given| {
            // An estimator keeps to the lights that it took out of the map before.
            let mut estimator = Estimator::new(width, height, prior);
            let plain = case.plain_merge(given);
            let plain = FluxCells::from_texels(estimator.grid(), &plain);
            case.estimate(&mut estimator, given);
            Outcome {
                plain: case.error(&plain),
                estimate: case.error(&cells_of(&estimator)),
                sigma_ev: estimator.sigma_ev(),
            }
        })
        .collect()
}

fn summarise(
    rung: usize,
    outcomes: &[(usize, Vec<Outcome>)],
    panoramas: &[std::path::PathBuf],
    priors: &[Prior],
) -> RungReport {
    let all: Vec<&Outcome> = outcomes.iter().map(|(_, of)| &of[rung]).collect();
    let bias: Vec<f64> = all.iter().map(|o| o.estimate.ev_bias.abs()).collect();
    let sigma: Vec<f64> = all.iter().map(|o| o.sigma_ev).collect();
    let inside = bias.iter().zip(&sigma).filter(|(b, s)| **b <= 2.0 * **s);
    let named = panoramas.iter().enumerate().map(|(i, path)| {
        let of_it: Vec<&Outcome> = outcomes
            .iter()
            .filter(|(p, _)| *p == i)
            .map(|(_, of)| &of[rung])
            .collect();
        let errors: Vec<LightError512> = of_it.iter().map(|o| o.estimate).collect();
        let plain: Vec<LightError512> = of_it.iter().map(|o| o.plain).collect();
        PanoramaReport {
            name: stem(path),
            prior: priors[i],
            plain: Figures::of(&plain),
            estimate: Figures::of(&errors),
            sigma_ev: median(of_it.iter().map(|o| o.sigma_ev).collect()),
        }
    });
    let plain: Vec<LightError512> = all.iter().map(|o| o.plain).collect();
    let estimate: Vec<LightError512> = all.iter().map(|o| o.estimate).collect();
    RungReport {
        evidence: Given::ALL[rung].name(),
        plain: Figures::of(&plain),
        estimate: Figures::of(&estimate),
        inside_two_sigma: inside.count() as f64 / all.len().max(1) as f64,
        rank_correlation: rank_correlation(&sigma, &bias),
        panoramas: named.collect(),
    }
}

fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    stem.trim_end_matches("_1k").to_owned()
}

/// Milliseconds of one update of 512 × 256 texels in the steady state, from two linear exposures
/// to light, on one core; the median of many.
fn time_update(map: &EnvironmentMap, prior: Prior) -> f64 {
    const SIZE: [usize; 2] = [512, 256];
    let texels: Vec<[f32; 3]> = (0..SIZE[0] * SIZE[1])
        .map(|i| {
            let uv = [
                (i % SIZE[0]) as f64 / SIZE[0] as f64,
                (i / SIZE[0]) as f64 / SIZE[1] as f64,
            ];
            map.radiance_at_uv(uv).map(|c| c as f32)
        })
        .collect();
    let small = EnvironmentMap::new(SIZE[0], SIZE[1], texels);
    let case = Case::new(0, &small, 0, CLIPPED_SHARES[1]);
    let clip = |ev: f32| -> Vec<[f32; 3]> {
        let scale = ev.exp2();
        case.map
            .texels()
            .iter()
            .map(|t| t.map(|c| (c * scale).min(1.0)))
            .collect()
    };
    let (base, dark) = (clip(0.0), clip(-6.0));
    let frames = [
        Exposure {
            ev: 0.0,
            radiance: &base,
        },
        Exposure {
            ev: -6.0,
            radiance: &dark,
        },
    ];
    let mut estimator = Estimator::new(SIZE[0], SIZE[1], prior);
    let mut filter = TemporalFilter::new(SIZE[0], SIZE[1]);
    let mut change = ChangeDetector::new();
    let times = (0..60).map(|_| {
        let started = Instant::now();
        estimator.estimate(&Evidence {
            frames: &frames,
            ..Evidence::default()
        });
        filter.update(estimator.radiance(), estimator.lights(), 1.0 / 30.0, 0.0);
        let t = change.update(estimator.grid(), filter.radiance(), filter.lights());
        let sh = spherical_harmonics(estimator.grid(), filter.radiance());
        std::hint::black_box((t, sh));
        started.elapsed().as_secs_f64() * 1e3
    });
    median(times.collect())
}

fn markdown(report: &Report, page: &mut String) -> std::fmt::Result {
    writeln!(page, "# Light\n")?;
    writeln!(
        page,
        "{} cases: each panorama turned and exposed so that 0.5, 2 and 8 % of it clip; 8-bit sRGB. The prior is fitted without the panorama that is measured. Irradiance over 512 normals, unscaled.\n",
        report.cases
    )?;
    writeln!(
        page,
        "| evidence | plain: rel. RMSE / EV bias, medians | estimate, medians | mean | p90 | direction, median / p90 | inside ± 2σ | rank of σ and error |"
    )?;
    writeln!(page, "|---|---|---|---|---|---|---|---|")?;
    for rung in &report.rungs {
        let (plain, found) = (&rung.plain, &rung.estimate);
        writeln!(
            page,
            "| {} | {:.2} / {:.2} | {:.2} / {:.2} | {:.2} / {:.2} | {:.2} / {:.2} | {:.1}° / {:.1}° | {:.0} % | {:.2} |",
            rung.evidence,
            plain.irradiance_rmse.median,
            plain.abs_ev_bias.median,
            found.irradiance_rmse.median,
            found.abs_ev_bias.median,
            found.irradiance_rmse.mean,
            found.abs_ev_bias.mean,
            found.irradiance_rmse.p90,
            found.abs_ev_bias.p90,
            found.direction_deg.median,
            found.direction_deg.p90,
            100.0 * rung.inside_two_sigma,
            rung.rank_correlation,
        )?;
    }
    writeln!(
        page,
        "\nOne update of 512 × 256 (two exposures merged, lights found and extended, filtered over time, T, spherical harmonics): {:.2} ms on one core.",
        report.milliseconds_512x256
    )?;
    let path = &report.end_to_end;
    writeln!(
        page,
        "\n## Through the camera\n\nTwo fisheyes (Mei), vignetting, gains of ± 5 %, 1 % of veiling glare, noise, 4:2:0 and block compression; stitched and turned back, with a −6 EV frame; all turns and exposures of all panoramas, each from another pose of the camera.\n\n| | rel. RMSE / EV bias, medians | mean | p90 | direction, median / p90 |\n|---|---|---|---|---|"
    )?;
    for (way, of) in [
        ("directly", &path.all.direct),
        ("through the camera", &path.all.camera),
    ] {
        writeln!(
            page,
            "| {way} | {:.3} / {:.3} | {:.3} / {:.3} | {:.3} / {:.3} | {:.1}° / {:.1}° |",
            of.irradiance_rmse.median,
            of.abs_ev_bias.median,
            of.irradiance_rmse.mean,
            of.abs_ev_bias.mean,
            of.irradiance_rmse.p90,
            of.abs_ev_bias.p90,
            of.direction_deg.median,
            of.direction_deg.p90,
        )?;
    }
    writeln!(
        page,
        "\nIrradiance of a uniform room: within {:.2} % of its mean. Stitching two pictures of 1440²: {:.2} ms on two cores.",
        100.0 * path.seam,
        path.stitch_milliseconds_1440
    )?;
    writeln!(
        page,
        "\n## Change of illumination, T\n\nPanoramas of 512 × 256. A person of 1.75 m walks by at 1.4 m/s, 1.5 m from the camera, in clothes lit by the panorama: the largest T of half a second at 30 frames a second; four walks in each panorama, by the largest share of all light that is hidden. Rooms and days at random: see `evaluate::imagined`.\n\n| event | expected | cases | least | median | most | not as expected |\n|---|---|---|---|---|---|---|"
    )?;
    for change in &report.changes {
        writeln!(
            page,
            "| {} | {} | {} | {:.3} | {:.3} | {:.3} | {} |",
            change.event,
            change.expected,
            change.count,
            change.least,
            change.median,
            change.most,
            change.outside
        )?;
    }
    writeln!(page, "\n## Panorama by panorama\n")?;
    writeln!(
        page,
        "Medians over turns and exposures: relative RMSE / EV bias; **in bold** what is worse than the same exposures plainly merged.\n"
    )?;
    write!(page, "| panorama |")?;
    for rung in &report.rungs {
        write!(page, " {} |", rung.evidence)?;
    }
    write!(page, " through the camera, −6 EV |")?;
    writeln!(page, "\n|---|{}", "---|".repeat(report.rungs.len() + 1))?;
    let panoramas = report.rungs.first().map_or(0, |rung| rung.panoramas.len());
    for i in 0..panoramas {
        write!(page, "| {} |", report.rungs[0].panoramas[i].name)?;
        for rung in &report.rungs {
            let found = &rung.panoramas[i];
            let figure = |of: &dyn Fn(&Figures) -> f64| {
                let (plain, estimate) = (of(&found.plain), of(&found.estimate));
                // Not for what rounds to the same.
                let mark = if estimate > plain + 0.005 { "**" } else { "" };
                format!("{mark}{estimate:.2}{mark}")
            };
            let rmse = figure(&|f| f.irradiance_rmse.median);
            let bias = figure(&|f| f.abs_ev_bias.median);
            write!(page, " {rmse} / {bias} |")?;
        }
        let path = &report.end_to_end.panoramas[i];
        let rmse = path.camera.irradiance_rmse.median;
        writeln!(page, " {rmse:.2} / {:.2} |", path.camera.abs_ev_bias.median)?;
    }
    let prior = &report.prior;
    writeln!(
        page,
        "\nThe prior fitted on all: sun over sky {:.3} EV (σ {:.2}), gain {:.3} times what the edge says (σ {:.3}), σ scales {:.3?}.",
        prior.sun_over_sky, prior.sun_sigma, prior.gain, prior.gain_sigma, prior.sigma_scale
    )
}

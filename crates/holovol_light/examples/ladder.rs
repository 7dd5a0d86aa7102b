//! Prints how well the ladder of evidence does on panoramas, leave-one-out.
//!
//! `cargo run --release -p holovol_light --example ladder -- [--all-turns] *.hdr`
use std::path::Path;

use holovol_light::EnvironmentMap;
use holovol_light::estimate::{Estimator, Prior};
use holovol_light::evaluate::{
    CLIPPED_SHARES, Case, Given, ROTATIONS, cells_of, fit, median, observe, quantile,
    rank_correlation,
};
use holovol_light::measure::FluxCells;
use rayon::prelude::*;

fn main() {
    let mut files: Vec<String> = std::env::args().skip(1).collect();
    let all_turns = files.first().is_some_and(|file| file == "--all-turns");
    if all_turns {
        files.remove(0);
    }
    let maps: Vec<EnvironmentMap> = files
        .iter()
        .map(|f| EnvironmentMap::load(Path::new(f)).expect("a panorama"))
        .collect();
    let cases: Vec<Case> = (0..maps.len() * 3)
        .into_par_iter()
        .map(|i| Case::new(i / 3, &maps[i / 3], 0, CLIPPED_SHARES[i % 3]))
        .collect();
    let observed: Vec<_> = cases.par_iter().map(observe).collect();
    let priors: Vec<Prior> = (0..=maps.len())
        .map(|left_out| {
            let all = cases.iter().zip(observed.iter().map(Vec::as_slice));
            let rest: Vec<_> = all.filter(|(c, _)| c.panorama != left_out).collect();
            fit(&rest)
        })
        .collect();
    let cases: Vec<Case> = if all_turns {
        (0..maps.len() * 3 * ROTATIONS)
            .into_par_iter()
            .map(|i| {
                let panorama = i / 3 / ROTATIONS;
                let (turn, share) = (i / 3 % ROTATIONS, CLIPPED_SHARES[i % 3]);
                Case::new(panorama, &maps[panorama], turn, share)
            })
            .collect()
    } else {
        cases
    };
    for (p, f) in priors
        .iter()
        .zip(files.iter().map(String::as_str).chain(["all"]))
    {
        println!("{:30} {p:?}", f.rsplit('/').next().unwrap_or(f));
    }
    for given in Given::ALL {
        let results: Vec<_> = cases
            .par_iter()
            .map(|case| {
                let mut estimator =
                    Estimator::new(case.map.width(), case.map.height(), priors[case.panorama]);
                case.estimate(&mut estimator, given);
                let plain = FluxCells::from_texels(estimator.grid(), &case.plain_merge(given));
                let plain = case.error(&plain);
                (case.error(&cells_of(&estimator)), estimator, plain)
            })
            .collect();
        println!("=== {}", given.name());
        for (case, (error, estimator, plain)) in cases.iter().zip(&results) {
            let name = files[case.panorama].rsplit('/').next().unwrap_or("");
            let lights: Vec<String> = estimator
                .lights()
                .iter()
                .take(3)
                .map(|l| {
                    format!(
                        "{:?} {:.1e}sr {:.2} s{:.1}",
                        l.class, l.solid_angle, l.irradiance[1], l.sigma_ev
                    )
                })
                .collect();
            println!(
                "{name:32} {:5} rmse {:.2} ev {:+.2} plain {:.2} {:+.2} sigma {:.2} dir {:5.1}  clear {:.2} haze {:.2} {lights:?}",
                case.share,
                error.irradiance_rmse,
                error.ev_bias,
                plain.irradiance_rmse,
                plain.ev_bias,
                estimator.sigma_ev(),
                error.direction.to_degrees(),
                estimator.sky().clearness,
                estimator.sky().haze,
            );
        }
        let of = |f: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..results.len()).map(f).collect() };
        let rmse = of(&|i| results[i].0.irradiance_rmse);
        let ev = of(&|i| results[i].0.ev_bias.abs());
        let direction = of(&|i| results[i].0.direction.to_degrees());
        let z = of(&|i| results[i].0.ev_bias.abs() / results[i].1.sigma_ev());
        let inside = z.iter().filter(|&&z| z <= 2.0).count() as f64 / z.len() as f64;
        let sigma = of(&|i| results[i].1.sigma_ev());
        let rank = rank_correlation(&sigma, &ev);
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        println!(
            "--- {}: rmse {:.3} mean {:.3} p90 {:.3}  ev {:.3} mean {:.3} p90 {:.3}  dir {:.1} p90 {:.1}  inside {inside:.2} z95 {:.2} rank {rank:.2}",
            given.name(),
            median(rmse.clone()),
            mean(&rmse),
            quantile(rmse, 0.9),
            median(ev.clone()),
            mean(&ev),
            quantile(ev, 0.9),
            median(direction.clone()),
            quantile(direction, 0.9),
            quantile(z, 0.95),
        );
    }
}

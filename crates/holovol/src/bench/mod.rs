//! `holovol bench`: measures holovol on this machine.

mod changes;
mod denoise;
mod denoise_measures;
mod denoise_oidn;
mod denoise_report;
mod light;
mod light_path;
mod report;
mod stereo;
mod trace;

use crate::Failure;
use crate::cli::BenchCommand;

pub(crate) fn run(command: &BenchCommand) -> Result<(), Failure> {
    match command {
        BenchCommand::Trace(args) => trace::run(args),
        BenchCommand::Light(args) => light::run(args),
        BenchCommand::Denoise(args) => denoise::run(args),
        BenchCommand::Stereo(args) => stereo::run(args),
    }
}

/// The middle of some measurements; 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[middle],
        _ => 0.5 * (values[middle - 1] + values[middle]),
    }
}

#[cfg(test)]
mod tests {
    use super::median;

    #[test]
    fn median_is_the_middle() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(median(Vec::new()), 0.0);
    }
}

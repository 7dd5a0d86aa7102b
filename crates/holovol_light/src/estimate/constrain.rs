//! Lights of unknown strength under measured irradiance: Gauss–Newton on log₂ fluxes.

/// At most this many lights are told apart; the strongest ones.
pub(super) const GROUPS: usize = 8;

/// What is believed of the log₂ strengths: normal with mean 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beliefs {
    count: usize,
    precision: [[f64; GROUPS]; GROUPS],
}

impl Beliefs {
    /// From the leading `count` × `count` block of a positive definite covariance.
    pub fn new(count: usize, covariance: &[[f64; GROUPS]; GROUPS]) -> Self {
        let count = count.min(GROUPS);
        match invert(covariance, count) {
            Some(precision) => Self { count, precision },
            // Not positive definite, which no caller of ours gives: then nothing is believed.
            None => Self {
                count: 0,
                precision: [[0.0; GROUPS]; GROUPS],
            },
        }
    }
}

/// One measured irradiance: `base + Σ reach[i] · 2^x[i]` should be `measured`, within `sigma` EV.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured {
    pub base: f64,
    pub reach: [f64; GROUPS],
    pub value: f64,
    pub sigma: f64,
}

impl Measured {
    /// How far the reading is above what lights of these log₂ strengths give, EV.
    pub fn residual(&self, strengths: &[f64; GROUPS]) -> f64 {
        self.value.max(1e-12).log2() - predict(strengths, GROUPS, self).0
    }
}

/// Most probable strengths and their covariance.
pub(super) struct Posterior {
    pub strengths: [f64; GROUPS],
    pub covariance: [[f64; GROUPS]; GROUPS],
    /// How far the strengths are from what was believed, and the readings from what these
    /// strengths give, in standard deviations.
    pub strain: f64,
    pub misfit: f64,
}

impl Posterior {
    /// How far beliefs and readings are from each other, in standard deviations.
    pub fn spreads(&self) -> f64 {
        self.strain.hypot(self.misfit)
    }

    /// Makes all spreads larger by a factor.
    pub fn widen(&mut self, factor: f64) {
        let entries = self.covariance.as_flattened_mut();
        entries.iter_mut().for_each(|v| *v *= factor * factor);
    }
}

/// Combines beliefs with measurements.
///
/// The residual of a measurement is taken in EV, as both beliefs and meters err by factors.
pub(super) fn posterior(beliefs: &Beliefs, measured: &[Measured]) -> Posterior {
    let n = beliefs.count;
    let strengths = [0.0; GROUPS];
    let mut best = (cost(&strengths, beliefs, measured), strengths);
    let mut damping = 1e-3;
    for _ in 0..40 {
        let (normal, gradient) = linearise(&best.1, beliefs, measured);
        let mut damped = normal;
        for (i, row) in damped.iter_mut().enumerate().take(n) {
            row[i] *= 1.0 + damping;
        }
        let Some(inverse) = invert(&damped, n) else {
            break;
        };
        let mut next = best.1;
        let mut step = 0.0_f64;
        for i in 0..n {
            let delta: f64 = (0..n).map(|j| inverse[i][j] * gradient[j]).sum();
            next[i] += delta.clamp(-2.0, 2.0);
            step = step.max(delta.abs());
        }
        let next_cost = cost(&next, beliefs, measured);
        if next_cost <= best.0 {
            best = (next_cost, next);
            damping = (damping * 0.3).max(1e-9);
            if step < 1e-5 {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e9 {
                break;
            }
        }
    }
    let (normal, _) = linearise(&best.1, beliefs, measured);
    let strain = cost(&best.1, beliefs, &[]).max(0.0);
    Posterior {
        strain: strain.sqrt(),
        misfit: (best.0 - strain).max(0.0).sqrt(),
        strengths: best.1,
        covariance: invert(&normal, n).unwrap_or([[0.0; GROUPS]; GROUPS]),
    }
}

/// log₂ of what a measurement should read, and how that goes with each strength.
fn predict(strengths: &[f64; GROUPS], n: usize, at: &Measured) -> (f64, [f64; GROUPS]) {
    let mut parts = [0.0; GROUPS];
    let mut total = at.base.max(1e-12);
    for i in 0..n {
        parts[i] = at.reach[i] * strengths[i].exp2();
        total += parts[i];
    }
    (total.log2(), parts.map(|part| part / total))
}

fn cost(strengths: &[f64; GROUPS], beliefs: &Beliefs, measured: &[Measured]) -> f64 {
    let n = beliefs.count;
    let prior = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    let prior = prior.map(|(i, j)| strengths[i] * beliefs.precision[i][j] * strengths[j]);
    let data = measured.iter().map(|at| {
        let (expected, _) = predict(strengths, n, at);
        ((at.value.max(1e-12).log2() - expected) / at.sigma).powi(2)
    });
    prior.sum::<f64>() + data.sum::<f64>()
}

/// Normal matrix and right-hand side of the step.
fn linearise(
    strengths: &[f64; GROUPS],
    beliefs: &Beliefs,
    measured: &[Measured],
) -> ([[f64; GROUPS]; GROUPS], [f64; GROUPS]) {
    let mut normal = [[0.0; GROUPS]; GROUPS];
    let mut right = [0.0; GROUPS];
    let n = beliefs.count;
    for i in 0..n {
        for j in 0..n {
            normal[i][j] += beliefs.precision[i][j];
            right[i] -= beliefs.precision[i][j] * strengths[j];
        }
    }
    for at in measured {
        let (expected, shares) = predict(strengths, n, at);
        let weight = at.sigma.powi(-2);
        let residual = at.value.max(1e-12).log2() - expected;
        for i in 0..n {
            right[i] += weight * shares[i] * residual;
            for j in 0..n {
                normal[i][j] += weight * shares[i] * shares[j];
            }
        }
    }
    (normal, right)
}

/// Inverse of the leading n × n block of a symmetric positive definite matrix, by Gauss–Jordan.
fn invert(matrix: &[[f64; GROUPS]; GROUPS], n: usize) -> Option<[[f64; GROUPS]; GROUPS]> {
    let mut left = *matrix;
    let mut inverse = [[0.0; GROUPS]; GROUPS];
    for (i, row) in inverse.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for i in 0..n {
        let pivot = left[i][i];
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        for j in 0..n {
            left[i][j] /= pivot;
            inverse[i][j] /= pivot;
        }
        for k in 0..n {
            if k == i {
                continue;
            }
            let factor = left[k][i];
            for j in 0..n {
                left[k][j] -= factor * left[i][j];
                inverse[k][j] -= factor * inverse[i][j];
            }
        }
    }
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beliefs(sigmas: &[f64]) -> Beliefs {
        let mut covariance = [[0.0; GROUPS]; GROUPS];
        for (i, sigma) in sigmas.iter().enumerate() {
            covariance[i][i] = sigma * sigma;
        }
        Beliefs::new(sigmas.len(), &covariance)
    }

    fn reach(values: &[f64]) -> [f64; GROUPS] {
        let mut out = [0.0; GROUPS];
        out[..values.len()].copy_from_slice(values);
        out
    }

    #[test]
    fn nothing_measured_leaves_beliefs() {
        let found = posterior(&beliefs(&[0.5, 2.0]), &[]);
        assert_eq!(found.strengths[..2], [0.0, 0.0]);
        assert!((found.covariance[0][0] - 0.25).abs() < 1e-12);
        assert!((found.covariance[1][1] - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_good_meter_settles_the_light_it_sees() {
        let measured = Measured {
            base: 1.0,
            reach: reach(&[2.0, 0.0]),
            value: 1.0 + 2.0 * 3.0_f64.exp2(),
            sigma: 0.07,
        };
        let found = posterior(&beliefs(&[1.0, 2.0]), &[measured]);
        let [x, other, ..] = found.strengths;
        assert!((x - 3.0).abs() < 0.05 && other == 0.0, "{x} {other}");
        assert!(found.covariance[0][0].sqrt() < 0.1);
        assert!((found.covariance[1][1] - 4.0).abs() < 1e-9);
    }

    #[test]
    fn alike_lights_learn_from_each_other() {
        let mut covariance = [[0.0; GROUPS]; GROUPS];
        covariance[0][0] = 1.0;
        covariance[1][1] = 1.0;
        covariance[0][1] = 0.6;
        covariance[1][0] = 0.6;
        let measured = Measured {
            base: 0.0,
            reach: reach(&[1.0, 0.0]),
            value: 2.0,
            sigma: 0.01,
        };
        let found = posterior(&Beliefs::new(2, &covariance), &[measured]);
        assert!((found.strengths[0] - 1.0).abs() < 0.01);
        assert!((found.strengths[1] - 0.6).abs() < 0.01);
    }

    #[test]
    fn what_can_not_be_met_is_met_as_well_as_beliefs_allow() {
        let measured = Measured {
            base: 2.0,
            reach: reach(&[4.0]),
            value: 1.0,
            sigma: 0.07,
        };
        let found = posterior(&beliefs(&[1.0]), &[measured]);
        assert!(found.strengths[0] < -2.0 && found.strengths[0].is_finite());
    }
}

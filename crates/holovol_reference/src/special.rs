//! The few special functions that tests of significance need, in f64.

use std::f64::consts::PI;

/// ln Γ(x) for x > 0, by Stirling's series after shifting x above 10; relative error near 1e-15.
pub fn ln_gamma(x: f64) -> f64 {
    let mut shift = 0.0;
    let mut x = x;
    while x < 10.0 {
        shift -= x.ln();
        x += 1.0;
    }
    let inverse = 1.0 / x;
    let square = inverse * inverse;
    // B₂ₖ / (2k(2k − 1)), k = 1 … 7.
    const SERIES: [f64; 7] = [
        1.0 / 12.0,
        -1.0 / 360.0,
        1.0 / 1260.0,
        -1.0 / 1680.0,
        1.0 / 1188.0,
        -691.0 / 360_360.0,
        1.0 / 156.0,
    ];
    let tail = SERIES.iter().rev().fold(0.0, |sum, b| sum * square + b) * inverse;
    shift + (x - 0.5) * x.ln() - x + 0.5 * (2.0 * PI).ln() + tail
}

/// Evaluates b₀ + a₁/(b₁ + a₂/(b₂ + …)) by Lentz's method; `term(n)` gives (aₙ, bₙ).
fn continued_fraction(b0: f64, mut term: impl FnMut(u32) -> (f64, f64)) -> f64 {
    const TINY: f64 = 1e-300;
    let guard = |x: f64| if x.abs() < TINY { TINY } else { x };
    let mut value = guard(b0);
    let (mut c, mut d) = (value, 0.0);
    for n in 1..100_000 {
        let (a, b) = term(n);
        d = 1.0 / guard(b + a * d);
        c = guard(b + a / c);
        value *= c * d;
        if (c * d - 1.0).abs() < 1e-15 {
            break;
        }
    }
    value
}

/// Upper tail of the gamma distribution, Q(a, x) = Γ(a, x)/Γ(a), a > 0, x ≥ 0.
pub fn gamma_q(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        // The lower tail's series converges fast here.
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-17 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        (1.0 - scale * sum).max(0.0)
    } else {
        let fraction = continued_fraction(x + 1.0 - a, |n| {
            let n = f64::from(n);
            (n * (a - n), x + 2.0 * n + 1.0 - a)
        });
        scale / fraction
    }
}

/// Regularised incomplete beta function I_x(a, b), a, b > 0, 0 ≤ x ≤ 1.
pub fn beta_i(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta_i(b, a, 1.0 - x);
    }
    let front = a * x.ln() + b * (1.0 - x).ln() + ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b);
    // Numerical Recipes' arrangement of DLMF 8.17.22.
    let fraction = continued_fraction(1.0, |n| {
        let m = f64::from(n / 2);
        let numerator = if n % 2 == 0 {
            m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m))
        } else {
            -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0))
        };
        (numerator, 1.0)
    });
    front.exp() / (a * fraction)
}

/// Two-sided p-value of Student's t.
pub fn student_t_p(t: f64, dof: f64) -> f64 {
    if !dof.is_finite() || dof > 1e7 {
        return normal_p(t);
    }
    beta_i(0.5 * dof, 0.5, dof / (dof + t * t))
}

/// Two-sided p-value of a standard normal.
pub fn normal_p(z: f64) -> f64 {
    gamma_q(0.5, 0.5 * z * z)
}

/// |z| of a two-sided p-value; at most [`MAX_Z`].
pub fn normal_z(p: f64) -> f64 {
    let (mut low, mut high) = (0.0, MAX_Z);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if normal_p(middle) > p {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Beyond it the normal's tail leaves the range of f64.
pub const MAX_Z: f64 = 37.0;

/// Upper tail of the chi-square distribution.
pub fn chi_square_p(chi_square: f64, dof: f64) -> f64 {
    gamma_q(0.5 * dof, 0.5 * chi_square)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64, relative: f64) {
        assert!((a - b).abs() <= relative * b.abs(), "{a} is not {b}");
    }

    #[test]
    fn gamma_is_that_of_factorials_and_halves() {
        close(ln_gamma(11.0), 3_628_800f64.ln(), 1e-14);
        close(ln_gamma(0.5), 0.5 * PI.ln(), 1e-13);
        close(ln_gamma(3.5), (15.0 / 8.0 * PI.sqrt()).ln(), 1e-13);
    }

    #[test]
    fn tails_are_those_of_the_tables() {
        close(normal_p(1.959_963_984_540_054), 0.05, 1e-12);
        close(normal_p(6.0), 1.973_175_290_075_e-9, 1e-9);
        close(chi_square_p(3.841_458_820_694_124, 1.0), 0.05, 1e-12);
        close(chi_square_p(124.342_113_404_004, 100.0), 0.05, 1e-9);
        close(student_t_p(2.131_449_545_559_323, 15.0), 0.05, 1e-9);
        // One degree of freedom is Cauchy's distribution.
        close(student_t_p(1e4, 1.0), 1.0 - 2.0 / PI * 1e4f64.atan(), 1e-8);
        // And two have a closed form.
        let t: f64 = 3.0;
        close(student_t_p(t, 2.0), 1.0 - t / (2.0 + t * t).sqrt(), 1e-12);
    }

    #[test]
    fn z_inverts_p() {
        for z in [0.1, 1.0, 5.0, 20.0, 36.0] {
            close(normal_z(normal_p(z)), z, 1e-9);
        }
        assert!(normal_z(0.0) >= MAX_Z - 1e-9);
    }
}

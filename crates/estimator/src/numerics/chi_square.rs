//! Quantiles of the chi-square distribution: the regularised lower incomplete gamma function by its power series,
//! inverted by bisection.
//!
//! ```text
//! F(x; n) = P(n/2, x/2)      P(a, x) = x^a e^-x / Γ(a + 1) · Σ_k x^k / ((a + 1) ... (a + k))
//! ln Γ(z) = (z - 1/2) ln z - z + ln(2π)/2 + 1/(12 z) - 1/(360 z³) + 1/(1260 z⁵) - 1/(1680 z⁷)    for large z
//! ```
//! Source: NIST Digital Library of Mathematical Functions, 8.11.4 (series) and 5.11.1 (Stirling).

use std::f64::consts::TAU;

/// From here on four terms of Stirling's series are good to 1e-14.
const STIRLING_FROM: f64 = 16.0;
/// Halvings of the bracket: from any bracket down to the spacing of doubles.
const BISECTIONS: usize = 80;

/// The value below which a chi-square variable with this number of degrees of freedom (at least 1) stays with this
/// probability. Within 1e-9 of 1 it loses digits, because the distribution function is summed from below.
pub fn chi_square_quantile(degrees_of_freedom: u64, probability: f64) -> f64 {
    let n = degrees_of_freedom.max(1) as f64;
    if probability >= 1.0 {
        return f64::INFINITY;
    }
    let mut low = 0.0;
    // Mean plus ten standard deviations plus the exponential tail of few degrees of freedom; a probability close to 1 lies further out.
    let mut high = n + 10.0 * (2.0 * n).sqrt() - 2.0 * (1.0 - probability).ln();
    for _ in 0..BISECTIONS {
        let middle = f64::midpoint(low, high);
        if cumulative(middle, n) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

/// Gates for innovations of one, two and three components: the quantiles for one, two and three degrees of freedom.
pub type ChiSquareGates = [f64; 3];

pub fn chi_square_gates(probability: f64) -> ChiSquareGates {
    [1, 2, 3].map(|degrees_of_freedom| chi_square_quantile(degrees_of_freedom, probability))
}

/// The probability that a chi-square variable with n degrees of freedom stays below x.
fn cumulative(x: f64, n: f64) -> f64 {
    let (a, half_x) = (n / 2.0, x / 2.0);
    if half_x <= 0.0 {
        return 0.0;
    }
    let mut term = 1.0;
    let mut sum = 1.0;
    let mut k = 1.0;
    while term > sum * f64::EPSILON {
        term *= half_x / (a + k);
        sum += term;
        k += 1.0;
    }
    (a * half_x.ln() - half_x - ln_gamma(a + 1.0)).exp() * sum
}

/// The logarithm of the gamma function for z > 0: shifted up, then Stirling's series.
fn ln_gamma(z: f64) -> f64 {
    let mut shifted = z;
    let mut product = 1.0;
    while shifted < STIRLING_FROM {
        product *= shifted;
        shifted += 1.0;
    }
    let inverse = 1.0 / shifted;
    let square = inverse * inverse;
    let correction = inverse * (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1260.0 - square / 1680.0)));
    (shifted - 0.5) * shifted.ln() - shifted + TAU.ln() / 2.0 + correction - product.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_agree_with_printed_tables() {
        // Critical values as printed in any table of the distribution, three digits after the point.
        for (degrees_of_freedom, probability, printed) in [
            (1, 0.5, 0.455),
            (1, 0.95, 3.841),
            (1, 0.999, 10.828),
            (2, 0.99, 9.210),
            (3, 0.025, 0.216),
            (3, 0.99, 11.345),
            (3, 0.999, 16.266),
            (5, 0.999, 20.515),
            (10, 0.975, 20.483),
            (60, 0.025, 40.482),
            (60, 0.975, 83.298),
            (100, 0.975, 129.561),
        ] {
            let value = chi_square_quantile(degrees_of_freedom, probability);
            assert!((value - printed).abs() < 6e-4, "{degrees_of_freedom} {probability}: {value}");
        }
    }

    #[test]
    fn two_degrees_of_freedom_are_an_exponential() {
        for tail in [0.5, 0.025, 1e-6, 1e-9] {
            let value = chi_square_quantile(2, 1.0 - tail);
            assert!((value / (-2.0 * f64::ln(tail)) - 1.0).abs() < 1e-5, "{tail}: {value}");
        }
        assert!(chi_square_quantile(2, 1.0).is_infinite());
    }

    #[test]
    fn many_degrees_of_freedom_approach_the_normal() {
        let n = 100_000;
        let value = chi_square_quantile(n, 0.975);
        // Wilson and Hilferty (1931): cube root of chi-square over n is nearly normal; 1.959964 is the 97.5 % point.
        let spread = 2.0 / (9.0 * n as f64);
        let approximate = n as f64 * (1.0 - spread + 1.959_964 * spread.sqrt()).powi(3);
        assert!((value / approximate - 1.0).abs() < 1e-6);
    }
}

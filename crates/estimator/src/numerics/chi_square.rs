//! Quantiles of the chi-square distribution, for the gate: does an innovation fit its covariance?
//!
//! A gate with a wrong R can lock itself out for ever; the way out is not here but in the filter, which counts what the
//! gate refuses and moves the estimate when the refused agree with each other.

/// The quantile of the chi-square distribution with `degrees_of_freedom` (at least 1) at `probability`.
///
/// Wilson and Hilferty's cube as a start, then Newton steps on the exact distribution function.
#[must_use]
pub fn chi_square_quantile(degrees_of_freedom: u8, probability: f64) -> f64 {
    let n = f64::from(degrees_of_freedom.max(1));
    let c = 2.0 / (9.0 * n);
    let mut q = (n * (1.0 - c + normal_quantile(probability) * c.sqrt()).powi(3)).max(1e-6);
    for _ in 0..NEWTON_STEPS {
        let (cdf, density) = chi_square_cdf_density(degrees_of_freedom.max(1), q);
        if density <= 0.0 {
            break;
        }
        q = (q - (cdf - probability) / density).max(q * 0.1);
    }
    q
}

/// From a start within some per cent Newton's method doubles its digits each step; the rest is for small degrees of freedom at
/// small probabilities.
const NEWTON_STEPS: u32 = 20;

/// Distribution function F and density f by the recurrence in steps of two degrees of freedom,
/// f_n = f_(n-2) q / (n-2), F_n = F_(n-2) - 2 f_n (Abramowitz and Stegun 26.4.4 to 26.4.8).
fn chi_square_cdf_density(degrees_of_freedom: u8, q: f64) -> (f64, f64) {
    let half = 0.5 * q;
    let (mut n, mut cdf, mut density) = if degrees_of_freedom.is_multiple_of(2) {
        (2, -(-half).exp_m1(), 0.5 * (-half).exp())
    } else {
        (1, erf(half.sqrt()), (-half).exp() / (std::f64::consts::TAU * q).sqrt())
    };
    while n < degrees_of_freedom {
        density *= q / f64::from(n);
        n += 2;
        cdf -= 2.0 * density;
    }
    (cdf, density)
}

/// The error function by its Maclaurin series (|x| < 3) or its continued fraction, to about 1e-13.
fn erf(x: f64) -> f64 {
    if x.abs() < 3.0 {
        let mut term = x;
        let mut sum = x;
        let mut n = 0.0;
        while term.abs() > 1e-17 * sum.abs() {
            n += 1.0;
            term *= -x * x / n;
            sum += term / (2.0 * n + 1.0);
        }
        return sum * std::f64::consts::FRAC_2_SQRT_PI;
    }
    let mut fraction = 0.0;
    for k in (1..=60).rev() {
        fraction = f64::from(k) * 0.5 / (x.abs() + fraction);
    }
    let tail = (-x * x).exp() / ((x.abs() + fraction) * std::f64::consts::PI.sqrt());
    (1.0 - tail).copysign(x)
}

/// The standard normal quantile, Abramowitz and Stegun 26.2.23 (error below 4.5e-4), only a starting value here.
fn normal_quantile(probability: f64) -> f64 {
    let tail = probability.min(1.0 - probability).max(1e-300);
    let t = (-2.0 * tail.ln()).sqrt();
    let z =
        t - (2.515_517 + t * (0.802_853 + t * 0.010_328)) / (1.0 + t * (1.432_788 + t * (0.189_269 + t * 0.001_308)));
    if probability >= 0.5 { z } else { -z }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_equal_the_published_table() {
        // Chi-square tables, e.g. Bar-Shalom, Li, Kirubarajan (2001), appendix; m = 1 to 5.
        for (m, p, expected) in [
            (1, 0.999, 10.828),
            (2, 0.999, 13.816),
            (3, 0.999, 16.266),
            (1, 0.99, 6.635),
            (2, 0.99, 9.210),
            (3, 0.99, 11.345),
            (1, 0.5, 0.455),
            (3, 0.5, 2.366),
            (4, 0.999, 18.467),
            (5, 0.999, 20.515),
        ] {
            let found = chi_square_quantile(m, p);
            assert!((found - expected).abs() < 6e-4, "m {m} p {p}: {found}");
        }
    }
}

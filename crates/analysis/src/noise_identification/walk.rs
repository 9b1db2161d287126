//! White noise and a random walk told apart: the most likely variances of a local level, equation (1) of the module's head.
//!
//! ```text
//! L(l) = -1/2 (n-1) (ln s2(l) + 1) - 1/2 sum ln f_k         l = var w / var v         (var v in front is taken out)
//! s2(l) = sum nu_k^2 / f_k / (n-1)                          nu_k, f_k of a Kalman filter with var v = 1, var w = l
//! ```

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WhiteAndWalk {
    /// White noise of a sample, one standard deviation.
    pub white: f64,
    /// Its standard deviation.
    pub white_sigma: f64,
    /// The random walk: standard deviation that is gained in one step. `None` where none can be told from zero.
    pub walk_per_step: Option<f64>,
    /// Standard deviation of ln of that.
    pub walk_ln_sigma: f64,
}

/// The range of ln l that is searched: from a walk that no record of a day shows to one that hides all white noise.
const LN_RATIO: [f64; 2] = [-27.0, 5.0];
/// Points of the first look over that range.
const GRID: u32 = 33;
/// Halvings of the interval that the search ends with: 2 / 1.618^30 is below a millionth.
const SECTIONS: u32 = 30;
/// Half a step for the curvature of L in ln l.
const CURVATURE_STEP: f64 = 0.1;
/// By so much must a walk raise L to be told from none: chi-square with one degree of freedom at 95 %, halved.
const LEAST_GAIN: f64 = 1.92;

/// Tells them apart; `None` for fewer than ten samples, values that are not finite, or no noise at all.
#[must_use]
pub fn white_and_walk(samples: &[f64]) -> Option<WhiteAndWalk> {
    if samples.len() < 10 || samples.iter().any(|sample| !sample.is_finite()) {
        return None;
    }
    let n = samples.len() as f64;
    let ln_l = best_ratio(samples);
    let (value, white2) = profile(samples, ln_l)?;
    let near = |by: f64| profile(samples, ln_l + by).map(|(value, _)| value);
    let curvature =
        (2.0 * value - near(CURVATURE_STEP)? - near(-CURVATURE_STEP)?) / CURVATURE_STEP.powi(2);
    let (none, _) = profile(samples, LN_RATIO[0])?;
    let is_told = value - none > LEAST_GAIN && curvature > 0.0;
    let ln_l_variance = if is_told { curvature.recip() } else { 0.0 };
    Some(WhiteAndWalk {
        white: white2.sqrt(),
        white_sigma: white2.sqrt() / (2.0 * n).sqrt(),
        walk_per_step: is_told.then(|| (white2 * ln_l.exp()).sqrt()),
        // ln walk = (ln l + ln s2) / 2, and ln s2 has the variance 2 / n.
        walk_ln_sigma: 0.5 * (ln_l_variance + 2.0 / n).sqrt(),
    })
}

/// ln l with the largest L: the best of a grid, then a golden section about it.
fn best_ratio(samples: &[f64]) -> f64 {
    let value = |ln_l: f64| profile(samples, ln_l).map_or(f64::NEG_INFINITY, |(value, _)| value);
    let width = (LN_RATIO[1] - LN_RATIO[0]) / f64::from(GRID - 1);
    let grid = (0..GRID).map(|i| LN_RATIO[0] + width * f64::from(i));
    let best = grid
        .map(|ln_l| (ln_l, value(ln_l)))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    let centre = best.map_or(LN_RATIO[0], |(ln_l, _)| ln_l);
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (centre - width, centre + width);
    let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
    let (mut at_a, mut at_b) = (value(a), value(b));
    for _ in 0..SECTIONS {
        if at_a > at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - golden * (high - low);
            at_a = value(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + golden * (high - low);
            at_b = value(b);
        }
    }
    0.5 * (low + high)
}

/// L and var v for a ratio; `None` where nothing varies.
fn profile(samples: &[f64], ln_l: f64) -> Option<(f64, f64)> {
    let l = ln_l.exp();
    let (first, rest) = samples.split_first()?;
    // A level that nothing is known of is the first sample, with its noise.
    let (mut level, mut p) = (*first, 1.0 + l);
    let (mut squares, mut ln_f) = (0.0, 0.0);
    for sample in rest {
        let f = p + 1.0;
        let nu = sample - level;
        squares += nu * nu / f;
        ln_f += f.ln();
        level += p / f * nu;
        p = p / f + l;
    }
    let n = rest.len() as f64;
    let white2 = squares / n;
    (white2 > 0.0).then(|| (-0.5 * (n * (white2.ln() + 1.0) + ln_f), white2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn drawn(white: f64, walk: f64, count: usize, seed: u64) -> Vec<f64> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut level = 3.0;
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        (0..count)
            .map(|_| {
                level += walk * normal();
                level + white * normal()
            })
            .collect()
    }

    #[test]
    fn both_are_found_and_their_sigmas_cover() {
        let (mut white2, mut walk2) = (0.0, 0.0);
        for seed in 0..20 {
            let found = white_and_walk(&drawn(0.5, 0.02, 20_000, seed)).unwrap();
            white2 += ((found.white - 0.5) / found.white_sigma).powi(2);
            walk2 += ((found.walk_per_step.unwrap() / 0.02).ln() / found.walk_ln_sigma).powi(2);
        }
        // Chi-square with 20 degrees of freedom: 99.8 % lie between 5.4 and 45.3.
        assert!((5.4..45.3).contains(&white2), "{white2}");
        assert!((5.4..45.3).contains(&walk2), "{walk2}");
    }

    #[test]
    fn no_walk_is_told_where_there_is_none() {
        let found = white_and_walk(&drawn(0.5, 0.0, 5_000, 1)).unwrap();
        assert_eq!(found.walk_per_step, None);
        assert!((found.white - 0.5).abs() < 0.02);
    }

    #[test]
    fn what_says_nothing_gives_nothing() {
        assert_eq!(white_and_walk(&[1.0; 100]), None);
        assert_eq!(white_and_walk(&[1.0, 2.0]), None);
        let mut broken = drawn(1.0, 0.0, 50, 1);
        broken[20] = f64::INFINITY;
        assert_eq!(white_and_walk(&broken), None);
    }
}

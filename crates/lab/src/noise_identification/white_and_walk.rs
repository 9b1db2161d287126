//! Separates white noise and random walk: maximum likelihood variances of a local level, equation (1) of the parent module.
//!
//! ```text
//! L(l) = -1/2 m (ln s2(l) + 1) - 1/2 sum ln f_k         l = var w / var v         (var v in front is taken out)
//! s2(l) = sum nu_k^2 / f_k / m                          nu_k, f_k of a Kalman filter with var v = 1, var w = l dt_k / dt
//! ```
//! The sums go over the m samples that have a predecessor: each stretch begins with an unknown level. dt_k is the interval before
//! sample k, dt the median interval: where a sample was lost, the walk is longer.

use super::record::RestRecord;
use crate::statistics::running_sums;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseDecomposition {
    pub white: f64,
    pub white_sigma: f64,
    /// Standard deviation gained in a median interval; `None` if not significant.
    pub walk_per_step: Option<f64>,
    /// Standard deviation of its logarithm.
    pub walk_ln_sigma: f64,
}

/// Search range of ln l: from a walk below the detection limit of a day's record to one that hides all white noise.
const LN_RATIO: [f64; 2] = [-27.0, 5.0];
const GRID: u32 = 33;
/// Golden sections of the final interval: 2 / 1.618^30 is below a millionth.
const SECTIONS: u32 = 30;
/// Half step of the curvature of L in ln l.
const CURVATURE_STEP: f64 = 0.1;
/// Least increase of L for a significant walk: chi-square with one degree of freedom at 95 %, halved.
const MIN_GAIN: f64 = 1.92;

/// `None` for fewer than ten samples with a predecessor, or without any noise.
pub fn decompose_noise(record: &RestRecord) -> Option<NoiseDecomposition> {
    let stretches: Vec<RestStretch> = record
        .stretches()
        .iter()
        .filter_map(|stretch| RestStretch::from_samples(stretch, record.interval_s()))
        .collect();
    let samples = stretches.as_slice();
    let n = count_followers(samples);
    if n < 10.0 {
        return None;
    }
    let ln_l = best_ratio(samples);
    let (value, white2) = profile(samples, ln_l)?;
    let near = |by: f64| profile(samples, ln_l + by).map(|(value, _)| value);
    let curvature = (2.0 * value - near(CURVATURE_STEP)? - near(-CURVATURE_STEP)?) / CURVATURE_STEP.powi(2);
    let (none, _) = profile(samples, LN_RATIO[0])?;
    let is_significant = value - none > MIN_GAIN && curvature > 0.0;
    let ln_l_variance = if is_significant { curvature.recip() } else { 0.0 };
    Some(NoiseDecomposition {
        white: white2.sqrt(),
        white_sigma: white2.sqrt() / (2.0 * n).sqrt(),
        walk_per_step: is_significant.then(|| (white2 * ln_l.exp()).sqrt()),
        // ln walk = (ln l + ln s2) / 2, and ln s2 has the variance 2 / n.
        walk_ln_sigma: 0.5 * (ln_l_variance + 2.0 / n).sqrt(),
    })
}

struct RestStretch {
    first: f64,
    /// Of every further sample: median intervals since the previous one, and its value.
    followers: Vec<(f64, f64)>,
}

impl RestStretch {
    /// From (instant in s, value).
    fn from_samples(stretch: &[(f64, f64)], dt_s: f64) -> Option<Self> {
        let (first, rest) = stretch.split_first()?;
        let steps = stretch.iter().zip(rest).map(|(before, after)| {
            let intervals = (after.0 - before.0) / dt_s;
            (intervals.max(0.0), after.1)
        });
        Some(Self { first: first.1, followers: steps.collect() })
    }
}

/// m of the module's formulas.
fn count_followers(stretches: &[RestStretch]) -> f64 {
    stretches.iter().map(|stretch| stretch.followers.len() as f64).sum()
}

/// ln l with the largest L: the best of a grid, then a golden section around it.
fn best_ratio(samples: &[RestStretch]) -> f64 {
    let value = |ln_l: f64| profile(samples, ln_l).map_or(f64::NEG_INFINITY, |(value, _)| value);
    let width = (LN_RATIO[1] - LN_RATIO[0]) / f64::from(GRID - 1);
    let grid = (0..GRID).map(|i| LN_RATIO[0] + width * f64::from(i));
    let best = grid.map(|ln_l| (ln_l, value(ln_l))).max_by(|a, b| a.1.total_cmp(&b.1));
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

/// L and var v for a ratio; `None` without variation.
fn profile(stretches: &[RestStretch], ln_l: f64) -> Option<(f64, f64)> {
    let l = ln_l.exp();
    let (mut squares, mut ln_f) = (0.0, 0.0);
    for stretch in stretches {
        // A level that nothing is known of is the first sample, with its noise.
        let (mut level, mut p) = (stretch.first, 1.0);
        for (intervals, sample) in &stretch.followers {
            p += l * intervals;
            let f = p + 1.0;
            let nu = sample - level;
            squares += nu * nu / f;
            ln_f += f.ln();
            level += p / f * nu;
            p /= f;
        }
    }
    let n = count_followers(stretches);
    let white2 = squares / n;
    (white2 > 0.0).then(|| (-0.5 * (n * (white2.ln() + 1.0) + ln_f), white2))
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AllanPoint {
    pub tau_s: f64,
    pub deviation: f64,
    /// From the number of averages that do not overlap.
    pub sigma: f64,
}

const POINTS_PER_DECADE: f64 = 8.0;
const MIN_AVERAGES: usize = 9;

/// Allan deviation of evenly sampled rates, over averaging times up to a ninth of the record.
pub fn allan_deviation(rates: &[f64], dt_s: f64) -> Vec<AllanPoint> {
    if !(dt_s.is_finite() && dt_s > 0.0) || rates.iter().any(|rate| !rate.is_finite()) {
        return Vec::new();
    }
    let angles = running_sums(rates.iter().map(|rate| rate * dt_s));
    let longest = rates.len() / MIN_AVERAGES;
    let mut points = Vec::new();
    let mut m = 1;
    while m <= longest {
        points.push(point(&angles, m, dt_s));
        let next = (m as f64 * 10.0_f64.powf(POINTS_PER_DECADE.recip())).round() as usize;
        m = next.max(m + 1);
    }
    points
}

fn point(angles: &[f64], m: usize, dt_s: f64) -> AllanPoint {
    let tau_s = m as f64 * dt_s;
    let later = angles.iter().skip(m).zip(angles.iter().skip(2 * m));
    let second = angles.iter().zip(later).map(|(a, (b, c))| c - 2.0 * b + a);
    let (sum, count) = second.fold((0.0, 0.0), |(sum, count), d| (sum + d * d, count + 1.0));
    let deviation = (sum / (2.0 * tau_s * tau_s * count)).sqrt();
    let averages = angles.len() as f64 / m as f64;
    AllanPoint { tau_s, deviation, sigma: deviation / (2.0 * (averages - 1.0)).sqrt() }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn simulated(white: f64, walk: f64, count: usize, seed: u64) -> Vec<f64> {
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

    /// A record of these samples, ten a second, in stretches of this length.
    fn record(samples: &[f64], per_stretch: usize) -> RestRecord {
        let stamped: Vec<(f64, f64)> =
            samples.iter().enumerate().map(|(k, sample)| (0.1 * k as f64, *sample)).collect();
        let stretches: Vec<_> = stamped.chunks(per_stretch).map(<[_]>::to_vec).collect();
        RestRecord::from_stretches(&stretches).unwrap()
    }

    #[test]
    fn both_are_found_and_their_sigmas_cover() {
        for per_stretch in [20_000, 500] {
            let (mut white2, mut walk2) = (0.0, 0.0);
            for seed in 0..20 {
                let samples = simulated(0.5, 0.02, 20_000, seed);
                let found = decompose_noise(&record(&samples, per_stretch)).unwrap();
                white2 += ((found.white - 0.5) / found.white_sigma).powi(2);
                walk2 += ((found.walk_per_step.unwrap() / 0.02).ln() / found.walk_ln_sigma).powi(2);
            }
            // Chi-square with 20 degrees of freedom: 99.8 % lie between 5.4 and 45.3.
            assert!((5.4..45.3).contains(&white2), "{white2}");
            assert!((5.4..45.3).contains(&walk2), "{walk2}");
        }
    }

    #[test]
    fn the_level_walks_on_where_samples_are_lost() {
        // Two of six are lost: one step of four is three intervals long.
        let samples = simulated(0.5, 0.1, 40_000, 3);
        let left = samples.iter().enumerate();
        let left = left.filter(|(k, _)| k % 6 != 1 && k % 6 != 2);
        let left = left.map(|(k, sample)| (0.1 * k as f64, *sample));
        let record = RestRecord::from_stretches(&[left.collect()]).unwrap();
        assert!((record.interval_s() - 0.1).abs() < 1e-9);
        let found = decompose_noise(&record).unwrap();
        let walk = found.walk_per_step.unwrap();
        assert!((walk / 0.1).ln().abs() < 3.0 * found.walk_ln_sigma && found.walk_ln_sigma < 0.03, "{found:?}");
    }

    #[test]
    fn no_walk_is_told_where_there_is_none() {
        let found = decompose_noise(&record(&simulated(0.5, 0.0, 5_000, 1), 5_000)).unwrap();
        assert_eq!(found.walk_per_step, None);
        assert!((found.white - 0.5).abs() < 0.02);
    }

    #[test]
    fn what_says_nothing_gives_nothing() {
        assert_eq!(decompose_noise(&record(&[1.0; 100], 100)), None);
        // Each stretch stands still, at a value of its own.
        let steps: Vec<f64> = (0..200).map(|k| f64::from(k / 100)).collect();
        assert_eq!(decompose_noise(&record(&steps, 100)), None);
    }

    #[test]
    fn alternating_rates_have_the_deviation_that_the_definition_gives() {
        let rates: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let points = allan_deviation(&rates, 0.1);
        // Neighbours differ by 2: sqrt(4 / 2). Averages over two samples are all equal.
        assert!((points[0].deviation - 2.0_f64.sqrt()).abs() < 1e-9);
        assert!(points[1].deviation < 1e-9 && (points[1].tau_s - 0.2).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_number_gives_no_points() {
        assert!(allan_deviation(&[0.0, f64::NAN], 0.1).is_empty());
        assert!(allan_deviation(&[0.0; 100], 0.0).is_empty());
        assert!(allan_deviation(&[0.0; 5], 0.1).is_empty());
    }
}

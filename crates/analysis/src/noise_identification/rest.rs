//! A gyro that rests: bias, white noise, step and random walk.

use super::walk::{WhiteAndWalk, white_and_walk};

/// The noise of a rate that rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestNoise {
    /// Samples.
    pub samples: usize,
    /// Their spacing, in seconds.
    pub dt_s: f64,
    /// The mean: the bias, on average over the record.
    pub bias: f64,
    /// Its standard deviation, the walk included.
    pub bias_sigma: f64,
    /// The step in which the sensor speaks; `None` if none is seen.
    pub quantum: Option<f64>,
    /// White noise of a sample with its rounding, one standard deviation.
    pub total: f64,
    /// White noise without the rounding.
    pub white: f64,
    /// Its standard deviation.
    pub white_sigma: f64,
    /// Angle random walk: `total` times the root of `dt_s`.
    pub angle_random_walk: f64,
    /// Random walk of the bias per root of a second, with its standard deviation; `None` where none can be told from zero.
    pub walk: Option<(f64, f64)>,
}

/// Why a rest tells nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RestError {
    /// Too few samples.
    #[error("only {0} samples; 100 are the least")]
    TooShort(usize),
    /// Not a number, or no time between samples.
    #[error("the samples hold a number that is not finite, or no time passes between them")]
    NotFinite,
    /// Every sample is the same.
    #[error(
        "every sample is the same: the sensor's step hides its noise, which is below half a step"
    )]
    Silent,
}

/// The least that is looked at.
const LEAST_SAMPLES: usize = 100;

/// Finds the noise of evenly sampled values.
///
/// # Errors
/// [`RestError`].
pub fn noise_at_rest(samples: &[f64], dt_s: f64) -> Result<RestNoise, RestError> {
    if samples.len() < LEAST_SAMPLES {
        return Err(RestError::TooShort(samples.len()));
    }
    let is_usable =
        dt_s.is_finite() && dt_s > 0.0 && samples.iter().all(|sample| sample.is_finite());
    if !is_usable {
        return Err(RestError::NotFinite);
    }
    let n = samples.len() as f64;
    let bias = samples.iter().sum::<f64>() / n;
    let found = white_and_walk(samples).ok_or(RestError::Silent)?;
    let quantum = quantum_of(samples);
    let (white, white_sigma) = without_rounding(&found, quantum);
    let walk = found.walk_per_step.map(|per_step| {
        let walk = per_step / dt_s.sqrt();
        (walk, walk * found.walk_ln_sigma)
    });
    let walked2 = walk.map_or(0.0, |(walk, _)| walk * walk * n * dt_s / 3.0);
    Ok(RestNoise {
        samples: samples.len(),
        dt_s,
        bias,
        bias_sigma: (found.white * found.white / n + walked2).sqrt(),
        quantum,
        total: found.white,
        white,
        white_sigma,
        angle_random_walk: found.white * dt_s.sqrt(),
        walk,
    })
}

/// Rounding to a step adds its square over twelve, as long as the noise is not far below the step (B. Widrow, I. Kollár,
/// Quantization Noise, 2008, section 4.4).
fn without_rounding(found: &WhiteAndWalk, quantum: Option<f64>) -> (f64, f64) {
    let rounding2 = quantum.map_or(0.0, |quantum| quantum * quantum / 12.0);
    let white = (found.white * found.white - rounding2).max(0.0).sqrt();
    // d white = total / white d total
    let sigma = if white > 0.0 {
        found.white_sigma * found.white / white
    } else {
        found.white
    };
    (white, sigma)
}

/// A difference is a whole number of steps when it is off by no more than this share of one.
const WHOLE: f64 = 0.02;
/// A sensor with more different values than this share of its samples has no step that is worth the name.
const MOST_VALUES: f64 = 0.2;

/// The step in which a sensor speaks: the smallest difference of two values, if all differences are multiples of it.
#[must_use]
pub fn quantum_of(samples: &[f64]) -> Option<f64> {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    let span = sorted.last()? - sorted.first()?;
    let same = 1e-9 * span;
    let gaps = sorted.windows(2).map(|pair| {
        pair.iter()
            .rev()
            .copied()
            .reduce(|high, low| high - low)
            .unwrap_or(0.0)
    });
    let gaps: Vec<f64> = gaps.filter(|gap| *gap > same).collect();
    let smallest = gaps.iter().copied().reduce(f64::min)?;
    let is_whole = |gap: &f64| {
        let steps = gap / smallest;
        (steps - steps.round()).abs() < WHOLE * steps.max(1.0)
    };
    let is_coarse = (gaps.len() as f64) < MOST_VALUES * samples.len() as f64;
    (is_coarse && gaps.iter().all(is_whole)).then_some(smallest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(count: usize, seed: u64) -> Vec<f64> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        (0..count)
            .map(|_| StandardNormal.sample(&mut rng))
            .collect()
    }

    #[test]
    fn rounding_is_seen_and_taken_out() {
        let rounded: Vec<f64> = normal(20_000, 5)
            .iter()
            .map(|n| (0.3 + 0.6 * n).round())
            .collect();
        let found = noise_at_rest(&rounded, 0.05).unwrap();
        assert_eq!(found.quantum, Some(1.0));
        assert!(
            (found.white - 0.6).abs() < 3.0 * found.white_sigma + 0.005,
            "{found:?}"
        );
        assert!((found.total * found.total - 0.36 - 1.0 / 12.0).abs() < 0.02);
        assert!((found.bias - 0.3).abs() < 3.0 * found.bias_sigma);
        assert_eq!(found.angle_random_walk, found.total * 0.05_f64.sqrt());
    }

    #[test]
    fn fine_values_have_no_step() {
        assert_eq!(quantum_of(&normal(1_000, 6)), None);
        assert_eq!(quantum_of(&[]), None);
        assert_eq!(quantum_of(&[2.0; 50]), None);
    }

    #[test]
    fn what_tells_nothing_says_why() {
        assert_eq!(noise_at_rest(&[0.0; 10], 0.1), Err(RestError::TooShort(10)));
        assert_eq!(noise_at_rest(&[0.0; 1_000], 0.1), Err(RestError::Silent));
        assert_eq!(
            noise_at_rest(&normal(1_000, 1), 0.0),
            Err(RestError::NotFinite)
        );
        assert_eq!(
            noise_at_rest(&[f64::NAN; 1_000], 0.1),
            Err(RestError::NotFinite)
        );
    }
}

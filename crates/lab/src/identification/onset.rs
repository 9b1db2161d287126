//! Detection of a step in a recording: rest, onset, transient, plateau.
//!
//! # Method
//! ```text
//! steepest    the shortest window w whose means before and after some sample differ by more than 8 sigma sqrt(2 / w)
//! onset       from there back to the last mean that is within 3 sigma / sqrt(w) of the rest before
//! plateau     on to the farthest that the smoothed signal gets before it turns back by a tenth of its way
//! ```
//! The search uses the whole recording.

use super::{TimedSample, sorted_finite};
use crate::statistics::running_sums;

/// Difference of window means, in sigmas, that counts as a step: false alarms in ten thousand samples have a probability below 1e-10.
const STEEP_SIGMAS: f64 = 8.0;
/// A mean within this number of sigmas counts as at rest.
const REST_SIGMAS: f64 = 3.0;
/// Reversal of the signal, as a share of the step, that ends a plateau.
const TURN_BACK: f64 = 0.1;
/// Duration of the rest that is kept before the step, as a share of the time from onset to end.
const REST_SHARE: f64 = 0.125;
/// The last tenth of the samples gives the final value.
const TAIL_SHARE: usize = 10;
/// Limit of the samples averaged for the level before the step.
const REST_SAMPLES: usize = 64;

#[derive(Clone, Debug, PartialEq)]
pub struct StepSegment {
    /// Some rest, the transient and the plateau.
    pub samples: Vec<TimedSample>,
    /// The last instant of rest, by the sensor's clock.
    pub onset_s: f64,
    pub start: f64,
    /// Final value: the mean of the last tenth.
    pub end: f64,
}

/// Finds the steepest step of a recording; `sigma` is the noise of a sample, positive.
///
/// `None` if no change exceeds the noise, or for fewer than eight usable samples. Samples that are not finite or not later than the
/// previous one are ignored.
pub fn find_step(samples: &[TimedSample], sigma: f64) -> Option<StepSegment> {
    let samples = sorted_finite(samples);
    if !(sigma > 0.0 && sigma.is_finite()) || samples.len() < MIN_SAMPLES {
        return None;
    }
    let sums = PrefixSums::from_samples(&samples);
    let change = steepest_change(&sums, sigma)?;
    let rest_until = change.index.saturating_sub(change.width).max(1);
    let rest_from = rest_until.saturating_sub(REST_SAMPLES.max(change.width));
    let start = sums.mean(rest_from, rest_until);
    let onset = onset_before(&sums, change, start, sigma);
    let until = plateau_end(&sums, change, start, sigma);
    let onset_s = samples.get(onset)?.at_s;
    let duration_s = samples.get(until - 1)?.at_s - onset_s;
    let from_s = onset_s - REST_SHARE * duration_s;
    let own: Vec<TimedSample> = samples.get(..until)?.iter().filter(|sample| sample.at_s >= from_s).copied().collect();
    let tail = (until - onset).div_ceil(TAIL_SHARE);
    Some(StepSegment { end: sums.mean(until - tail, until), samples: own, onset_s, start })
}

/// Fewer samples cannot contain rest, transient and plateau.
const MIN_SAMPLES: usize = 8;

/// Running sums, so that a mean costs two look-ups.
struct PrefixSums(Vec<f64>);

impl PrefixSums {
    fn from_samples(samples: &[TimedSample]) -> Self {
        Self(running_sums(samples.iter().map(|sample| sample.value)))
    }

    fn count(&self) -> usize {
        self.0.len() - 1
    }

    /// The mean of the samples in [from, until), clamped to the recording.
    fn mean(&self, from: usize, until: usize) -> f64 {
        let until = until.clamp(1, self.count());
        let from = from.min(until - 1);
        (self.0[until] - self.0[from]) / (until - from) as f64
    }
}

#[derive(Clone, Copy)]
struct SteepestChange {
    index: usize,
    width: usize,
}

fn steepest_change(sums: &PrefixSums, sigma: f64) -> Option<SteepestChange> {
    let mut width = 1;
    while 4 * width <= sums.count() {
        let leap_at = |k: usize| (sums.mean(k, k + width) - sums.mean(k - width, k)).abs();
        let index = (width..=sums.count() - width).max_by(|a, b| leap_at(*a).total_cmp(&leap_at(*b)))?;
        if leap_at(index) > STEEP_SIGMAS * sigma * (2.0 / width as f64).sqrt() {
            return Some(SteepestChange { index, width });
        }
        width *= 2;
    }
    None
}

fn onset_before(sums: &PrefixSums, change: SteepestChange, start: f64, sigma: f64) -> usize {
    let SteepestChange { mut index, width } = change;
    let limit = REST_SIGMAS * sigma / (width as f64).sqrt();
    while index > width && (sums.mean(index - width, index) - start).abs() > limit {
        index -= 1;
    }
    index.saturating_sub(1)
}

/// Index after the last sample of the plateau.
fn plateau_end(sums: &PrefixSums, change: SteepestChange, start: f64, sigma: f64) -> usize {
    let SteepestChange { index, width } = change;
    let count = sums.count();
    let smooth = (2 * width).max((count - index) / 64).max(1);
    let direction = (sums.mean(index, index + width) - start).signum();
    let white = REST_SIGMAS * sigma / (smooth as f64).sqrt();
    let rise = |k: usize| direction * (sums.mean(k, k + smooth) - start);
    let mut farthest = rise(index);
    let mut turned = None;
    for k in index..=count.saturating_sub(smooth) {
        farthest = farthest.max(rise(k));
        if farthest - rise(k) > (TURN_BACK * farthest).max(2.0 * white) {
            turned = Some(k);
            break;
        }
    }
    let Some(turned) = turned else { return count };
    let last = (index..turned).rev().find(|k| farthest - rise(*k) <= white);
    last.map_or(turned, |k| k + smooth).clamp(index + 1, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rest at 20 for 30 s, then down to 4 with a lag of 10 s until 130 s, then a slow ramp up for another use.
    fn recording(sigma: f64, per_s: u32) -> Vec<TimedSample> {
        let mut alternate = 1.0;
        (0..260 * per_s)
            .map(|k| {
                let at_s = f64::from(k) / f64::from(per_s);
                alternate = -alternate;
                let value = if at_s < 30.0 {
                    20.0
                } else if at_s < 130.0 {
                    4.0 + 16.0 * ((30.0 - at_s) / 10.0).exp()
                } else {
                    4.0 + 0.1 * (at_s - 130.0)
                };
                TimedSample { at_s, value: value + sigma * alternate }
            })
            .collect()
    }

    #[test]
    fn the_step_is_cut_out_between_its_rest_and_the_end_of_its_plateau() {
        for (sigma, per_s) in [(0.05, 1), (0.5, 20)] {
            let found = find_step(&recording(sigma, per_s), sigma).unwrap();
            assert!((found.onset_s - 30.0).abs() < 1.5, "{}", found.onset_s);
            assert!((found.start - 20.0).abs() < 0.1, "{}", found.start);
            assert!((found.end - 4.0).abs() < 0.3, "{}", found.end);
            let last = found.samples.last().unwrap();
            assert!((120.0..150.0).contains(&last.at_s), "{last:?}");
            assert!(found.samples[0].at_s > 10.0);
        }
    }

    #[test]
    fn noise_alone_holds_no_step() {
        let quiet: Vec<TimedSample> = recording(0.5, 1).into_iter().take(30).collect();
        assert_eq!(find_step(&quiet, 0.5), None);
        assert_eq!(find_step(&[], 0.5), None);
        assert_eq!(find_step(&quiet, 0.0), None);
        assert_eq!(find_step(&quiet, f64::NAN), None);
    }
}

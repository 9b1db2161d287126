//! The mean wheel size from the length of the way, which no error of a heading can bend.
//!
//! # Model
//! ```text
//! c_k    distance between two sights                     over windows that are long beside the noise and turn little
//! c0_k   the same by dead reckoning, heading free
//! 1 + e_m = sum (c_k - v / 2 c_k) c0_k / sum c0_k^2      sigma from how the windows scatter about it
//! v = min(scatter^2, sigma_from^2 + sigma_to^2)
//! ```
//! A chord does not change when the whole path is turned or shifted, so neither a wrong start nor a camera that hangs crooked nor a
//! drifting heading takes part in it, and a wrong track only by `turn²/24` of itself.
//!
//! Noise across a chord makes it longer by `v / 2 c` on average. It is taken as large as the noise along the chord, which shows in the
//! scatter, and never larger than described: what else scatters (a tag off the axle, slip) does not make chords longer.
//!
//! # Source
//! Own; docs/lab/calibration.md section 3, equation 8.

use posebridge_telemetry::UncertainValue;

use super::drive::FreePath;
use super::predict::PathPredictor;

/// Least length of a window, in sigmas of its fixes.
const MIN_CHORD_SIGMAS: f64 = 20.0;
/// And turns by no more than this, in radians.
const MAX_TURN_RAD: f64 = 0.5;
/// How many windows on count as neighbours.
const NEIGHBOURS: usize = 3;
/// Fewest windows whose scatter means something.
const MIN_WINDOWS: usize = 3;

/// The mean wheel size against the numbers with which the path was reckoned: a factor, and how many windows it stands on.
///
/// `None`: fewer than three windows are long enough.
pub(super) fn length_factor(prediction: &PathPredictor<'_>, paths: &[FreePath]) -> Option<(UncertainValue, usize)> {
    let runs: Vec<Vec<PathChord>> = paths.iter().map(|path| chords(prediction, path)).collect();
    let chords = || runs.iter().flatten();
    let count = chords().count();
    if count < MIN_WINDOWS {
        return None;
    }
    let square: f64 = chords().map(|chord| chord.predicted_m.powi(2)).sum();
    let factor = |most_m2: f64| {
        let straightened = chords().map(|chord| {
            let longer_m = 0.5 * chord.noise_m2.min(most_m2) / chord.measured_m;
            chord.predicted_m * (chord.measured_m - longer_m)
        });
        straightened.sum::<f64>() / square
    };
    let raw = factor(0.0);
    let apart = chords().map(|chord| chord.residual_m(raw).powi(2));
    let scatter_m2 = apart.sum::<f64>() / (count - 1) as f64;
    let value = factor(scatter_m2);
    let sigma = runs.iter().map(|run| residual_variance_m4(run, raw)).sum::<f64>().sqrt() / square;
    (value > 0.0 && value.is_finite()).then_some((UncertainValue { value, sigma }, count))
}

/// The variance of `sum (c_k - factor c0_k) c0_k` over one run.
///
/// Neighbours share a sight, whose noise makes one window longer and the other one shorter by as much, so that most of it is gone
/// from the sum. The products of neighbours say how much, weighted as Newey and West (1987) do, which keeps the sum positive.
fn residual_variance_m4(run: &[PathChord], factor: f64) -> f64 {
    let scores: Vec<f64> = run.iter().map(|chord| chord.predicted_m * chord.residual_m(factor)).collect();
    let at_lag = |lag: usize| -> f64 {
        let pairs = scores.iter().zip(scores.iter().skip(lag));
        pairs.map(|(one, other)| one * other).sum()
    };
    let neighbours = (1..=NEIGHBOURS).map(|lag| {
        let weight = 1.0 - lag as f64 / (NEIGHBOURS as f64 + 1.0);
        2.0 * weight * at_lag(lag)
    });
    at_lag(0) + neighbours.sum::<f64>()
}

/// A window.
#[derive(Clone, Copy, Debug)]
struct PathChord {
    predicted_m: f64,
    /// More than zero.
    measured_m: f64,
    /// Variance of the distance by the described noise of both sights.
    noise_m2: f64,
}

impl PathChord {
    fn residual_m(&self, factor: f64) -> f64 {
        self.measured_m - factor * self.predicted_m
    }
}

/// Reckoned and seen length of each window.
fn chords(prediction: &PathPredictor<'_>, path: &FreePath) -> Vec<PathChord> {
    let reckoned = prediction.predict_tags(path, path.start.pose[2]);
    let mut chords = Vec::new();
    let mut first = 0;
    for last in 1..path.fixes.len() {
        let (from, to) = (&path.fixes[first], &path.fixes[last]);
        let (begin, end) = (&reckoned[first], &reckoned[last]);
        let length_m = distance(begin.tag_m, end.tag_m);
        let turned_rad = (end.heading_rad - begin.heading_rad).abs();
        if turned_rad > MAX_TURN_RAD {
            first = last;
        } else if length_m >= MIN_CHORD_SIGMAS * from.sigma_m.max(to.sigma_m) {
            let seen_m = distance(from.position_m, to.position_m);
            if seen_m > 0.0 {
                chords.push(PathChord {
                    predicted_m: length_m,
                    measured_m: seen_m,
                    noise_m2: from.sigma_m.powi(2) + to.sigma_m.powi(2),
                });
            }
            first = last;
        }
    }
    chords
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

//! The mean wheel size from the length of the way, which no error of a heading can bend.
//!
//! # Model
//! ```text
//! c_k    distance between two sights                     over windows that are long beside the noise and turn little
//! c0_k   the same by dead reckoning, heading free
//! 1 + e_m = sum c_k c0_k / sum c0_k^2                    sigma from how the windows scatter about it
//! ```
//! A chord does not change when the whole path is turned or shifted, so neither a wrong start nor a camera that hangs crooked nor a
//! drifting heading takes part in it, and a wrong track only by `turn²/24` of itself.
//!
//! Noise makes a chord longer by `sigma² / c`; at the shortest window, 20 sigmas, that is 0.25 %.
//!
//! # Source
//! Own; docs/lab/calibrate.md section 3, equation 8.

use posebridge_telemetry::Known;

use super::drive::FreePath;
use super::predict::Prediction;

/// A window is at least so many sigmas of its sights long.
const SHORTEST_SIGMAS: f64 = 20.0;
/// And turns by no more than this, in radians.
const MOST_TURN_RAD: f64 = 0.5;
/// Fewest windows whose scatter means something.
const FEWEST_WINDOWS: usize = 3;

/// The mean wheel size against the numbers with which the path was reckoned: a factor, and how many windows it stands on.
///
/// `None`: fewer than three windows are long enough.
pub(super) fn length_factor(
    prediction: &Prediction<'_>,
    paths: &[FreePath],
) -> Option<(Known, usize)> {
    let chords: Vec<[f64; 2]> = paths
        .iter()
        .flat_map(|path| chords(prediction, path))
        .collect();
    if chords.len() < FEWEST_WINDOWS {
        return None;
    }
    let (mut both, mut square) = (0.0, 0.0);
    for [reckoned_m, seen_m] in &chords {
        both += reckoned_m * seen_m;
        square += reckoned_m * reckoned_m;
    }
    let value = both / square;
    let apart = chords
        .iter()
        .map(|[reckoned_m, seen_m]| (seen_m - value * reckoned_m).powi(2));
    let variance = apart.sum::<f64>() / (chords.len() - 1) as f64 / square;
    let sigma = variance.sqrt();
    (value > 0.0 && value.is_finite()).then_some((Known { value, sigma }, chords.len()))
}

/// Reckoned and seen length of each window.
fn chords(prediction: &Prediction<'_>, path: &FreePath) -> Vec<[f64; 2]> {
    let reckoned = prediction.reckoned(path, path.start.pose[2]);
    let mut chords = Vec::new();
    let mut first = 0;
    for last in 1..path.sights.len() {
        let (from, to) = (&path.sights[first], &path.sights[last]);
        let (begin, end) = (&reckoned[first], &reckoned[last]);
        let length_m = distance(begin.tag_m, end.tag_m);
        let turned_rad = (end.heading_rad - begin.heading_rad).abs();
        if turned_rad > MOST_TURN_RAD {
            first = last;
        } else if length_m >= SHORTEST_SIGMAS * from.sigma_m.max(to.sigma_m) {
            chords.push([length_m, distance(from.place_m, to.place_m)]);
            first = last;
        }
    }
    chords
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

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
    let chords: Vec<Chord> = paths
        .iter()
        .flat_map(|path| chords(prediction, path))
        .collect();
    if chords.len() < FEWEST_WINDOWS {
        return None;
    }
    let square: f64 = chords.iter().map(|chord| chord.reckoned_m.powi(2)).sum();
    let factor = |most_m2: f64| {
        let straightened = chords.iter().map(|chord| {
            let longer_m = 0.5 * chord.noise_m2.min(most_m2) / chord.seen_m;
            chord.reckoned_m * (chord.seen_m - longer_m)
        });
        straightened.sum::<f64>() / square
    };
    let raw = factor(0.0);
    let apart = chords
        .iter()
        .map(|chord| (chord.seen_m - raw * chord.reckoned_m).powi(2));
    let scatter_m2 = apart.sum::<f64>() / (chords.len() - 1) as f64;
    let value = factor(scatter_m2);
    let sigma = (scatter_m2 / square).sqrt();
    (value > 0.0 && value.is_finite()).then_some((Known { value, sigma }, chords.len()))
}

/// A window.
#[derive(Clone, Copy, Debug)]
struct Chord {
    reckoned_m: f64,
    /// More than zero.
    seen_m: f64,
    /// Variance of the distance by the described noise of both sights.
    noise_m2: f64,
}

/// Reckoned and seen length of each window.
fn chords(prediction: &Prediction<'_>, path: &FreePath) -> Vec<Chord> {
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
            let seen_m = distance(from.place_m, to.place_m);
            if seen_m > 0.0 {
                chords.push(Chord {
                    reckoned_m: length_m,
                    seen_m,
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

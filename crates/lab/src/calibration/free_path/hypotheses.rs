//! Errors of a description that no small correction can fix: wheels exchanged, half the track, counts per turn off by a factor.
//!
//! Every combination is a hypothesis. Each predicts the shape of the path; the one with the highest likelihood of the fixes is
//! selected, and reported if it is not the given description.
//!
//! # Model
//! ```text
//! the drive is cut into pieces; each piece is laid onto its sights by the best turn and shift      (Umeyama 1991, without scale)
//! ln L = -n ln(sum |rest|^2)              n places of two numbers each, with equal and independent errors
//! ```
//! Aligned by its own rotation and translation, a piece is independent of start, heading and drift, and so is the comparison. Therefore
//! exchanged wheels look like wheels that both count backwards; a known heading distinguishes them: the first moves against it, the
//! second along with it. A negative track is indistinguishable from exchanged wheels.

use std::f64::consts::{FRAC_PI_2, PI};

use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_telemetry::UncertainValue;
use posebridge_telemetry::quantities::wrap_rad;
use serde::Serialize;

use super::drive::{FreePath, TravelStep};
use super::predict::PathPredictor;
use crate::statistics::{PairedVectors, centroid, correlated_variance};

/// Wiring errors of the two counters. Their names in results stay when a variant is renamed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Wiring {
    #[serde(rename = "AsGiven")]
    AsGiven,
    /// Left and right exchanged, or the track has the wrong sign.
    #[serde(rename = "Swapped")]
    Swapped,
    #[serde(rename = "BothReversed")]
    BothReversed,
    #[serde(rename = "LeftReversed")]
    LeftReversed,
    #[serde(rename = "RightReversed")]
    RightReversed,
    /// Exchanged, and the counter called left counts backwards.
    #[serde(rename = "SwappedLeftReversed")]
    SwappedLeftReversed,
    /// Exchanged, and the counter called right counts backwards.
    #[serde(rename = "SwappedRightReversed")]
    SwappedRightReversed,
}

impl Wiring {
    /// All, in the order of preference among equally likely ones.
    pub const ALL: [Self; 7] = [
        Self::AsGiven,
        Self::Swapped,
        Self::BothReversed,
        Self::LeftReversed,
        Self::RightReversed,
        Self::SwappedLeftReversed,
        Self::SwappedRightReversed,
    ];

    /// The true travel of both wheels if this is the error.
    const fn undo(self, WheelTravel { left_m, right_m }: WheelTravel) -> WheelTravel {
        let (left_m, right_m) = match self {
            Self::AsGiven => (left_m, right_m),
            Self::Swapped => (right_m, left_m),
            Self::BothReversed => (-left_m, -right_m),
            Self::LeftReversed => (-left_m, right_m),
            Self::RightReversed => (left_m, -right_m),
            Self::SwappedLeftReversed => (right_m, -left_m),
            Self::SwappedRightReversed => (-right_m, left_m),
        };
        WheelTravel { left_m, right_m }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hypothesis {
    pub wiring: Wiring,
    /// True track over the described one.
    pub track_factor: f64,
    /// True travel of a count over the described one.
    pub travel_factor: f64,
}

pub const AS_GIVEN: Hypothesis = Hypothesis { wiring: Wiring::AsGiven, track_factor: 1.0, travel_factor: 1.0 };

/// Radius for diameter, half track for track, a quadrature decoder's 2 and 4.
const TRACK_FACTORS: [f64; 3] = [1.0, 2.0, 0.5];
const TRAVEL_FACTORS: [f64; 5] = [1.0, 2.0, 0.5, 4.0, 0.25];

const SEGMENT_FIXES: usize = 24;
const MIN_FIXES: usize = 8;
/// An error is only reported if its correction improves the fit by this factor: small corrections gain less.
const MIN_IMPROVEMENT: f64 = 1.6;
const EQUAL_FIT_FACTOR: f64 = 1.02;

/// Comparison of the description with other hypotheses.
#[derive(Clone, Debug, PartialEq)]
pub struct HypothesisTest {
    /// The most likely hypothesis; [`AS_GIVEN`] unless another one is clearly better.
    pub found: Hypothesis,
    /// Root mean square distance of the fixes from the pieces of the path as described.
    pub described_rms_m: f64,
    pub found_rms_m: f64,
    /// ln L of `found` minus that of the description.
    pub log_likelihood_gain: f64,
    pub compared: usize,
}

impl HypothesisTest {
    /// Whether the description has no error that calibration cannot correct.
    pub fn is_sound(&self) -> bool {
        self.found == AS_GIVEN
    }
}

impl FreePath {
    /// The drive corrected by a hypothesis, except its track.
    pub fn with_hypothesis(&self, hypothesis: &Hypothesis) -> Self {
        let factor = hypothesis.travel_factor;
        let steps = self.steps.iter().map(|step| {
            let travel = hypothesis.wiring.undo(step.travel);
            TravelStep {
                travel: WheelTravel { left_m: travel.left_m * factor, right_m: travel.right_m * factor },
                ..*step
            }
        });
        Self { steps: steps.collect(), ..self.clone() }
    }
}

#[derive(Clone, Copy, Debug)]
struct ScoredHypothesis {
    hypothesis: Hypothesis,
    square_m2: f64,
    /// Rotation from the predicted to the observed path, for runs with a known start heading.
    start_off_rad: Option<f64>,
}

pub(super) fn test_hypotheses(prediction: &PathPredictor<'_>, paths: &[FreePath]) -> Option<HypothesisTest> {
    let fix_count: usize = paths.iter().map(|path| path.fixes.len()).sum();
    if fix_count < MIN_FIXES {
        return None;
    }
    let mut all = Vec::new();
    for wiring in Wiring::ALL {
        for track_factor in TRACK_FACTORS {
            for travel_factor in TRAVEL_FACTORS {
                let hypothesis = Hypothesis { wiring, track_factor, travel_factor };
                all.push(score_hypothesis(prediction, paths, hypothesis));
            }
        }
    }
    let described = *all.first()?;
    let smallest = all.iter().map(|s| s.square_m2).fold(f64::INFINITY, f64::min);
    let as_good = all.iter().filter(|scored| scored.square_m2 <= smallest * EQUAL_FIT_FACTOR * EQUAL_FIT_FACTOR);
    // Of those that fit alike the one that sets out as the start says, then the simplest.
    let is_forward = |scored: &ScoredHypothesis| scored.start_off_rad.is_none_or(|off| off.abs() < FRAC_PI_2);
    let best = as_good.clone().find(|scored| is_forward(scored)).or(as_good.clone().next())?;
    let ratio = (described.square_m2 / best.square_m2).sqrt();
    let found = if ratio >= MIN_IMPROVEMENT { best } else { &described };
    let rms = |square_m2: f64| (square_m2 / fix_count as f64).sqrt();
    Some(HypothesisTest {
        found: found.hypothesis,
        described_rms_m: rms(described.square_m2),
        found_rms_m: rms(found.square_m2),
        log_likelihood_gain: fix_count as f64 * (described.square_m2 / found.square_m2).ln(),
        compared: all.len(),
    })
}

fn score_hypothesis(prediction: &PathPredictor<'_>, paths: &[FreePath], hypothesis: Hypothesis) -> ScoredHypothesis {
    let mut prediction = *prediction;
    prediction.parameters.track_width_m *= hypothesis.track_factor;
    let mut square_m2 = 0.0;
    let mut start_off_rad = None;
    for path in paths {
        let path = path.with_hypothesis(&hypothesis);
        let reckoned: Vec<[f64; 2]> =
            prediction.predict_tags(&path, path.start.pose[2]).iter().map(|reckoned| reckoned.tag_m).collect();
        let measured: Vec<[f64; 2]> = path.fixes.iter().map(|fix| fix.position_m).collect();
        for (index, (ours, theirs)) in reckoned.chunks(SEGMENT_FIXES).zip(measured.chunks(SEGMENT_FIXES)).enumerate() {
            let laid = align_paths(ours, theirs);
            square_m2 += laid.square_m2;
            let knows_heading = index == 0 && path.start.heading_sigma_rad < PI / 6.0;
            if knows_heading && laid.length_m > 0.0 {
                start_off_rad = start_off_rad.or(Some(wrap_rad(laid.turn_rad)));
            }
        }
        // What the sights' own noise leaves is no fit.
        square_m2 += path.fixes.iter().map(|s| 0.1 * s.sigma_m.powi(2)).sum::<f64>();
    }
    ScoredHypothesis { hypothesis, square_m2, start_off_rad }
}

/// Track factors that are tried, relative to the prediction.
const COARSE_FROM: f64 = 0.7;
const COARSE_STEP: f64 = 0.01;
const COARSE_STEPS: u32 = 70;

/// The track factor under which pieces of the path fit best: the start of the descent.
///
/// Over a long drive a track error of a few percent accumulates to whole turns, and a descent ends in one of many local minima. A piece
/// is too short for that.
pub(super) fn coarse_track_factor(prediction: &PathPredictor<'_>, paths: &[FreePath]) -> f64 {
    let factor = |step: u32| COARSE_FROM + COARSE_STEP * f64::from(step);
    let scored = (0..=COARSE_STEPS).map(|step| {
        let hypothesis = Hypothesis { track_factor: factor(step), ..AS_GIVEN };
        (step, score_hypothesis(prediction, paths, hypothesis).square_m2)
    });
    match scored.min_by(|a, b| a.1.total_cmp(&b.1)) {
        // At an end there is no minimum: the pieces do not determine it.
        None | Some((0 | COARSE_STEPS, _)) => 1.0,
        Some((step, _)) => factor(step),
    }
}

struct PathAlignment {
    square_m2: f64,
    turn_rad: f64,
    length_m: f64,
}

/// Rotates and shifts `ours` onto `theirs` by least squares.
fn align_paths(ours: &[[f64; 2]], theirs: &[[f64; 2]]) -> PathAlignment {
    let centres = [ours, theirs].map(centroid);
    let sums = PairedVectors::about(centres, ours.iter().zip(theirs).map(|(a, b)| [*a, *b]));
    let [ours_m2, theirs_m2] = sums.squares;
    PathAlignment {
        square_m2: (ours_m2 + theirs_m2 - 2.0 * sums.dot.hypot(sums.cross)).max(0.0),
        turn_rad: sums.angle_rad(),
        length_m: ours_m2.sqrt(),
    }
}

// The mean wheel size from the length of the way, which no error of a heading can bend.
//
// # Model
// ```text
// c_k    distance between two sights                     over windows that are long beside the noise and turn little
// c0_k   the same by dead reckoning, heading free
// 1 + e_m = sum (c_k - v / 2 c_k) c0_k / sum c0_k^2      sigma from how the windows scatter about it
// v = min(scatter^2, sigma_from^2 + sigma_to^2)
// ```
// A chord does not change when the whole path is turned or shifted, so neither a wrong start nor a camera that hangs crooked nor a
// drifting heading takes part in it, and a wrong track only by `turn²/24` of itself.
//
// Noise across a chord makes it longer by `v / 2 c` on average. It is taken as large as the noise along the chord, which shows in the
// scatter, and never larger than described: what else scatters (a tag off the axle, slip) does not make chords longer.
//
// # Source
// Own; docs/lab/calibration.md section 3, equation 8.

/// Least length of a window, in sigmas of its fixes.
const MIN_CHORD_SIGMAS: f64 = 20.0;
const MAX_TURN_RAD: f64 = 0.5;
const NEIGHBOURS: usize = 3;
const MIN_WINDOWS: usize = 3;

/// The mean wheel size relative to the predicted path: a factor, and the number of windows behind it.
///
/// `None` if fewer than three windows are long enough.
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
/// Neighbours share a fix, whose noise lengthens one window and shortens the other, so that most of it cancels in the sum. The products
/// of neighbours measure that.
fn residual_variance_m4(run: &[PathChord], factor: f64) -> f64 {
    let scores: Vec<f64> = run.iter().map(|chord| chord.predicted_m * chord.residual_m(factor)).collect();
    correlated_variance(&scores, NEIGHBOURS)
}

#[derive(Clone, Copy, Debug)]
struct PathChord {
    predicted_m: f64,
    measured_m: f64,
    /// Variance of the distance by the described noise of both fixes.
    noise_m2: f64,
}

impl PathChord {
    fn residual_m(&self, factor: f64) -> f64 {
        self.measured_m - factor * self.predicted_m
    }
}

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
            let measured_m = distance(from.position_m, to.position_m);
            if measured_m > 0.0 {
                chords.push(PathChord {
                    predicted_m: length_m,
                    measured_m,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_is_laid_on_by_turn_and_shift_and_no_scale() {
        let ours = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        let (sin, cos) = 2.0_f64.sin_cos();
        let theirs = ours.map(|[x, y]| [5.0 + cos * x - sin * y, -1.0 + sin * x + cos * y]);
        let laid = align_paths(&ours, &theirs);
        assert!(laid.square_m2 < 1e-12 && (laid.turn_rad - 2.0).abs() < 1e-12);
        let doubled = theirs.map(|[x, y]| [2.0 * x, 2.0 * y]);
        // About their centre the points have 4/3 m²; all that doubling adds is left.
        assert!((align_paths(&ours, &doubled).square_m2 - 4.0 / 3.0).abs() < 1e-12);
    }
}

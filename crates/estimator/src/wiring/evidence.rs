//! The evidence for and against each fault, summed over windows, and the decision.
//!
//! ```text
//! c_0, c_f   disagreement of two sensors over a window without a fault and with fault f: squared, in expected
//!            standard deviations, at most 16
//! G_f        sum of c_0 - c_f where that is positive          B_f    sum of c_f - c_0 where that is
//! f is found when   G_f > 45,   B_f < 0.3 G_f,   its windows support it,   G_f - B_f > G_g - B_g + 32 for every other g
//! ```
//! Costs are limited, so that slip, an outlier or a robot that is carried cannot decide. A window supports a fault when both
//! sensors clearly moved, agree with the fault and disagree without it: a stuck robot and a lifted one support none. A fault
//! that makes a motion a thousand times smaller or larger gains nothing where that leaves nothing of it but noise.

use serde::{Deserialize, Serialize};

use super::fault::{Hypothesis, WiringFault};
use super::finding::{DecidingObservation, RatioKind, WiringFinding, WiringRatio};
use crate::saved::finite;

/// Cost of one window at most: four standard deviations.
pub(super) const MAX_COST: f64 = 16.0;
/// Three windows that contradict a robot without a fault, almost as clearly as one can.
const MIN_GAIN: f64 = 45.0;
/// Two windows that tell two faults apart.
const DECIDING_GAIN: f64 = 32.0;
/// What contradicts a fault, of what contradicts its absence.
const MAX_LOSS_SHARE: f64 = 0.3;
/// Before several faults that look the same are reported: eight windows, so that what would decide had its time.
const UNDECIDED_GAIN: f64 = 120.0;
/// Likewise where there are fixes, which are rarer and may decide.
const UNDECIDED_GAIN_WITH_FIXES: f64 = 240.0;
/// Likewise; half a turn.
const UNDECIDED_TURN_RAD: f64 = std::f64::consts::PI;
/// A window without the fault must cost so much, and with it so little, to support the fault.
const REFUTED_WINDOW: f64 = 8.0;
const FITTING_WINDOW: f64 = 3.0;
const MIN_SUPPORTING_WINDOWS: u32 = 3;
const MIN_SUPPORTING_TURN_RAD: f64 = 1.0;
const MIN_SUPPORTING_PATH_M: f64 = 0.3;
/// A smaller turn or path of either sensor supports nothing.
const MIN_TURN_RAD: f64 = 0.15;
const MIN_PATH_M: f64 = 0.03;
/// A fault gains where its absence is contradicted by so many times the noise that the fault leaves.
const INFORMATIVE_SIGMAS: f64 = 2.0;
/// What a cost weighs a window later: memory of two hundred windows.
const MEMORY: f64 = 0.995;

const FAULTS: usize = WiringFault::ALL.len();

/// A comparison of two sensors over one window, under one hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Comparison {
    /// What two sensors observed, corrected: turns in radians, or paths in metres.
    pub(super) observed: [f64; 2],
    /// Their disagreement, in expected standard deviations, squared.
    pub(super) cost: f64,
    /// Their disagreement.
    pub(super) error: f64,
    /// Standard deviation of the disagreement for sensors that stand still.
    pub(super) noise: f64,
    /// Its ratio, if the window shows one: what the wheels and what the other sensor reported, uncorrected.
    pub(super) ratio: Option<(RatioKind, [f64; 2])>,
    pub(super) is_path: bool,
    /// The hypothesis takes one of them for a much smaller motion than was reported.
    pub(super) is_shrunk: bool,
}

impl Comparison {
    /// Both sensors clearly moved.
    fn is_moving(&self) -> bool {
        let minimum = if self.is_path { MIN_PATH_M } else { MIN_TURN_RAD };
        self.observed.iter().all(|observed| observed.abs() >= minimum)
    }

    /// Whether agreement under this hypothesis says something where there is none without a fault: not if it makes one of the
    /// motions too small to be seen, or its noise too large.
    fn is_informative(&self, refuted: &Self) -> bool {
        refuted.error.abs() >= INFORMATIVE_SIGMAS * self.noise && (!self.is_shrunk || self.is_moving())
    }
}

/// Sums for a ratio by least squares.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct RatioSums {
    #[serde(deserialize_with = "finite")]
    windows: f64,
    #[serde(deserialize_with = "finite")]
    xx: f64,
    #[serde(deserialize_with = "finite")]
    xy: f64,
    #[serde(deserialize_with = "finite")]
    yy: f64,
}

impl RatioSums {
    fn add(&mut self, [x, y]: [f64; 2]) {
        self.windows += 1.0;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }

    fn ratio(&self, kind: RatioKind) -> Option<WiringRatio> {
        if self.windows < 2.0 || self.xx <= 0.0 {
            return None;
        }
        let value = self.xy / self.xx;
        let residual = (self.yy - value * self.xy).max(0.0) / (self.windows - 1.0);
        Some(WiringRatio { kind, value, sigma: (residual / self.xx).sqrt() })
    }
}

#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Score {
    #[serde(deserialize_with = "finite")]
    gain: f64,
    #[serde(deserialize_with = "finite")]
    loss: f64,
    supporting_windows: u32,
    #[serde(deserialize_with = "finite")]
    supporting_turn_rad: f64,
    #[serde(deserialize_with = "finite")]
    supporting_path_m: f64,
    ratios: [RatioSums; RatioKind::ALL.len()],
}

impl Score {
    fn net(&self) -> f64 {
        self.gain - self.loss
    }

    /// Whether the fault explains what contradicts its absence.
    fn is_plausible(&self) -> bool {
        self.gain >= MIN_GAIN && self.loss <= MAX_LOSS_SHARE * self.gain && self.is_supported()
    }

    fn is_supported(&self) -> bool {
        self.supporting_windows >= MIN_SUPPORTING_WINDOWS
            && (self.supporting_turn_rad >= MIN_SUPPORTING_TURN_RAD || self.supporting_path_m >= MIN_SUPPORTING_PATH_M)
    }

    /// The ratio with the most windows, the gyro's of equals.
    fn ratio(&self) -> Option<WiringRatio> {
        let mut best: Option<(f64, WiringRatio)> = None;
        for (kind, sums) in RatioKind::ALL.into_iter().zip(&self.ratios) {
            if let Some(ratio) = sums.ratio(kind)
                && best.is_none_or(|(windows, _)| sums.windows > windows)
            {
                best = Some((sums.windows, ratio));
            }
        }
        best.map(|(_, ratio)| ratio)
    }
}

/// A set of faults, one bit each.
type FaultSet = u32;

/// What has been observed of each fault.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    hypotheses: [Hypothesis; FAULTS],
    scores: [Score; FAULTS],
    segments: u32,
    gyro_windows: u32,
    reported: Option<FaultSet>,
}

/// Most comparisons of one window: two turns and a path.
pub(super) type Comparisons = [Option<Comparison>; 3];

/// What a window compared with the wheels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WindowKind {
    Gyro,
    Fixes,
}

/// Evidence without the hypotheses, which are always the same.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SavedEvidence {
    scores: [Score; FAULTS],
    segments: u32,
    gyro_windows: u32,
    reported: Option<FaultSet>,
}

impl Evidence {
    pub(super) const fn save(&self) -> SavedEvidence {
        let Self { hypotheses: _, scores, segments, gyro_windows, reported } = self;
        SavedEvidence { scores: *scores, segments: *segments, gyro_windows: *gyro_windows, reported: *reported }
    }

    pub(super) fn restored(saved: &SavedEvidence) -> Self {
        let SavedEvidence { scores, segments, gyro_windows, reported } = *saved;
        Self { scores, segments, gyro_windows, reported, ..Self::new() }
    }

    pub(super) fn new() -> Self {
        Self {
            hypotheses: WiringFault::ALL.map(Hypothesis::of_fault),
            scores: [Score::default(); FAULTS],
            segments: 0,
            gyro_windows: 0,
            reported: None,
        }
    }

    /// Adds a window; `compare` gives its comparisons under a hypothesis, by the hypothesis' number, or `None` for no fault.
    pub(super) fn add(&mut self, kind: WindowKind, mut compare: impl FnMut(Option<usize>, &Hypothesis) -> Comparisons) {
        match kind {
            WindowKind::Gyro => self.gyro_windows = self.gyro_windows.saturating_add(1),
            WindowKind::Fixes => self.segments = self.segments.saturating_add(1),
        }
        let without = compare(None, &Hypothesis::CORRECT);
        for (index, (score, hypothesis)) in self.scores.iter_mut().zip(&self.hypotheses).enumerate() {
            let with = compare(Some(index), hypothesis);
            score.gain *= MEMORY;
            score.loss *= MEMORY;
            for (comparison, refuted) in with.iter().flatten().zip(without.iter().flatten()) {
                let gain = refuted.cost.min(MAX_COST) - comparison.cost.min(MAX_COST);
                score.loss -= gain.min(0.0);
                if comparison.is_informative(refuted) {
                    score.gain += gain.max(0.0);
                }
            }
            add_support(score, &with, &without);
        }
    }

    /// A fault that has just been decided, or a set of faults that look the same; each once.
    pub(super) fn take_finding(&mut self) -> Option<WiringFinding> {
        let plausible = self.scores.iter().filter(|score| score.is_plausible());
        let best = plausible.max_by(|one, other| one.net().total_cmp(&other.net()))?;
        let rivals = |score: &&Score| score.net() > best.net() - DECIDING_GAIN;
        let is_undecided = self.scores.iter().filter(rivals).count() > 1;
        if is_undecided {
            let needed = if self.segments == 0 { UNDECIDED_GAIN } else { UNDECIDED_GAIN_WITH_FIXES };
            let has_waited = best.gain >= needed;
            let have_turned = |score: &Score| score.is_plausible() && score.supporting_turn_rad >= UNDECIDED_TURN_RAD;
            if !has_waited || !self.scores.iter().filter(rivals).all(have_turned) {
                return None;
            }
        }
        let ratio = best.ratio()?;
        let numbered = self.scores.iter().enumerate();
        let set = numbered.filter(|(_, score)| rivals(score)).fold(0, |set: FaultSet, (index, _)| set | 1 << index);
        let is_new = self.reported.is_none_or(|reported| set != reported && set & reported == set);
        if !is_new {
            return None;
        }
        self.reported = Some(set);
        let all = WiringFault::ALL.into_iter().enumerate();
        let candidates: Vec<_> = all.filter(|(index, _)| set & 1 << index != 0).map(|(_, fault)| fault).collect();
        let missing = is_undecided.then(|| self.missing());
        Some(WiringFinding { candidates, ratio, missing })
    }

    fn missing(&self) -> DecidingObservation {
        if self.segments == 0 {
            DecidingObservation::Fixes
        } else if self.gyro_windows == 0 {
            DecidingObservation::Gyro
        } else {
            DecidingObservation::FixesWithHeading
        }
    }
}

fn add_support(score: &mut Score, with: &Comparisons, without: &Comparisons) {
    if with.iter().flatten().any(|comparison| comparison.cost > FITTING_WINDOW) {
        return;
    }
    let mut is_supporting = false;
    for (comparison, refuted) in with.iter().zip(without) {
        let (Some(comparison), Some(refuted)) = (comparison, refuted) else {
            continue;
        };
        let smaller = comparison.observed[0].abs().min(comparison.observed[1].abs());
        if refuted.cost < REFUTED_WINDOW || !comparison.is_moving() || !comparison.is_informative(refuted) {
            continue;
        }
        is_supporting = true;
        if comparison.is_path {
            score.supporting_path_m += smaller;
        } else {
            score.supporting_turn_rad += smaller;
        }
        if let Some((kind, pair)) = comparison.ratio {
            score.ratios[kind as usize].add(pair);
        }
    }
    score.supporting_windows = score.supporting_windows.saturating_add(u32::from(is_supporting));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turn(fault_cost: f64, observed: [f64; 2]) -> Comparisons {
        let ratio = Some((RatioKind::GyroTurn, observed));
        let error = fault_cost.sqrt();
        [
            Some(Comparison { observed, cost: fault_cost, error, noise: 0.1, ratio, is_path: false, is_shrunk: false }),
            None,
            None,
        ]
    }

    /// Windows in which these faults fit and nothing else does.
    fn windows(count: usize, fitting: &[WiringFault], observed: [f64; 2]) -> Evidence {
        let mut evidence = Evidence::new();
        for _ in 0..count {
            evidence.add(WindowKind::Gyro, |index, _| {
                let fits = index.is_some_and(|index| fitting.contains(&WiringFault::ALL[index]));
                turn(if fits { 0.1 } else { 100.0 }, observed)
            });
        }
        evidence
    }

    #[test]
    fn three_clear_windows_decide_and_two_do_not_and_it_is_said_once() {
        let swapped = [WiringFault::WheelsSwapped];
        assert_eq!(windows(2, &swapped, [1.0, -1.0]).take_finding(), None);
        let mut evidence = windows(3, &swapped, [1.0, -1.0]);
        let finding = evidence.take_finding().unwrap();
        assert_eq!((finding.fault(), finding.ratio.value), (Some(WiringFault::WheelsSwapped), -1.0));
        assert_eq!(evidence.take_finding(), None);
    }

    #[test]
    fn faults_that_look_the_same_are_reported_late_and_together() {
        let both = [WiringFault::GyroReversed, WiringFault::WheelsSwapped];
        assert_eq!(windows(7, &both, [1.0, -1.0]).take_finding(), None);
        let finding = windows(8, &both, [1.0, -1.0]).take_finding().unwrap();
        assert_eq!(finding.candidates, both);
        assert_eq!((finding.fault(), finding.missing), (None, Some(DecidingObservation::Fixes)));
    }

    #[test]
    fn one_window_does_not_tell_two_faults_apart_and_three_do() {
        let mut evidence = windows(4, &[WiringFault::GyroReversed, WiringFault::WheelsSwapped], [1.0, -1.0]);
        let mut add_window = || {
            evidence.add(WindowKind::Gyro, |index, _| {
                let fits = index.is_some_and(|index| WiringFault::ALL[index] == WiringFault::WheelsSwapped);
                turn(if fits { 0.1 } else { 100.0 }, [1.0, -1.0])
            });
            evidence.take_finding()
        };
        assert_eq!(add_window(), None);
        assert_eq!(add_window(), None);
        assert_eq!(add_window().unwrap().fault(), Some(WiringFault::WheelsSwapped));
    }

    #[test]
    fn what_explains_by_standing_still_is_not_supported() {
        assert_eq!(windows(20, &[WiringFault::WheelsSwapped], [0.0, 0.0]).take_finding(), None);
    }

    #[test]
    fn a_fault_that_leaves_a_third_unexplained_is_not_found() {
        let mut evidence = windows(20, &[WiringFault::WheelsSwapped], [1.0, -1.0]);
        for _ in 0..7 {
            evidence.add(WindowKind::Gyro, |index, _| turn(if index.is_none() { 0.1 } else { 100.0 }, [1.0, 1.0]));
        }
        assert_eq!(evidence.take_finding(), None);
    }
}

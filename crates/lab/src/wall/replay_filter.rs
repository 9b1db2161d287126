//! Distance estimators for the approach: the last reading, a line through the last two, or the wall filter.

use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::{RangeFilter, RangeFilterVariant};
use posebridge_estimator::{Filter, Params};
use posebridge_telemetry::{
    BrickClock, FusionOutcome, FusionRecord, Meters, MetersPerSecond, Observation, ObservationKind, RadiansPerSecond,
    SensorId, SensorNoise, TimeDelta, Timestamp,
};

use super::log::{WallLog, WallReading};
use crate::config_without_wheels;

/// Estimated distance and speed towards the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachEstimate {
    pub distance_m: f64,
    pub towards_m_per_s: f64,
}

/// Estimates a distance from readings and inputs. Times are the brick's.
pub trait ApproachEstimator {
    fn observe_range(&mut self, at_s: f64, range_m: f64);
    /// Processes the motor input that holds from `at_s` on; 1 is that of the step test.
    fn observe_input(&mut self, at_s: f64, input: f64);
    /// `None` before the first reading.
    fn estimate(&self, at_s: f64) -> Option<ApproachEstimate>;
    /// The readings so far against their predictions; none without a gate.
    fn gates(&self) -> &[GateSample] {
        &[]
    }
}

/// The line through the last two readings: extrapolated, or its last reading held until the next.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinearExtrapolation {
    last: Option<(f64, f64)>,
    before: Option<(f64, f64)>,
    is_held: bool,
}

impl LinearExtrapolation {
    pub const HELD: Self = Self { last: None, before: None, is_held: true };
}

impl ApproachEstimator for LinearExtrapolation {
    fn observe_range(&mut self, at_s: f64, range_m: f64) {
        if self.last.is_none_or(|(last_s, _)| at_s > last_s) {
            self.before = self.last.replace((at_s, range_m));
        }
    }

    fn observe_input(&mut self, _: f64, _: f64) {}

    fn estimate(&self, at_s: f64) -> Option<ApproachEstimate> {
        let (last_s, range_m) = self.last?;
        let towards_m_per_s = self.before.map_or(0.0, |(t0, z0)| (z0 - range_m) / (last_s - t0));
        let since_s = if self.is_held { 0.0 } else { at_s - last_s };
        Some(ApproachEstimate { distance_m: range_m - towards_m_per_s * since_s, towards_m_per_s })
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KalmanNoise {
    /// sigma_u: of distance (m) and speed (m/s) per step of 7.6 ms.
    pub process_m: f64,
    /// sigma_z: of a reading, m.
    pub range_m: f64,
}

impl KalmanNoise {
    /// The paper's: 50 mm and 20 mm.
    pub const PAPER: Self = Self { process_m: 0.05, range_m: 0.02 };
}

/// A reading against its prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GateSample {
    pub at_s: f64,
    pub innovation_m: f64,
    /// Half-width of the gate, max(GATE_MIN, 3 sqrt(S)).
    pub gate_m: f64,
}

pub struct WallKalman {
    filter: RangeFilter,
    drag_s_per_m: f64,
    gates: Vec<GateSample>,
}

impl WallKalman {
    pub fn new(model: WallApproachModel, noise: KalmanNoise, variant: RangeFilterVariant) -> Self {
        let params = Params {
            wall_drag_s_per_m: model.drag_s_per_m,
            wall_mass_s2_per_m: model.mass_s2_per_m,
            wall_process_m: noise.process_m,
            ..Params::default()
        };
        let config = config_without_wheels(SensorNoise { wall_range_m: noise.range_m, ..SensorNoise::EXACT }, params);
        Self { filter: RangeFilter::new(&config, variant), drag_s_per_m: model.drag_s_per_m, gates: Vec::new() }
    }

    pub fn fuse(&mut self, at_s: f64, range_m: f64) -> FusionRecord {
        let record = self.observe(at_s, ObservationKind::WallRange(Meters(range_m)));
        self.gates.extend(innovation_sigma(&record).map(|s_m2| GateSample {
            at_s,
            innovation_m: record.innovation[0],
            gate_m: Params::default().wall_gate_m.max(GATE_SIGMAS * s_m2.sqrt()),
        }));
        record
    }

    fn observe(&mut self, at_s: f64, observed: ObservationKind) -> FusionRecord {
        self.filter.observe(&Observation {
            sensor: SensorId::RANGE,
            stamp: timestamp(at_s),
            stamp_sigma: TimeDelta::ZERO,
            measurement: observed,
        })
    }
}

impl ApproachEstimator for WallKalman {
    fn observe_range(&mut self, at_s: f64, range_m: f64) {
        self.fuse(at_s, range_m);
    }

    /// Converts the input to the steady speed, which the filter expects.
    fn observe_input(&mut self, at_s: f64, input: f64) {
        let observed = ObservationKind::BodyVelocity {
            forward: MetersPerSecond(input / self.drag_s_per_m),
            turn: RadiansPerSecond(0.0),
        };
        self.observe(at_s, observed);
    }

    fn estimate(&self, at_s: f64) -> Option<ApproachEstimate> {
        let scalar = self.filter.scalar_at(timestamp(at_s))?;
        Some(ApproachEstimate { distance_m: scalar.value, towards_m_per_s: -scalar.rate_per_s })
    }

    fn gates(&self) -> &[GateSample] {
        &self.gates
    }
}

fn timestamp(at_s: f64) -> Timestamp<BrickClock> {
    Timestamp::from_secs_f64(at_s)
}

/// The paper's gate, in standard deviations of the innovation.
pub(super) const GATE_SIGMAS: f64 = 3.0;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Validation {
    /// Control cycles: each is a prediction.
    pub turns: usize,
    pub used: usize,
    pub gated: usize,
    /// Mean of K, the weight of a reading in the distance.
    pub gain: f64,
    /// Mean half-width of the gate, 3 sqrt(S).
    pub gate_m: f64,
    /// Root mean square of readings minus predictions.
    pub innovation_rms_m: f64,
    /// Mean normalised innovation squared; 1 is consistent.
    pub nis: f64,
}

impl Validation {
    /// Share of the control cycles without a reading: the paper has 77.4 %.
    pub fn predicted_share(&self) -> f64 {
        if self.turns == 0 {
            return 0.0;
        }
        1.0 - (self.used + self.gated).min(self.turns) as f64 / self.turns as f64
    }
}

/// Runs the filter over a log. The first reading starts it and is not counted.
pub fn validate_model(
    log: &WallLog,
    model: WallApproachModel,
    noise: KalmanNoise,
    variant: RangeFilterVariant,
) -> Validation {
    let mut kalman = WallKalman::new(model, noise, variant);
    let mut found = Validation::default();
    let (mut predicted, mut squares) = (0.0, 0.0);
    for entry in log.entries() {
        match entry.reading {
            WallReading::Input(input) => {
                kalman.observe_input(entry.at_s, input);
                found.turns += 1;
            }
            WallReading::Range(range_m) => {
                let record = kalman.fuse(entry.at_s, range_m);
                let Some(s_m2) = innovation_sigma(&record) else {
                    continue;
                };
                found.used += usize::from(record.outcome == FusionOutcome::Accepted);
                found.gated += usize::from(record.outcome == FusionOutcome::Gated);
                predicted += 1.0;
                squares += record.innovation[0].powi(2);
                found.gain += 1.0 - noise.range_m.powi(2) / s_m2;
                found.gate_m += GATE_SIGMAS * s_m2.sqrt();
                found.nis += record.nis;
            }
        }
    }
    if predicted > 0.0 {
        found.innovation_rms_m = f64::sqrt(squares / predicted);
        for mean in [&mut found.gain, &mut found.gate_m, &mut found.nis] {
            *mean /= predicted;
        }
    }
    found
}

/// S of a reading that was held against a prediction, m².
pub(super) fn innovation_sigma(record: &FusionRecord) -> Option<f64> {
    let s_m2 = record.innovation_covariance[0][0];
    (record.degrees_of_freedom == 1 && s_m2 > 0.0).then_some(s_m2)
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GateTrial {
    pub added_m: f64,
    pub is_gated: bool,
    pub jumped_m: f64,
}

/// Adds `added_m` to reading number `index`; `None` if there is no such reading, or it had no prediction.
pub fn gate_trial(
    log: &WallLog,
    model: WallApproachModel,
    noise: KalmanNoise,
    variant: RangeFilterVariant,
    index: usize,
    added_m: f64,
) -> Option<GateTrial> {
    let mut kalman = WallKalman::new(model, noise, variant);
    let mut range_count = 0;
    for entry in log.entries() {
        match entry.reading {
            WallReading::Input(input) => kalman.observe_input(entry.at_s, input),
            WallReading::Range(range_m) if range_count < index => {
                kalman.observe_range(entry.at_s, range_m);
                range_count += 1;
            }
            WallReading::Range(range_m) => {
                let before = kalman.estimate(entry.at_s)?;
                let record = kalman.fuse(entry.at_s, range_m + added_m);
                innovation_sigma(&record)?;
                let after = kalman.estimate(entry.at_s)?;
                return Some(GateTrial {
                    added_m,
                    is_gated: record.outcome == FusionOutcome::Gated,
                    jumped_m: after.distance_m - before.distance_m,
                });
            }
        }
    }
    None
}

/// Tolerance of a stop at the target.
pub const NEAR_WALL_M: f64 = 0.02;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopResult {
    /// Distance from the wall minus the target; negative is too near.
    pub error_m: f64,
    /// From start to standstill.
    pub time_s: f64,
    /// Mean speed of the approach.
    pub approach_m_per_s: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StopSummary {
    pub runs: usize,
    pub stopped: usize,
    /// Stopped within [`NEAR_WALL_M`] of the target.
    pub near: usize,
    /// Of those that stopped.
    pub mean_error_m: f64,
    /// Root mean square error.
    pub rms_error_m: f64,
    pub worst_error_m: f64,
    pub mean_time_s: f64,
    pub mean_approach_m_per_s: f64,
}

/// `None` is an approach that did not stop.
pub fn summarise_stops(stops: &[Option<StopResult>]) -> StopSummary {
    let mut sum = StopSummary { runs: stops.len(), ..StopSummary::default() };
    let mut squares = 0.0;
    for stop in stops.iter().flatten() {
        sum.stopped += 1;
        sum.near += usize::from(stop.error_m.abs() <= NEAR_WALL_M);
        sum.mean_error_m += stop.error_m;
        squares += stop.error_m.powi(2);
        sum.worst_error_m = sum.worst_error_m.max(stop.error_m.abs());
        sum.mean_time_s += stop.time_s;
        sum.mean_approach_m_per_s += stop.approach_m_per_s;
    }
    if sum.stopped > 0 {
        let count = sum.stopped as f64;
        sum.rms_error_m = f64::sqrt(squares / count);
        sum.mean_error_m /= count;
        sum.mean_time_s /= count;
        sum.mean_approach_m_per_s /= count;
    }
    sum
}

/// Number of runs in which one method did better than another in the same world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StopComparison {
    pub nearer: usize,
    pub faster: usize,
    pub both: usize,
}

/// Compares run by run. A method that did not stop is neither nearer nor faster; one that stopped is both compared with one that did
/// not.
pub fn compare_stops(ours: &[Option<StopResult>], theirs: &[Option<StopResult>]) -> StopComparison {
    let mut found = StopComparison::default();
    for (ours, theirs) in ours.iter().zip(theirs) {
        let Some(ours) = ours else { continue };
        let is_nearer = theirs.is_none_or(|theirs| ours.error_m.abs() < theirs.error_m.abs());
        let is_faster = theirs.is_none_or(|theirs| ours.approach_m_per_s > theirs.approach_m_per_s);
        found.nearer += usize::from(is_nearer);
        found.faster += usize::from(is_faster);
        found.both += usize::from(is_nearer && is_faster);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wall::log::test_logs::{driven_m, log_of};

    #[test]
    fn a_line_goes_on_where_the_last_reading_stays() {
        let (mut last, mut line) = (LinearExtrapolation::HELD, LinearExtrapolation::default());
        assert_eq!(line.estimate(0.0), None);
        for (at_s, range_m) in [(0.0, 2.0), (0.1, 1.9), (0.1, 7.0)] {
            last.observe_range(at_s, range_m);
            line.observe_range(at_s, range_m);
        }
        assert!((last.estimate(0.3).unwrap().distance_m - 1.9).abs() < 1e-12);
        let line = line.estimate(0.3).unwrap();
        assert!((line.distance_m - 1.7).abs() < 1e-12 && (line.towards_m_per_s - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_filter_takes_the_input_of_the_step_for_the_steady_speed() {
        let model = WallApproachModel::from_step_test(1.225, 0.997);
        let mut kalman = WallKalman::new(model, KalmanNoise::PAPER, RangeFilterVariant::Corrected);
        kalman.observe_range(0.0, 9.0);
        kalman.observe_input(0.0, 1.0);
        let settled = kalman.estimate(5.0).unwrap();
        assert!((settled.towards_m_per_s - 1.225).abs() < 1e-4, "{settled:?}");
    }

    /// The paper's loop: 84 turns of 7.6 ms, 19 with a reading, of its own car, without noise.
    fn paper_log() -> WallLog {
        let at_s = |turn: u32| 0.0076 * f64::from(turn);
        let read = (0..84).filter(|turn| (turn * 19) % 84 < 19);
        log_of((0..84).map(|turn| (at_s(turn), 1.0)), read.map(|turn| (at_s(turn), 2.0 - driven_m(at_s(turn)))))
    }

    fn model() -> WallApproachModel {
        WallApproachModel::from_step_test(1.225, 0.997)
    }

    #[test]
    fn the_papers_loop_is_mostly_prediction_and_its_sigmas_have_their_gains() {
        for (process_m, gain) in [(0.01, 0.620), (0.05, 0.963), (0.5, 0.999_6)] {
            let noise = KalmanNoise { process_m, range_m: 0.02 };
            let found = validate_model(&paper_log(), model(), noise, RangeFilterVariant::Paper);
            assert_eq!(found.turns, 84);
            // The first of the 19 readings starts the filter.
            assert_eq!(found.used, 18);
            assert!((found.predicted_share() - (1.0 - 18.0 / 84.0)).abs() < 1e-12);
            assert!((found.gain - gain).abs() < 0.03, "{process_m}: {found:?}");
            assert!(found.innovation_rms_m < 0.01);
        }
    }

    #[test]
    fn the_gate_refuses_what_is_beyond_three_sigmas_and_not_before() {
        let trial = |index, added_m| {
            gate_trial(&paper_log(), model(), KalmanNoise::PAPER, RangeFilterVariant::Paper, index, added_m)
        };
        let refused = trial(12, 0.5).unwrap();
        assert!(refused.is_gated && refused.jumped_m == 0.0, "{refused:?}");
        let used = trial(12, 0.2).unwrap();
        assert!(!used.is_gated && used.jumped_m > 0.15, "{used:?}");
        assert_eq!(trial(19, 0.2), None);
        assert_eq!(trial(0, 0.2), None);
    }

    const fn stop(error_m: f64, time_s: f64) -> StopResult {
        StopResult { error_m, time_s, approach_m_per_s: 3.0 / time_s }
    }

    #[test]
    fn a_run_without_a_stop_is_counted_and_not_averaged() {
        let found = summarise_stops(&[Some(stop(0.03, 2.0)), None, Some(stop(-0.01, 4.0))]);
        assert_eq!((found.runs, found.stopped, found.near), (3, 2, 1));
        assert!((found.mean_error_m - 0.01).abs() < 1e-12);
        assert!((found.rms_error_m - 0.0005_f64.sqrt()).abs() < 1e-12);
        assert_eq!((found.worst_error_m, found.mean_time_s), (0.03, 3.0));
        assert_eq!(summarise_stops(&[]), StopSummary::default());
    }

    #[test]
    fn runs_are_compared_one_by_one() {
        let ours = [Some(stop(0.01, 2.0)), Some(stop(-0.05, 2.0)), None, Some(stop(0.2, 9.0)), Some(stop(0.0, 1.0))];
        let theirs = [Some(stop(-0.02, 3.0)), Some(stop(0.04, 3.0)), Some(stop(0.9, 9.0)), None, Some(stop(0.05, 2.0))];
        let expected = StopComparison { nearer: 3, faster: 4, both: 3 };
        assert_eq!(compare_stops(&ours, &theirs), expected);
    }
}

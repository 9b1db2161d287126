//! The filter on the readings of a step: how much it predicts, what it estimates, and what its gate lets through.

use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_telemetry::{FusionOutcome, FusionRecord};

use super::log::{WallLog, WallReading};
use super::replay_filter::{ApproachEstimator, KalmanNoise, WallKalman};

/// The paper's gate, in standard deviations of the innovation.
pub(super) const GATE_SIGMAS: f64 = 3.0;

/// What the filter did with a log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Validation {
    /// Turns of the loop: each is a prediction.
    pub turns: usize,
    /// Readings that were used.
    pub used: usize,
    /// Readings that the gate refused.
    pub gated: usize,
    /// Mean share of a reading in the distance: K.
    pub gain: f64,
    /// Mean half-width of the gate, 3 sqrt(S), m.
    pub gate_m: f64,
    /// Root mean square of readings minus their prediction, m.
    pub innovation_rms_m: f64,
    /// Mean normalised innovation squared; 1 if the filter knows how wrong it is.
    pub nis: f64,
}

impl Validation {
    /// Share of the turns that had no reading: the paper has 77.4 %.
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

/// What the filter did with a reading that was made wrong on purpose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GateTrial {
    /// Which, counted from 0.
    pub index: usize,
    /// What was added to it, m.
    pub added_m: f64,
    /// Whether the gate refused it.
    pub is_gated: bool,
    /// By how much the estimate jumped, m.
    pub jumped_m: f64,
}

/// Adds `added_m` to reading number `index`; `None` if there is no such reading, or nothing was predicted for it.
pub fn gate_trial(
    log: &WallLog,
    model: WallApproachModel,
    noise: KalmanNoise,
    variant: RangeFilterVariant,
    index: usize,
    added_m: f64,
) -> Option<GateTrial> {
    let mut kalman = WallKalman::new(model, noise, variant);
    let mut seen = 0;
    for entry in log.entries() {
        match entry.reading {
            WallReading::Input(input) => kalman.observe_input(entry.at_s, input),
            WallReading::Range(range_m) if seen < index => {
                kalman.observe_range(entry.at_s, range_m);
                seen += 1;
            }
            WallReading::Range(range_m) => {
                let before = kalman.estimate(entry.at_s)?;
                let record = kalman.fuse(entry.at_s, range_m + added_m);
                innovation_sigma(&record)?;
                let after = kalman.estimate(entry.at_s)?;
                return Some(GateTrial {
                    index,
                    added_m,
                    is_gated: record.outcome == FusionOutcome::Gated,
                    jumped_m: after.distance_m - before.distance_m,
                });
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::log::WallEntry;
    use super::*;

    /// The paper's loop: 84 turns of 7.6 ms, 19 with a reading, of its own car, without noise.
    fn paper_log() -> WallLog {
        let tau_s = 0.997 / std::f64::consts::LN_10;
        let entries = (0..84_u32).flat_map(|turn| {
            let at_s = 0.0076 * f64::from(turn);
            let way_m = 1.225 * (at_s - tau_s * (1.0 - (-at_s / tau_s).exp()));
            let reading = ((turn * 19) % 84 < 19).then_some(WallReading::Range(2.0 - way_m));
            [Some(WallReading::Input(1.0)), reading]
                .into_iter()
                .flatten()
                .map(move |said| WallEntry { at_s, reading: said })
        });
        WallLog::new(entries.collect())
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
}

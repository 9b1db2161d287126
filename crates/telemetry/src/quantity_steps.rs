//! How often a filter of one quantity predicts without a reading.

use std::fmt;

use crate::clock::{BrickClock, Timestamp};
use crate::fusion::{FusionOutcome, FusionRecord};
use crate::observation::ObservationKind;
use crate::quantities::{Celsius, Meters};

const WALL_RANGE: &str = ObservationKind::WallRange(Meters(0.0)).kind();
const TEMPERATURE: &str = ObservationKind::Temperature(Celsius(0.0)).kind();

/// The steps of a filter of one quantity, and those that it took by prediction alone: without a reading, or with one that it refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QuantitySteps {
    taken: u64,
    predicted: u64,
    last_outcome: Option<FusionOutcome>,
    readings: ReadingsSinceStep,
    last_stamp: Option<Timestamp<BrickClock>>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum ReadingsSinceStep {
    #[default]
    None,
    Refused,
    Used,
}

impl QuantitySteps {
    /// Whether a record is that of a reading of the quantity; commands and observations of other kinds are none.
    pub fn is_reading(record: &FusionRecord) -> bool {
        [WALL_RANGE, TEMPERATURE].contains(&record.kind) && record.outcome != FusionOutcome::Unused
    }

    /// Takes what became of an observation. Whether it was a reading.
    pub fn observe(&mut self, record: &FusionRecord) -> bool {
        let is_reading = Self::is_reading(record);
        if is_reading {
            self.observe_reading(record.outcome);
        }
        is_reading
    }

    /// Takes what became of a reading.
    pub fn observe_reading(&mut self, outcome: FusionOutcome) {
        self.last_outcome = Some(outcome);
        if outcome.is_used() {
            self.readings = ReadingsSinceStep::Used;
        } else if self.readings == ReadingsSinceStep::None {
            self.readings = ReadingsSinceStep::Refused;
        }
    }

    /// Takes an estimate after its readings. False for a repetition, which is no step: the filter was given nothing that it uses.
    pub fn step(&mut self, stamp: Timestamp<BrickClock>) -> bool {
        let readings = std::mem::take(&mut self.readings);
        // A stamp may go back: the brick was restarted.
        let is_step = readings != ReadingsSinceStep::None || self.last_stamp != Some(stamp);
        self.last_stamp = Some(stamp);
        self.taken += u64::from(is_step);
        self.predicted += u64::from(is_step && readings != ReadingsSinceStep::Used);
        is_step
    }

    pub const fn taken(&self) -> u64 {
        self.taken
    }

    pub const fn predicted(&self) -> u64 {
        self.predicted
    }

    /// Counts in words, `outcome` being that of the last reading: `last reading gated, 77 % of 84 steps by prediction alone`.
    pub fn describe(outcome: &str, taken: u64, predicted: u64) -> String {
        let percent = if taken == 0 { 0.0 } else { 100.0 * predicted as f64 / taken as f64 };
        format!("last reading {outcome}, {percent:.0} % of {taken} steps by prediction alone")
    }
}

impl fmt::Display for QuantitySteps {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let outcome = self.last_outcome.map_or("unknown", FusionOutcome::reason);
        formatter.write_str(&Self::describe(outcome, self.taken, self.predicted))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::SensorId;

    fn record(kind: &'static str, outcome: FusionOutcome) -> FusionRecord {
        FusionRecord::new(SensorId::RANGE, kind, Timestamp::ZERO, outcome)
    }

    #[test]
    fn a_step_without_an_accepted_reading_is_a_prediction_and_a_repetition_is_no_step() {
        let mut steps = QuantitySteps::default();
        let at = Timestamp::from_millis;
        let used = record("wall_range", FusionOutcome::Accepted);
        let gated = record("wall_range", FusionOutcome::Gated);
        // A command leads the state on, and a refused reading does not; wheels are of no use.
        let others = [record("body_velocity", FusionOutcome::Accepted), record("wheel_angles", FusionOutcome::Unused)];
        steps.observe(&used);
        assert!(steps.step(at(10)));
        assert!(others.iter().all(|other| !steps.observe(other)));
        assert!(steps.step(at(20)), "a command");
        assert!(!steps.step(at(20)), "nothing of use came");
        steps.observe(&gated);
        assert!(steps.step(at(20)), "a refused reading");
        // Two readings in one step: one of them is enough.
        steps.observe(&used);
        steps.observe(&gated);
        assert!(steps.step(at(30)));
        assert_eq!((steps.taken(), steps.predicted()), (4, 2));
        assert_eq!(steps.to_string(), "last reading gated, 50 % of 4 steps by prediction alone");
    }
}

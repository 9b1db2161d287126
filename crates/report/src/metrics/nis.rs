//! What each sensor contributed: how often it was used, and whether its innovations fit the claims.
//!
//! Works without truth, so it is the health of a real robot too. It reads the filter's records; it does not repeat the
//! gate's decision.

use std::collections::BTreeMap;

use posebridge_telemetry::{FusionOutcome, FusionRecord, SensorId};

use super::consistency::{Consistency, ConsistencyBand};

/// Mean normalised innovation squared over all sensors, per degree of freedom.
pub(super) fn mean_nis_per_dof(tallies: &[SourceTally]) -> Option<f64> {
    let nis_sum: f64 = tallies.iter().map(|tally| tally.nis_sum).sum();
    let degrees_of_freedom = tallies.iter().map(|tally| tally.degrees_of_freedom);
    mean_per_degree(nis_sum, degrees_of_freedom.sum())
}

/// What became of the observations of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceTally {
    /// The sensor.
    pub sensor: SensorId,
    /// Used by the filter, slip included.
    pub used: u64,
    /// Used, but the wheels slipped.
    pub slip: u64,
    /// Further from the prediction than the gate allows.
    pub gated: u64,
    /// Older than the oldest state that the filter keeps.
    pub too_old: u64,
    /// Not finite, negative where it cannot be, or of zero duration.
    pub malformed: u64,
    /// Counters that jumped to another base.
    pub rebased: u64,
    /// Observations to which the estimate was moved.
    pub reset_to: u64,
    /// Of a kind that the filter does not use.
    pub unused: u64,
    /// Sum of the normalised innovations squared of the used observations.
    nis_sum: f64,
    /// Sum of their degrees of freedom.
    degrees_of_freedom: u64,
}

impl SourceTally {
    /// An empty tally.
    pub const fn new(sensor: SensorId) -> Self {
        Self {
            sensor,
            used: 0,
            slip: 0,
            gated: 0,
            too_old: 0,
            malformed: 0,
            rebased: 0,
            reset_to: 0,
            unused: 0,
            nis_sum: 0.0,
            degrees_of_freedom: 0,
        }
    }

    /// Counts one record. Records of other sensors are the caller's mistake and are counted all the same; [`tally_sources`]
    /// sorts them.
    pub fn add(&mut self, record: &FusionRecord) {
        match record.outcome {
            FusionOutcome::Accepted | FusionOutcome::Slip => {
                self.used += 1;
                self.slip += u64::from(record.outcome == FusionOutcome::Slip);
                if record.nis.is_finite() {
                    self.nis_sum += record.nis;
                    self.degrees_of_freedom += u64::from(record.degrees_of_freedom);
                }
            }
            FusionOutcome::Gated => self.gated += 1,
            FusionOutcome::TooOld => self.too_old += 1,
            FusionOutcome::Malformed => self.malformed += 1,
            FusionOutcome::Rebased => self.rebased += 1,
            FusionOutcome::PoseReset => self.reset_to += 1,
            FusionOutcome::Unused => self.unused += 1,
        }
    }

    /// Adds the counts of another run of the same sensor.
    pub fn merge(&mut self, other: &Self) {
        self.used += other.used;
        self.slip += other.slip;
        self.gated += other.gated;
        self.too_old += other.too_old;
        self.malformed += other.malformed;
        self.rebased += other.rebased;
        self.reset_to += other.reset_to;
        self.unused += other.unused;
        self.nis_sum += other.nis_sum;
        self.degrees_of_freedom += other.degrees_of_freedom;
    }

    /// Mean normalised innovation squared per degree of freedom of the used observations; `None` before the first that
    /// was predicted. Gated ones are not in it, so with a gate at 99.9 % an honest sensor sits at 0.99 rather than 1.
    pub fn mean_nis_per_dof(&self) -> Option<f64> {
        mean_per_degree(self.nis_sum, self.degrees_of_freedom)
    }

    /// How many degrees of freedom the mean stands on.
    pub const fn degrees_of_freedom(&self) -> u64 {
        self.degrees_of_freedom
    }

    /// The share of observations that the gate refused, among those that reached it; `None` if none did.
    pub fn gated_share(&self) -> Option<f64> {
        let judged = self.used + self.gated;
        (judged > 0).then(|| self.gated as f64 / judged as f64)
    }

    /// Whether the sensor's noise fits what the filter assumes.
    pub fn consistency(&self) -> Consistency {
        let band = ConsistencyBand::of_mean(self.degrees_of_freedom);
        match (self.mean_nis_per_dof(), band) {
            (Some(mean), Some(band)) => band.classify(mean),
            (None, _) | (_, None) => Consistency::Undetermined,
        }
    }
}

fn mean_per_degree(nis_sum: f64, degrees_of_freedom: u64) -> Option<f64> {
    (degrees_of_freedom > 0).then(|| nis_sum / degrees_of_freedom as f64)
}

/// Counts one record with its sensor; tallies stand in the order in which their sensors were heard first.
pub fn add_to_tallies(tallies: &mut Vec<SourceTally>, record: &FusionRecord) {
    let known = tallies.iter_mut().find(|tally| tally.sensor == record.sensor);
    if let Some(tally) = known {
        tally.add(record);
    } else {
        let mut tally = SourceTally::new(record.sensor);
        tally.add(record);
        tallies.push(tally);
    }
}

/// One tally per sensor that occurs in the records, in the order of the sensor ids.
pub fn tally_sources<'a>(records: impl IntoIterator<Item = &'a FusionRecord>) -> Vec<SourceTally> {
    let mut tallies = BTreeMap::new();
    for record in records {
        tallies.entry(record.sensor).or_insert(SourceTally::new(record.sensor)).add(record);
    }
    tallies.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{TimeDelta, Timestamp};

    fn record(sensor: SensorId, verdict: FusionOutcome, nis: f64) -> FusionRecord {
        FusionRecord {
            sensor,
            kind: "fix",
            stamp: Timestamp::ZERO,
            lag: TimeDelta::ZERO,
            outcome: verdict,
            innovation: [0.0; 3],
            innovation_covariance: [[0.0; 3]; 3],
            nis,
            degrees_of_freedom: 2,
            log_likelihood: 0.0,
        }
    }

    #[test]
    fn only_used_observations_enter_the_mean() {
        let mut tally = SourceTally::new(SensorId::CAMERA);
        tally.add(&record(SensorId::CAMERA, FusionOutcome::Accepted, 1.0));
        tally.add(&record(SensorId::CAMERA, FusionOutcome::Accepted, 5.0));
        tally.add(&record(SensorId::CAMERA, FusionOutcome::Gated, 400.0));
        tally.add(&record(SensorId::CAMERA, FusionOutcome::TooOld, 0.0));
        tally.add(&record(SensorId::CAMERA, FusionOutcome::Malformed, f64::NAN));
        assert_eq!(tally.mean_nis_per_dof(), Some(1.5));
        assert_eq!((tally.used, tally.gated, tally.too_old, tally.malformed), (2, 1, 1, 1));
        assert_eq!(tally.gated_share(), Some(1.0 / 3.0));
    }

    #[test]
    fn an_innovation_that_is_not_a_number_does_not_poison_the_mean() {
        let mut tally = SourceTally::new(SensorId::GYRO);
        tally.add(&record(SensorId::GYRO, FusionOutcome::Accepted, f64::NAN));
        assert_eq!((tally.used, tally.mean_nis_per_dof()), (1, None));
        assert_eq!(tally.consistency(), Consistency::Undetermined);
    }

    #[test]
    fn tallies_come_in_the_order_of_the_sensors() {
        let records = [
            record(SensorId::CAMERA, FusionOutcome::Accepted, 2.0),
            record(SensorId::WHEELS, FusionOutcome::Rebased, 0.0),
            record(SensorId::CAMERA, FusionOutcome::PoseReset, 2.0),
        ];
        let tallies = tally_sources(&records);
        assert_eq!(tallies.iter().map(|tally| tally.sensor).collect::<Vec<_>>(), [SensorId::WHEELS, SensorId::CAMERA]);
        assert_eq!((tallies[0].rebased, tallies[1].reset_to), (1, 1));
    }
}

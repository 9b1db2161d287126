//! Says in words what it means when a robot's observations contradict each other or its pose jumps, and what to do: wheels that slip, a
//! sensor that contradicts the pose, a robot that was moved.
//!
//! A robot that is lifted shows both: its wheels contradict the gyro, and then the camera contradicts the pose. So slip is reported with
//! a delay, and not at all while a sensor contradicts the pose.

use std::collections::BTreeMap;

use posebridge_telemetry::{
    BrickClock, Estimate, FusionOutcome, FusionRecord, ResetCause, SensorId, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

/// Time without slip after which an episode ends: ten of the gyro's usual windows of 0.2 s.
const SLIP_TIMEOUT: TimeDelta = TimeDelta::from_millis(2_000);
/// Consecutive windows with slip that are no coincidence. A single one happens by chance once in a thousand, or by
/// backlash where a wheel changes direction.
const MIN_CONSECUTIVE: u32 = 3;
/// The sensors of a pose have had a chance to contradict it by then: a camera has 2 Hz or more.
const SLIP_DELAY: TimeDelta = TimeDelta::from_millis(600);
/// A sensor that contradicts the pose for so long, and so often, is no coincidence.
const MIN_CONTRADICTION: TimeDelta = TimeDelta::from_millis(500);
/// Observations further apart belong to two contradictions.
const MAX_GAP: TimeDelta = TimeDelta::from_millis(2_000);
/// Time after which a contradiction that lasts is reported again.
const REPEAT: TimeDelta = TimeDelta::from_millis(10_000);

/// What the observations of one robot have shown so far.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct FusionAlarms {
    slip: SlipEpisode,
    /// An episode that is not reported yet.
    pending_slip: Option<Timestamp<BrickClock>>,
    contradictions: BTreeMap<SensorId, Contradiction>,
    reset_counter: Option<u8>,
}

/// An unbroken run of gated observations of one sensor.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Contradiction {
    since: Timestamp<BrickClock>,
    last: Timestamp<BrickClock>,
    count: u32,
    reported: Option<Timestamp<BrickClock>>,
}

impl FusionAlarms {
    /// What the next record means; `None` if nothing that has not been said.
    pub(crate) fn observe(&mut self, record: &FusionRecord) -> Option<String> {
        let stamp = record.stamp;
        match record.outcome {
            FusionOutcome::Slip if self.slip.observe(stamp) => self.pending_slip = Some(stamp),
            FusionOutcome::Gated => return self.observe_gated(record),
            FusionOutcome::Accepted | FusionOutcome::PoseReset => {
                self.contradictions.remove(&record.sensor);
            }
            FusionOutcome::Slip
            | FusionOutcome::TooOld
            | FusionOutcome::Malformed
            | FusionOutcome::Rebased
            | FusionOutcome::Unused => {}
        }
        let is_recent = |run: &Contradiction| (TimeDelta::ZERO..=MAX_GAP).contains(&(stamp - run.last));
        let is_contradicted = self.contradictions.values().any(is_recent);
        let since = self.pending_slip.filter(|_| !is_contradicted)?;
        // A brick that was restarted begins with an earlier stamp.
        if (TimeDelta::ZERO..SLIP_DELAY).contains(&(stamp - since)) {
            return None;
        }
        self.pending_slip = None;
        Some("wheels slip: gyro and wheels disagree, and the pose follows the gyro. Look at the floor, and at the track if it lasts".to_owned())
    }

    fn observe_gated(&mut self, record: &FusionRecord) -> Option<String> {
        let FusionRecord { sensor, stamp, .. } = *record;
        let begun = Contradiction { since: stamp, last: stamp, count: 0, reported: None };
        let run = self.contradictions.entry(sensor).or_insert(begun);
        // After a gap, or a restart of the brick's clock, another one begins.
        if !(TimeDelta::ZERO..=MAX_GAP).contains(&(stamp - run.last)) {
            *run = begun;
        }
        run.count = run.count.saturating_add(1);
        run.last = stamp;
        let lasts = stamp - run.since;
        let is_due = run.reported.is_none_or(|reported| stamp - reported >= REPEAT);
        if run.count < MIN_CONSECUTIVE || lasts < MIN_CONTRADICTION || !is_due {
            return None;
        }
        run.reported = Some(stamp);
        // What looked like slip is a robot that was moved, or a sensor that is wrong.
        self.pending_slip = None;
        Some(format!(
            "{} contradicts the pose for {:.1} s: if the robot was moved, the pose follows it in a moment; if not, look at the sensor's \
             place, its outliers and its noise",
            sensor.name(),
            lasts.as_secs_f64()
        ))
    }

    /// What a jump of the estimate means; `None` without one.
    pub(crate) fn observe_estimate(&mut self, estimate: &Estimate) -> Option<String> {
        let before = self.reset_counter.replace(estimate.reset_counter)?;
        if before == estimate.reset_counter {
            return None;
        }
        self.pending_slip = None;
        self.contradictions.clear();
        let text = estimate.describe_reset();
        match estimate.last_correction.map(|correction| correction.cause) {
            Some(ResetCause::Relocated) => {
                Some(text + ": the robot was lifted or pushed, or its pose was wrong before")
            }
            Some(ResetCause::Located | ResetCause::Given | ResetCause::Discarded) | None => Some(text),
        }
    }
}

/// Counts consecutive motion observations with slip.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct SlipEpisode {
    last: Option<Timestamp<BrickClock>>,
    consecutive: u32,
}

impl SlipEpisode {
    /// Records an observation with slip, and returns whether to warn people: once in an episode.
    fn observe(&mut self, stamp: Timestamp<BrickClock>) -> bool {
        let last = self.last.replace(stamp);
        let goes_on = last.is_some_and(|last| (TimeDelta::ZERO..=SLIP_TIMEOUT).contains(&(stamp - last)));
        self.consecutive = if goes_on { self.consecutive.saturating_add(1) } else { 1 };
        self.consecutive == MIN_CONSECUTIVE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(sensor: SensorId, millis: i64, outcome: FusionOutcome) -> FusionRecord {
        FusionRecord::new(sensor, "fix", Timestamp::from_millis(millis), outcome)
    }

    /// What is said to these records of the wheels and the camera.
    fn texts(records: impl IntoIterator<Item = (SensorId, i64, FusionOutcome)>) -> Vec<String> {
        let mut alarms = FusionAlarms::default();
        let all = records.into_iter();
        all.filter_map(|(sensor, millis, outcome)| alarms.observe(&record(sensor, millis, outcome))).collect()
    }

    #[test]
    fn slip_is_reported_once_per_episode_and_a_single_one_never() {
        let mut episode = SlipEpisode::default();
        let reported = [0, 100, 250, 400, 2_400, 4_401, 9_000, 9_200, 9_300, 50, 60, 70]
            .map(|millis| episode.observe(Timestamp::from_millis(millis)));
        let expected = [false, false, true, false, false, false, false, false, true, false, false, true];
        assert_eq!(reported, expected);
        let slipping = (0..20).map(|step| (SensorId::WHEELS, 100 * step, FusionOutcome::Slip));
        let said = texts(slipping);
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].starts_with("wheels slip"), "{said:?}");
    }

    #[test]
    fn a_robot_that_was_moved_is_not_called_slipping() {
        let both = (0..40).flat_map(|step| {
            [(SensorId::WHEELS, 100 * step, FusionOutcome::Slip), (SensorId::CAMERA, 100 * step, FusionOutcome::Gated)]
        });
        let said = texts(both);
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].starts_with("camera contradicts the pose for 0.5 s"), "{said:?}");
    }

    #[test]
    fn a_camera_that_sees_nothing_any_more_contradicts_nothing() {
        let gated = [0, 60_000, 60_500, 60_900].map(|millis| (SensorId::CAMERA, millis, FusionOutcome::Gated));
        let said = texts(gated);
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].starts_with("camera contradicts the pose for 0.9 s"), "{said:?}");
        let one_outlier = std::iter::once((SensorId::CAMERA, 0, FusionOutcome::Gated));
        let slip = (50..80).map(|step| (SensorId::WHEELS, 100 * step, FusionOutcome::Slip));
        assert_eq!(texts(one_outlier.chain(slip)).len(), 1);
    }

    #[test]
    fn a_gate_that_closes_now_and_then_is_no_contradiction() {
        let outliers = (0..200).map(|step| {
            let outcome = if step % 3 == 0 { FusionOutcome::Accepted } else { FusionOutcome::Gated };
            (SensorId::CAMERA, 100 * step, outcome)
        });
        assert_eq!(texts(outliers), [""; 0]);
        let lasting = (0..200).map(|step| (SensorId::CAMERA, 100 * step, FusionOutcome::Gated));
        assert_eq!(texts(lasting).len(), 2, "it is repeated after ten seconds");
    }
}

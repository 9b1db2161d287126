//! The inputs of the pose filter, and the order in which they are applied.

use std::cmp::Ordering;

use posebridge_telemetry::{BrickClock, Fix, FusionOutcome, Heading, ObservationKind, SensorId, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use super::relocalize::StateCommand;
use crate::history::HistoryEntry;
use crate::models::planar_speeds::Acceleration;
use crate::motion::MotionReading;
use crate::saved::Numbers;
use crate::validation;

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) enum UpdateKind {
    TurnRate(f64),
    Accelerations(Acceleration),
    Motion(MotionReading),
    /// A fix, a landmark, a range or a heading, and the sigma of its stamp.
    Absolute(ObservationKind, TimeDelta),
    Command(StateCommand),
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct PoseEntry {
    pub(super) stamp: Timestamp<BrickClock>,
    pub(super) sensor: SensorId,
    pub(super) update: UpdateKind,
}

impl PoseEntry {
    /// Whether it is what the filter might have made of an observation or a command.
    pub(super) fn is_valid(&self) -> bool {
        match &self.update {
            UpdateKind::TurnRate(rate) => rate.are_finite(),
            UpdateKind::Absolute(observation, sigma) => validation::is_finite(observation) && *sigma >= TimeDelta::ZERO,
            UpdateKind::Command(StateCommand::SetPose(start)) => validation::is_valid_start(start),
            UpdateKind::Accelerations(_)
            | UpdateKind::Motion(_)
            | UpdateKind::Command(
                StateCommand::ResetPose | StateCommand::SetOnlineCalibration(_) | StateCommand::ResetCalibration,
            ) => true,
        }
    }

    /// Order of the updates of one instant, so that the order of arrival does not matter. Commands come last, in the order given.
    const fn rank(&self) -> u8 {
        match self.update {
            UpdateKind::TurnRate(_) => 0,
            UpdateKind::Accelerations(_) => 1,
            UpdateKind::Motion(_) => 2,
            UpdateKind::Absolute(..) => 3,
            UpdateKind::Command(_) => 4,
        }
    }

    /// Whether this is an absolute observation that was not used.
    pub(super) const fn is_without_effect(&self, verdict: FusionOutcome) -> bool {
        matches!(self.update, UpdateKind::Absolute(..))
            && !matches!(verdict, FusionOutcome::Accepted | FusionOutcome::PoseReset)
    }

    /// Whether two entries have the same instant and content: a datagram that was received twice.
    pub(super) fn is_duplicate_of(&self, other: &Self) -> bool {
        let is_same = match (&self.update, &other.update) {
            (UpdateKind::Absolute(ours, _), UpdateKind::Absolute(theirs, _)) => ours == theirs,
            (UpdateKind::Accelerations(_), UpdateKind::Accelerations(_)) => true,
            _ => false,
        };
        is_same && self.stamp == other.stamp && self.sensor == other.sensor
    }
}

impl HistoryEntry for PoseEntry {
    fn stamp(&self) -> Timestamp<BrickClock> {
        self.stamp
    }

    /// By stamp, rank and sensor, and two absolute observations of one sensor by their values.
    fn order(&self, other: &Self) -> Ordering {
        let key = |entry: &Self| (entry.stamp, entry.rank(), entry.sensor.0);
        key(self).cmp(&key(other)).then_with(|| match (&self.update, &other.update) {
            (UpdateKind::Absolute(ours, _), UpdateKind::Absolute(theirs, _)) => {
                let ((kind, values), (other_kind, other_values)) = (sort_key(ours), sort_key(theirs));
                let differences = values.iter().zip(&other_values).map(|(ours, theirs)| ours.total_cmp(theirs));
                differences.fold(kind.cmp(&other_kind), Ordering::then)
            }
            _ => Ordering::Equal,
        })
    }
}

/// Number of values that distinguish two absolute observations of one instant.
const VALUES: usize = 10;

/// The number of a kind of absolute observation, which distinguishes those of one sensor, and all values of the
/// observation.
pub(super) fn sort_key(observation: &ObservationKind) -> (u8, [f64; VALUES]) {
    match *observation {
        ObservationKind::Fix(fix) => (0, fix_values(&fix)),
        ObservationKind::Landmark { id, range, bearing } => (1, padded(&[f64::from(id.0), range.0, bearing.0])),
        ObservationKind::BeaconRange { id, range } => (2, padded(&[f64::from(id.0), range.0])),
        ObservationKind::WallRange(range) => (3, padded(&[range.0])),
        ObservationKind::CompassHeading(heading) => (4, padded(&[heading.rad()])),
        ObservationKind::WheelAngles { .. }
        | ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. }
        | ObservationKind::TurnRate(_)
        | ObservationKind::WheelAccelerations { .. }
        | ObservationKind::Temperature(_) => (5, [0.0; VALUES]),
    }
}

fn padded(values: &[f64]) -> [f64; VALUES] {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
}

fn fix_values(fix: &Fix) -> [f64; VALUES] {
    let claimed = fix.covariance.map_or([f64::INFINITY; 4], |own| [own.xx_m2, own.xy_m2, own.yy_m2, own.heading_rad2]);
    [
        fix.position.x.0,
        fix.position.y.0,
        fix.heading.map_or(f64::INFINITY, Heading::rad),
        claimed[0],
        claimed[1],
        claimed[2],
        claimed[3],
        fix.tag_in_body.x.0,
        fix.tag_in_body.y.0,
        f64::from(fix.reset_counter),
    ]
}

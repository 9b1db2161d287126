//! The inputs of the pose filter, and the order in which they are applied.

use std::cmp::Ordering;

use posebridge_telemetry::{BrickClock, Fix, FusionOutcome, Heading, ObservationKind, SensorId, TimeDelta, Timestamp};

use super::relocalize::StateCommand;
use crate::history::HistoryEntry;
use crate::observations::accelerometer::WheelAccelerations;

/// The effect of one history entry on the state.
#[derive(Clone, Copy, Debug)]
pub(super) enum UpdateKind {
    TurnRate(f64),
    Accelerations(WheelAccelerations),
    Motion,
    /// A fix, a landmark, a range or a heading.
    Absolute(ObservationKind, TimeDelta),
    Command(StateCommand),
}

impl UpdateKind {
    /// Order of the updates of one instant, so that the order of arrival does not matter. Commands come last, in the order given.
    pub(super) const fn rank(&self) -> u8 {
        match self {
            Self::TurnRate(_) => 0,
            Self::Accelerations(_) => 1,
            Self::Motion => 2,
            Self::Absolute(..) => 3,
            Self::Command(_) => 4,
        }
    }

    /// The order of two actions of one rank, sensor and instant: absolute observations are ordered by their values.
    pub(super) fn order(&self, other: &Self) -> Ordering {
        match (self, other) {
            (Self::Absolute(ours, _), Self::Absolute(theirs, _)) => {
                compare_sort_keys(&sort_key(ours), &sort_key(theirs))
            }
            _ => Ordering::Equal,
        }
    }

    /// Whether two actions of one sensor and instant have the same content.
    pub(super) fn is_duplicate_of(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Absolute(ours, _), Self::Absolute(theirs, _)) => ours == theirs,
            (Self::Accelerations(_), Self::Accelerations(_)) => true,
            _ => false,
        }
    }
}

/// An observation with its instant and its source.
#[derive(Clone, Copy, Debug)]
pub(super) struct PoseEntry {
    pub(super) stamp: Timestamp<BrickClock>,
    pub(super) sensor: SensorId,
    pub(super) update: UpdateKind,
}

impl PoseEntry {
    /// Whether this is an absolute observation that was not used.
    pub(super) const fn is_without_effect(&self, verdict: FusionOutcome) -> bool {
        matches!(self.update, UpdateKind::Absolute(..))
            && !matches!(verdict, FusionOutcome::Accepted | FusionOutcome::PoseReset)
    }

    /// Whether two entries have the same instant and content: a datagram that was received twice.
    pub(super) fn is_duplicate_of(&self, other: &Self) -> bool {
        self.stamp == other.stamp && self.sensor == other.sensor && self.update.is_duplicate_of(&other.update)
    }
}

impl HistoryEntry for PoseEntry {
    fn stamp(&self) -> Timestamp<BrickClock> {
        self.stamp
    }

    /// By stamp, rank and sensor, and two absolute observations of one sensor by their values.
    fn order(&self, other: &Self) -> Ordering {
        let key = |entry: &Self| (entry.stamp, entry.update.rank(), entry.sensor.0);
        key(self).cmp(&key(other)).then_with(|| self.update.order(&other.update))
    }
}

/// The number of a kind of absolute observation, which distinguishes those of one sensor.
pub(super) const fn kind_index(observation: &ObservationKind) -> u8 {
    match observation {
        ObservationKind::Fix(_) => 0,
        ObservationKind::Landmark { .. } => 1,
        ObservationKind::BeaconRange { .. } => 2,
        ObservationKind::WallRange(_) => 3,
        ObservationKind::CompassHeading(_) => 4,
        ObservationKind::WheelAngles { .. }
        | ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. }
        | ObservationKind::TurnRate(_)
        | ObservationKind::WheelAccelerations { .. }
        | ObservationKind::Temperature(_) => 5,
    }
}

/// Number of values that distinguish two absolute observations of one instant.
const SORT_KEY_LEN: usize = 11;

/// All values of an observation, which distinguish two of one instant.
fn sort_key(observation: &ObservationKind) -> [f64; SORT_KEY_LEN] {
    let mut numbers = [0.0; SORT_KEY_LEN];
    numbers[0] = f64::from(kind_index(observation));
    match *observation {
        ObservationKind::Fix(fix) => numbers[1..].copy_from_slice(&fix_sort_key(&fix)),
        ObservationKind::Landmark { id, range, bearing } => {
            numbers[1..4].copy_from_slice(&[f64::from(id.0), range.0, bearing.0]);
        }
        ObservationKind::BeaconRange { id, range } => {
            numbers[1..3].copy_from_slice(&[f64::from(id.0), range.0]);
        }
        ObservationKind::WallRange(range) => numbers[1] = range.0,
        ObservationKind::CompassHeading(heading) => numbers[1] = heading.rad(),
        ObservationKind::WheelAngles { .. }
        | ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. }
        | ObservationKind::TurnRate(_)
        | ObservationKind::WheelAccelerations { .. }
        | ObservationKind::Temperature(_) => {}
    }
    numbers
}

fn fix_sort_key(fix: &Fix) -> [f64; SORT_KEY_LEN - 1] {
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

fn compare_sort_keys(ours: &[f64; SORT_KEY_LEN], theirs: &[f64; SORT_KEY_LEN]) -> Ordering {
    ours.iter().zip(theirs).map(|(ours, theirs)| ours.total_cmp(theirs)).fold(Ordering::Equal, Ordering::then)
}

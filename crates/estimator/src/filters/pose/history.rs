//! What the pose filter is told, and in which order it is applied.

use std::cmp::Ordering;

use posebridge_telemetry::{BrickClock, Fix, Heading, Observed, SensorId, Span, Stamp, Verdict};

use super::revise::Revision;
use crate::filters::StartPose;
use crate::observations::accelerometer::Accelerations;

/// What stands in the history.
#[derive(Clone, Copy, Debug)]
pub(super) enum Action {
    TurnRate(f64),
    Accelerations(Accelerations),
    Motion,
    /// Something absolute was seen: a fix, a landmark, a range, a heading.
    Sight(Observed, Span),
    SetPose(StartPose),
    /// A person changed what is known, but not where the robot is.
    Revise(Revision),
}

impl Action {
    /// Order among the actions of one instant, so that the order of arrival does not matter. What a person says comes last, in the
    /// order in which it was said: who moves the robot knows what the sensors have said.
    pub(super) const fn rank(&self) -> u8 {
        match self {
            Self::TurnRate(_) => 0,
            Self::Accelerations(_) => 1,
            Self::Motion => 2,
            Self::Sight(..) => 3,
            Self::SetPose(_) | Self::Revise(_) => 4,
        }
    }

    /// The order of two actions of one rank, sensor and instant: that of two sights is by what they say.
    pub(super) fn order(&self, other: &Self) -> Ordering {
        match (self, other) {
            (Self::Sight(ours, _), Self::Sight(theirs, _)) => order_of_numbers(&numbers_of(ours), &numbers_of(theirs)),
            _ => Ordering::Equal,
        }
    }

    /// Whether another action of the same sensor and instant says the same.
    pub(super) fn repeats(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Sight(ours, _), Self::Sight(theirs, _)) => ours == theirs,
            (Self::Accelerations(_), Self::Accelerations(_)) => true,
            _ => false,
        }
    }
}

/// What was told, of which instant and by whom.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    pub(super) stamp: Stamp<BrickClock>,
    pub(super) sensor: SensorId,
    pub(super) action: Action,
}

impl Told {
    /// The order in which it is applied: by stamp, rank and sensor, and two sights of one sensor by what they say.
    pub(super) fn order(&self, other: &Self) -> Ordering {
        let key = |told: &Self| (told.stamp, told.action.rank(), told.sensor.0);
        key(self).cmp(&key(other)).then_with(|| self.action.order(&other.action))
    }

    /// Whether this is a sight that was not used.
    pub(super) const fn is_without_effect(&self, verdict: Verdict) -> bool {
        matches!(self.action, Action::Sight(..)) && !matches!(verdict, Verdict::Accepted | Verdict::ResetTo)
    }

    /// Whether another says the same of the same instant: a datagram that came twice.
    pub(super) fn repeats(&self, other: &Self) -> bool {
        self.stamp == other.stamp && self.sensor == other.sensor && self.action.repeats(&other.action)
    }
}

/// The number of a kind of sight, which tells apart what one sensor says.
pub(super) const fn kind_of(seen: &Observed) -> u8 {
    match seen {
        Observed::Fix(_) => 0,
        Observed::Landmark { .. } => 1,
        Observed::BeaconRange { .. } => 2,
        Observed::WallRange(_) => 3,
        Observed::CompassHeading(_) => 4,
        Observed::WheelAngles { .. }
        | Observed::OdometerPose(_)
        | Observed::BodyVelocity { .. }
        | Observed::TurnRate(_)
        | Observed::WheelAccelerations { .. }
        | Observed::Temperature(_) => 5,
    }
}

/// As many numbers tell two sights of one instant apart.
const MOST_NUMBERS: usize = 11;

/// What tells two sights of one instant apart: all that they say.
fn numbers_of(seen: &Observed) -> [f64; MOST_NUMBERS] {
    let mut numbers = [0.0; MOST_NUMBERS];
    numbers[0] = f64::from(kind_of(seen));
    match *seen {
        Observed::Fix(fix) => numbers[1..].copy_from_slice(&numbers_of_fix(&fix)),
        Observed::Landmark { id, range, bearing } => {
            numbers[1..4].copy_from_slice(&[f64::from(id.0), range.0, bearing.0]);
        }
        Observed::BeaconRange { id, range } => {
            numbers[1..3].copy_from_slice(&[f64::from(id.0), range.0]);
        }
        Observed::WallRange(range) => numbers[1] = range.0,
        Observed::CompassHeading(heading) => numbers[1] = heading.rad(),
        Observed::WheelAngles { .. }
        | Observed::OdometerPose(_)
        | Observed::BodyVelocity { .. }
        | Observed::TurnRate(_)
        | Observed::WheelAccelerations { .. }
        | Observed::Temperature(_) => {}
    }
    numbers
}

fn numbers_of_fix(fix: &Fix) -> [f64; MOST_NUMBERS - 1] {
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

fn order_of_numbers(ours: &[f64; MOST_NUMBERS], theirs: &[f64; MOST_NUMBERS]) -> Ordering {
    ours.iter().zip(theirs).map(|(ours, theirs)| ours.total_cmp(theirs)).fold(Ordering::Equal, Ordering::then)
}

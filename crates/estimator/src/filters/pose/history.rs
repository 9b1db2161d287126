//! What the pose filter was told lately, in the order of time, with the state after each.

use std::cmp::Ordering;

use posebridge_telemetry::{BrickClock, Fix, Heading, Span, Stamp, Verdict};

use super::state::PoseState;
use crate::filters::StartPose;

/// What stands in the history.
#[derive(Clone, Copy, Debug)]
pub(super) enum Action {
    TurnRate(f64),
    Motion,
    Fix(Fix, Span),
    SetPose(StartPose),
}

impl Action {
    /// Order among the actions of one instant, so that the order of arrival does not matter. A pose that is set comes last: a
    /// person who moves the robot knows what the sensors have said.
    const fn rank(&self) -> u8 {
        match self {
            Self::TurnRate(_) => 0,
            Self::Motion => 1,
            Self::Fix(..) => 2,
            Self::SetPose(_) => 3,
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Entry {
    pub(super) stamp: Stamp<BrickClock>,
    pub(super) action: Action,
    pub(super) sensor: u8,
    /// The state after this entry.
    pub(super) after: PoseState,
}

impl Entry {
    /// Whether this is a fix that was not used.
    pub(super) const fn is_without_effect(&self, verdict: Verdict) -> bool {
        matches!(self.action, Action::Fix(..))
            && !matches!(verdict, Verdict::Accepted | Verdict::ResetTo)
    }

    /// The order in which entries are applied: by stamp, rank and sensor, and two fixes of one sensor by what they say.
    pub(super) fn order(&self, other: &Self) -> Ordering {
        let key = |entry: &Self| (entry.stamp, entry.action.rank(), entry.sensor);
        key(self)
            .cmp(&key(other))
            .then_with(|| match (&self.action, &other.action) {
                (Action::Fix(ours, _), Action::Fix(theirs, _)) => order_of_fixes(ours, theirs),
                _ => Ordering::Equal,
            })
    }

    /// Whether another entry says the same of the same instant: a datagram that came twice.
    pub(super) fn repeats(&self, other: &Self) -> bool {
        let is_same_fix = match (&self.action, &other.action) {
            (Action::Fix(ours, _), Action::Fix(theirs, _)) => ours == theirs,
            _ => false,
        };
        is_same_fix && self.stamp == other.stamp && self.sensor == other.sensor
    }
}

fn order_of_fixes(ours: &Fix, theirs: &Fix) -> Ordering {
    let numbers = |fix: &Fix| {
        [
            fix.position.x.0,
            fix.position.y.0,
            fix.heading.map_or(f64::INFINITY, Heading::rad),
        ]
    };
    numbers(ours)
        .iter()
        .zip(&numbers(theirs))
        .map(|(ours, theirs)| ours.total_cmp(theirs))
        .fold(Ordering::Equal, Ordering::then)
}

//! Whether the brick is there: it answers, so it lives.

use posebridge_telemetry::{HostClock, Span, Stamp};

use crate::message::Heartbeat;

/// Silence after which the brick counts as lost for the session: LEGO's own limit of two seconds.
const LOST_AFTER: Span = Span::from_millis(2_000);
/// The usual period of heartbeats.
const HEARTBEAT_PERIOD: Span = Span::from_millis(1_000);
/// MAV_TYPE_GROUND_ROVER, MAV_AUTOPILOT_GENERIC, nothing armed, MAV_STATE_ACTIVE.
pub(super) const HEARTBEAT: Heartbeat = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };

/// A change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sign {
    /// It was lost, and is there again.
    pub(super) is_return: bool,
    /// A heartbeat is due.
    pub(super) is_beat: bool,
}

/// The presence of one brick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Presence {
    last_answer: Option<Stamp<HostClock>>,
    last_beat: Option<Stamp<HostClock>>,
    is_lost: bool,
}

impl Presence {
    /// The link came up: from now on it should answer.
    pub(super) const fn begin(&mut self, now: Stamp<HostClock>) {
        self.last_answer = Some(now);
        self.is_lost = false;
    }

    /// It answered.
    pub(super) fn answered(&mut self, now: Stamp<HostClock>) -> Sign {
        self.last_answer = Some(now);
        let is_return = std::mem::take(&mut self.is_lost);
        let is_beat = self.last_beat.is_none_or(|last| now - last >= HEARTBEAT_PERIOD);
        if is_beat {
            self.last_beat = Some(now);
        }
        Sign { is_return, is_beat }
    }

    /// It said something that is no answer.
    pub(super) const fn speaks(&mut self, now: Stamp<HostClock>) {
        if !self.is_lost {
            self.last_answer = Some(now);
        }
    }

    /// When it will count as lost.
    pub(super) fn deadline(&self) -> Option<Stamp<HostClock>> {
        let last = self.last_answer.filter(|_| !self.is_lost)?;
        Some(last + LOST_AFTER)
    }

    /// True once when it is lost.
    pub(super) fn expire(&mut self, now: Stamp<HostClock>) -> bool {
        let is_lost = self.deadline().is_some_and(|due| due <= now);
        self.is_lost |= is_lost;
        is_lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_brick_beats_once_a_second_while_it_answers_and_is_lost_after_two() {
        let mut presence = Presence::default();
        assert_eq!(presence.deadline(), None);
        presence.begin(Stamp::ZERO);
        let beats = (0..40).filter(|step| presence.answered(Stamp::from_millis(50 * step)).is_beat).count();
        assert_eq!(beats, 2);
        assert!(!presence.expire(Stamp::from_millis(3_949)));
        assert!(presence.expire(Stamp::from_millis(3_950)));
        assert!(!presence.expire(Stamp::from_millis(9_000)));
        assert_eq!(presence.deadline(), None);
        assert!(presence.answered(Stamp::from_millis(9_000)).is_return);
    }
}

//! Whether the brick is alive, by its replies.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::message::Heartbeat;

/// Silence after which the brick counts as lost for the session: LEGO's own limit of two seconds.
const LOST_AFTER: TimeDelta = TimeDelta::from_millis(2_000);
/// The usual period of heartbeats.
const HEARTBEAT_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
/// MAV_TYPE_GROUND_ROVER, MAV_AUTOPILOT_GENERIC, nothing armed, MAV_STATE_ACTIVE.
pub(super) const HEARTBEAT: Heartbeat = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };

/// A change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PresenceChange {
    /// It was lost, and is there again.
    pub(super) is_back: bool,
    /// A heartbeat is due.
    pub(super) is_heartbeat_due: bool,
}

/// The presence of one brick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BrickLiveness {
    last_reply: Option<Timestamp<HostClock>>,
    last_heartbeat: Option<Timestamp<HostClock>>,
    is_lost: bool,
}

impl BrickLiveness {
    /// The link came up: from now on it should answer.
    pub(super) const fn reset(&mut self, now: Timestamp<HostClock>) {
        self.last_reply = Some(now);
        self.is_lost = false;
    }

    /// It answered.
    pub(super) fn record_reply(&mut self, now: Timestamp<HostClock>) -> PresenceChange {
        self.last_reply = Some(now);
        let is_return = std::mem::take(&mut self.is_lost);
        let is_beat = self.last_heartbeat.is_none_or(|last| now - last >= HEARTBEAT_PERIOD);
        if is_beat {
            self.last_heartbeat = Some(now);
        }
        PresenceChange { is_back: is_return, is_heartbeat_due: is_beat }
    }

    /// It said something that is no answer.
    pub(super) const fn record_activity(&mut self, now: Timestamp<HostClock>) {
        if !self.is_lost {
            self.last_reply = Some(now);
        }
    }

    /// When it will count as lost.
    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let last = self.last_reply.filter(|_| !self.is_lost)?;
        Some(last + LOST_AFTER)
    }

    /// True once when it is lost.
    pub(super) fn expire(&mut self, now: Timestamp<HostClock>) -> bool {
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
        let mut presence = BrickLiveness::default();
        assert_eq!(presence.deadline(), None);
        presence.reset(Timestamp::ZERO);
        let beats =
            (0..40).filter(|step| presence.record_reply(Timestamp::from_millis(50 * step)).is_heartbeat_due).count();
        assert_eq!(beats, 2);
        assert!(!presence.expire(Timestamp::from_millis(3_949)));
        assert!(presence.expire(Timestamp::from_millis(3_950)));
        assert!(!presence.expire(Timestamp::from_millis(9_000)));
        assert_eq!(presence.deadline(), None);
        assert!(presence.record_reply(Timestamp::from_millis(9_000)).is_back);
    }
}

//! A sign of life once a second, for bricks that have none of their own: the station then knows when they come and go.

use posebridge_telemetry::{HostClock, Span, Stamp};

use crate::message::{Heartbeat, Message};

/// The common interval of heartbeats.
const PERIOD: Span = Span::from_millis(1_000);
/// MAV_TYPE_GROUND_ROVER.
const GROUND_ROVER: u8 = 10;
/// MAV_AUTOPILOT_GENERIC.
const GENERIC: u8 = 0;
/// MAV_STATE_ACTIVE.
const ACTIVE: u8 = 4;

/// When the last sign of life was told.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pulse {
    last: Option<Stamp<HostClock>>,
}

impl Pulse {
    /// The brick was heard at `now`: its heartbeat, if one is due.
    pub(super) fn heard(&mut self, now: Stamp<HostClock>) -> Option<Message> {
        if self.last.is_some_and(|last| now - last < PERIOD) {
            return None;
        }
        self.last = Some(now);
        Some(Message::Heartbeat(Heartbeat {
            vehicle_type: GROUND_ROVER,
            autopilot: GENERIC,
            base_mode: 0,
            system_status: ACTIVE,
        }))
    }
}

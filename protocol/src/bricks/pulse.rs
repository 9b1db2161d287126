//! A sign of life once a second, for bricks and cameras that have none of their own: the station then knows when they come and go.

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

/// MAV_TYPE_CAMERA.
const CAMERA: u8 = 30;
/// MAV_AUTOPILOT_INVALID: not an autopilot.
const NOT_AN_AUTOPILOT: u8 = 8;

/// Whose sign of life it is, and when the last one was told.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pulse {
    vehicle_type: u8,
    autopilot: u8,
    last: Option<Stamp<HostClock>>,
}

impl Default for Pulse {
    /// A robot's.
    fn default() -> Self {
        Self { vehicle_type: GROUND_ROVER, autopilot: GENERIC, last: None }
    }
}

impl Pulse {
    /// A camera's.
    pub(super) const fn of_camera() -> Self {
        Self { vehicle_type: CAMERA, autopilot: NOT_AN_AUTOPILOT, last: None }
    }

    /// The brick was heard at `now`: its heartbeat, if one is due.
    pub(super) fn heard(&mut self, now: Stamp<HostClock>) -> Option<Message> {
        if self.last.is_some_and(|last| now - last < PERIOD) {
            return None;
        }
        self.last = Some(now);
        Some(Message::Heartbeat(Heartbeat {
            vehicle_type: self.vehicle_type,
            autopilot: self.autopilot,
            base_mode: 0,
            system_status: ACTIVE,
        }))
    }
}

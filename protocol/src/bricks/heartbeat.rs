//! A heartbeat once a second for bricks and cameras without one of their own, so that the station detects when they
//! come and go.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use crate::message::{Heartbeat, Message};

const PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
const GROUND_ROVER: u8 = 10;
const GENERIC: u8 = 0;
const ACTIVE: u8 = 4;

const CAMERA: u8 = 30;
/// MAV_AUTOPILOT_INVALID: not an autopilot.
const NOT_AN_AUTOPILOT: u8 = 8;

/// The sender of the heartbeat, and when the last one was emitted.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeartbeatSource {
    vehicle_type: u8,
    autopilot: u8,
    last_sent: Option<Timestamp<HostClock>>,
}

impl Default for HeartbeatSource {
    fn default() -> Self {
        Self { vehicle_type: GROUND_ROVER, autopilot: GENERIC, last_sent: None }
    }
}

impl HeartbeatSource {
    pub(super) const fn for_camera() -> Self {
        Self { vehicle_type: CAMERA, autopilot: NOT_AN_AUTOPILOT, last_sent: None }
    }

    /// The brick sent something at `now`: returns its heartbeat, if one is due.
    pub(super) fn heartbeat_if_due(&mut self, now: Timestamp<HostClock>) -> Option<Message> {
        if self.last_sent.is_some_and(|last| now - last < PERIOD) {
            return None;
        }
        self.last_sent = Some(now);
        Some(Message::Heartbeat(Heartbeat {
            vehicle_type: self.vehicle_type,
            autopilot: self.autopilot,
            base_mode: 0,
            system_status: ACTIVE,
        }))
    }
}

//! The sending half: one participant on one link.

use crate::frame::{
    BATTERY, Frame, HEARTBEAT, INERTIAL, Kind, Origin, Payload, ROBOT_DESCRIPTION, TIMESYNC, WHEEL_TICKS,
};
use crate::messages::{Battery, Inertial, RobotDescription, TimeRequest, WheelTicks};

/// MAV_TYPE_GROUND_ROVER (minimal.xml).
const GROUND_ROVER: u8 = 10;
/// MAV_AUTOPILOT_GENERIC.
const GENERIC_AUTOPILOT: u8 = 0;
/// MAV_STATE_ACTIVE.
const ACTIVE: u8 = 4;
/// The version of MAVLink that HEARTBEAT names.
const MAVLINK_VERSION: u8 = 3;
/// MAV_BATTERY_FUNCTION_ALL (common.xml).
const BATTERY_OF_ALL: u8 = 1;
/// What BATTERY_STATUS says of temperature, and of consumption, current and cells, where they are not known.
const TEMPERATURE_UNKNOWN: i16 = i16::MAX;
const UNKNOWN: u8 = 0xFF;
/// Bytes of a name in PB_ROBOT_DESCRIPTION.
const NAME_BYTES: usize = 16;

/// Where frames go: a serial port, a socket, a buffer. It is given one whole frame at a time.
pub trait Sink {
    /// Takes a frame. A sink that cannot keep it drops it whole; the receiver sees that by the sequence.
    fn put(&mut self, frame: &[u8]);
}

impl<F: FnMut(&[u8])> Sink for F {
    fn put(&mut self, frame: &[u8]) {
        self(frame);
    }
}

/// One participant on one link, with the number of its next frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link {
    system: u8,
    component: u8,
    sequence: u8,
}

impl Link {
    /// A participant that has sent nothing. A robot is component 1 of a system from 1 to 254.
    #[must_use]
    pub const fn new(system: u8, component: u8) -> Self {
        Self::continued(system, component, 0)
    }

    /// A participant whose next frame has this number, because something else sends under its name, too.
    #[must_use]
    pub const fn continued(system: u8, component: u8, sequence: u8) -> Self {
        Self { system, component, sequence }
    }

    /// Says that the robot is there: once per second.
    pub fn heartbeat(&mut self, sink: &mut impl Sink) {
        let state = [GROUND_ROVER, GENERIC_AUTOPILOT, 0, ACTIVE, MAVLINK_VERSION];
        self.send(HEARTBEAT, &Payload::new().put([0; 4]).put(state), sink);
    }

    /// Sends total counts: 10 to 50 times per second.
    pub fn wheel_ticks(&mut self, ticks: &WheelTicks, sink: &mut impl Sink) {
        let payload = Payload::new()
            .put(ticks.time_us.to_le_bytes())
            .put(ticks.left.to_le_bytes())
            .put(ticks.right.to_le_bytes())
            .put([ticks.valid.0]);
        self.send(WHEEL_TICKS, &payload, sink);
    }

    /// Sends gyro and accelerometers: 10 to 50 times per second.
    pub fn inertial(&mut self, inertial: &Inertial, sink: &mut impl Sink) {
        let payload = Payload::new()
            .put(inertial.time_us.to_le_bytes())
            .put(inertial.turn_urad.to_le_bytes())
            .put(inertial.turn_rate.to_le_bytes())
            .put(inertial.accel_left.to_le_bytes())
            .put(inertial.accel_right.to_le_bytes())
            .put([inertial.valid.0]);
        self.send(INERTIAL, &payload, sink);
    }

    /// Says how full the battery is: once a second or more rarely.
    pub fn battery(&mut self, battery: &Battery, sink: &mut impl Sink) {
        let percent = battery.percent.map_or([UNKNOWN], |percent| [percent]);
        let payload = Payload::new()
            .put([UNKNOWN; 8])
            .put(TEMPERATURE_UNKNOWN.to_le_bytes())
            .put(battery.millivolts.to_le_bytes())
            .put([UNKNOWN; 20])
            .put([0, BATTERY_OF_ALL, 0])
            .put(percent);
        self.send(BATTERY, &payload, sink);
    }

    /// Says how the robot is built: at the start, and every few seconds for stations that come later.
    pub fn description(&mut self, robot: &RobotDescription<'_>, sink: &mut impl Sink) {
        let mut name = [0; NAME_BYTES];
        for (place, byte) in name.iter_mut().zip(robot.name.bytes()) {
            *place = byte;
        }
        let payload = Payload::new()
            .put(robot.left_wheel_radius_m.to_le_bytes())
            .put(robot.right_wheel_radius_m.to_le_bytes())
            .put(robot.track_width_m.to_le_bytes())
            .put(robot.ticks_per_turn.to_le_bytes())
            .put(robot.gyro_sigma_rad_per_s.to_le_bytes())
            .put(robot.gyro_resolution_rad_per_s.to_le_bytes())
            .put(name);
        self.send(ROBOT_DESCRIPTION, &payload, sink);
    }

    /// Answers what time it is, if this participant was asked. `now_us` is the clock that the sensors are stamped with,
    /// read as late as can be.
    pub fn answer_time(&mut self, request: &TimeRequest, now_us: u32, sink: &mut impl Sink) {
        let [system, component] = request.target;
        let is_asked = (system == 0 || system == self.system) && (component == 0 || component == self.component);
        if !is_asked {
            return;
        }
        // An answer of 0 would be a question.
        let nanos = (u64::from(now_us) * 1_000).max(1);
        let payload = Payload::new().put(nanos.to_le_bytes()).put(request.ts1).put(request.from);
        self.send(TIMESYNC, &payload, sink);
    }

    fn send(&mut self, kind: Kind, payload: &Payload, sink: &mut impl Sink) {
        let origin = Origin { sequence: self.sequence, system: self.system, component: self.component };
        self.sequence = self.sequence.wrapping_add(1);
        sink.put(Frame::new(kind, origin, payload).as_bytes());
    }
}

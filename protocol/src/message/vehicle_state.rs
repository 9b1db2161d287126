//! What ground stations show of a vehicle: its place on a map, its battery, its state.

use posebridge_telemetry::{Address, GeodeticPoint, Heading, Meters, MetersPerSecond, RadiansPerSecond, SystemId};

use super::wire_stamp::WireStamp;

/// GLOBAL_POSITION_INT (33).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GlobalPosition {
    pub stamp: WireStamp,
    pub position: GeodeticPoint,
    /// Above mean sea level.
    pub altitude: Meters,
    pub east_speed: MetersPerSecond,
    pub north_speed: MetersPerSecond,
    /// `None` while it is unknown.
    pub heading: Option<Heading>,
}

/// A position of the Earth that belongs to the arena, in HOME_POSITION (242) and GPS_GLOBAL_ORIGIN (49).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GlobalReference {
    pub stamp: WireStamp,
    pub position: GeodeticPoint,
    /// Above mean sea level.
    pub altitude: Meters,
}

/// SET_GPS_GLOBAL_ORIGIN (48).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetGlobalOrigin {
    /// 0 for all systems.
    pub system: SystemId,
    pub position: GeodeticPoint,
    /// Above mean sea level.
    pub altitude: Meters,
}

/// VFR_HUD (74), the parts that a robot on the ground has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadUpDisplay {
    pub ground_speed: MetersPerSecond,
    pub heading: Heading,
    /// Above mean sea level.
    pub altitude: Meters,
}

/// ATTITUDE_QUATERNION (31), the planar parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeQuaternion {
    pub stamp: WireStamp,
    pub heading: Heading,
    /// Counter-clockwise positive.
    pub turn_rate: RadiansPerSecond,
}

/// A battery as its robot describes it, in SYS_STATUS (1) and BATTERY_STATUS (147).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Battery {
    pub voltage_v: Option<f64>,
    /// Out of the battery.
    pub current_a: Option<f64>,
    /// Of a full battery, 0 to 1.
    pub remaining: Option<f64>,
}

/// SYS_STATUS (1), the parts that are known of any robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SystemStatus {
    /// MAV_SYS_STATUS_SENSOR bits of the sensors that are there.
    pub sensors_present: u32,
    /// Of these, those that are heard and used.
    pub sensors_healthy: u32,
    pub battery: Battery,
}

/// MANUAL_CONTROL (69): a stick or the keys of a ground station.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ManualControl {
    pub system: SystemId,
    /// -1 to 1, forward positive; `None` for an axis that the sender does not have.
    pub forward: Option<f64>,
    /// -1 to 1, counter-clockwise positive.
    pub turn: Option<f64>,
}

/// SET_POSITION_TARGET_LOCAL_NED (84) with speeds in the vehicle's own axes, or with a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionTarget {
    pub target: Address,
    pub setpoint: Setpoint,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setpoint {
    /// In the arena: `x` is east, `y` north.
    Position { x: Meters, y: Meters },
    /// Along the body's x axis, and about the vertical.
    BodyVelocity { forward: MetersPerSecond, turn: RadiansPerSecond },
    /// Another frame, or a combination of fields that no robot here follows.
    Unsupported,
}

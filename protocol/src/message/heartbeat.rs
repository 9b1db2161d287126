//! HEARTBEAT (0).

/// A participant's description of itself, sent once per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// MAV_TYPE, e.g. 10 ground rover, 18 onboard controller, 30 camera, 6 ground station.
    pub vehicle_type: u8,
    /// MAV_AUTOPILOT, e.g. 0 generic, 8 invalid (not an autopilot).
    pub autopilot: u8,
    /// MAV_MODE_FLAG bits; 0 unless something is armed.
    pub base_mode: u8,
    /// MAV_STATE, e.g. 4 active.
    pub system_status: u8,
}

impl Heartbeat {
    /// An active robot: MAV_TYPE_GROUND_ROVER, MAV_AUTOPILOT_GENERIC, MAV_STATE_ACTIVE (minimal.xml).
    pub const ROVER: Self = Self { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };
    /// An active camera: MAV_TYPE_CAMERA, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE (minimal.xml).
    pub const CAMERA: Self = Self { vehicle_type: 30, autopilot: Self::NOT_AN_AUTOPILOT, ..Self::ROVER };

    /// MAV_AUTOPILOT_INVALID.
    pub const NOT_AN_AUTOPILOT: u8 = 8;
    /// MAV_TYPE_GCS.
    const GROUND_STATION: u8 = 6;

    /// Some ground stations claim an autopilot.
    pub const fn is_ground_station(self) -> bool {
        self.vehicle_type == Self::GROUND_STATION
    }

    /// Whether its sender is no camera, ground station or companion computer.
    pub const fn is_vehicle(self) -> bool {
        self.autopilot != Self::NOT_AN_AUTOPILOT && !self.is_ground_station()
    }
}

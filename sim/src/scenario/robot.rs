//! The nominal robot, its deviations, and the brick: clock, protocol, program, sensors.

use posebridge_telemetry::{Address, SystemId, TimeDelta};
use serde::Deserialize;

/// The nominal robot. Defaults: a LEGO NXT on 56 mm wheels.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotSettings {
    pub wheel_radius_m: f64,
    pub track_width_m: f64,
    /// Of the whole robot; each wheel carries half.
    pub mass_kg: f64,
    /// Total play between each encoder and its wheel.
    pub backlash_deg: f64,
    pub battery_v: f64,
    /// The voltage stays at 5 V or above.
    pub battery_drop_v_per_min: f64,
    pub motor: MotorSettings,
}

impl Default for RobotSettings {
    fn default() -> Self {
        Self {
            wheel_radius_m: 0.028,
            track_width_m: 0.112,
            mass_kg: 0.7,
            // +-2 degrees (Scholer, NXT motor control).
            backlash_deg: 4.0,
            battery_v: 8.0,
            battery_drop_v_per_min: 0.01,
            motor: MotorSettings::default(),
        }
    }
}

/// Defaults: the LEGO NXT motor as Pybricks identified it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotorSettings {
    /// Kt/R.
    pub torque_n_m_per_v: f64,
    /// Ke.
    pub back_emf_v_s_per_rad: f64,
    /// J at the output shaft.
    pub inertia_kg_m2: f64,
    /// Coulomb friction.
    pub friction_n_m: f64,
}

impl Default for MotorSettings {
    fn default() -> Self {
        Self { torque_n_m_per_v: 0.0618, back_emf_v_s_per_rad: 0.487, inertia_kg_m2: 3.07e-3, friction_n_m: 0.0204 }
    }
}

impl MotorSettings {
    /// `load_kg_m2` is the inertia besides its own, at the output shaft.
    pub(crate) fn time_constant_s(&self, load_kg_m2: f64) -> f64 {
        (self.inertia_kg_m2 + load_kg_m2) / (self.torque_n_m_per_v * self.back_emf_v_s_per_rad)
    }
}

/// Deviations of the real robot from the nominal one. Each relative error is a fixed part plus a sigma times a draw.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ErrorSettings {
    /// Relative, of both radii.
    pub radius_error: f64,
    pub radius_error_sigma: f64,
    /// Right radius minus left radius, as a fraction of their mean.
    pub radius_mismatch: f64,
    pub radius_mismatch_sigma: f64,
    /// Relative.
    pub track_error: f64,
    pub track_error_sigma: f64,
    /// Slip of each wheel: sigma per square root of its travel.
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Slip in turns: sigma of the heading per square root of the turn.
    pub turn_rad_per_sqrt_rad: f64,
    /// Events in which a wheel spins without grip for 10 to 40 counts, per minute of motion.
    pub slip_events_per_min: f64,
    /// Disturbances that turn the robot by 3 to 8 degrees unseen by the encoders, per minute of motion.
    pub kicks_per_min: f64,
}

impl Default for ErrorSettings {
    fn default() -> Self {
        Self {
            radius_error: 0.0,
            radius_error_sigma: 0.005,
            radius_mismatch: 0.0,
            radius_mismatch_sigma: 0.005,
            track_error: 0.0,
            track_error_sigma: 0.02,
            wheel_travel_m_per_sqrt_m: 0.0008,
            turn_rad_per_sqrt_rad: 0.004,
            slip_events_per_min: 0.0,
            kicks_per_min: 0.0,
        }
    }
}

impl ErrorSettings {
    /// No deviations: the encoders' readings are exact.
    pub const fn none() -> Self {
        Self {
            radius_error: 0.0,
            radius_error_sigma: 0.0,
            radius_mismatch: 0.0,
            radius_mismatch_sigma: 0.0,
            track_error: 0.0,
            track_error_sigma: 0.0,
            wheel_travel_m_per_sqrt_m: 0.0,
            turn_rad_per_sqrt_rad: 0.0,
            slip_events_per_min: 0.0,
            kicks_per_min: 0.0,
        }
    }
}

/// The telemetry messages of the brick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wire {
    /// `PB_WHEEL_TICKS` and `PB_INERTIAL`, for slow links; timestamps are a 32-bit register that wraps.
    #[default]
    Compact,
    /// `WHEEL_DISTANCE` and `SCALED_IMU`, for any ground station; timestamps do not wrap within a run.
    Standard,
}

/// How an EV3 answers a request to a missing sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MissingSensor {
    /// With NaN.
    #[default]
    Answered,
    /// Not at all until the next command: it waits for the sensor.
    Awaited,
}

/// Clock, telemetry, protocol and program of the brick.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BrickSettings {
    /// Default rate of wheel and inertial messages; a station may request another.
    pub telemetry_hz: f64,
    pub wire: Wire,
    /// MAVLink system id of brick and camera.
    pub system: u8,
    /// Start value; just below 2^32 makes the register wrap early.
    pub clock_start_micros: u64,
    pub clock_skew_ppm: f64,
    pub clock_tick_micros: u32,
    pub personality: Personality,
    /// Running from power-up.
    pub program: BrickProgram,
    /// Interval of program restarts, at which a LEGO brick zeroes its counters; `None` for no restarts.
    pub program_restart_s: Option<f64>,
    pub missing_sensor: MissingSensor,
    /// Turn-around of the radio of an NXT or EV3, from receiving to sending; `None` for that of the personality.
    pub turn_around_ms: Option<f64>,
    /// Longest telegram of an NXT's firmware; 64 for old ones.
    pub telegram_bytes: usize,
    /// In the sensor ports 1 to 4 of an NXT.
    pub sensors: [PortSensor; 4],
    /// A wall across the arena at this x, for the ultrasonic sensor.
    pub wall_x_m: Option<f64>,
}

impl Default for BrickSettings {
    fn default() -> Self {
        Self {
            telemetry_hz: 20.0,
            wire: Wire::default(),
            system: 1,
            clock_start_micros: 5_000_000,
            clock_skew_ppm: 60.0,
            clock_tick_micros: 1_000,
            personality: Personality::default(),
            program: BrickProgram::default(),
            program_restart_s: None,
            missing_sensor: MissingSensor::default(),
            turn_around_ms: None,
            telegram_bytes: 128,
            sensors: PortSensor::USUAL,
            wall_x_m: None,
        }
    }
}

impl BrickSettings {
    /// Minimum from the last byte of a request to the first of its reply.
    pub(crate) fn turn_around(&self) -> TimeDelta {
        let usual_ms = self.personality.turn_around_ms();
        TimeDelta::from_secs_f64(self.turn_around_ms.unwrap_or(usual_ms) * 1e-3)
    }

    pub fn address_of(&self, component: Address) -> Address {
        Address { system: SystemId(self.system), ..component }
    }
}

/// The protocol of a simulated brick's link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Personality {
    /// MAVLink 2, with the camera on the same link.
    #[default]
    Mavlink,
    /// The telegrams of an unmodified LEGO NXT, which never sends unsolicited data. The camera has a separate link.
    Nxt,
    /// A LEGO NXT whose program pushes a compact MAVLink frame in each telegram. The camera has a separate link.
    NxtPush,
    /// The direct and system commands of an unmodified LEGO EV3. The camera has a separate link.
    Ev3,
    /// A board that prints lines of text (`[text_board]`) and hears nothing. The camera has a separate link.
    Line,
}

impl Personality {
    /// Whether brick and camera are on one link.
    pub const fn shares_link_with_camera(self) -> bool {
        matches!(self, Self::Mavlink)
    }

    /// Default turn-around of its radio.
    pub(crate) const fn turn_around_ms(self) -> f64 {
        match self {
            Self::Mavlink | Self::Line => 0.0,
            // LEGO's own figure for the Bluetooth chip of the NXT, which the RWTH Aachen toolbox waits for.
            Self::Nxt | Self::NxtPush => 30.0,
            // No trustworthy figure is published; ours, from the 20 to 60 ms that people report.
            Self::Ev3 => 20.0,
        }
    }
}

/// The program of an NXT or EV3 at power-up. A MAVLink brick sends nothing without its program, so there it always runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BrickProgram {
    /// Drives the scenario's path and reads estimates from its mailbox.
    #[default]
    Path,
    /// The motors turn only on the station's commands.
    None,
}

/// The sensor in a port of the NXT.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PortSensor {
    #[default]
    None,
    /// HiTechnic gyro, analog.
    Gyro,
    /// HiTechnic accelerometer, on I2C.
    Accelerometer,
    /// HiTechnic compass, on I2C.
    Compass,
    /// LEGO ultrasonic sensor, on I2C.
    Ultrasonic,
    /// LEGO temperature sensor 9749, on I2C.
    Temperature,
}

impl PortSensor {
    /// Default sensors.
    pub(crate) const USUAL: [Self; 4] = [Self::Gyro, Self::Accelerometer, Self::Compass, Self::Ultrasonic];
}

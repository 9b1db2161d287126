//! The robot as its brick is configured, how the real one differs, and the brick itself: clock, protocol, program, plugged sensors.

use posebridge_telemetry::{Address, SystemId, TimeDelta};
use serde::Deserialize;

use crate::checks;

/// The robot as its brick is configured. Defaults: a LEGO NXT on 56 mm wheels.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotSettings {
    #[serde(deserialize_with = "checks::positive")]
    pub wheel_radius_m: f64,
    /// Distance between the wheels, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub track_width_m: f64,
    /// Mass of the whole robot, in kilograms; half of it rides on each wheel.
    #[serde(deserialize_with = "checks::non_negative")]
    pub mass_kg: f64,
    /// Play between each encoder and its wheel, in degrees in all.
    #[serde(deserialize_with = "checks::non_negative")]
    pub backlash_deg: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub battery_v: f64,
    /// How fast it runs down, in volts per minute; it stays at 5 V or above.
    #[serde(deserialize_with = "checks::non_negative")]
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

/// A motor. Defaults: the LEGO NXT motor as Pybricks identified it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotorSettings {
    /// Kt/R, in newton metres per volt.
    #[serde(deserialize_with = "checks::positive")]
    pub torque_n_m_per_v: f64,
    /// Ke, in volt seconds per radian.
    #[serde(deserialize_with = "checks::positive")]
    pub back_emf_v_s_per_rad: f64,
    /// J at the output shaft, in kilogram square metres.
    #[serde(deserialize_with = "checks::positive")]
    pub inertia_kg_m2: f64,
    /// Coulomb friction, in newton metres.
    #[serde(deserialize_with = "checks::non_negative")]
    pub friction_n_m: f64,
}

impl Default for MotorSettings {
    fn default() -> Self {
        Self { torque_n_m_per_v: 0.0618, back_emf_v_s_per_rad: 0.487, inertia_kg_m2: 3.07e-3, friction_n_m: 0.0204 }
    }
}

impl MotorSettings {
    /// With what the motor has to move besides itself, in kg m² at the output shaft.
    pub(crate) fn time_constant_s(&self, load_kg_m2: f64) -> f64 {
        (self.inertia_kg_m2 + load_kg_m2) / (self.torque_n_m_per_v * self.back_emf_v_s_per_rad)
    }
}

/// How the real robot differs from its brick's configuration. Each relative error is a fixed part plus a sigma times a draw.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ErrorSettings {
    /// Both radii larger by this fraction.
    #[serde(deserialize_with = "checks::relative")]
    pub radius_error: f64,
    /// Standard deviation of the drawn part.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_error_sigma: f64,
    /// Right radius minus left radius, as a fraction of their mean.
    #[serde(deserialize_with = "checks::relative")]
    pub radius_mismatch: f64,
    /// Standard deviation of the drawn part.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_mismatch_sigma: f64,
    /// Track wider by this fraction.
    #[serde(deserialize_with = "checks::relative")]
    pub track_error: f64,
    /// Standard deviation of the drawn part.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub track_error_sigma: f64,
    /// Slip of each wheel: sigma per square root of its path, in m per sqrt(m).
    #[serde(deserialize_with = "checks::non_negative")]
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Slip in turns: sigma of the heading per square root of the turn, in rad per sqrt(rad).
    #[serde(deserialize_with = "checks::non_negative")]
    pub turn_rad_per_sqrt_rad: f64,
    /// How often a wheel spins without grip for 10 to 40 counts, per minute of motion.
    #[serde(deserialize_with = "checks::non_negative")]
    pub slip_events_per_min: f64,
    /// How often something turns the robot by 3 to 8 degrees unseen by the encoders, per minute of motion.
    #[serde(deserialize_with = "checks::non_negative")]
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
    /// No difference at all: the encoders' readings are exact.
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

/// Which messages the brick sends its telemetry in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wire {
    /// `PB_WHEEL_TICKS` and `PB_INERTIAL`: for thin links; time stamps are a 32-bit register that wraps.
    #[default]
    Compact,
    /// `WHEEL_DISTANCE` and `SCALED_IMU`: understood everywhere; time stamps do not wrap within a run.
    Standard,
}

/// What an EV3 does that is to set up a sensor that is not there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MissingSensor {
    /// It answers with a value that is no number.
    #[default]
    Answered,
    /// It waits for the sensor, and answers nothing until the next command.
    Awaited,
}

/// The brick's clock and telemetry.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BrickSettings {
    /// How often wheels and inertial sensors are sent, in hertz, unless the station asks for something else.
    #[serde(deserialize_with = "checks::rate_hz")]
    pub telemetry_hz: f64,
    pub wire: Wire,
    /// The MAVLink system id of brick and camera.
    #[serde(deserialize_with = "checks::vehicle_system")]
    pub system: u8,
    /// What the clock shows at the beginning, in microseconds; just below 2^32 makes the register wrap early.
    #[serde(deserialize_with = "checks::clock_micros")]
    pub clock_start_micros: u64,
    /// The clock's rate minus one, in parts per million; positive runs fast.
    #[serde(deserialize_with = "checks::skew_ppm")]
    pub clock_skew_ppm: f64,
    #[serde(deserialize_with = "checks::tick_micros")]
    pub clock_tick_micros: u32,
    /// The protocol of its link.
    pub personality: Personality,
    /// What runs on it from the beginning.
    pub program: BrickProgram,
    /// Interval in seconds after which the program is stopped and started again: a LEGO brick then zeroes its counters. Without it never.
    #[serde(deserialize_with = "checks::restart_interval_s")]
    pub program_restart_s: Option<f64>,
    /// What an EV3 does that is to set up a sensor that is not there.
    pub missing_sensor: MissingSensor,
    /// Time that the radio of an NXT or EV3 needs to turn from receiving to sending, in milliseconds; without it that of the personality.
    #[serde(deserialize_with = "checks::turn_around_ms")]
    pub turn_around_ms: Option<f64>,
    /// Longest telegram that an NXT's firmware takes and sends, in bytes; 64 for old ones.
    #[serde(deserialize_with = "checks::telegram_bytes")]
    pub telegram_bytes: usize,
    /// What is plugged into the sensor ports 1 to 4 of an NXT.
    pub sensors: [PortSensor; 4],
    /// A wall across the arena at this x, which the ultrasonic sensor sees; without it there is none.
    #[serde(deserialize_with = "checks::optional_finite")]
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
    /// From the last byte of a request to the first of its answer, at least.
    pub(crate) fn turn_around(&self) -> TimeDelta {
        let usual_ms = self.personality.turn_around_ms();
        TimeDelta::from_secs_f64(self.turn_around_ms.unwrap_or(usual_ms) * 1e-3)
    }

    pub fn address_of(&self, component: Address) -> Address {
        Address { system: SystemId(self.system), ..component }
    }
}

/// The protocol of a brick's link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Personality {
    /// MAVLink 2, together with the camera on one link.
    #[default]
    Mavlink,
    /// The telegrams of an unmodified LEGO NXT, which answers and never sends first. The camera has a link of its own.
    Nxt,
    /// A LEGO NXT whose program pushes a compact MAVLink frame in each telegram. The camera has a link of its own.
    NxtPush,
    /// The direct and system commands of an unmodified LEGO EV3. The camera has a link of its own.
    Ev3,
}

impl Personality {
    /// Whether brick and camera use the same protocol on one link.
    pub const fn shares_link_with_camera(self) -> bool {
        matches!(self, Self::Mavlink)
    }

    /// What its radio usually needs to turn around, in milliseconds.
    pub(crate) const fn turn_around_ms(self) -> f64 {
        match self {
            Self::Mavlink => 0.0,
            // LEGO's own figure for the Bluetooth chip of the NXT, which the RWTH Aachen toolbox waits for.
            Self::Nxt | Self::NxtPush => 30.0,
            // No trustworthy figure is published; ours, from the 20 to 60 ms that people report.
            Self::Ev3 => 20.0,
        }
    }
}

/// What runs on an NXT or EV3 from the beginning. A MAVLink brick without its program would be mute, so it always runs there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BrickProgram {
    /// A program that drives the scenario's path and takes the estimate out of its mailbox.
    #[default]
    Path,
    /// None: motors turn only when the station says so.
    None,
}

/// A sensor in a port of the NXT.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PortSensor {
    /// Nothing.
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
    /// What is plugged in unless the scenario says otherwise.
    pub(crate) const USUAL: [Self; 4] = [Self::Gyro, Self::Accelerometer, Self::Compass, Self::Ultrasonic];
}

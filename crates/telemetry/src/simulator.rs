//! Commands to the simulated brick while it drives: faults, and steering.
//!
//! They are [`Command`](crate::Command)s like the others and so part of a recording; the station passes them on as a
//! [`Request`](crate::Request), and the program that runs the simulated brick carries them out. docs/simulator.md describes each.

use std::f64::consts::PI;
use std::fmt;
use std::ops::RangeInclusive;

use crate::clock::TimeDelta;
use crate::ids::ChannelName;
use crate::observation::SensorSwitch;

/// The name of a link profile: that of a file in `config/links/` without its ending.
pub type ProfileName = ChannelName;

/// A command to the simulated brick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SimulatorCommand {
    /// Carry the robot elsewhere; its wheels spin in the air, and the encoders count.
    Kidnap {
        /// Along its own x axis.
        forward_m: f64,
        /// Along its own y axis.
        left_m: f64,
        /// Counter-clockwise.
        turn_rad: f64,
    },
    /// Wheels lose grip: the encoders count, but the robot moves less.
    Slip {
        wheel: SlippingWheel,
        /// The share of their travel that is lost: 0 is full grip, 1 spins on the spot.
        factor: f64,
        duration: TimeDelta,
    },
    /// Uncover or cover the camera.
    Camera(SensorSwitch),
    CameraDelay {
        /// From the middle of the exposure to the first byte.
        delay: TimeDelta,
    },
    GyroBiasStep {
        rad_per_s: f64,
    },
    /// Impair the brick's link by a profile, or stop impairing it.
    LinkProfile(Option<ProfileName>),
    PullCable {
        duration: TimeDelta,
    },
    Steering(SteeringSource),
    /// Drive by hand; holds for [`DRIVE_HOLD_TIME`].
    Drive {
        forward_m_per_s: f64,
        /// Counter-clockwise.
        turn_rad_per_s: f64,
    },
    /// Return to the path, at its nearest point.
    Path,
}

/// How long the brick drives at a speed set by hand; then it stops, unless the command comes again. Keyboards repeat a held key after 250 ms to
/// 500 ms, so the brick does not stop while a key is held.
pub const DRIVE_HOLD_TIME: TimeDelta = TimeDelta::from_millis(500);

/// The wheels that lose grip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlippingWheel {
    Left,
    Right,
    Both,
}

impl SlippingWheel {
    pub const ALL: [Self; 3] = [Self::Left, Self::Right, Self::Both];

    /// The value in a command's JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Both => "both",
        }
    }
}

/// The pose by which the simulated brick steers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SteeringSource {
    /// Its own dead reckoning.
    Odometry,
    /// The station's estimate.
    Estimate,
}

impl SteeringSource {
    pub const ALL: [Self; 2] = [Self::Odometry, Self::Estimate];

    /// The value in a command's JSON.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::Estimate => "estimate",
        }
    }
}

/// A number of a command and its permitted range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberField {
    /// The command's name in JSON.
    pub command: &'static str,
    /// The field's name in JSON, with its unit.
    pub field: &'static str,
    pub minimum: f64,
    pub maximum: f64,
}

impl NumberField {
    pub const fn range(&self) -> RangeInclusive<f64> {
        self.minimum..=self.maximum
    }

    fn validate(&'static self, value: f64) -> Result<(), OutOfRange> {
        // NaN is in no range.
        if self.range().contains(&value) { Ok(()) } else { Err(OutOfRange { field: self, value }) }
    }
}

/// A number of a command that is out of its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfRange {
    pub field: &'static NumberField,
    pub value: f64,
}

impl fmt::Display for OutOfRange {
    // At most 50 characters, the length of a STATUSTEXT.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let NumberField { command, field, minimum: least, maximum: most } = self.field;
        write!(f, "{command}: {field} {:?} not in {least}..{most}", self.value)
    }
}

impl std::error::Error for OutOfRange {}

/// Every number of every command, with its range.
///
/// Lengths: the arenas of the bundled scenarios are smaller than 10 m. Times: from a tenth of a second, shorter than a person unplugs a cable,
/// to a minute. Delay: 5 s is longer than the filter keeps its history. Bias: 1 rad/s is ten times that of the cheap gyro of
/// docs/simulator.md. Speeds: more than the simulated motors reach (0.44 m/s at 8 V), so the limit means "full speed".
pub const NUMBER_FIELDS: [&NumberField; 10] = [
    &KIDNAP_FORWARD,
    &KIDNAP_LEFT,
    &KIDNAP_TURN,
    &SLIP_FACTOR,
    &SLIP_SECONDS,
    &CAMERA_DELAY,
    &GYRO_BIAS,
    &CABLE_SECONDS,
    &DRIVE_FORWARD,
    &DRIVE_TURN,
];

/// A division is exact for whole seconds; the product in `TimeDelta::as_secs_f64` is not, and would put 60 s out of range.
const NANOS_PER_SECOND: f64 = 1e9;
const NANOS_PER_MILLISECOND: f64 = 1e6;

static KIDNAP_FORWARD: NumberField =
    NumberField { command: "kidnap", field: "forward_m", minimum: -10.0, maximum: 10.0 };
static KIDNAP_LEFT: NumberField = NumberField { command: "kidnap", field: "left_m", minimum: -10.0, maximum: 10.0 };
static KIDNAP_TURN: NumberField = NumberField { command: "kidnap", field: "turn_rad", minimum: -PI, maximum: PI };
static SLIP_FACTOR: NumberField = NumberField { command: "slip", field: "factor", minimum: 0.0, maximum: 1.0 };
static SLIP_SECONDS: NumberField = NumberField { command: "slip", field: "seconds", minimum: 0.1, maximum: 60.0 };
static CAMERA_DELAY: NumberField =
    NumberField { command: "camera-delay", field: "delay_ms", minimum: 0.0, maximum: 5_000.0 };
static GYRO_BIAS: NumberField =
    NumberField { command: "gyro-bias-step", field: "rad_per_s", minimum: -1.0, maximum: 1.0 };
static CABLE_SECONDS: NumberField =
    NumberField { command: "pull-cable", field: "seconds", minimum: 0.1, maximum: 60.0 };
static DRIVE_FORWARD: NumberField =
    NumberField { command: "drive", field: "forward_m_per_s", minimum: -1.0, maximum: 1.0 };
static DRIVE_TURN: NumberField = NumberField { command: "drive", field: "turn_rad_per_s", minimum: -6.3, maximum: 6.3 };

impl SimulatorCommand {
    /// Its name in JSON.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Kidnap { .. } => "kidnap",
            Self::Slip { .. } => "slip",
            Self::Camera(_) => "camera",
            Self::CameraDelay { .. } => "camera-delay",
            Self::GyroBiasStep { .. } => "gyro-bias-step",
            Self::LinkProfile(_) => "link-profile",
            Self::PullCable { .. } => "pull-cable",
            Self::Steering(_) => "steering",
            Self::Drive { .. } => "drive",
            Self::Path => "path",
        }
    }

    /// Fails if a number is out of its range or not finite.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        match *self {
            Self::Kidnap { forward_m, left_m, turn_rad } => {
                KIDNAP_FORWARD.validate(forward_m)?;
                KIDNAP_LEFT.validate(left_m)?;
                KIDNAP_TURN.validate(turn_rad)
            }
            Self::Slip {
                wheel: SlippingWheel::Left | SlippingWheel::Right | SlippingWheel::Both,
                factor,
                duration,
            } => {
                SLIP_FACTOR.validate(factor)?;
                SLIP_SECONDS.validate(duration.as_nanos() as f64 / NANOS_PER_SECOND)
            }
            Self::CameraDelay { delay } => CAMERA_DELAY.validate(delay.as_nanos() as f64 / NANOS_PER_MILLISECOND),
            Self::GyroBiasStep { rad_per_s } => GYRO_BIAS.validate(rad_per_s),
            Self::PullCable { duration } => CABLE_SECONDS.validate(duration.as_nanos() as f64 / NANOS_PER_SECOND),
            Self::Drive { forward_m_per_s, turn_rad_per_s } => {
                DRIVE_FORWARD.validate(forward_m_per_s)?;
                DRIVE_TURN.validate(turn_rad_per_s)
            }
            Self::Camera(SensorSwitch::On | SensorSwitch::Off)
            | Self::LinkProfile(_)
            | Self::Steering(_)
            | Self::Path => Ok(()),
        }
    }
}

impl fmt::Display for SimulatorCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name();
        match self {
            Self::Kidnap { forward_m, left_m, turn_rad } => {
                write!(f, "{name}: {forward_m:.2} m forward, {left_m:.2} m left, {:.0} deg", turn_rad.to_degrees())
            }
            Self::Slip { wheel, factor, duration } => {
                write!(f, "{name}: {} lost {:.0} % for {:.1} s", wheel.as_str(), factor * 100.0, duration.as_secs_f64())
            }
            Self::Camera(SensorSwitch::On) => write!(f, "{name}: on"),
            Self::Camera(SensorSwitch::Off) => write!(f, "{name}: off"),
            Self::CameraDelay { delay } => write!(f, "{name}: {:.0} ms", delay.as_millis_f64()),
            Self::GyroBiasStep { rad_per_s } => write!(f, "{name}: {rad_per_s} rad/s"),
            Self::LinkProfile(Some(profile)) => write!(f, "{name}: {profile}"),
            Self::LinkProfile(None) => write!(f, "{name}: none"),
            Self::PullCable { duration } => write!(f, "{name}: {:.1} s", duration.as_secs_f64()),
            Self::Steering(source) => write!(f, "{name}: by {}", source.as_str()),
            Self::Drive { forward_m_per_s, turn_rad_per_s } => {
                write!(f, "{name}: {forward_m_per_s:.2} m/s, {turn_rad_per_s:.2} rad/s")
            }
            Self::Path => write!(f, "{name}: followed again"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_out_of_its_range_is_named() {
        let slip = |factor, millis| SimulatorCommand::Slip {
            wheel: SlippingWheel::Both,
            factor,
            duration: TimeDelta::from_millis(millis),
        };
        assert_eq!(slip(1.0, 60_000).validate(), Ok(()));
        let validation_error = |command: SimulatorCommand| command.validate().unwrap_err().to_string();
        assert_eq!(validation_error(slip(1.5, 1_000)), "slip: factor 1.5 not in 0..1");
        assert_eq!(validation_error(slip(0.5, 0)), "slip: seconds 0.0 not in 0.1..60");
        let kidnap = SimulatorCommand::Kidnap { forward_m: 0.0, left_m: f64::NAN, turn_rad: 0.0 };
        assert_eq!(validation_error(kidnap), "kidnap: left_m NaN not in -10..10");
    }

    #[test]
    fn what_happens_fits_into_a_line_of_mavlink() {
        let profile = ProfileName::from_bytes(b"bluetooth-spp");
        for (command, line) in [
            (
                SimulatorCommand::Kidnap { forward_m: -10.0, left_m: -10.0, turn_rad: -PI },
                "kidnap: -10.00 m forward, -10.00 m left, -180 deg",
            ),
            (SimulatorCommand::LinkProfile(Some(profile)), "link-profile: bluetooth-spp"),
            (SimulatorCommand::Steering(SteeringSource::Odometry), "steering: by odometry"),
        ] {
            assert_eq!(command.to_string(), line);
            // MAVLink's STATUSTEXT holds 50 characters.
            assert!(line.len() <= 50, "{line}");
        }
    }
}

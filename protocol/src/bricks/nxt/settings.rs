//! The settings of an NXT: the motors of the wheels, and the sensor at each port.

use posebridge_telemetry::TimeDelta;
use thiserror::Error;

/// Longest wait for a reply; other programs wait from 0.5 s to 2 s (RWTH Aachen NXT toolbox: 2 s).
const ANSWER_TIMEOUT: TimeDelta = TimeDelta::from_millis(500);
/// Mailboxes that a host may write to (LEGO MINDSTORMS NXT Bluetooth Developer Kit, appendix 2, MESSAGEWRITE).
const MAILBOXES: u8 = 10;

/// A motor's port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotorPort {
    A,
    B,
    C,
}

impl MotorPort {
    pub const ALL: [Self; 3] = [Self::A, Self::B, Self::C];

    /// Its number on the wire.
    pub const fn number(self) -> u8 {
        self as u8
    }

    pub(super) const fn index(self) -> usize {
        self as usize
    }
}

/// The orientation of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotorMounting {
    /// The count increases when the robot drives forward.
    #[default]
    Forward,
    /// The count decreases when the robot drives forward.
    Backward,
}

/// The motor of one wheel: port and orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WheelMotor {
    pub port: MotorPort,
    pub mounting: MotorMounting,
}

/// The axis of an accelerometer that points forward.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForwardAxis {
    #[default]
    X,
    MinusX,
    Y,
    MinusY,
    Z,
    MinusZ,
}

/// The position of an accelerometer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AccelerometerMounting {
    Left,
    Right,
    /// Between the wheels.
    #[default]
    Centre,
}

/// A sensor at a port, with its resolution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NxtSensor {
    #[default]
    None,
    /// HiTechnic NGY1044, one degree per second and count.
    HtGyro,
    /// HiTechnic NAC1040, 200 counts per g.
    HtAccelerometer { forward: ForwardAxis, place: AccelerometerMounting },
    /// HiTechnic NMC1034, one degree.
    HtCompass,
    /// LEGO 9846, one centimetre, looking forward.
    Ultrasonic,
    /// LEGO 9749, 1/16 of a degree Celsius.
    Temperature,
}

/// The sign of a gyro's readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroSign {
    /// The reading increases when the robot turns counter-clockwise, seen from above.
    #[default]
    CounterClockwise,
    /// The reading increases when the robot turns clockwise: the sensor is mounted upside down.
    Clockwise,
}

/// The number of outstanding requests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaxOutstanding {
    /// Every firmware supports one.
    #[default]
    One,
    /// Two, if a trial at connect shows that the brick answers both.
    Two,
}

/// How the readings of the wheels come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WheelSource {
    /// The brick is asked for them.
    Polled,
    /// A program on the brick sends MAVLink 2 frames.
    Pushed,
}

/// The settings of one NXT.
#[derive(Clone, Debug, PartialEq)]
pub struct NxtSettings {
    pub left_motor: WheelMotor,
    pub right_motor: WheelMotor,
    /// At the ports 1 to 4.
    pub sensors: [NxtSensor; 4],
    /// The gyro's reading at rest; `None` learns it while both wheels are at rest.
    pub gyro_rest_counts: Option<f64>,
    pub gyro_sign: GyroSign,
    pub compass_zero_deg: f64,
    /// The mailbox for the estimate, 0 to 9.
    pub mailbox: u8,
    /// Shortest time between two estimates; `None` is 200 ms for a program that pushes, and no limit for a polled
    /// brick.
    pub estimate_interval: Option<TimeDelta>,
    pub outstanding: MaxOutstanding,
    pub answer_timeout: TimeDelta,
}

impl Default for NxtSettings {
    /// The robot of LEGO's building instructions: left wheel at B, right wheel at C, no sensor.
    fn default() -> Self {
        let motor = |port| WheelMotor { port, mounting: MotorMounting::Forward };
        Self {
            left_motor: motor(MotorPort::B),
            right_motor: motor(MotorPort::C),
            sensors: [NxtSensor::None; 4],
            gyro_rest_counts: None,
            gyro_sign: GyroSign::default(),
            compass_zero_deg: 0.0,
            mailbox: 0,
            estimate_interval: None,
            outstanding: MaxOutstanding::default(),
            answer_timeout: ANSWER_TIMEOUT,
        }
    }
}

/// Why settings are invalid.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum NxtSettingsError {
    #[error("both wheels are at motor port {0:?}")]
    OneMotor(MotorPort),
    #[error("mailbox {0} does not exist: a brick has 0 to 9")]
    Mailbox(u8),
    /// Outside the range of the ten-bit converter.
    #[error("a gyro cannot read {0} at rest: the reading lies between 0 and 1023")]
    GyroRest(f64),
    #[error("the compass zero is {0} degrees, which is no direction")]
    CompassZero(f64),
    #[error("the longest wait for an answer is {0} ms, but must be more than zero")]
    AnswerTimeout(f64),
}

impl NxtSettings {
    /// Returns the first invalid setting as the error.
    pub fn validate(&self) -> Result<(), NxtSettingsError> {
        if self.left_motor.port == self.right_motor.port {
            return Err(NxtSettingsError::OneMotor(self.left_motor.port));
        }
        if self.mailbox >= MAILBOXES {
            return Err(NxtSettingsError::Mailbox(self.mailbox));
        }
        if let Some(rest) = self.gyro_rest_counts
            && !(0.0..=1023.0).contains(&rest)
        {
            return Err(NxtSettingsError::GyroRest(rest));
        }
        if !self.compass_zero_deg.is_finite() {
            return Err(NxtSettingsError::CompassZero(self.compass_zero_deg));
        }
        if self.answer_timeout <= TimeDelta::ZERO {
            let millis = self.answer_timeout.as_millis_f64();
            return Err(NxtSettingsError::AnswerTimeout(millis));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_of_no_robot_are_refused_by_name() {
        let sound = NxtSettings::default();
        assert_eq!(sound.validate(), Ok(()));
        let one = NxtSettings { right_motor: sound.left_motor, ..NxtSettings::default() };
        assert_eq!(one.validate().unwrap_err().to_string(), "both wheels are at motor port B");
        let mailbox = NxtSettings { mailbox: 10, ..NxtSettings::default() };
        assert_eq!(mailbox.validate(), Err(NxtSettingsError::Mailbox(10)));
        for rest in [f64::NAN, -1.0, 1024.0] {
            let gyro = NxtSettings { gyro_rest_counts: Some(rest), ..NxtSettings::default() };
            assert!(matches!(gyro.validate(), Err(NxtSettingsError::GyroRest(_))));
        }
        let compass = NxtSettings { compass_zero_deg: f64::INFINITY, ..NxtSettings::default() };
        assert!(compass.validate().is_err());
        let hasty = NxtSettings { answer_timeout: TimeDelta::ZERO, ..NxtSettings::default() };
        assert!(hasty.validate().is_err());
    }
}

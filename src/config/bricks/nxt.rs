//! `[robot.nxt]`: which motor of an NXT is which wheel, and what is plugged in at its ports.

use anyhow::{Context, Result, ensure};
use posebridge_protocol::bricks::nxt::{
    AccelerometerMounting, ForwardAxis, GyroSign, MaxOutstanding, MotorMounting, MotorPort, NxtSensor, NxtSettings,
    WheelMotor,
};
use posebridge_telemetry::TimeDelta;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One NXT. Without this section: left wheel at B, right wheel at C, no sensor.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct NxtSection {
    /// The left wheel's motor: A, B or C, with a minus in front if its count falls when the robot drives forward.
    pub left_motor: String,
    /// The right wheel's motor.
    pub right_motor: String,
    /// What is plugged in, one entry for each port.
    #[serde(rename = "sensor", skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<NxtSensorSection>,
    /// What the gyro reads at rest, in counts; without it that is learned while both wheels stand.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gyro_rest: Option<f64>,
    /// The gyro reads more when the robot turns clockwise, seen from above: it hangs upside down.
    pub gyro_clockwise: bool,
    /// What the compass reads when the robot points along the arena's x axis.
    pub compass_zero_deg: f64,
    /// The mailbox that takes the estimate, 0 to 9.
    pub mailbox: u8,
    /// Shortest time between two estimates to the brick; without it 200 for `nxt-push`, whose radio each of them turns around, and 0 for `nxt`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimate_interval_ms: Option<u32>,
    /// How many questions may wait at the same time: 1, or 2 if a trial at connect shows that the brick answers both.
    pub outstanding: u8,
    /// Longest wait for an answer.
    pub answer_timeout_ms: u32,
}

/// A sensor of an NXT.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct NxtSensorSection {
    /// Its port, 1 to 4.
    pub port: u8,
    /// What it is.
    pub kind: NxtSensorKind,
    /// The axis of an accelerometer that points forward: x, -x, y, -y, z or -z.
    #[serde(default = "x_axis")]
    pub forward: String,
    /// Where an accelerometer sits.
    #[serde(default)]
    pub place: Place,
}

/// Which sensor.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum NxtSensorKind {
    /// HiTechnic gyro.
    HtGyro,
    /// HiTechnic accelerometer.
    HtAccelerometer,
    /// HiTechnic compass.
    HtCompass,
    /// LEGO's ultrasonic sensor, looking forward.
    Ultrasonic,
    /// LEGO's temperature sensor.
    Temperature,
}

/// Where an accelerometer sits.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Place {
    /// Above the left wheel.
    Left,
    /// Above the right wheel.
    Right,
    /// Between them.
    #[default]
    Centre,
}

fn x_axis() -> String {
    "x".to_owned()
}

impl Default for NxtSection {
    fn default() -> Self {
        Self {
            left_motor: "B".to_owned(),
            right_motor: "C".to_owned(),
            sensors: Vec::new(),
            gyro_rest: None,
            gyro_clockwise: false,
            compass_zero_deg: 0.0,
            mailbox: 0,
            estimate_interval_ms: None,
            outstanding: 1,
            answer_timeout_ms: 500,
        }
    }
}

impl NxtSection {
    /// The settings of the codec.
    ///
    /// # Errors
    /// A value makes no sense; the message names its key.
    pub(super) fn settings(&self) -> Result<NxtSettings> {
        let settings = NxtSettings {
            left_motor: wheel_motor(&self.left_motor).context("`left_motor`")?,
            right_motor: wheel_motor(&self.right_motor).context("`right_motor`")?,
            sensors: self.ports()?,
            gyro_rest_counts: self.gyro_rest,
            gyro_sign: if self.gyro_clockwise { GyroSign::Clockwise } else { GyroSign::CounterClockwise },
            compass_zero_deg: self.compass_zero_deg,
            mailbox: self.mailbox,
            estimate_interval: self.estimate_interval_ms.map(|millis| TimeDelta::from_millis(i64::from(millis))),
            outstanding: match self.outstanding {
                1 => MaxOutstanding::One,
                2 => MaxOutstanding::Two,
                other => anyhow::bail!("`outstanding` is {other}, must be 1 or 2"),
            },
            answer_timeout: TimeDelta::from_millis(i64::from(self.answer_timeout_ms)),
        };
        settings.validate()?;
        Ok(settings)
    }

    fn ports(&self) -> Result<[NxtSensor; 4]> {
        let mut ports = [NxtSensor::None; 4];
        for (index, sensor) in self.sensors.iter().enumerate() {
            let number = index + 1;
            let place = usize::from(sensor.port)
                .checked_sub(1)
                .and_then(|place| ports.get_mut(place))
                .with_context(|| format!("`sensor`, number {number}: `port` is {}, must be 1 to 4", sensor.port))?;
            ensure!(
                *place == NxtSensor::None,
                "`sensor`, number {number}: there is a sensor at port {} already",
                sensor.port
            );
            *place = sensor.sensor().with_context(|| format!("`sensor`, number {number}"))?;
        }
        Ok(ports)
    }
}

impl NxtSensorSection {
    fn sensor(&self) -> Result<NxtSensor> {
        Ok(match self.kind {
            NxtSensorKind::HtGyro => NxtSensor::HtGyro,
            NxtSensorKind::HtAccelerometer => NxtSensor::HtAccelerometer {
                forward: match self.forward.as_str() {
                    "x" => ForwardAxis::X,
                    "-x" => ForwardAxis::MinusX,
                    "y" => ForwardAxis::Y,
                    "-y" => ForwardAxis::MinusY,
                    "z" => ForwardAxis::Z,
                    "-z" => ForwardAxis::MinusZ,
                    other => anyhow::bail!("`forward` is `{other}`, must be x, -x, y, -y, z or -z"),
                },
                place: match self.place {
                    Place::Left => AccelerometerMounting::Left,
                    Place::Right => AccelerometerMounting::Right,
                    Place::Centre => AccelerometerMounting::Centre,
                },
            },
            NxtSensorKind::HtCompass => NxtSensor::HtCompass,
            NxtSensorKind::Ultrasonic => NxtSensor::Ultrasonic,
            NxtSensorKind::Temperature => NxtSensor::Temperature,
        })
    }
}

fn wheel_motor(text: &str) -> Result<WheelMotor> {
    let (letter, mounting) = match text.strip_prefix('-') {
        Some(letter) => (letter, MotorMounting::Backward),
        None => (text, MotorMounting::Forward),
    };
    let port = match letter {
        "A" => MotorPort::A,
        "B" => MotorPort::B,
        "C" => MotorPort::C,
        _ => anyhow::bail!("`{text}` is no motor: write A, B or C, or -A, -B or -C for one that is mounted backwards"),
    };
    Ok(WheelMotor { port, mounting })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Result<NxtSettings, String> {
        let section: NxtSection = toml::from_str(text).map_err(|error| error.to_string())?;
        section.settings().map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn without_a_word_it_is_the_robot_of_the_instructions() {
        assert_eq!(settings("").unwrap(), NxtSettings::default());
    }

    #[test]
    fn motors_and_sensors_stand_where_they_are_said_to() {
        let parsed = settings(
            "left_motor = \"-A\"\nright_motor = \"B\"\ngyro_rest = 598.5\nsensor = [{ port = 2, kind = \"ht-gyro\" }, \
             { port = 3, kind = \"ht-accelerometer\", forward = \"-y\", place = \"left\" }]",
        )
        .unwrap();
        assert_eq!(parsed.left_motor.port, MotorPort::A);
        assert_eq!(parsed.left_motor.mounting, MotorMounting::Backward);
        assert_eq!(parsed.sensors[1], NxtSensor::HtGyro);
        assert_eq!(
            parsed.sensors[2],
            NxtSensor::HtAccelerometer { forward: ForwardAxis::MinusY, place: AccelerometerMounting::Left }
        );
        assert_eq!(parsed.gyro_rest_counts, Some(598.5));
    }

    #[test]
    fn what_cannot_be_is_refused_by_its_key() {
        for (text, expected) in [
            ("left_motor = \"D\"", "`left_motor`"),
            ("left_motor = \"C\"", "port C"),
            ("outstanding = 3", "`outstanding`"),
            ("mailbox = 10", "mailbox 10"),
            ("sensor = [{ port = 5, kind = \"ht-gyro\" }]", "`port` is 5"),
            ("sensor = [{ port = 1, kind = \"ht-gyro\" }, { port = 1, kind = \"ultrasonic\" }]", "port 1 already"),
            ("sensor = [{ port = 1, kind = \"ht-accelerometer\", forward = \"up\" }]", "`forward`"),
            ("sensor = [{ port = 1, kind = \"lidar\" }]", "lidar"),
        ] {
            let error = settings(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}

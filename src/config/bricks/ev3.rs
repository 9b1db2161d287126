//! `[robot.ev3]`: which motor of an EV3 is which wheel, what is plugged in at its ports, and how it is reached.

use anyhow::{Context, Result, bail, ensure};
use posebridge_protocol::bricks::ev3::{
    DistanceKind, DistanceSettings, Ev3Settings, GyroMounting, GyroReading, GyroSettings, MotorDirection, MotorPort,
    SensorPort,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One EV3. Without this section it is LEGO's Educator robot: motors B and C, gyro at port 2.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Ev3Section {
    /// The left wheel's motor, A to D.
    pub left_motor: String,
    /// The right wheel's motor, A to D.
    pub right_motor: String,
    /// Both counts fall when the robot drives forward: the motors are built in the other way round.
    pub motors_backward: bool,
    /// The gyro's port, 1 to 4; 0 if there is none.
    pub gyro_port: u8,
    /// Read the gyro's angle, too.
    pub gyro_angle: bool,
    /// The arrows on the gyro's case look down.
    pub gyro_upside_down: bool,
    /// The port of a sensor that looks straight ahead, 1 to 4; 0 if there is none.
    pub distance_port: u8,
    /// What that sensor is.
    pub distance_kind: Ev3Distance,
    /// Most telegrams per second, 0.1 to 50.
    pub rate_hz: f64,
    /// Most requests that may wait for their replies at once, 1 to 4.
    pub outstanding: u8,
    /// The mailbox of a program on the brick that gets the estimate; empty sends none.
    pub mailbox: String,
}

/// Which sensor looks straight ahead.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum Ev3Distance {
    /// The EV3's ultrasonic sensor.
    #[default]
    Ultrasonic,
    /// The NXT's ultrasonic sensor.
    NxtUltrasonic,
    /// The EV3's infrared sensor.
    Infrared,
}

impl Default for Ev3Section {
    fn default() -> Self {
        Self {
            left_motor: "B".to_owned(),
            right_motor: "C".to_owned(),
            motors_backward: false,
            gyro_port: 2,
            gyro_angle: false,
            gyro_upside_down: false,
            distance_port: 0,
            distance_kind: Ev3Distance::default(),
            rate_hz: 50.0,
            outstanding: 1,
            mailbox: "estimate".to_owned(),
        }
    }
}

impl Ev3Section {
    /// The settings of the codec.
    ///
    /// # Errors
    /// A value makes no sense; the message names its key.
    pub(super) fn settings(&self) -> Result<Ev3Settings> {
        let left_motor = motor(&self.left_motor).context("`left_motor`")?;
        let right_motor = motor(&self.right_motor).context("`right_motor`")?;
        ensure!(left_motor != right_motor, "`left_motor` and `right_motor` are both {}", self.left_motor);
        ensure!((0.1..=50.0).contains(&self.rate_hz), "`rate_hz` is {}, must be 0.1 to 50", self.rate_hz);
        ensure!((1..=4).contains(&self.outstanding), "`outstanding` is {}, must be 1 to 4", self.outstanding);
        let gyro = sensor(self.gyro_port).context("`gyro_port`")?;
        let distance = sensor(self.distance_port).context("`distance_port`")?;
        if let (Some(gyro), Some(distance)) = (gyro, distance) {
            ensure!(gyro != distance, "`gyro_port` and `distance_port` are both {}", self.gyro_port);
        }
        Ok(Ev3Settings {
            left_motor,
            right_motor,
            motors: if self.motors_backward { MotorDirection::Backward } else { MotorDirection::Forward },
            gyro: gyro.map(|port| self.gyro(port)),
            distance: distance.map(|port| DistanceSettings {
                port,
                kind: match self.distance_kind {
                    Ev3Distance::Ultrasonic => DistanceKind::Ultrasonic,
                    Ev3Distance::NxtUltrasonic => DistanceKind::NxtUltrasonic,
                    Ev3Distance::Infrared => DistanceKind::Infrared,
                },
            }),
            rate_hz: self.rate_hz,
            outstanding: self.outstanding,
            mailbox: (!self.mailbox.is_empty()).then(|| self.mailbox.clone()),
        })
    }

    const fn gyro(&self, port: SensorPort) -> GyroSettings {
        GyroSettings {
            port,
            reading: if self.gyro_angle { GyroReading::RateAndAngle } else { GyroReading::Rate },
            mounting: if self.gyro_upside_down { GyroMounting::UpsideDown } else { GyroMounting::Upright },
        }
    }
}

fn motor(text: &str) -> Result<MotorPort> {
    Ok(match text {
        "A" => MotorPort::A,
        "B" => MotorPort::B,
        "C" => MotorPort::C,
        "D" => MotorPort::D,
        _ => bail!("`{text}` is no motor: write A, B, C or D"),
    })
}

fn sensor(printed: u8) -> Result<Option<SensorPort>> {
    if printed == 0 {
        return Ok(None);
    }
    let port = SensorPort::from_label(printed);
    Ok(Some(port.with_context(|| format!("{printed} is no port: 1 to 4, or 0 for none"))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> Result<Ev3Settings, String> {
        let section: Ev3Section = toml::from_str(text).map_err(|error| error.to_string())?;
        section.settings().map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn without_a_word_it_is_the_educator_robot() {
        assert_eq!(settings("").unwrap(), Ev3Settings::default());
    }

    #[test]
    fn what_is_said_is_told() {
        let parsed = settings(
            "left_motor = \"A\"\nright_motor = \"D\"\nmotors_backward = true\ngyro_port = 0\ndistance_port = 4\n\
             distance_kind = \"infrared\"\nmailbox = \"\"",
        )
        .unwrap();
        assert_eq!((parsed.left_motor, parsed.right_motor), (MotorPort::A, MotorPort::D));
        assert_eq!(parsed.motors, MotorDirection::Backward);
        assert_eq!(parsed.gyro, None);
        assert_eq!(parsed.distance.map(|one| one.kind), Some(DistanceKind::Infrared));
        assert_eq!(parsed.mailbox, None);
    }

    #[test]
    fn what_cannot_be_is_refused_by_its_key() {
        for (text, expected) in [
            ("left_motor = \"E\"", "`left_motor`"),
            ("left_motor = \"C\"", "both C"),
            ("gyro_port = 5", "`gyro_port`"),
            ("distance_port = 2", "both 2"),
            ("rate_hz = 0.0", "`rate_hz`"),
            ("outstanding = 0", "`outstanding`"),
        ] {
            let error = settings(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}

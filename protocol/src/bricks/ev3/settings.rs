//! The settings of an EV3: its motors and sensors, and how it is reached.

/// The settings of one EV3. The default is LEGO's Educator robot: motors B and C, gyro at port 2.
#[derive(Clone, Debug, PartialEq)]
pub struct Ev3Settings {
    pub left_motor: MotorPort,
    pub right_motor: MotorPort,
    /// The direction of both motors when the robot drives forward.
    pub motors: MotorDirection,
    pub gyro: Option<GyroSettings>,
    pub distance: Option<DistanceSettings>,
    /// Most telegrams per second, 0.1 to 50. A slow link reduces them: at a turn-around of 30 ms to about 33.
    pub rate_hz: f64,
    /// Most outstanding requests, 1 to 4. More than one hides the turn-around of the link.
    pub outstanding: u8,
    /// The mailbox, of a program on the brick, that receives the estimate; `None` sends none.
    pub mailbox: Option<String>,
}

impl Default for Ev3Settings {
    fn default() -> Self {
        Self {
            left_motor: MotorPort::B,
            right_motor: MotorPort::C,
            motors: MotorDirection::Forward,
            gyro: Some(GyroSettings::default()),
            distance: None,
            rate_hz: 50.0,
            outstanding: 1,
            mailbox: Some("estimate".to_owned()),
        }
    }
}

/// A port for motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotorPort {
    A,
    B,
    C,
    D,
}

impl MotorPort {
    pub(super) const fn number(self) -> u8 {
        self as u8
    }
}

/// The direction of the motors when the robot drives forward.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotorDirection {
    #[default]
    Forward,
    /// The counts decrease: the motors are mounted the other way round.
    Backward,
}

/// A port for sensors, by its printed number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorPort {
    P1,
    P2,
    P3,
    P4,
}

impl SensorPort {
    /// The port with this printed number, 1 to 4.
    pub const fn from_label(number: u8) -> Option<Self> {
        match number {
            1 => Some(Self::P1),
            2 => Some(Self::P2),
            3 => Some(Self::P3),
            4 => Some(Self::P4),
            _ => None,
        }
    }

    pub const fn label(self) -> u8 {
        self.number() + 1
    }

    pub(super) const fn number(self) -> u8 {
        self as u8
    }
}

/// The gyro's port, reading and mounting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GyroSettings {
    pub port: SensorPort,
    pub reading: GyroReading,
    pub mounting: GyroMounting,
}

impl Default for GyroSettings {
    fn default() -> Self {
        Self { port: SensorPort::P2, reading: GyroReading::Rate, mounting: GyroMounting::Upright }
    }
}

/// The quantities that are read from the gyro.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroReading {
    /// The rate, in steps of 1 degree per second.
    #[default]
    Rate,
    /// Rate and angle. The angle has steps of 1 degree, so the mean rate between two telegrams has steps of 1 degree
    /// over their interval: better than the rate below about one telegram per second, worse above.
    RateAndAngle,
}

/// The orientation of the gyro.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroMounting {
    /// The arrows on its case are visible from above: clockwise is positive for the sensor (LEGO's manual; ev3dev,
    /// lego-ev3-gyro).
    #[default]
    Upright,
    UpsideDown,
}

/// A forward-looking range sensor: port and kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DistanceSettings {
    pub port: SensorPort,
    pub kind: DistanceKind,
}

/// The kind of a forward-looking range sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DistanceKind {
    /// The EV3's ultrasonic sensor: 3 to 250 cm in steps of 0.1 cm.
    Ultrasonic,
    /// The NXT's ultrasonic sensor: up to 250 cm in steps of 1 cm.
    NxtUltrasonic,
    /// The EV3's infrared sensor: a proximity of 0 to 100, which is about 70 cm and depends on the target.
    Infrared,
}

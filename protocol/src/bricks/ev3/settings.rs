//! What the EV3 codec must know of the brick: what is plugged in where, and how it is reached.

/// Everything about one EV3, as its user would say it. The default is LEGO's Educator robot: motors B and C, gyro at port 2.
#[derive(Clone, Debug, PartialEq)]
pub struct Ev3Settings {
    /// The motor of the left wheel.
    pub left_motor: MotorPort,
    /// The motor of the right wheel.
    pub right_motor: MotorPort,
    /// Which way the motors turn when the robot drives forward.
    pub motors: MotorDirection,
    /// The gyro; `None` if there is none.
    pub gyro: Option<GyroSettings>,
    /// A sensor that looks straight ahead; `None` if there is none.
    pub distance: Option<DistanceSettings>,
    /// Most telegrams per second, 0.1 to 50. Fewer come if the link is slower: at a turn-around of 30 ms about 33.
    pub rate_hz: f64,
    /// Most requests that may wait for their replies at once, 1 to 4. More than one hides the turn-around of the link.
    pub outstanding: u8,
    /// The mailbox of a program on the brick that gets the estimate; `None` sends none.
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
    /// Port A.
    A,
    /// Port B.
    B,
    /// Port C.
    C,
    /// Port D.
    D,
}

impl MotorPort {
    pub(super) const fn number(self) -> u8 {
        self as u8
    }
}

/// Which way the motors turn when the robot drives forward.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MotorDirection {
    /// Their counts rise.
    #[default]
    Forward,
    /// Their counts fall: the motors are built in the other way round.
    Backward,
}

/// A port for sensors, as it is printed on the brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorPort {
    /// Port 1.
    P1,
    /// Port 2.
    P2,
    /// Port 3.
    P3,
    /// Port 4.
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

    /// Its printed number, 1 to 4.
    pub const fn label(self) -> u8 {
        self.number() + 1
    }

    pub(super) const fn number(self) -> u8 {
        self as u8
    }
}

/// The gyro.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GyroSettings {
    /// Where it is plugged in.
    pub port: SensorPort,
    /// What is read of it.
    pub reading: GyroReading,
    /// How it is built in.
    pub mounting: GyroMounting,
}

impl Default for GyroSettings {
    fn default() -> Self {
        Self { port: SensorPort::P2, reading: GyroReading::Rate, mounting: GyroMounting::Upright }
    }
}

/// What is read of the gyro.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroReading {
    /// The rate, in steps of 1 degree per second.
    #[default]
    Rate,
    /// Rate and angle. The angle has steps of 1 degree, so the mean rate between two telegrams has steps of 1 degree over their distance:
    /// better than the rate below about one telegram per second, worse above.
    RateAndAngle,
}

/// How the gyro is built in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroMounting {
    /// The arrows on its case look up: clockwise is positive for the sensor (LEGO's manual; ev3dev, lego-ev3-gyro).
    #[default]
    Upright,
    /// The arrows look down.
    UpsideDown,
}

/// A sensor that looks straight ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DistanceSettings {
    /// Where it is plugged in.
    pub port: SensorPort,
    /// What it is.
    pub kind: DistanceKind,
}

/// Which sensor looks straight ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DistanceKind {
    /// The EV3's ultrasonic sensor: 3 to 250 cm in steps of 0.1 cm.
    Ultrasonic,
    /// The NXT's ultrasonic sensor: up to 250 cm in steps of 1 cm.
    NxtUltrasonic,
    /// The EV3's infrared sensor: a proximity of 0 to 100, which is about 70 cm and depends on what is seen.
    Infrared,
}

//! The messages: integers as they stand on the wire, and what they mean.

/// Which of the two counts of [`WheelTicks`] mean something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sides(pub u8);

impl Sides {
    /// Neither.
    pub const NONE: Self = Self(0);
    /// The left one.
    pub const LEFT: Self = Self(1);
    /// The right one.
    pub const RIGHT: Self = Self(2);
    /// Both. The station drops a message without.
    pub const BOTH: Self = Self(3);
}

/// Total counts of both driven wheels since power-up: PB_WHEEL_TICKS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WheelTicks {
    /// When the counters were read, microseconds of the robot's own clock; wraps.
    pub time_us: u32,
    /// Counts of the left wheel, forward positive; wraps.
    pub left: i32,
    /// Counts of the right wheel, forward positive; wraps.
    pub right: i32,
    /// Which of them are valid.
    pub valid: Sides,
}

/// Which parts of [`Inertial`] mean something: bits, to be joined by `|`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InertialParts(pub u8);

impl InertialParts {
    /// The turn rate.
    pub const RATE: Self = Self(1);
    /// The total turn.
    pub const TURN: Self = Self(2);
    /// Both accelerations.
    pub const ACCELERATIONS: Self = Self(4);
    /// A gyro and nothing else.
    pub const GYRO: Self = Self(3);
}

impl core::ops::BitOr for InertialParts {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// Gyro and accelerometers: PB_INERTIAL. [`Gyro`](crate::Gyro) makes one from samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inertial {
    /// End of the interval over which the rates are means, microseconds of the robot's own clock; wraps.
    pub time_us: u32,
    /// Turn since power-up in microradians, counter-clockwise positive, bias included; wraps.
    pub turn_urad: i32,
    /// Mean turn rate in units of 0.5 mrad/s, counter-clockwise positive, bias included; saturated by the sender.
    pub turn_rate: i16,
    /// Forward acceleration at the left wheel in mm/s².
    pub accel_left: i16,
    /// Forward acceleration at the right wheel in mm/s².
    pub accel_right: i16,
    /// Which of them are valid.
    pub valid: InertialParts,
}

/// The robot's battery: BATTERY_STATUS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Battery {
    /// All cells together; 65535 stands for unknown.
    pub millivolts: u16,
    /// Of a full one, 0 to 100.
    pub percent: Option<u8>,
}

/// The robot's own build, so that any station knows it: PB_ROBOT_DESCRIPTION.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotDescription<'a> {
    /// Radius of the left wheel in metres.
    pub left_wheel_radius_m: f32,
    /// Radius of the right wheel in metres.
    pub right_wheel_radius_m: f32,
    /// Distance between the wheels' contact points in metres.
    pub track_width_m: f32,
    /// Encoder counts per turn of a wheel.
    pub ticks_per_turn: f32,
    /// Gyro noise per sample, one standard deviation, rad/s; 0 without a gyro.
    pub gyro_sigma_rad_per_s: f32,
    /// Resolution of the gyro, rad/s; 0 when it is fine or absent.
    pub gyro_resolution_rad_per_s: f32,
    /// Name for people, UTF-8; what is behind the 16th byte is cut off.
    pub name: &'a str,
}

/// The station's estimate in the arena: PB_PLANAR_POSE. All numbers are finite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlanarPose {
    /// The instant for which it holds, microseconds of the robot's own clock; wraps.
    pub time_us: u32,
    /// East, metres.
    pub x_m: f32,
    /// North, metres.
    pub y_m: f32,
    /// Counter-clockwise from east, (-π, π].
    pub heading_rad: f32,
    /// Along the body's forward axis.
    pub forward_speed_m_per_s: f32,
    /// Counter-clockwise positive, bias removed.
    pub turn_rate_rad_per_s: f32,
    /// Upper triangle of the covariance of x, y, heading, row by row; m², m rad, rad².
    pub covariance: [f32; 6],
    /// Time since the last fix that was used; 65534 for that long or longer, 65535 before the first fix.
    pub fix_age_ms: u16,
    /// Counts jumps of the estimate that are not motion; wraps.
    pub reset_counter: u8,
    /// Bit 0 position, 1 heading, 2 speeds are valid; 3 dead reckoning; 4 predicted to the time of arrival.
    pub flags: u8,
    /// Rises with every change of the station that owns the robot; 0 without a fleet of stations. Drop an estimate with a lower one than
    /// you have seen since power-up.
    pub epoch: u32,
}

impl PlanarPose {
    /// Whether x and y mean something.
    #[must_use]
    pub const fn position_is_valid(&self) -> bool {
        self.flags & 1 != 0
    }

    /// Whether the heading means something.
    #[must_use]
    pub const fn heading_is_valid(&self) -> bool {
        self.flags & 2 != 0
    }
}

/// Somebody asks what time it is on the robot: TIMESYNC with `tc1` 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimeRequest {
    /// Comes back as it is.
    pub(crate) ts1: [u8; 8],
    /// Who asks: system and component.
    pub(crate) from: [u8; 2],
    /// Who is asked; 0 is everybody.
    pub(crate) target: [u8; 2],
}

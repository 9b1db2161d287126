//! Geometry and wiring from three motions by hand.
//!
//! ```text
//! one wheel, n turns     N = |c| / n                                     which counter is that wheel's, and its sign
//! straight on, d metres  r = (d / |c|) N / 2 pi     for each wheel       its sign, forward
//! on the spot, n turns   b = (|c_l| d_l + |c_r| d_r) / (2 pi n)          d: metres per count of the wheel
//!                        gyro: k = its turn / (2 pi n)                   1 rad/s, 57.3 deg/s, negative clockwise
//! ```
//! One standard deviation of each figure is that of a person who aims at a mark, and of the counts themselves.

use std::f64::consts::TAU;

use posebridge_telemetry::{Polarity, UncertainValue, WheelOrder};

use super::log::{Motion, WheelUnit};

/// How far a person misses a mark: on a tyre, on the floor, a heading. One standard deviation.
const WHEEL_MARK_RAD: f64 = 0.05;
const FLOOR_MARK_M: f64 = 0.005;
const HEADING_MARK_RAD: f64 = 0.05;
/// Of the difference of two counts.
const COUNT_SIGMA: f64 = 0.41;
/// Largest share of one wheel's counts that the other may have where one wheel is turned.
const MAX_OTHER_SHARE: f64 = 0.1;
/// Least ratio of the two wheels' counts in a turn on the spot, which by hand is never quite about the middle.
const MIN_SPOT_RATIO: f64 = 0.8;
/// The same on a straight line, where only the wheels' radii may differ.
const MIN_STRAIGHT_RATIO: f64 = 0.95;
/// The difference of two counts may be off by so many of its standard deviations.
const COARSE_COUNTS: f64 = 5.0;
/// Fewer counts are too coarse for 2 %.
const MIN_COUNTS: f64 = 20.0;

/// A wheel, or the counter that is called so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    Left,
    Right,
}

impl Side {
    pub const fn index(self) -> usize {
        match self {
            Self::Left => 0,
            Self::Right => 1,
        }
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

/// Why a motion shows nothing.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MotionProblem {
    #[error("both wheels counted ({left:+} and {right:+}), where one was to be turned")]
    BothWheels { left: f64, right: f64 },
    #[error("one wheel counted ({left:+} and {right:+}), where both were to roll")]
    OneWheel { left: f64, right: f64 },
    #[error("the wheels counted {left:+} and {right:+}: they did not roll equally far")]
    Unequal { left: f64, right: f64 },
    #[error(
        "the counts are those of a robot that drives straight on ({left:+} and {right:+}), where it was to turn on the spot"
    )]
    NotOnSpot { left: f64, right: f64 },
    #[error("the counts are those of a turn to the right, where it was to turn to the left")]
    Clockwise,
    #[error("the wheels counted the other way than the wheel that was turned: one of the two motions was backwards")]
    AgainstWheel,
    #[error("{0} counts are too few for a figure: move further")]
    TooFew(f64),
}

/// One wheel turned by hand, forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelTurn {
    /// The wheel that the person turned.
    pub wheel: Side,
    /// The counter that counted.
    pub counter: Side,
    pub polarity: Polarity,
    /// `None` of a robot that reports metres.
    pub ticks_per_turn: Option<UncertainValue>,
}

impl WheelTurn {
    pub fn new(motion: &Motion, unit: WheelUnit, wheel: Side, turns: f64) -> Result<Self, MotionProblem> {
        let [left, right] = motion.change;
        let counter = if left.abs() > right.abs() { Side::Left } else { Side::Right };
        let (counted, other) = if counter == Side::Left { (left, right) } else { (right, left) };
        if other.abs() > MAX_OTHER_SHARE * counted.abs() {
            return Err(MotionProblem::BothWheels { left, right });
        }
        if unit == WheelUnit::Counts && counted.abs() < MIN_COUNTS {
            return Err(MotionProblem::TooFew(counted.abs()));
        }
        let value = counted.abs() / turns;
        let relative = (WHEEL_MARK_RAD / (TAU * turns)).hypot(COUNT_SIGMA / counted.abs());
        let ticks_per_turn = (unit == WheelUnit::Counts).then_some(UncertainValue { value, sigma: value * relative });
        Ok(Self { wheel, counter, polarity: polarity(counted), ticks_per_turn })
    }

    pub const fn order(&self) -> WheelOrder {
        match (self.wheel, self.counter) {
            (Side::Left, Side::Left) | (Side::Right, Side::Right) => WheelOrder::AsNamed,
            (Side::Left, Side::Right) | (Side::Right, Side::Left) => WheelOrder::Swapped,
        }
    }
}

fn polarity(forward: f64) -> Polarity {
    if forward < 0.0 { Polarity::Reversed } else { Polarity::Normal }
}

/// Both wheels rolled straight on; all figures are of the counters, in their order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StraightRoll {
    /// Metres per count, or per reported metre.
    pub m_per_count: [UncertainValue; 2],
    pub polarity: [Polarity; 2],
}

impl StraightRoll {
    pub fn new(motion: &Motion, unit: WheelUnit, distance_m: f64) -> Result<Self, MotionProblem> {
        check_both(motion, unit, MIN_STRAIGHT_RATIO)?;
        let m_per_count = motion.change.map(|counted| {
            let value = distance_m / counted.abs();
            let relative = (FLOOR_MARK_M / distance_m).hypot(count_sigma(unit) / counted.abs());
            UncertainValue { value, sigma: value * relative }
        });
        Ok(Self { m_per_count, polarity: motion.change.map(polarity) })
    }
}

const fn count_sigma(unit: WheelUnit) -> f64 {
    match unit {
        WheelUnit::Counts => COUNT_SIGMA,
        WheelUnit::Meters => 0.0,
    }
}

/// Both wheels counted, and about as far.
fn check_both(motion: &Motion, unit: WheelUnit, min_ratio: f64) -> Result<(), MotionProblem> {
    let [left, right] = motion.change;
    let (less, more) = (left.abs().min(right.abs()), left.abs().max(right.abs()));
    if less < MAX_OTHER_SHARE * more {
        return Err(MotionProblem::OneWheel { left, right });
    }
    if unit == WheelUnit::Counts && less < MIN_COUNTS {
        return Err(MotionProblem::TooFew(less));
    }
    if less < min_ratio * more - count_sigma(unit) * COARSE_COUNTS {
        return Err(MotionProblem::Unequal { left, right });
    }
    Ok(())
}

/// A turn on the spot, to the left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpotTurn {
    pub track_m: UncertainValue,
    pub order: WheelOrder,
    /// The gyro's turn over the true one; `None` without a gyro.
    pub gyro_ratio: Option<UncertainValue>,
}

impl SpotTurn {
    /// `order` is that of the counters, if a turned wheel has shown it.
    pub fn new(
        motion: &Motion,
        unit: WheelUnit,
        straight: &StraightRoll,
        order: Option<WheelOrder>,
        turns: f64,
    ) -> Result<Self, MotionProblem> {
        check_both(motion, unit, MIN_SPOT_RATIO)?;
        let [left, right] = [0, 1].map(|side| motion.change[side] * straight.polarity[side].sign());
        if left * right > 0.0 {
            let [left, right] = motion.change;
            return Err(MotionProblem::NotOnSpot { left, right });
        }
        // In a turn to the left the right wheel rolls forward.
        let seen = if right > 0.0 { WheelOrder::AsNamed } else { WheelOrder::Swapped };
        if order.is_some_and(|order| order != seen) {
            return Err(MotionProblem::Clockwise);
        }
        let angle_rad = TAU * turns;
        let ways = [0, 1].map(|side| motion.change[side].abs() * straight.m_per_count[side].value);
        let track_m = (ways[0] + ways[1]) / angle_rad;
        let scale = [0, 1].map(|side| straight.m_per_count[side].sigma / straight.m_per_count[side].value);
        let counts = [0, 1].map(|side| count_sigma(unit) * straight.m_per_count[side].value);
        // A mark on the floor that is missed falsifies both wheels alike.
        let relative = (HEADING_MARK_RAD / angle_rad).hypot(0.5 * (scale[0] + scale[1]));
        let sigma = (track_m * relative).hypot(counts[0].hypot(counts[1]) / angle_rad);
        let gyro_ratio = motion.gyro_turn.map(|turn| {
            let value = turn / angle_rad;
            UncertainValue { value, sigma: (value * HEADING_MARK_RAD / angle_rad).abs() }
        });
        Ok(Self { track_m: UncertainValue { value: track_m, sigma }, order: seen, gyro_ratio })
    }
}

/// The unit of a gyro by how far it turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GyroScale {
    RadiansPerSecond,
    DegreesPerSecond,
    /// Neither of them: its own numbers, or a wrong scale.
    Other,
    /// It felt next to nothing of the turn.
    Still,
}

/// Scale errors of a gyro, and of a turn by hand, are smaller.
const MAX_SCALE_ERROR: f64 = 1.3;
/// A gyro that turns less is still.
const MIN_RATIO: f64 = 0.005;

impl GyroScale {
    pub fn from_ratio(ratio: f64) -> Self {
        let degrees = TAU.recip() * 360.0;
        let fits = |unit: f64| (unit / MAX_SCALE_ERROR..=unit * MAX_SCALE_ERROR).contains(&ratio.abs());
        if fits(1.0) {
            Self::RadiansPerSecond
        } else if fits(degrees) {
            Self::DegreesPerSecond
        } else if ratio.abs() < MIN_RATIO {
            Self::Still
        } else {
            Self::Other
        }
    }
}

/// What usual gyros count at one degree per second: MPU-6050 and L3GD20 at their ranges, by their data sheets.
const USUAL_GYRO_COUNTS: [f64; 7] = [131.0, 65.5, 32.8, 16.4, 114.3, 57.1, 14.3];
/// A turn by hand and a gyro's scale err by less.
const USUAL_TOLERANCE: f64 = 0.05;

/// The scale of a usual gyro that is near, else the measured one; both in counts at one degree per second.
pub fn usual_gyro_counts(measured: f64) -> f64 {
    let is_near = |usual: &f64| (measured / usual - 1.0).abs() < USUAL_TOLERANCE;
    USUAL_GYRO_COUNTS.into_iter().find(is_near).unwrap_or(measured)
}

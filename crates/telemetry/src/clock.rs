//! Three clocks, three timestamp types.
//!
//! A brick counts from its own power-up, up to 2000 ppm wrong; the host counts monotonically from the start of the
//! session; a camera has its own clock. Timestamps of different clocks neither subtract nor compare; only the station's
//! clock alignment converts between them.
//!
//! ```compile_fail
//! use posebridge_telemetry::{BrickClock, HostClock, Timestamp};
//! let brick = Timestamp::<BrickClock>::from_nanos(5);
//! let host = Timestamp::<HostClock>::from_nanos(3);
//! let nonsense = brick - host; // different clocks: this must not build
//! ```

use std::fmt;
use std::hash::Hash;
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Neg, Sub};

use serde::{Deserialize, Serialize};

/// A clock; implemented only by the three clocks of this module.
pub trait Clock: Copy + Ord + Hash + fmt::Debug {
    /// The clock's name in messages to people.
    const NAME: &'static str;
}

/// The robot's own clock, unwrapped to 64 bits. The filter runs in this time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BrickClock {}
/// The host's monotonic clock, zero at the start of the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum HostClock {}
/// The clock of a camera or another outside observer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CameraClock {}

impl Clock for BrickClock {
    const NAME: &'static str = "brick";
}
impl Clock for HostClock {
    const NAME: &'static str = "host";
}
impl Clock for CameraClock {
    const NAME: &'static str = "camera";
}

/// An instant on the clock `C`, in nanoseconds since that clock's zero. The field that holds it says which instant is meant
/// (middle of an exposure, arrival of the last byte).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct Timestamp<C> {
    nanos: i64,
    clock: PhantomData<C>,
}

impl<C: Clock> Timestamp<C> {
    pub const ZERO: Self = Self::from_nanos(0);

    pub const fn from_nanos(nanos: i64) -> Self {
        Self { nanos, clock: PhantomData }
    }

    /// Saturates at the ends of the range, as all conversions and operators do.
    pub const fn from_micros(micros: i64) -> Self {
        Self::from_nanos(micros.saturating_mul(1_000))
    }

    pub const fn from_millis(millis: i64) -> Self {
        Self::from_nanos(millis.saturating_mul(1_000_000))
    }

    /// Rounds to the nearest nanosecond; saturates, NaN gives zero.
    pub fn from_secs_f64(secs: f64) -> Self {
        Self::from_nanos(round_to_i64(secs * 1e9))
    }

    pub const fn as_nanos(self) -> i64 {
        self.nanos
    }

    /// Rounds towards minus infinity.
    pub const fn as_micros(self) -> i64 {
        self.nanos.div_euclid(1_000)
    }

    pub fn as_secs_f64(self) -> f64 {
        self.nanos as f64 * 1e-9
    }
}

impl<C: Clock> fmt::Debug for Timestamp<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{:.9}s", C::NAME, self.as_secs_f64())
    }
}
impl<C> Sub for Timestamp<C> {
    type Output = TimeDelta;
    fn sub(self, other: Self) -> TimeDelta {
        TimeDelta(self.nanos.saturating_sub(other.nanos))
    }
}
impl<C: Clock> Add<TimeDelta> for Timestamp<C> {
    type Output = Self;
    fn add(self, delta: TimeDelta) -> Self {
        Self::from_nanos(self.nanos.saturating_add(delta.0))
    }
}
impl<C: Clock> Sub<TimeDelta> for Timestamp<C> {
    type Output = Self;
    fn sub(self, delta: TimeDelta) -> Self {
        Self::from_nanos(self.nanos.saturating_sub(delta.0))
    }
}

/// A signed duration, in nanoseconds. It belongs to no clock: the skew between clocks over one duration is negligible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct TimeDelta(i64);

impl TimeDelta {
    pub const ZERO: Self = Self(0);

    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }
    pub const fn from_micros(micros: i64) -> Self {
        Self(micros.saturating_mul(1_000))
    }
    pub const fn from_millis(millis: i64) -> Self {
        Self(millis.saturating_mul(1_000_000))
    }
    /// Rounds to the nearest nanosecond; saturates, NaN gives zero.
    pub fn from_secs_f64(secs: f64) -> Self {
        Self(round_to_i64(secs * 1e9))
    }
    pub const fn as_nanos(self) -> i64 {
        self.0
    }
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }
    pub fn as_millis_f64(self) -> f64 {
        self.0 as f64 * 1e-6
    }
}

impl Add for TimeDelta {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}
impl AddAssign for TimeDelta {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}
impl Sub for TimeDelta {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}
impl Neg for TimeDelta {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

/// The nearest whole number, halves away from zero; saturates, NaN gives zero. The same result as `f64::round`, which calls
/// the C library on the baseline x86-64 target; this function runs a dozen times for each message.
#[inline]
fn round_to_i64(value: f64) -> i64 {
    let truncated = value as i64;
    // Exact: beyond 2^53 there is no fraction.
    let fraction = value - truncated as f64;
    truncated.saturating_add(i64::from(fraction >= 0.5)).saturating_sub(i64::from(fraction <= -0.5))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_number_is_that_of_the_standard_library() {
        let mut state = 1_u64;
        let mut values = vec![
            0.0,
            -0.0,
            0.5,
            -0.5,
            0.499_999_999_999_999_94,
            -0.499_999_999_999_999_94,
            1.5,
            2.5,
            -2.5,
            4_503_599_627_370_495.5,
            9_007_199_254_740_992.0,
            9.3e18,
            -9.3e18,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NAN,
            f64::MIN_POSITIVE,
        ];
        for _ in 0..200_000 {
            // Any bits at all, and what is usual.
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            values.push(f64::from_bits(state));
            values.push((state >> 20) as f64 / 64.0 - 1e11);
        }
        for value in values {
            assert_eq!(round_to_i64(value), value.round() as i64, "{value:e}");
        }
    }

    #[test]
    fn stamps_of_one_clock_subtract_and_saturate() {
        let late = Timestamp::<BrickClock>::from_millis(1_500);
        let early = Timestamp::<BrickClock>::from_micros(250_000);
        assert_eq!(late - early, TimeDelta::from_millis(1_250));
        assert_eq!(
            Timestamp::<BrickClock>::from_nanos(i64::MAX) + TimeDelta::from_nanos(1),
            Timestamp::from_nanos(i64::MAX)
        );
    }

    #[test]
    fn seconds_round_to_the_nearest_nanosecond() {
        assert_eq!(Timestamp::<HostClock>::from_secs_f64(0.05).as_nanos(), 50_000_000);
        assert_eq!(Timestamp::<HostClock>::from_secs_f64(f64::NAN).as_nanos(), 0);
    }

    #[test]
    fn a_stamp_names_its_clock() {
        assert_eq!(format!("{:?}", Timestamp::<CameraClock>::from_millis(1)), "camera@0.001000000s");
    }
}

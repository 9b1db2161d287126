//! Three clocks, three stamp types.
//!
//! A brick counts from its own power-up, up to 2000 ppm wrong; the host counts monotonically from the start of the
//! session; a camera has a clock of its own. Stamps of different clocks neither subtract nor compare; only
//! `pipeline::clock` converts between them.
//!
//! ```compile_fail
//! use posebridge_telemetry::{BrickClock, HostClock, Stamp};
//! let brick = Stamp::<BrickClock>::from_nanos(5);
//! let host = Stamp::<HostClock>::from_nanos(3);
//! let nonsense = brick - host; // different clocks: this must not build
//! ```

use std::cmp::Ordering;
use std::fmt;
use std::hash::{Hash, Hasher};
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Neg, Sub};

/// Marks a clock; implemented only by the three clocks of this module.
pub trait Clock: Copy + fmt::Debug {
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

/// An instant on the clock `C`, in nanoseconds since that clock's zero. Which instant (middle of an exposure, arrival of
/// the last byte) is said where the stamp is stored.
pub struct Stamp<C> {
    nanos: i64,
    clock: PhantomData<C>,
}

impl<C: Clock> Stamp<C> {
    /// The clock's zero.
    pub const ZERO: Self = Self::from_nanos(0);

    /// An instant in nanoseconds since the clock's zero.
    #[must_use]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self { nanos, clock: PhantomData }
    }

    /// An instant in microseconds since the clock's zero; saturates at the ends of the range.
    #[must_use]
    pub const fn from_micros(micros: i64) -> Self {
        Self::from_nanos(micros.saturating_mul(1_000))
    }

    /// An instant in milliseconds since the clock's zero; saturates at the ends of the range.
    #[must_use]
    pub const fn from_millis(millis: i64) -> Self {
        Self::from_nanos(millis.saturating_mul(1_000_000))
    }

    /// An instant in seconds since the clock's zero, rounded to the nearest nanosecond; saturates, NaN gives zero.
    #[must_use]
    pub fn from_secs_f64(secs: f64) -> Self {
        Self::from_nanos(nearest(secs * 1e9))
    }

    /// Nanoseconds since the clock's zero.
    #[must_use]
    pub const fn as_nanos(self) -> i64 {
        self.nanos
    }

    /// Microseconds since the clock's zero, rounded towards minus infinity.
    #[must_use]
    pub const fn as_micros(self) -> i64 {
        self.nanos.div_euclid(1_000)
    }

    /// Seconds since the clock's zero.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.nanos as f64 * 1e-9
    }
}

impl<C> Clone for Stamp<C> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<C> Copy for Stamp<C> {}
impl<C> PartialEq for Stamp<C> {
    fn eq(&self, other: &Self) -> bool {
        self.nanos == other.nanos
    }
}
impl<C> Eq for Stamp<C> {}
impl<C> PartialOrd for Stamp<C> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl<C> Ord for Stamp<C> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.nanos.cmp(&other.nanos)
    }
}
impl<C> Hash for Stamp<C> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.nanos.hash(state);
    }
}
impl<C: Clock> fmt::Debug for Stamp<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{:.9}s", C::NAME, self.as_secs_f64())
    }
}
impl<C> Sub for Stamp<C> {
    type Output = Span;
    fn sub(self, other: Self) -> Span {
        Span(self.nanos.saturating_sub(other.nanos))
    }
}
impl<C: Clock> Add<Span> for Stamp<C> {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self::from_nanos(self.nanos.saturating_add(span.0))
    }
}
impl<C: Clock> Sub<Span> for Stamp<C> {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self::from_nanos(self.nanos.saturating_sub(span.0))
    }
}

/// A signed length of time, in nanoseconds. It belongs to no clock: skew over a span is below what matters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span(i64);

impl Span {
    /// No time at all.
    pub const ZERO: Self = Self(0);

    /// A span in nanoseconds.
    #[must_use]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }
    /// A span in microseconds; saturates.
    #[must_use]
    pub const fn from_micros(micros: i64) -> Self {
        Self(micros.saturating_mul(1_000))
    }
    /// A span in milliseconds; saturates.
    #[must_use]
    pub const fn from_millis(millis: i64) -> Self {
        Self(millis.saturating_mul(1_000_000))
    }
    /// A span in seconds, rounded to the nearest nanosecond; saturates, NaN gives zero.
    #[must_use]
    pub fn from_secs_f64(secs: f64) -> Self {
        Self(nearest(secs * 1e9))
    }
    /// The span in nanoseconds.
    #[must_use]
    pub const fn as_nanos(self) -> i64 {
        self.0
    }
    /// The span in seconds.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }
    /// The span in milliseconds, with fractions.
    #[must_use]
    pub fn as_millis_f64(self) -> f64 {
        self.0 as f64 * 1e-6
    }
}

impl Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}
impl AddAssign for Span {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}
impl Sub for Span {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}
impl Neg for Span {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

/// The nearest whole number, halves away from zero; saturates, NaN gives zero. What `f64::round` gives, which is a call of the C library
/// where the processor is not known to round by itself: a robot's every message is stamped a dozen times.
#[inline]
fn nearest(value: f64) -> i64 {
    let whole = value as i64;
    // Exact: beyond 2^53 there is no fraction.
    let fraction = value - whole as f64;
    whole.saturating_add(i64::from(fraction >= 0.5)).saturating_sub(i64::from(fraction <= -0.5))
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
            assert_eq!(nearest(value), value.round() as i64, "{value:e}");
        }
    }

    #[test]
    fn stamps_of_one_clock_subtract_and_saturate() {
        let late = Stamp::<BrickClock>::from_millis(1_500);
        let early = Stamp::<BrickClock>::from_micros(250_000);
        assert_eq!(late - early, Span::from_millis(1_250));
        assert_eq!(Stamp::<BrickClock>::from_nanos(i64::MAX) + Span::from_nanos(1), Stamp::from_nanos(i64::MAX));
    }

    #[test]
    fn seconds_round_to_the_nearest_nanosecond() {
        assert_eq!(Stamp::<HostClock>::from_secs_f64(0.05).as_nanos(), 50_000_000);
        assert_eq!(Stamp::<HostClock>::from_secs_f64(f64::NAN).as_nanos(), 0);
    }

    #[test]
    fn a_stamp_names_its_clock() {
        assert_eq!(format!("{:?}", Stamp::<CameraClock>::from_millis(1)), "camera@0.001000000s");
    }
}

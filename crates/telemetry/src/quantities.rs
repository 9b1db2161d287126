//! Physical quantities as newtypes over `f64`, for use at crate boundaries.
//!
//! Only the operators with a physical meaning exist: a heading minus a heading is an angle, but two headings do
//! not add. Inside the filters the numbers are plain SI `f64`.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use serde::{Deserialize, Serialize};

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $unit:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
        pub struct $name(pub f64);

        impl Add for $name {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }
        impl AddAssign for $name {
            fn add_assign(&mut self, other: Self) {
                self.0 += other.0;
            }
        }
        impl Sub for $name {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }
        impl Neg for $name {
            type Output = Self;
            fn neg(self) -> Self {
                Self(-self.0)
            }
        }
        impl Mul<f64> for $name {
            type Output = Self;
            fn mul(self, factor: f64) -> Self {
                Self(self.0 * factor)
            }
        }
        impl Div<f64> for $name {
            type Output = Self;
            fn div(self, divisor: f64) -> Self {
                Self(self.0 / divisor)
            }
        }
        impl Div for $name {
            type Output = f64;
            fn div(self, other: Self) -> f64 {
                self.0 / other.0
            }
        }
        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(&self.0, f)?;
                f.write_str(concat!(" ", $unit))
            }
        }
    };
}

quantity!(/// A length, in metres.
    Meters, "m");
quantity!(/// A speed along a line, in metres per second.
    MetersPerSecond, "m/s");
quantity!(/// An acceleration along a line, in metres per second squared.
    MetersPerSecondSquared, "m/s²");
quantity!(/// An unbounded angle (a wheel's total rotation, a change of heading), in radians.
    Radians, "rad");
quantity!(/// An angular speed, in radians per second, counter-clockwise positive.
    RadiansPerSecond, "rad/s");
quantity!(/// A temperature, in degrees Celsius.
    Celsius, "°C");

/// Counts of an encoder since it was last zeroed; negative when the wheel ran backwards.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EncoderTicks(pub i64);

impl Sub for EncoderTicks {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.wrapping_sub(other.0))
    }
}

/// Where the body points: an angle on the circle, in (-pi, pi], 0 along x, counter-clockwise positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct Heading(f64);

impl Heading {
    /// Wraps any finite angle onto the circle. A value that is not finite stays as it is, so that a filter sees it.
    pub fn new(angle: Radians) -> Self {
        Self(wrap_rad(angle.0))
    }

    pub fn from_rad(angle_rad: f64) -> Self {
        Self(wrap_rad(angle_rad))
    }

    /// In radians, in (-pi, pi].
    pub const fn rad(self) -> f64 {
        self.0
    }
}

/// Fails for an angle outside the circle: a saved one is never wrapped.
impl TryFrom<f64> for Heading {
    type Error = &'static str;

    fn try_from(angle_rad: f64) -> Result<Self, Self::Error> {
        let is_wrapped = wrap_rad(angle_rad).to_bits() == angle_rad.to_bits();
        is_wrapped.then_some(Self(angle_rad)).ok_or("a heading outside (-pi, pi]")
    }
}

impl From<Heading> for f64 {
    fn from(heading: Heading) -> Self {
        heading.rad()
    }
}

impl Sub for Heading {
    type Output = Radians;
    /// The short way from `other` to `self`, in (-pi, pi].
    fn sub(self, other: Self) -> Radians {
        Radians(wrap_rad(self.0 - other.0))
    }
}

impl Add<Radians> for Heading {
    type Output = Self;
    fn add(self, turn: Radians) -> Self {
        Self(wrap_rad(self.0 + turn.0))
    }
}

impl Sub<Radians> for Heading {
    type Output = Self;
    fn sub(self, turn: Radians) -> Self {
        Self(wrap_rad(self.0 - turn.0))
    }
}

/// Wraps an angle in radians into (-pi, pi]; values that are not finite pass through unchanged.
pub fn wrap_rad(angle_rad: f64) -> f64 {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    if !angle_rad.is_finite() {
        return angle_rad;
    }
    let wrapped = (angle_rad + PI).rem_euclid(TAU) - PI;
    if wrapped <= -PI { PI } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_live_in_the_half_open_circle() {
        assert_eq!(Heading::from_rad(PI).rad(), PI);
        assert_eq!(Heading::from_rad(-PI).rad(), PI);
        assert!((Heading::from_rad(3.0 * TAU + 0.25).rad() - 0.25).abs() < 1e-12);
        assert!((Heading::from_rad(-PI - 0.1).rad() - (PI - 0.1)).abs() < 1e-12);
    }

    #[test]
    fn the_difference_of_headings_goes_the_short_way() {
        let turn = Heading::from_rad(3.1) - Heading::from_rad(-3.1);
        assert!((turn.0 - (6.2 - TAU)).abs() < 1e-12);
    }

    #[test]
    fn a_heading_that_is_not_a_number_is_not_hidden() {
        assert!(Heading::from_rad(f64::NAN).rad().is_nan());
    }

    #[test]
    fn quantities_print_their_unit() {
        assert_eq!(format!("{:.2}", Meters(1.5)), "1.50 m");
    }
}

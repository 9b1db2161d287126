//! The HiTechnic gyro: a turn rate as the difference of a reading and what it reads at rest.
//!
//! # Model
//! ```text
//! rate = sign (raw - rest) deg/s
//! rest = mean of the readings while both wheels stand; the first ENOUGH of them, close together, make it, later ones follow slowly:
//!        rest += (raw - rest) / n,  n = count of readings, at most MEMORY
//! ```
//! Nothing is told until the rest is known. What is left of it is the filter's gyro bias.
//!
//! # Sources
//! HiTechnic NGY1044: one degree per second and count, +-360 degrees per second, rest around 600, 580 to 625 reported, different
//! for each sensor and drifting with temperature; people average about 500 readings at rest.

use posebridge_telemetry::RadiansPerSecond;

use super::settings::GyroSign;

/// Readings that make a first rest value: about two seconds' worth, a mean good to 0.2 degrees per second.
const ENOUGH: u32 = 25;
/// Readings over which the rest is a mean, afterwards.
const MEMORY: u32 = 500;
/// Readings at rest lie within so many counts of each other: the noise is about one.
const REST_SPREAD: f64 = 8.0;
/// A reading further from the rest than this is a robot that is turned by hand.
const REST_WANDER: f64 = 4.0;
/// Where a rest can be, generously; an empty port reads 1023.
const REST_RANGE: std::ops::RangeInclusive<f64> = 500.0..=700.0;
/// The converter has ten bits.
const LARGEST_RAW: u16 = 1023;

/// Whether the wheels stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wheels {
    Standing,
    Turning,
}

/// The state of one gyro.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gyro {
    sign: f64,
    configured_rest: Option<f64>,
    learnt: Learnt,
}

/// What readings at rest say.
#[derive(Clone, Copy, Debug, Default)]
struct Learnt {
    count: u32,
    mean: f64,
    smallest: f64,
    largest: f64,
}

impl Gyro {
    pub(super) const fn new(rest: Option<f64>, sign: GyroSign) -> Self {
        Self {
            sign: match sign {
                GyroSign::CounterClockwise => 1.0,
                GyroSign::Clockwise => -1.0,
            },
            configured_rest: rest,
            learnt: Learnt {
                count: 0,
                mean: 0.0,
                smallest: 0.0,
                largest: 0.0,
            },
        }
    }

    /// What it reads at rest, in counts, if that is known.
    pub(super) fn rest(&self) -> Option<f64> {
        self.configured_rest
            .or((self.learnt.count >= ENOUGH).then_some(self.learnt.mean))
    }

    /// The turn rate that a reading means, counter-clockwise positive, bias included.
    pub(super) fn take(&mut self, raw: u16, wheels: Wheels) -> Option<RadiansPerSecond> {
        if raw > LARGEST_RAW {
            return None;
        }
        let raw = f64::from(raw);
        if self.configured_rest.is_none() {
            self.learnt.take(raw, wheels);
        }
        let rest = self.rest()?;
        Some(RadiansPerSecond(self.sign * (raw - rest).to_radians()))
    }
}

impl Learnt {
    fn take(&mut self, raw: f64, wheels: Wheels) {
        if self.count >= ENOUGH {
            if wheels == Wheels::Standing && (raw - self.mean).abs() <= REST_WANDER {
                self.count = (self.count + 1).min(MEMORY);
                self.mean += (raw - self.mean) / f64::from(self.count);
            }
            return;
        }
        if wheels == Wheels::Turning || !REST_RANGE.contains(&raw) {
            self.count = 0;
            return;
        }
        let is_first = self.count == 0;
        self.smallest = if is_first {
            raw
        } else {
            self.smallest.min(raw)
        };
        self.largest = if is_first { raw } else { self.largest.max(raw) };
        if self.largest - self.smallest > REST_SPREAD {
            self.count = 0;
            return;
        }
        self.count += 1;
        self.mean = if is_first {
            raw
        } else {
            self.mean + (raw - self.mean) / f64::from(self.count)
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_rest(gyro: &mut Gyro, readings: impl IntoIterator<Item = u16>) {
        for raw in readings {
            gyro.take(raw, Wheels::Standing);
        }
    }

    #[test]
    fn a_configured_rest_is_used_at_once_and_kept() {
        let mut gyro = Gyro::new(Some(600.5), GyroSign::CounterClockwise);
        let rate = gyro.take(690, Wheels::Turning).unwrap();
        assert!((rate.0.to_degrees() - 89.5).abs() < 1e-9);
        at_rest(&mut gyro, [598; 100]);
        assert_eq!(gyro.rest(), Some(600.5));
    }

    #[test]
    fn the_rest_is_learnt_standing_and_nothing_is_told_before() {
        let mut gyro = Gyro::new(None, GyroSign::Clockwise);
        assert_eq!(gyro.take(600, Wheels::Turning), None);
        at_rest(&mut gyro, (0..24).map(|index| 597 + index % 2));
        assert_eq!(gyro.rest(), None);
        at_rest(&mut gyro, [597]);
        assert!((gyro.rest().unwrap() - 597.48).abs() < 1e-9);
        let rate = gyro.take(607, Wheels::Turning).unwrap();
        assert!((rate.0.to_degrees() + 9.52).abs() < 1e-9);
    }

    #[test]
    fn a_turn_while_it_learns_begins_anew_and_a_turn_by_hand_teaches_nothing() {
        let mut gyro = Gyro::new(None, GyroSign::CounterClockwise);
        at_rest(&mut gyro, [600; 24]);
        at_rest(&mut gyro, [620, 600]);
        assert_eq!(gyro.rest(), None);
        at_rest(&mut gyro, [600; 25]);
        assert!(gyro.rest().is_some());
        at_rest(&mut gyro, [640; 200]);
        assert_eq!(gyro.rest(), Some(600.0));
    }

    #[test]
    fn the_rest_follows_slowly_while_the_robot_stands() {
        let mut gyro = Gyro::new(None, GyroSign::CounterClockwise);
        at_rest(&mut gyro, [600; 25]);
        at_rest(&mut gyro, [602; 25]);
        let soon = gyro.rest().unwrap();
        assert!((soon - 601.0).abs() < 1e-9, "{soon}");
        at_rest(&mut gyro, [602; 2_000]);
        assert!((gyro.rest().unwrap() - 602.0).abs() < 0.05);
    }

    #[test]
    fn an_empty_port_is_no_gyro() {
        let mut gyro = Gyro::new(None, GyroSign::CounterClockwise);
        at_rest(&mut gyro, [1023; 100]);
        assert_eq!(gyro.rest(), None);
        assert_eq!(gyro.take(5_000, Wheels::Standing), None);
    }
}

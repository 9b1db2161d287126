//! A gyro's samples as total turn and mean rate.
//!
//! The total is what the station lives by: with a rate alone a lost frame is a lost turn. It is summed in whole numbers,
//! so that nothing drifts and every language comes to the same bytes.
//!
//! # Model
//! ```text
//! turn  += rate * dt        each rate holds since the sample before it; kept exactly, sent rounded down
//! mean   = sum of rates / number of samples since the last message, of the last 1 to 100, rounded to the nearest unit
//! ```
//! # Assumptions
//! Samples come at nearly equal intervals, and often enough that a rate holds for one of them. After a gap of more than
//! a second the turn made in it is unknown: it is left out, and the total goes on from where it was.

use crate::messages::{Inertial, InertialParts};

/// The longest interval over which a rate is believed to hold.
const LONGEST_US: u32 = 1_000_000;
/// Beyond this PB_INERTIAL.turn_rate saturates, and with it the total.
const LARGEST_URAD_PER_S: i32 = 16_383_500;
/// Unit of PB_INERTIAL.turn_rate in microradians per second.
const RATE_UNIT_URAD_PER_S: i64 = 500;
/// Microseconds in a second.
const MICROS: i64 = 1_000_000;
/// After this number of samples the mean begins anew: so its sum stays within 32 bits.
const MANY: i32 = 100;

/// Sums samples between two messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gyro {
    turn_urad: i32,
    /// What is above `turn_urad`, in millionths of a microradian.
    rest: i64,
    sampled_us: Option<u32>,
    sum_urad_per_s: i32,
    samples: i32,
}

impl Gyro {
    /// A gyro that has seen nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self { turn_urad: 0, rest: 0, sampled_us: None, sum_urad_per_s: 0, samples: 0 }
    }

    /// Takes a sample: the rate at `now_us`, counter-clockwise positive, in microradians per second (a degree per second
    /// is 17453). Rates beyond 16.38 rad/s are cut off there.
    pub fn sample(&mut self, now_us: u32, rate_urad_per_s: i32) {
        let rate = rate_urad_per_s.clamp(-LARGEST_URAD_PER_S, LARGEST_URAD_PER_S);
        if let Some(before) = self.sampled_us {
            self.turn(now_us.wrapping_sub(before), rate);
        }
        self.sampled_us = Some(now_us);
        if self.samples == MANY {
            self.sum_urad_per_s = 0;
            self.samples = 0;
        }
        self.sum_urad_per_s += rate;
        self.samples += 1;
    }

    /// What is to be sent: the total turn, and the mean rate since the last call. `None` if there was no sample since.
    pub fn take(&mut self) -> Option<Inertial> {
        let time_us = self.sampled_us.filter(|_| self.samples > 0)?;
        let (sum, samples) = (i64::from(self.sum_urad_per_s), i64::from(self.samples));
        let half = samples * RATE_UNIT_URAD_PER_S / 2;
        let mean = (sum + half).div_euclid(samples * RATE_UNIT_URAD_PER_S);
        self.sum_urad_per_s = 0;
        self.samples = 0;
        Some(Inertial {
            time_us,
            turn_urad: self.turn_urad,
            turn_rate: mean.clamp(i64::from(i16::MIN), i64::from(i16::MAX)) as i16,
            accel_left: 0,
            accel_right: 0,
            valid: InertialParts::GYRO,
        })
    }

    fn turn(&mut self, interval_us: u32, rate_urad_per_s: i32) {
        if interval_us > LONGEST_US {
            return;
        }
        let total = self.rest + i64::from(rate_urad_per_s) * i64::from(interval_us);
        self.rest = total.rem_euclid(MICROS);
        // At most 16.4 rad in one interval; the total wraps.
        let turned = total.div_euclid(MICROS) as i32;
        self.turn_urad = self.turn_urad.wrapping_add(turned);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_adds_no_turn_and_silence_sends_nothing() {
        let mut gyro = Gyro::new();
        assert_eq!(gyro.take(), None);
        gyro.sample(0, 1_000_000);
        gyro.sample(LONGEST_US, 1_000_000);
        gyro.sample(2 * LONGEST_US + 1, 1_000_000);
        let sent = gyro.take().map(|inertial| (inertial.turn_urad, inertial.turn_rate));
        assert_eq!(sent, Some((1_000_000, 2_000)));
        assert_eq!(gyro.take(), None);
    }

    #[test]
    fn absurd_rates_saturate_and_many_samples_do_not_overflow() {
        let mut gyro = Gyro::new();
        for step in 0..1_000 {
            gyro.sample(step, i32::MIN);
        }
        let sent = gyro.take().map(|inertial| inertial.turn_rate);
        assert_eq!(sent, Some(-32_767));
    }

    #[test]
    fn the_total_wraps() {
        let mut gyro = Gyro { turn_urad: i32::MAX, ..Gyro::new() };
        gyro.sample(0, 0);
        gyro.sample(1_000_000, 1);
        assert_eq!(gyro.take().map(|inertial| inertial.turn_urad), Some(i32::MIN));
    }
}

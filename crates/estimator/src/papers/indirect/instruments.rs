//! The instruments beside the wheels, each integrated separately: the angle by a gyro; speed, distance and angle by
//! accelerometers. Each sum is compared with the nominal path within the wheels' last step, so that the rounding of the
//! counters does not add up.

use posebridge_telemetry::{BrickClock, FusionOutcome, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::saved::{finite, not_negative};
use crate::validation::reject_repeated;

/// After a longer silence the integral restarts.
const MAX_INTERVAL: TimeDelta = TimeDelta::from_millis(300);

/// Timing of an instrument, and whether the filter tracks its integrals.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct InstrumentTiming {
    last: Option<Timestamp<BrickClock>>,
    /// Sum of the squared intervals since it was taken last.
    #[serde(deserialize_with = "not_negative")]
    squared_intervals_s2: f64,
    /// Whether the filter has rows for the errors of the sums.
    pub(super) is_tracked: bool,
    /// Whether the sums were compared with the path since the last sample.
    pub(super) is_compared: bool,
}

impl InstrumentTiming {
    /// The interval that a sample ends, in seconds; zero for the first one and after a silence. Errors: it is not
    /// used.
    fn record_sample(&mut self, stamp: Timestamp<BrickClock>) -> Result<f64, FusionOutcome> {
        if let Some(verdict) = reject_repeated(self.last, stamp) {
            return Err(verdict);
        }
        if self.is_silent_at(stamp) {
            *self = Self { last: Some(stamp), ..Self::default() };
            return Ok(0.0);
        }
        let interval_s = self.last.map_or(0.0, |last| (stamp - last).as_secs_f64());
        self.last = Some(stamp);
        self.squared_intervals_s2 += interval_s * interval_s;
        self.is_compared = false;
        Ok(interval_s)
    }

    /// The instant of the sums, if they have not been compared yet.
    pub(super) fn pending_comparison(&self) -> Option<Timestamp<BrickClock>> {
        self.last.filter(|_| !self.is_compared)
    }

    /// Whether the instrument's last sample is older than the longest interval.
    pub(super) fn is_silent_at(&self, stamp: Timestamp<BrickClock>) -> bool {
        self.last.is_none_or(|last| stamp - last > MAX_INTERVAL)
    }

    /// Returns the sum of the squared intervals and resets it.
    pub(super) fn take_squared_intervals_s2(&mut self) -> f64 {
        std::mem::take(&mut self.squared_intervals_s2)
    }
}

#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct GyroAngle {
    pub(super) timing: InstrumentTiming,
    #[serde(deserialize_with = "finite")]
    pub(super) angle_rad: f64,
}

impl GyroAngle {
    /// Integrates the mean rate since the previous sample.
    pub(super) fn integrate(&mut self, stamp: Timestamp<BrickClock>, rate_rad_per_s: f64) -> Result<(), FusionOutcome> {
        let interval_s = self.timing.record_sample(stamp)?;
        self.angle_rad += rate_rad_per_s * interval_s;
        Ok(())
    }
}

/// Distance and angle by a pair of accelerometers, one at each wheel.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct AccelerometerIntegral {
    pub(super) timing: InstrumentTiming,
    #[serde(deserialize_with = "finite")]
    pub(super) distance_m: f64,
    #[serde(deserialize_with = "finite")]
    pub(super) speed_m_per_s: f64,
    #[serde(deserialize_with = "finite")]
    pub(super) angle_rad: f64,
    #[serde(deserialize_with = "finite")]
    pub(super) turn_rad_per_s: f64,
}

impl AccelerometerIntegral {
    /// Integrates accelerations, m/s² and rad/s², twice: each is the mean since the previous sample.
    pub(super) fn integrate(
        &mut self,
        stamp: Timestamp<BrickClock>,
        forward: f64,
        turn: f64,
    ) -> Result<(), FusionOutcome> {
        let interval_s = self.timing.record_sample(stamp)?;
        let half_s2 = 0.5 * interval_s * interval_s;
        self.distance_m += self.speed_m_per_s * interval_s + forward * half_s2;
        self.speed_m_per_s += forward * interval_s;
        self.angle_rad += self.turn_rad_per_s * interval_s + turn * half_s2;
        self.turn_rad_per_s += turn * interval_s;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(millis: i64) -> Timestamp<BrickClock> {
        Timestamp::from_millis(millis)
    }

    #[test]
    fn constant_acceleration_gives_speed_and_distance_whatever_the_intervals() {
        let mut sums = AccelerometerIntegral::default();
        let verdicts = [0, 100, 130, 330, 330, 200, 500].map(|at| sums.integrate(ms(at), 2.0, -4.0));
        assert_eq!(verdicts[0], Ok(()));
        assert_eq!(verdicts[4], Err(FusionOutcome::Malformed));
        assert_eq!(verdicts[5], Err(FusionOutcome::TooOld));
        assert!((sums.speed_m_per_s - 1.0).abs() < 1e-12);
        assert!((sums.distance_m - 0.25).abs() < 1e-12);
        assert!((sums.angle_rad + 0.5).abs() < 1e-12);
    }

    #[test]
    fn after_a_silence_an_instrument_begins_anew() {
        let mut gyro = GyroAngle::default();
        gyro.integrate(ms(0), 1.0).unwrap();
        gyro.timing.is_tracked = true;
        gyro.integrate(ms(300), 1.0).unwrap();
        assert!(gyro.timing.is_tracked && gyro.timing.is_silent_at(ms(601)));
        gyro.integrate(ms(601), 1.0).unwrap();
        assert!(!gyro.timing.is_tracked);
    }
}

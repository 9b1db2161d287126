//! The gyro's angle as a turn that neither wraps nor jumps back.
//!
//! The sensor counts degrees in 16 bits, and setting its mode, as a program on the brick may do, sets the angle to zero. A change
//! that the rate does not explain is replaced by the integral of the rate.

use posebridge_telemetry::TimeDelta;

/// The sensor's range, degrees per second (LEGO's manual).
const MAX_DEG_PER_S: f64 = 440.0;
/// Steps of both angles and of the rate.
const MARGIN_DEG: f64 = 5.0;
/// Period of the sensor's angle.
const PERIOD_DEG: f64 = 65_536.0;

/// The turn since the first sample, degrees, the sensor's own sign.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TurnAccumulator {
    total_deg: f64,
    last_deg: Option<f64>,
}

impl TurnAccumulator {
    /// Takes angle and rate, so long after the ones before.
    pub(super) fn push(&mut self, since: TimeDelta, angle_deg: f64, rate_deg_per_s: f64) -> f64 {
        if let Some(last_deg) = self.last_deg {
            let half = 0.5 * PERIOD_DEG;
            let change_deg = (angle_deg - last_deg + half).rem_euclid(PERIOD_DEG) - half;
            let by_rate_deg = rate_deg_per_s * since.as_secs_f64();
            let most_deg = MAX_DEG_PER_S * since.as_secs_f64() + MARGIN_DEG;
            self.total_deg += if (change_deg - by_rate_deg).abs() <= most_deg { change_deg } else { by_rate_deg };
        }
        self.last_deg = Some(angle_deg);
        self.total_deg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_turn_runs_on_across_the_wrap_and_a_reset_of_the_angle() {
        let mut turn = TurnAccumulator::default();
        let cycle = TimeDelta::from_millis(100);
        let angles = [32_760.0, 32_766.0, -32_764.0, -32_758.0, 0.0, 6.0];
        let turns = angles.map(|angle_deg| turn.push(cycle, angle_deg, 60.0));
        assert_eq!(turns, [0.0, 6.0, 12.0, 18.0, 24.0, 30.0]);
    }
}

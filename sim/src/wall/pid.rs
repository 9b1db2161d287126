//! The PID controller on board.

use super::ranger::RangeEstimate;
use super::scene::Gains;

/// The controller with its sum.
#[derive(Clone, Debug)]
pub(super) struct Pid {
    pub(super) gains: Gains,
    pub(super) target_m: f64,
    pub(super) max_pwm: f64,
    pub(super) integral_most_m_s: f64,
    pub(super) integral_m_s: f64,
}

impl Pid {
    /// The PWM for the estimate; `dt_s` is the time since the turn before.
    pub(super) fn steer(&mut self, believed: RangeEstimate, dt_s: f64) -> f64 {
        let error_m = believed.distance_m - self.target_m;
        let sum = self.integral_m_s + error_m * dt_s;
        self.integral_m_s = sum.clamp(-self.integral_most_m_s, self.integral_most_m_s);
        let pwm = self.gains.kp_pwm_per_m * error_m + self.gains.ki_pwm_per_m_s * self.integral_m_s
            - self.gains.kd_pwm_s_per_m * believed.towards_m_per_s;
        pwm.clamp(-self.max_pwm, self.max_pwm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_sum_and_rate_add_up_and_the_limits_hold() {
        let mut pid = Pid {
            gains: Gains { kp_pwm_per_m: 20.0, ki_pwm_per_m_s: 5.0, kd_pwm_s_per_m: 8.0 },
            target_m: 0.3,
            max_pwm: 80.0,
            integral_most_m_s: 0.5,
            integral_m_s: 0.0,
        };
        let believed = |distance_m, towards_m_per_s| RangeEstimate { distance_m, towards_m_per_s };
        // 20 x 1 + 5 x 0.1 - 8 x 0.5
        assert!((pid.steer(believed(1.3, 0.5), 0.1) - 16.5).abs() < 1e-12);
        assert_eq!(pid.steer(believed(9.0, 0.0), 1.0), 80.0);
        assert_eq!(pid.integral_m_s, 0.5);
        assert_eq!(pid.steer(believed(0.3, 20.0), 0.1), -80.0);
    }
}

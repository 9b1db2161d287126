//! A robot that drives straight at a wall on level ground: distance and speed under a held motor input, in discrete
//! time by two rules.
//!
//! ```text
//! x = [z, v]'     z distance to the wall, m      v speed towards it, m/s      u motor input, 1 at PWM 80
//! dz/dt = -v      dv/dt = (u - d v) / m          steady speed u / d           a = d / m, 1/s
//!
//! Euler:  A = [1, -dt; 0, 1 - a dt]              B = [0; dt/m]
//! exact:  A = [1, -g;  0, E]                     B = [-(dt - g)/d; (1 - E)/d]       E = e^(-a dt)   g = (1 - E)/a
//!
//! Q = q_z [dt, 0; 0, 0] + q_v [ (dt - 2 g + g_2)/a^2,  -(g - g_2)/a ]     g_2 = (1 - E^2)/(2 a)
//!                             [ -(g - g_2)/a,          g_2          ]     q_z, q_v densities of white noise
//! ```
//! Source: Paper 3 (Lab 7: step test, d and m, Euler's rule); exact discretisation: Van Loan (1978); docs/lab/wall.md
//! sections M1, M2.

use nalgebra::{Matrix2, Vector2};

pub const DISTANCE: usize = 0;
pub const SPEED: usize = 1;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallApproachModel {
    /// Drag d: input per steady speed.
    pub drag_s_per_m: f64,
    /// Mass m: input per acceleration.
    pub mass_s2_per_m: f64,
}

/// One step of the model: x' = A x + B u.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiscreteModel {
    pub a: Matrix2<f64>,
    pub b: Vector2<f64>,
}

impl WallApproachModel {
    /// From a step test: the steady speed under the input 1, and the time to 90 % of it; m = d t90 / ln 10.
    pub fn from_step_test(steady_m_per_s: f64, rise_90_s: f64) -> Self {
        let drag_s_per_m = 1.0 / steady_m_per_s;
        Self { drag_s_per_m, mass_s2_per_m: drag_s_per_m * rise_90_s / std::f64::consts::LN_10 }
    }

    /// a = d / m: the inverse of the time constant.
    pub fn rate_per_s(&self) -> f64 {
        self.drag_s_per_m / self.mass_s2_per_m
    }

    /// Euler's rule, as the paper has it. It is unstable for steps beyond 2 m / d.
    pub fn euler(&self, dt_s: f64) -> DiscreteModel {
        DiscreteModel {
            a: Matrix2::new(1.0, -dt_s, 0.0, 1.0 - self.rate_per_s() * dt_s),
            b: Vector2::new(0.0, dt_s / self.mass_s2_per_m),
        }
    }

    /// The exact step for a held input. Negative steps go back.
    pub fn exact(&self, dt_s: f64) -> DiscreteModel {
        let a = self.rate_per_s();
        let decayed = -(-a * dt_s).exp_m1();
        let g = decayed / a;
        DiscreteModel {
            a: Matrix2::new(1.0, -g, 0.0, 1.0 - decayed),
            b: Vector2::new(-(dt_s - g), decayed) / self.drag_s_per_m,
        }
    }

    /// What white noise of these densities, m²/s on distance and m²/s³ on speed, adds over a step of at least 0 s.
    pub fn exact_noise(&self, dt_s: f64, distance_density: f64, speed_density: f64) -> Matrix2<f64> {
        let a = self.rate_per_s();
        let g = -(-a * dt_s).exp_m1() / a;
        let g_2 = -(-2.0 * a * dt_s).exp_m1() / (2.0 * a);
        let through = if a * dt_s < SHORT {
            // The closed form loses its digits; the next term is this one times 3/4 a dt.
            dt_s.powi(3) / 3.0
        } else {
            (dt_s - 2.0 * g + g_2) / (a * a)
        };
        let cross = if a * dt_s < SHORT { 0.5 * dt_s * dt_s } else { (g - g_2) / a };
        let shared = -speed_density * cross;
        Matrix2::new(distance_density * dt_s + speed_density * through, shared, shared, speed_density * g_2)
    }
}

/// Below this a dt the closed forms of the noise are differences of nearly equal numbers.
const SHORT: f64 = 1e-5;

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: WallApproachModel = WallApproachModel { drag_s_per_m: 0.816_33, mass_s2_per_m: 0.353_46 };

    #[test]
    fn two_exact_steps_are_one_of_their_length_noise_included() {
        let (first, second, combined) = (PAPER.exact(0.03), PAPER.exact(0.17), PAPER.exact(0.2));
        assert!((second.a * first.a - combined.a).norm() < 1e-14);
        assert!((second.a * first.b + second.b - combined.b).norm() < 1e-14);
        for (first_s, second_s) in [(0.03, 0.17), (2e-6, 0.02), (3e-6, 9e-6)] {
            let q = |dt_s| PAPER.exact_noise(dt_s, 0.02, 0.3);
            let a = PAPER.exact(second_s).a;
            let in_two = a * q(first_s) * a.transpose() + q(second_s);
            let at_once = q(first_s + second_s);
            assert!((in_two - at_once).norm() < 1e-9 * at_once.norm());
        }
    }

    #[test]
    fn a_step_back_undoes_a_step_ahead() {
        let (ahead, back) = (PAPER.exact(0.08), PAPER.exact(-0.08));
        assert!((back.a * ahead.a - Matrix2::identity()).norm() < 1e-14);
        assert!((back.a * ahead.b + back.b).norm() < 1e-14);
    }
}

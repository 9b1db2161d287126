//! The group SE(2): poses that are composed, and the small motions that lead from one to the next.
//!
//! ```text
//! X = (t, R(th))                                   X Y = (t_X + R_X t_Y, th_X + th_Y)
//! exp(rho, phi) = (V(phi) rho, phi)                V = [s, -c; c, s],  s = sin(phi)/phi,  c = (1 - cos(phi))/phi
//! Ad(X^-1) (rho, phi) = (R' (rho + phi J t), phi)  J t = (-t_y, t_x)
//! ```
//! Source: Barrau and Bonnabel (2017), section V; docs/maths/pose.md section 1.

use nalgebra::Matrix3;
use posebridge_telemetry::quantities::wrap_rad;
use serde::{Deserialize, Serialize};

use crate::saved::finite;

/// An element of SE(2): position and heading of a body in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Se2 {
    /// Coordinates of the origin.
    #[serde(deserialize_with = "finite")]
    pub x_m: f64,
    #[serde(deserialize_with = "finite")]
    pub y_m: f64,
    /// Wrapped.
    #[serde(deserialize_with = "finite")]
    pub heading_rad: f64,
}

impl Se2 {
    /// The motion of a twist in unit time: forward and left in metres, turn in radians.
    pub fn exp([forward_m, left_m, turn_rad]: [f64; 3]) -> Self {
        let (s, c) = sine_and_cosine_ratios(turn_rad);
        Self { x_m: s * forward_m - c * left_m, y_m: c * forward_m + s * left_m, heading_rad: wrap_rad(turn_rad) }
    }

    /// The twist of this motion, with a turn in (-pi, pi].
    pub fn log(self) -> [f64; 3] {
        let (s, c) = sine_and_cosine_ratios(self.heading_rad);
        let determinant = s * s + c * c;
        [(s * self.x_m + c * self.y_m) / determinant, (s * self.y_m - c * self.x_m) / determinant, self.heading_rad]
    }

    /// The right Jacobian of the group: how a twist's motion changes with the twist, in the frame of its end.
    pub fn right_jacobian([forward_m, left_m, turn_rad]: [f64; 3]) -> Matrix3<f64> {
        let (s, c) = sine_and_cosine_ratios(turn_rad);
        // (1 - s) / turn and (1 - cos) / turn^2, by series near zero.
        let (one_less_s, half) =
            if turn_rad.abs() < 1e-4 { (turn_rad / 6.0, 0.5) } else { ((1.0 - s) / turn_rad, c / turn_rad) };
        let forward_by_turn = forward_m * one_less_s - left_m * half;
        let left_by_turn = left_m * one_less_s + forward_m * half;
        Matrix3::new(s, c, forward_by_turn, -c, s, left_by_turn, 0.0, 0.0, 1.0)
    }

    /// This pose, moved by `motion` in its own frame.
    pub fn compose(self, motion: Self) -> Self {
        let (sin, cos) = self.heading_rad.sin_cos();
        Self {
            x_m: self.x_m + cos * motion.x_m - sin * motion.y_m,
            y_m: self.y_m + sin * motion.x_m + cos * motion.y_m,
            heading_rad: wrap_rad(self.heading_rad + motion.heading_rad),
        }
    }

    pub fn inverse(self) -> Self {
        let (sin, cos) = self.heading_rad.sin_cos();
        Self {
            x_m: -cos * self.x_m - sin * self.y_m,
            y_m: sin * self.x_m - cos * self.y_m,
            heading_rad: wrap_rad(-self.heading_rad),
        }
    }

    /// The adjoint, row by row: an error after this motion, seen before it.
    pub fn adjoint(self) -> [[f64; 3]; 3] {
        let (sin, cos) = self.heading_rad.sin_cos();
        [[cos, -sin, self.y_m], [sin, cos, -self.x_m], [0.0, 0.0, 1.0]]
    }

    /// The motion from this pose to another.
    pub fn between(self, other: Self) -> Self {
        self.inverse().compose(other)
    }

    /// A point, given in the frame of this pose, in the body's frame: (forward, left), in metres.
    #[inline]
    pub fn point_in_body(self, x_m: f64, y_m: f64) -> [f64; 2] {
        let (sin, cos) = self.heading_rad.sin_cos();
        let (dx_m, dy_m) = (x_m - self.x_m, y_m - self.y_m);
        [cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m]
    }
}

/// sin(t)/t and (1 - cos t)/t, from the chord: no loss of digits near zero, as 1 - cos t would have.
fn sine_and_cosine_ratios(turn_rad: f64) -> (f64, f64) {
    let half = 0.5 * turn_rad;
    let (sin, cos) = if half.abs() < 1e-3 {
        // What an update turns a pose by, mostly. The next terms are below 1e-20.
        let squared = half * half;
        (half * (1.0 - squared / 6.0 * (1.0 - squared / 20.0)), 1.0 - 0.5 * squared * (1.0 - squared / 12.0))
    } else {
        half.sin_cos()
    };
    let (chord, _) = chord_ratio_of(half, sin, cos);
    (chord * cos, chord * sin)
}

/// A step along an arc and its derivatives, in the body's frame at the end of the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcStep {
    pub motion: Se2,
    pub cos: f64,
    pub sin: f64,
    /// Derivatives of the end's position by the distance.
    pub by_forward: [f64; 2],
    /// Derivatives of the end's position by the turn.
    pub by_turn: [f64; 2],
}

impl ArcStep {
    pub fn new(forward_m: f64, turn_rad: f64) -> Self {
        let (sin_half, cos_half) = (0.5 * turn_rad).sin_cos();
        let (chord, chord_by_turn) = chord_ratio_of(0.5 * turn_rad, sin_half, cos_half);
        let along = chord * forward_m;
        let (sin, cos) = (2.0 * sin_half * cos_half, 1.0 - 2.0 * sin_half * sin_half);
        Self {
            motion: Se2 { x_m: along * cos_half, y_m: along * sin_half, heading_rad: turn_rad },
            cos,
            sin,
            by_forward: [chord * cos_half, -chord * sin_half],
            by_turn: [
                chord_by_turn * forward_m * cos_half + 0.5 * along * sin_half,
                0.5 * along * cos_half - chord_by_turn * forward_m * sin_half,
            ],
        }
    }
}

/// Chord over arc length, sin(t/2)/(t/2), and its derivative by t; by series where the quotient would lose digits.
pub(super) fn chord_ratio(turn_rad: f64) -> (f64, f64) {
    let half = 0.5 * turn_rad;
    let (sin, cos) = half.sin_cos();
    chord_ratio_of(half, sin, cos)
}

/// The same, with sine and cosine of half the turn given.
fn chord_ratio_of(half: f64, sin: f64, cos: f64) -> (f64, f64) {
    if half.abs() < 1e-3 {
        // The next terms are below 1e-14 of the first.
        let squared = half * half;
        return (1.0 - squared / 6.0 * (1.0 - squared / 20.0), -half / 6.0 * (1.0 - squared / 10.0));
    }
    (sin / half, 0.5 * (cos * half - sin) / (half * half))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWISTS: [[f64; 3]; 6] =
        [[0.3, 0.0, 0.0], [-0.1, 0.05, 5e-5], [0.4, -0.3, 1.1e-4], [1.0, -2.0, 0.7], [0.2, 0.4, -3.1], [0.0, 0.0, 2.0]];

    fn distance(a: Se2, b: Se2) -> f64 {
        let apart = a.between(b);
        apart.x_m.abs() + apart.y_m.abs() + apart.heading_rad.abs()
    }

    #[test]
    fn the_logarithm_undoes_the_exponential_and_the_inverse_the_motion() {
        for twist in TWISTS {
            let back = Se2::exp(twist).log();
            for (found, expected) in back.iter().zip(twist) {
                assert!((found - expected).abs() < 1e-12, "{twist:?} became {back:?}");
            }
            let motion = Se2::exp(twist);
            assert!(distance(motion.compose(motion.inverse()), Se2::default()) < 1e-12);
        }
    }

    #[test]
    fn a_twist_in_a_thousand_parts_ends_where_the_complete_one_does() {
        for twist in TWISTS {
            let part = Se2::exp(twist.map(|value| value / 1000.0));
            let composed = (0..1000).fold(Se2::default(), |at, _| at.compose(part));
            assert!(distance(composed, Se2::exp(twist)) < 1e-11, "{twist:?}");
        }
    }

    #[test]
    fn the_right_jacobian_agrees_with_central_differences() {
        let h = 1e-6;
        for twist in TWISTS {
            let jacobian = Se2::right_jacobian(twist);
            for column in 0..3 {
                let moved = |by: f64| {
                    let mut other = twist;
                    other[column] += by;
                    Se2::exp(twist).between(Se2::exp(other)).log()
                };
                let (ahead, behind) = (moved(h), moved(-h));
                for row in 0..3 {
                    let expected = (ahead[row] - behind[row]) / (2.0 * h);
                    assert!((jacobian[(row, column)] - expected).abs() < 1e-7, "{twist:?}");
                }
            }
        }
    }
}

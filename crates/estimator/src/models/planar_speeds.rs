//! A body in the plane whose speeds are states and whose accelerations are an input; rows as telemetry's
//! `estimate::row`, SI units.
//!
//! ```text
//! x = [x, y, th, v, w]'     u = [a, alpha]'     phi = th + T w / 2  the mean heading during the step T
//! x'  = x + v T cos phi     y'  = y + v T sin phi     th' = th + T w     v'  = v + T a     w'  = w + T alpha
//!
//!     | 1  0  -v T sin phi   T cos phi   -v T^2 sin phi / 2 |
//!     | 0  1   v T cos phi   T sin phi    v T^2 cos phi / 2 |
//! F = | 0  0   1             0            T                 |          P' = F P F' + Q
//!     | 0  0   0             1            0                 |
//!     | 0  0   0             0            1                 |
//! ```
//! The heading is not wrapped: a filter that compares it with an integral must know how many turns both have made.
//!
//! Source: Paper 1 (Valera et al.), equations 13, 20 to 22 and 24; its Jacobian by hand; docs/lab/square.md sections M3
//! and M4.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::DriveGeometry;
use posebridge_telemetry::estimate::row;
use serde::{Deserialize, Serialize};

use crate::saved::finite;

pub const N: usize = 5;
pub type Mean = SVector<f64, N>;
pub type Covariance = SMatrix<f64, N, N>;

/// The accelerations of the body, along its x axis and about the vertical: the input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Acceleration {
    #[serde(deserialize_with = "finite")]
    pub forward_m_per_s2: f64,
    #[serde(deserialize_with = "finite")]
    pub turn_rad_per_s2: f64,
}

impl Acceleration {
    /// a = (a_L + a_R) / 2, alpha = (a_R - a_L) / b.
    pub fn from_wheels(left_m_per_s2: f64, right_m_per_s2: f64, geometry: &DriveGeometry) -> Self {
        Self {
            forward_m_per_s2: 0.5 * (left_m_per_s2 + right_m_per_s2),
            turn_rad_per_s2: (right_m_per_s2 - left_m_per_s2) / geometry.track_width.0,
        }
    }

    /// The acceleration of mid-axle, from that of a pair of sensors at (x, y) that point `yaw_rad` to the left:
    ///
    /// ```text
    /// f       = (a - x w^2 - y alpha) cos(yaw) + (v w + x alpha - y w^2) sin(yaw)      f measured, v and w the speeds
    /// alpha_f = alpha cos(yaw) - w^2 sin(yaw)                                          alpha_f from their difference
    /// ```
    #[must_use]
    pub fn at_mid_axle(self, [x_m, y_m, yaw_rad]: [f64; 3], forward_m_per_s: f64, turn_rad_per_s: f64) -> Self {
        let (sin, cos) = yaw_rad.sin_cos();
        let turn_rad2 = turn_rad_per_s.powi(2);
        let alpha = (self.turn_rad_per_s2 + turn_rad2 * sin) / cos;
        let sideways = forward_m_per_s * turn_rad_per_s + x_m * alpha - y_m * turn_rad2;
        let forward_m_per_s2 = (self.forward_m_per_s2 - sideways * sin) / cos + x_m * turn_rad2 + y_m * alpha;
        Self { forward_m_per_s2, turn_rad_per_s2: alpha }
    }
}

/// One step of the motion, for mean and covariance together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictionStep {
    /// More than zero.
    pub interval_s: f64,
    /// The diagonal of Q for this step, rows as telemetry's `estimate::row`: m², m², rad², m²/s², rad²/s².
    pub variances: [f64; N],
}

impl PredictionStep {
    /// [`advance`], and F P F' + Q with the F of [`jacobian`], which reads only the lower triangle of P and leaves it
    /// symmetric.
    #[inline]
    pub fn predict(&self, mean: &mut Mean, covariance: &mut Covariance, felt: Acceleration) {
        let slope = SparseJacobian::at(mean, self.interval_s);
        *mean = slope.predict_mean(mean, felt);
        slope.propagate_covariance(covariance, &self.variances);
    }
}

/// Moves the state by `dt_s`: pose by the speeds at the beginning, speeds by the accelerations.
pub fn advance(mean: &Mean, felt: Acceleration, dt_s: f64) -> Mean {
    SparseJacobian::at(mean, dt_s).predict_mean(mean, felt)
}

/// F: the derivative of [`advance`] by the state, 5 x 5. The input does not enter it.
pub fn jacobian(mean: &Mean, dt_s: f64) -> Covariance {
    let slope = SparseJacobian::at(mean, dt_s);
    let mut f = Covariance::identity();
    f[(row::X, row::HEADING)] = slope.x_by_heading;
    f[(row::X, row::FORWARD)] = slope.x_by_forward;
    f[(row::X, row::TURN)] = slope.x_by_turn;
    f[(row::Y, row::HEADING)] = slope.y_by_heading;
    f[(row::Y, row::FORWARD)] = slope.y_by_forward;
    f[(row::Y, row::TURN)] = slope.y_by_turn;
    f[(row::HEADING, row::TURN)] = slope.heading_by_turn;
    f
}

/// The entries of F that are neither 0 nor 1.
#[derive(Clone, Copy)]
struct SparseJacobian {
    x_by_heading: f64,
    x_by_forward: f64,
    x_by_turn: f64,
    y_by_heading: f64,
    y_by_forward: f64,
    y_by_turn: f64,
    heading_by_turn: f64,
}

impl SparseJacobian {
    #[inline]
    fn at(mean: &Mean, t: f64) -> Self {
        let (sin, cos) = (mean[row::HEADING] + 0.5 * t * mean[row::TURN]).sin_cos();
        let travel_m = t * mean[row::FORWARD];
        let (x_by_heading, y_by_heading) = (-travel_m * sin, travel_m * cos);
        Self {
            x_by_heading,
            x_by_forward: t * cos,
            x_by_turn: 0.5 * t * x_by_heading,
            y_by_heading,
            y_by_forward: t * sin,
            y_by_turn: 0.5 * t * y_by_heading,
            heading_by_turn: t,
        }
    }

    /// The state after the step: the motion is linear in v and w except for the direction, so F's own entries give it.
    #[inline]
    fn predict_mean(&self, mean: &Mean, felt: Acceleration) -> Mean {
        let t = self.heading_by_turn;
        Mean::new(
            mean[row::X] + mean[row::FORWARD] * self.x_by_forward,
            mean[row::Y] + mean[row::FORWARD] * self.y_by_forward,
            mean[row::HEADING] + t * mean[row::TURN],
            mean[row::FORWARD] + t * felt.forward_m_per_s2,
            mean[row::TURN] + t * felt.turn_rad_per_s2,
        )
    }

    /// P <- F P F' + Q. The rows of v and w of F are those of the identity, so G = F P differs from P in three rows only.
    #[inline]
    fn propagate_covariance(&self, p: &mut Covariance, q: &[f64; N]) {
        use row::{FORWARD as V, HEADING as H, TURN as W, X, Y};
        let (a, b, c) = (self.x_by_heading, self.x_by_forward, self.x_by_turn);
        let (d, e, f) = (self.y_by_heading, self.y_by_forward, self.y_by_turn);
        let t = self.heading_by_turn;
        let (hh, vh, wh) = (p[(H, H)], p[(V, H)], p[(W, H)]);
        let (vv, wv, ww) = (p[(V, V)], p[(W, V)], p[(W, W)]);
        let (hx, vx, wx) = (p[(H, X)], p[(V, X)], p[(W, X)]);
        let (hy, vy, wy) = (p[(H, Y)], p[(V, Y)], p[(W, Y)]);

        let xh = hx + a * hh + b * vh + c * wh;
        let xv = vx + a * vh + b * vv + c * wv;
        let xw = wx + a * wh + b * wv + c * ww;
        let xy = p[(Y, X)] + a * hy + b * vy + c * wy;
        let xx = p[(X, X)] + a * hx + b * vx + c * wx;
        let yh = hy + d * hh + e * vh + f * wh;
        let yv = vy + d * vh + e * vv + f * wv;
        let yw = wy + d * wh + e * wv + f * ww;
        let yy = p[(Y, Y)] + d * hy + e * vy + f * wy;
        let hv = vh + t * wv;
        let hw = wh + t * ww;

        p[(X, X)] = xx + a * xh + b * xv + c * xw + q[X];
        p[(Y, Y)] = yy + d * yh + e * yv + f * yw + q[Y];
        p[(H, H)] = hh + t * wh + t * hw + q[H];
        p[(V, V)] = vv + q[V];
        p[(W, W)] = ww + q[W];
        let mut set = |row, column, value| {
            p[(row, column)] = value;
            p[(column, row)] = value;
        };
        set(Y, X, xy + d * xh + e * xv + f * xw);
        set(H, X, xh + t * xw);
        set(V, X, xv);
        set(W, X, xw);
        set(H, Y, yh + t * yw);
        set(V, Y, yv);
        set(W, Y, yw);
        set(V, H, hv);
        set(W, H, hw);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: PredictionStep = PredictionStep { interval_s: 0.05, variances: [1e-6, 2e-6, 3e-6, 4e-4, 5e-3] };
    const ACCELERATION: Acceleration = Acceleration { forward_m_per_s2: 0.7, turn_rad_per_s2: -1.9 };

    fn states() -> [Mean; 4] {
        [
            Mean::from([0.0, 0.0, 0.0, 0.0, 0.0]),
            Mean::from([1.3, -0.7, 0.4, 0.2, 0.3]),
            Mean::from([-2.1, 3.9, 1.9, 0.35, 2.5]),
            Mean::from([5.0, 5.0, -2.6, -0.15, -4.0]),
        ]
    }

    fn covariance() -> Covariance {
        let root = Covariance::from_fn(|i, j| 0.1 * ((3 * i + 5 * j) as f64 + 0.5).sin());
        root * root.transpose() + Covariance::identity() * 0.02
    }

    fn moved(from: &Mean) -> Mean {
        advance(from, ACCELERATION, STEP.interval_s)
    }

    #[test]
    fn the_sparse_propagation_equals_the_dense_product_and_is_symmetric() {
        for mean in states() {
            let f = jacobian(&mean, STEP.interval_s);
            let q = Covariance::from_diagonal(&Mean::from(STEP.variances));
            let dense = f * covariance() * f.transpose() + q;
            let (mut carried, mut sparse) = (mean, covariance());
            STEP.predict(&mut carried, &mut sparse, ACCELERATION);
            assert!((sparse - dense).norm() < 1e-15, "{mean}");
            assert_eq!(sparse, sparse.transpose());
            assert_eq!(carried, moved(&mean), "the mean goes with it");
        }
    }
}

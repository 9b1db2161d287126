//! A body in the plane with its speeds as states, driven by its accelerations.
//!
//! The motion of the filters that believe in speeds rather than in wheel travel. It carries mean and covariance over one step;
//! the zeros of F are not multiplied, and only one triangle of P is computed.
//!
//! # Model
//! ```text
//! x = [x, y, th, v, w]'     m, m, rad, m/s, rad/s          u = [a, alpha]'     m/s2, rad/s2          T  length of the step, s
//!
//! phi = th + T w / 2                     mean heading during the step
//! x'  = x + v T cos phi
//! y'  = y + v T sin phi
//! th' = th + T w
//! v'  = v + T a
//! w'  = w + T alpha
//!
//!     | 1  0  -v T sin phi   T cos phi   -v T^2 sin phi / 2 |
//!     | 0  1   v T cos phi   T sin phi    v T^2 cos phi / 2 |
//! F = | 0  0   1             0            T                 |          P' = F P F' + Q
//!     | 0  0   0             1            0                 |
//!     | 0  0   0             0            1                 |
//! ```
//! # Assumptions
//! Accelerations are constant over a step, and the step is short against v / a: position and heading follow the speeds at its
//! beginning. The heading is not wrapped here; that is for the filter that holds it against something.
//!
//! # Sources
//! Paper 1 (Valera et al.), equation 24; its Jacobian by hand, checked against central differences below.

use nalgebra::{SMatrix, SVector};
pub use posebridge_telemetry::estimate::row;

/// How many states it has.
pub const N: usize = 5;

/// What accelerates the body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Acceleration {
    /// Along the body's x axis, in m/s².
    pub forward_m_per_s2: f64,
    /// About the vertical, in rad/s².
    pub turn_rad_per_s2: f64,
}

/// One step of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarSpeed {
    /// Length of the step, in seconds, more than zero.
    pub interval_s: f64,
    /// The diagonal of Q for this step, rows as in [`row`]: m², m², rad², m²/s², rad²/s².
    pub variances: [f64; N],
}

impl PlanarSpeed {
    /// Carries mean and covariance, rows as in [`row`], over the step. Of the covariance only the lower triangle is read; the
    /// result is symmetric to the last bit.
    #[inline]
    pub fn predict(
        &self,
        mean: &mut SVector<f64, N>,
        covariance: &mut SMatrix<f64, N, N>,
        acceleration: Acceleration,
    ) {
        let t = self.interval_s;
        let slope = Slope::at(mean, t);
        mean[row::X] += mean[row::FORWARD] * slope.x_by_forward;
        mean[row::Y] += mean[row::FORWARD] * slope.y_by_forward;
        mean[row::HEADING] += t * mean[row::TURN];
        mean[row::FORWARD] += t * acceleration.forward_m_per_s2;
        mean[row::TURN] += t * acceleration.turn_rad_per_s2;
        slope.carry(covariance, &self.variances);
    }

    /// F at `mean`, rows and columns as in [`row`], in full: for smoothers and tests.
    #[must_use]
    pub fn jacobian(&self, mean: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        let slope = Slope::at(mean, self.interval_s);
        let mut f = SMatrix::identity();
        f[(row::X, row::HEADING)] = slope.x_by_heading;
        f[(row::X, row::FORWARD)] = slope.x_by_forward;
        f[(row::X, row::TURN)] = slope.x_by_turn;
        f[(row::Y, row::HEADING)] = slope.y_by_heading;
        f[(row::Y, row::FORWARD)] = slope.y_by_forward;
        f[(row::Y, row::TURN)] = slope.y_by_turn;
        f[(row::HEADING, row::TURN)] = slope.heading_by_turn;
        f
    }
}

/// The entries of F that are neither 0 nor 1.
#[derive(Clone, Copy)]
struct Slope {
    x_by_heading: f64,
    x_by_forward: f64,
    x_by_turn: f64,
    y_by_heading: f64,
    y_by_forward: f64,
    y_by_turn: f64,
    heading_by_turn: f64,
}

impl Slope {
    #[inline]
    fn at(mean: &SVector<f64, N>, t: f64) -> Self {
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

    /// P <- F P F' + Q. The rows of v and w of F are those of the identity, so G = F P differs from P in three rows only.
    #[inline]
    fn carry(&self, p: &mut SMatrix<f64, N, N>, q: &[f64; N]) {
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

    const STEP: PlanarSpeed = PlanarSpeed {
        interval_s: 0.05,
        variances: [1e-6, 2e-6, 3e-6, 4e-4, 5e-3],
    };
    const ACCELERATION: Acceleration = Acceleration {
        forward_m_per_s2: 0.7,
        turn_rad_per_s2: -1.9,
    };

    fn states() -> [SVector<f64, N>; 4] {
        [
            SVector::from([0.0, 0.0, 0.0, 0.0, 0.0]),
            SVector::from([1.3, -0.7, 0.4, 0.2, 0.3]),
            SVector::from([-2.1, 3.9, 1.9, 0.35, 2.5]),
            SVector::from([5.0, 5.0, -2.6, -0.15, -4.0]),
        ]
    }

    fn covariance() -> SMatrix<f64, N, N> {
        let root = SMatrix::<f64, N, N>::from_fn(|i, j| 0.1 * ((3 * i + 5 * j) as f64 + 0.5).sin());
        root * root.transpose() + SMatrix::identity() * 0.02
    }

    fn moved(from: &SVector<f64, N>) -> SVector<f64, N> {
        let mut mean = *from;
        STEP.predict(&mut mean, &mut SMatrix::zeros(), ACCELERATION);
        mean
    }

    #[test]
    fn a_step_on_a_circle_follows_the_mean_heading() {
        let to = moved(&SVector::from([1.0, 2.0, 0.3, 0.4, 2.0]));
        let phi = 0.3 + 0.05;
        assert!((to[row::X] - (1.0 + 0.02 * f64::cos(phi))).abs() < 1e-15);
        assert!((to[row::Y] - (2.0 + 0.02 * f64::sin(phi))).abs() < 1e-15);
        assert!((to[row::HEADING] - 0.4).abs() < 1e-15);
        assert!((to[row::FORWARD] - (0.4 + 0.035)).abs() < 1e-15);
        assert!((to[row::TURN] - (2.0 - 0.095)).abs() < 1e-15);
    }

    #[test]
    fn the_jacobian_agrees_with_central_differences() {
        let h = 1e-6;
        for mean in states() {
            let jacobian = STEP.jacobian(&mean);
            for column in 0..N {
                let (mut above, mut below) = (mean, mean);
                above[column] += h;
                below[column] -= h;
                let slope = (moved(&above) - moved(&below)) / (2.0 * h);
                let error = (jacobian.column(column) - slope).norm();
                assert!(error < 1e-9, "{mean} {column}: {error}");
            }
        }
    }

    #[test]
    fn the_sparse_propagation_equals_the_dense_product_and_is_symmetric() {
        for mean in states() {
            let f = STEP.jacobian(&mean);
            let q = SMatrix::from_diagonal(&SVector::from(STEP.variances));
            let dense = f * covariance() * f.transpose() + q;
            let (mut carried, mut sparse) = (mean, covariance());
            STEP.predict(&mut carried, &mut sparse, ACCELERATION);
            assert!((sparse - dense).norm() < 1e-15, "{mean}");
            assert_eq!(sparse, sparse.transpose());
        }
    }
}

//! The five states of [`super::ekf5`] predicted by sigma points instead of a Jacobian: the outlook of paper 1.
//!
//! ```text
//! X_0 = x, X_i = x + sqrt(5) L e_i, X_(5+i) = x - sqrt(5) L e_i      P = L L'
//! each X_i moves as models::planar_speeds
//! x' = sum W_i X_i        th' = th_0 + atan2(sum W_i sin(th_i - th_0), sum W_i cos(th_i - th_0))
//! P' = sum W_i (X_i - x')(X_i - x')' + Q                 W_0 = 0, W_i = 1/10
//! ```
//! The weights are those with kappa = 0, alpha = 1, beta = 0, the cubature rule. None is negative, so P' is positive
//! semi-definite whatever the model does; the customary kappa = 3 - n can make it indefinite.
//!
//! Source: Julier and Uhlmann (2004); Arasaratnam and Haykin (2009), section III, for the weights; paper 1 (Valera et
//! al.), equations 24 to 26; docs/lab/square.md section M6.

use posebridge_telemetry::estimate::row::HEADING;

use super::ekf5::{FiveStateEkf, FixUsage, SpeedVarianceOrder, predict_linearized, process_noise};
use super::paper_scaffold::OnArrivalFilter;
use crate::filter::{Filter, FilterConfig};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean, N, advance};
use crate::numerics::cholesky::factorise;
use crate::numerics::covariance::symmetrise;

/// A pivot this far below zero, as a share of its diagonal element, is rounding.
const ROUNDING: f64 = 1e-9;

/// Mean and covariance after `dt_s` by sigma points, without process noise; `None` when P has no square root.
pub fn predict(mean: &Mean, covariance: &Covariance, felt: Acceleration, dt_s: f64) -> Option<(Mean, Covariance)> {
    let spread = square_root(covariance)? * (N as f64).sqrt();
    let middle = advance(mean, felt, dt_s);
    let mut from_middle = [Mean::zeros(); 2 * N];
    for i in 0..N {
        let column = spread.column(i).into_owned();
        from_middle[i] = advance(&(mean + column), felt, dt_s) - middle;
        from_middle[N + i] = advance(&(mean - column), felt, dt_s) - middle;
    }
    let weight = 1.0 / (2.0 * N as f64);
    let mut shift = Mean::zeros();
    let (mut sin, mut cos) = (0.0, 0.0);
    for point in &from_middle {
        shift += point * weight;
        sin += point[HEADING].sin() * weight;
        cos += point[HEADING].cos() * weight;
    }
    // Points all around the circle have no mean direction; that of the middle one is then as good as any.
    shift[HEADING] = if cos > 0.0 { sin.atan2(cos) } else { 0.0 };
    let mut spread_after = Covariance::zeros();
    for point in &from_middle {
        let off = point - shift;
        spread_after += off * off.transpose() * weight;
    }
    symmetrise(&mut spread_after);
    Some((middle + shift, spread_after))
}

/// The lower triangle L with L L' = P; a row without variance gets a column of zeros. `None` when P has a negative
/// eigenvalue beyond rounding or is not finite.
pub fn square_root(covariance: &Covariance) -> Option<Covariance> {
    let root = factorise(covariance, |row, pivot| {
        let rounding = ROUNDING * covariance[(row, row)].abs();
        if !pivot.is_finite() || pivot < -rounding {
            return Err(());
        }
        Ok(if pivot <= rounding { 0.0 } else { pivot.sqrt() })
    })
    .ok()?;
    // Rows without variance of their own can share none with the rows below.
    for row in (0..N).filter(|&row| root[(row, row)] == 0.0) {
        for below in row + 1..N {
            let left = covariance[(below, row)] - root.row(below).dot(&root.row(row));
            let scale = (covariance[(below, below)] * covariance[(row, row)]).sqrt();
            if left.is_nan() || left.abs() > ROUNDING.sqrt() * scale {
                return None;
            }
        }
    }
    Some(root)
}

/// The filter of [`super::ekf5`] with another prediction.
pub(crate) fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let filter = FiveStateEkf::new(SpeedVarianceOrder::Printed, FixUsage::Unused, predict_sigma_points);
    Box::new(OnArrivalFilter::new(filter, config))
}

fn predict_sigma_points(filter: &mut FiveStateEkf, dt_s: f64, felt: Acceleration) {
    if let Some((mean, covariance)) = predict(&filter.mean, &filter.covariance, felt, dt_s) {
        filter.mean = mean;
        filter.covariance = covariance + process_noise(filter.order, dt_s);
    } else {
        // P has no square root, so there are no sigma points. Without its correlations it is a covariance again.
        filter.covariance = Covariance::from_diagonal(&filter.covariance.diagonal().map(f64::abs));
        predict_linearized(filter, dt_s, felt);
    }
}

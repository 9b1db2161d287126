//! The five states of [`super::ekf5`] predicted by sigma points instead of a Jacobian: the outlook of paper 1.
//!
//! Source: paper 1 (Valera et al.), equations 24 to 26; [`super::sigma_points`]; docs/lab/square.md section M6.

use super::ekf5::{FiveStateEkf, FixUsage, predict_linearized};
use super::paper_scaffold::OnArrivalFilter;
use super::paper1::FiveStateMatrices;
use super::sigma_points;
use crate::filter::{Filter, FilterConfig};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean, advance};

/// Mean and covariance after `dt_s` by sigma points, without process noise; `None` when P has no square root.
pub fn predict(mean: &Mean, covariance: &Covariance, felt: Acceleration, dt_s: f64) -> Option<(Mean, Covariance)> {
    sigma_points::predict(mean, covariance, |point| advance(point, felt, dt_s))
}

/// The filter of [`super::ekf5`] with another prediction.
pub(crate) fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let filter = FiveStateEkf::new(&FiveStateMatrices::AS_PRINTED, FixUsage::Unused, predict_sigma_points);
    Box::new(OnArrivalFilter::new(filter, config))
}

fn predict_sigma_points(filter: &mut FiveStateEkf, dt_s: f64, felt: Acceleration) {
    if let Some((mean, covariance)) = predict(&filter.mean, &filter.covariance, felt, dt_s) {
        filter.mean = mean;
        filter.covariance = covariance + filter.matrices.process_noise(dt_s);
    } else {
        // P has no square root, so there are no sigma points. Without its correlations it is a covariance again.
        filter.covariance = Covariance::from_diagonal(&filter.covariance.diagonal().map(f64::abs));
        predict_linearized(filter, dt_s, felt);
    }
}

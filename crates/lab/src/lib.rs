//! The laboratory: experiments, calibration, identification and tuning, as pure functions over observations.
//!
//! The program reads recordings and simulates drives; these modules evaluate them and return values, tables and pages of
//! [`posebridge_report`]. No IO, no clock, and random numbers only from a given seed: two calls with the same data give the same bytes.

use posebridge_telemetry::UncertainValue;

pub mod accuracy;
pub mod calibration;
pub mod clocks;
pub mod end_errors;
pub mod identification;
pub mod noise_identification;
pub mod recorded_drive;
pub mod square;
#[cfg(test)]
mod test_support;
pub mod tuning;
pub mod wall;

/// Mean, and variance of a single value; `None` with fewer than two.
fn mean_and_variance(values: &[f64]) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() > 1).then(|| (mean, squares / (count - 1.0)))
}

/// Mean of independent values with its standard deviation; `None` with fewer than two.
fn uncertain_mean(values: &[f64]) -> Option<UncertainValue> {
    let (value, variance) = mean_and_variance(values)?;
    Some(UncertainValue { value, sigma: (variance / values.len() as f64).sqrt() })
}

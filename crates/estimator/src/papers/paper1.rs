//! Sampling interval and units of paper 1, which prints its matrices without units: only centimetres and degrees make
//! sense of them (docs/lab/square.md section M1). Here the states are SI and the printed numbers are brought to SI,
//! which changes no gain.

use crate::models::planar_speeds::{Covariance, Mean, N};

/// The paper samples every 50 ms; its Q is that of one such interval.
pub const SAMPLING_INTERVAL_S: f64 = 0.05;
pub const CENTIMETRE: f64 = 0.01;
pub const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// The units of x, y, heading, forward speed and turn rate in the paper: cm, cm, degrees, cm/s, degrees/s.
pub const UNITS: [f64; N] = [CENTIMETRE, CENTIMETRE, DEGREE, CENTIMETRE, DEGREE];

/// A printed diagonal of five variances, converted to SI units.
pub fn variances_si(diagonal: [f64; N]) -> [f64; N] {
    std::array::from_fn(|i| diagonal[i] * UNITS[i] * UNITS[i])
}

pub fn covariance_si(diagonal: [f64; N]) -> Covariance {
    Covariance::from_diagonal(&Mean::from(variances_si(diagonal)))
}

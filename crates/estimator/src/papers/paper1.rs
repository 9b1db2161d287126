//! Sampling interval, units and matrices of paper 1, which prints its matrices without units: only centimetres and
//! degrees make sense of them (docs/lab/square.md section M1). Here the states are SI and the printed numbers are
//! brought to SI, which changes no gain.

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

/// R, Q and P0 of one filter per wheel, in degrees; Q is that of [`SAMPLING_INTERVAL_S`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelMatrices {
    /// Diagonal of Q: degrees² and (degrees/s)².
    pub process: [f64; 2],
    /// R of the left and of the right counter, degrees².
    pub variances: [f64; 2],
    /// P0, the same for angle and rate.
    pub initial: f64,
}

impl WheelMatrices {
    /// Equation 19.
    pub const AS_PRINTED: Self = Self { process: [0.1, 10.0], variances: [1.5, 2.5], initial: 10.0 };
}

/// R, Q and P0 of the filter of v and w, all diagonal, (cm/s)² and (degrees/s)²; Q is that of [`SAMPLING_INTERVAL_S`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedMatrices {
    pub process: [f64; 2],
    pub variances: [f64; 2],
    pub initial: [f64; 2],
}

impl SpeedMatrices {
    /// Equation 23.
    pub const AS_PRINTED: Self = Self { process: [2.2; 2], variances: [5.1, 1.938], initial: [10.0; 2] };
}

/// R, Q and P0 of the five-state EKF, all diagonal, cm and degrees; Q is that of [`SAMPLING_INTERVAL_S`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FiveStateMatrices {
    /// Of x, y, heading, v, w.
    pub process: [f64; N],
    /// R of v_enc, th_enc and th_gyro.
    pub variances: [f64; 3],
    pub initial: f64,
}

impl FiveStateMatrices {
    /// Equation 26 with the order of states that equation 25 is printed for: 1 is for w, 3 for v.
    pub const AS_PRINTED: Self =
        Self { process: [2.0, 2.0, 0.1, 3.0, 1.0], variances: [5.1, 0.938, 0.332], initial: 0.05 };
    /// Equation 26 with the order of states of equation 24: 1 is for v, 3 for w.
    pub const SWAPPED: Self = Self { process: [2.0, 2.0, 0.1, 1.0, 3.0], ..Self::AS_PRINTED };

    /// Q over `dt_s`, SI units.
    pub fn process_noise(&self, dt_s: f64) -> Covariance {
        covariance_si(self.process) * (dt_s / SAMPLING_INTERVAL_S)
    }
}

//! A sensor's noise from rest or a straight drive, and a camera's delay from motion.
//!
//! # Model
//! ```text
//! rest      y_k = b_k + v_k     b_k+1 = b_k + w_k     var v = s^2 + q^2 / 12     var w = K^2 dt                  (1)
//! Allan     s_A^2(tau) = mean((a_k+2m - 2 a_k+m + a_k)^2) / (2 tau^2)     a the integral of y, tau = m dt       (2)
//! straight  v_k = r (phi_k - phi_k-1) / dt,  R = its variance about a straight line                            (3)
//!           of rounding to whole counts: R = (r tick / dt)^2 / 6 on average over speeds                        (4)
//! delay     c_k = g e(t_k - d) + n_k     c what the camera saw the robot turn, e what the wheels counted       (5)
//!           d^ = argmax of the correlation of c and e(. - d), both less their moving mean
//! ```
//! # Source
//! (1): A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter (1989), chapter 4, the local level model.
//! (2): IEEE Std 952-1997, annex C. (3): paper 1, "R from a stop and a straight run". (4): the variance of a difference of two
//! rounding errors, each uniform. (5): C. H. Knapp, G. C. Carter, The generalized correlation method for estimation of time delay,
//! IEEE Trans. ASSP 24(4), 1976.

mod delay;
mod record;
mod rest;
mod straight;
mod white_and_walk;

pub use self::delay::{
    CameraSample, CumulativeMotion, DelayError, DelaySearch, FixDelay, cumulative_motion_of, find_delay,
};
pub use self::record::{RestError, RestRecord};
pub use self::rest::{MIN_STANDSTILL_S, RestIntervals, RestNoise, noise_at_rest, readings_at_rest, rest_noise};
pub use self::straight::{StraightError, StraightNoise, rounding_speed_sigma, straight_noise};
pub use self::white_and_walk::{AllanPoint, NoiseDecomposition, allan_deviation, decompose_noise};

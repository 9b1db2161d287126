//! The filter by the library's own parts, sparse as its filters use them, and dense as a textbook prints it.

use nalgebra::{Matrix4, Matrix4x5, Matrix5, Vector4, Vector5};
use posebridge_estimator::models::planar_speeds::{Acceleration, PredictionStep, jacobian};
use posebridge_estimator::update::{ScalarMeasurement, UpdateOutcome, use_scalar};
use posebridge_telemetry::estimate::row;

use super::{FilterState, INITIAL_VARIANCE, INTERVAL_S, Input, OBSERVED_VARIANCES, PROCESS_VARIANCES};

/// The state that each observation speaks of.
const ROWS: [usize; 4] = [row::FORWARD, row::HEADING, row::HEADING, row::TURN];
/// Six sigma: every scalar is held against the gate, and none of the inputs is refused, so that all ways do the same.
const GATE: f64 = 36.0;

const STEP: PredictionStep = PredictionStep { interval_s: INTERVAL_S, variances: PROCESS_VARIANCES };

const fn acceleration(input: &Input) -> Acceleration {
    Acceleration { forward_m_per_s2: input.forward_m_per_s2, turn_rad_per_s2: input.turn_rad_per_s2 }
}

fn belief(mean: &Vector5<f64>, covariance: &Matrix5<f64>) -> FilterState {
    FilterState { mean: (*mean).into(), covariance: (*covariance).into() }
}

pub(super) fn run(inputs: &[Input]) -> FilterState {
    let mut mean = Vector5::zeros();
    let mut covariance = Matrix5::identity() * INITIAL_VARIANCE;
    let mut refused = 0_usize;
    for input in inputs {
        STEP.predict(&mut mean, &mut covariance, acceleration(input));
        for i in 0..4 {
            let scalar = ScalarMeasurement {
                innovation: input.observed[i] - mean[ROWS[i]],
                rows: [ROWS[i]],
                jacobian: [1.0],
                variance: OBSERVED_VARIANCES[i],
            };
            let outcome = use_scalar(&mut mean, &mut covariance, &scalar, GATE);
            refused += usize::from(outcome.outcome != UpdateOutcome::Used);
        }
    }
    assert_eq!(refused, 0, "the inputs pass the gate");
    belief(&mean, &covariance)
}

/// P' = F P F' + Q, S by a matrix inverse, P = (I - K H) P: what the sparse form saves.
pub(super) fn run_dense(inputs: &[Input]) -> FilterState {
    let mut mean = Vector5::zeros();
    let mut covariance = Matrix5::identity() * INITIAL_VARIANCE;
    let q = Matrix5::from_diagonal(&PROCESS_VARIANCES.into());
    let r = Matrix4::from_diagonal(&OBSERVED_VARIANCES.into());
    let h = Matrix4x5::from_fn(|i, j| f64::from(u8::from(ROWS[i] == j)));
    for input in inputs {
        let f = jacobian(&mean, INTERVAL_S);
        let u = acceleration(input);
        let travel_m = mean[row::FORWARD] * INTERVAL_S;
        let phi = mean[row::HEADING] + 0.5 * INTERVAL_S * mean[row::TURN];
        mean += Vector5::new(
            travel_m * phi.cos(),
            travel_m * phi.sin(),
            INTERVAL_S * mean[row::TURN],
            INTERVAL_S * u.forward_m_per_s2,
            INTERVAL_S * u.turn_rad_per_s2,
        );
        covariance = f * covariance * f.transpose() + q;
        let s = h * covariance * h.transpose() + r;
        // S holds R, which is positive definite: it has an inverse, and NaN would show in the comparison.
        let inverse = s.try_inverse().unwrap_or(Matrix4::repeat(f64::NAN));
        let gain = covariance * h.transpose() * inverse;
        mean += gain * (Vector4::from(input.observed) - h * mean);
        covariance = (Matrix5::identity() - gain * h) * covariance;
    }
    belief(&mean, &covariance)
}

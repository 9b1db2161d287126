//! The filter by two crates that people would otherwise take, as their documentation shows them.

use adskalman::{CovarianceUpdateMethod, ObservationModel, StateAndCovariance, TransitionModelLinearNoControl};
use kfilter::measurement::LinearMeasurement;
use kfilter::system::StepReturn;
use kfilter::{EKF, KalmanFilter, KalmanPredictInput, KalmanUpdate};
use nalgebra::{Matrix4, Matrix4x5, Matrix5, Matrix5x4, U4, U5, Vector5};
use nalgebra_034 as na34;

use super::{FilterState, INITIAL_VARIANCE, INTERVAL_S, Input, OBSERVED_VARIANCES, PROCESS_VARIANCES};

const T: f64 = INTERVAL_S;

/// The state after a step, and F by rows.
fn moved(x: [f64; 5], input: [f64; 2]) -> ([f64; 5], [[f64; 5]; 5]) {
    let [px, py, heading, v, w] = x;
    let (sin, cos) = (heading + 0.5 * T * w).sin_cos();
    let (dx, dy) = (v * T * cos, v * T * sin);
    let next = [px + dx, py + dy, heading + T * w, v + T * input[0], w + T * input[1]];
    let f = [
        [1.0, 0.0, -dy, T * cos, -0.5 * T * dy],
        [0.0, 1.0, dx, T * sin, 0.5 * T * dx],
        [0.0, 0.0, 1.0, 0.0, T],
        [0.0, 0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0],
    ];
    (next, f)
}

/// H by rows: v, heading, heading, w.
const H: [[f64; 5]; 4] =
    [[0.0, 0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1.0]];

pub(super) fn run_kfilter(inputs: &[Input]) -> FilterState {
    let mut filter: EKF<f64, 5, 2> =
        EKF::new_ekf_with_input(kfilter_step, na34::SVector::zeros(), na34::SMatrix::identity() * INITIAL_VARIANCE);
    let mut measurement = LinearMeasurement::new(
        na34::SMatrix::<f64, 4, 5>::from_fn(|i, j| H[i][j]),
        na34::SMatrix::<f64, 4, 4>::from_diagonal(&OBSERVED_VARIANCES.into()),
        na34::SVector::<f64, 4>::zeros(),
    );
    let mut failures = 0_usize;
    for input in inputs {
        let u = na34::SVector::from([input.forward_m_per_s2, input.turn_rad_per_s2]);
        measurement.z = input.observed.into();
        failures += usize::from(filter.predict(u).is_err());
        failures += usize::from(filter.update(&measurement).is_err());
    }
    assert_eq!(failures, 0, "S can be inverted");
    FilterState { mean: (*filter.state()).into(), covariance: (*filter.covariance()).into() }
}

fn kfilter_step(x: na34::SVector<f64, 5>, u: na34::SVector<f64, 2>) -> StepReturn<f64, 5> {
    let (next, f) = moved(x.into(), u.into());
    StepReturn {
        state: next.into(),
        jacobian: na34::SMatrix::from_fn(|i, j| f[i][j]),
        covariance: na34::SMatrix::from_diagonal(&PROCESS_VARIANCES.into()),
    }
}

/// It has linear motion without a control only: the model is rebuilt for every step, and predicts the mean itself.
struct Motion {
    next: Vector5<f64>,
    f: Matrix5<f64>,
    ft: Matrix5<f64>,
    q: Matrix5<f64>,
}

impl TransitionModelLinearNoControl<f64, U5> for Motion {
    fn F(&self) -> &Matrix5<f64> {
        &self.f
    }
    fn FT(&self) -> &Matrix5<f64> {
        &self.ft
    }
    fn Q(&self) -> &Matrix5<f64> {
        &self.q
    }
    fn predict(&self, from: &StateAndCovariance<f64, U5>) -> StateAndCovariance<f64, U5> {
        let covariance = self.f * from.covariance() * self.ft + self.q;
        StateAndCovariance::new(self.next, covariance)
    }
}

struct Observed {
    h: Matrix4x5<f64>,
    ht: Matrix5x4<f64>,
    r: Matrix4<f64>,
}

impl ObservationModel<f64, U5, U4> for Observed {
    fn H(&self) -> &Matrix4x5<f64> {
        &self.h
    }
    fn HT(&self) -> &Matrix5x4<f64> {
        &self.ht
    }
    fn R(&self) -> &Matrix4<f64> {
        &self.r
    }
}

pub(super) fn run_adskalman(inputs: &[Input]) -> FilterState {
    let h = Matrix4x5::from_fn(|i, j| H[i][j]);
    let observed = Observed { h, ht: h.transpose(), r: Matrix4::from_diagonal(&OBSERVED_VARIANCES.into()) };
    let q = Matrix5::from_diagonal(&PROCESS_VARIANCES.into());
    let start = Matrix5::identity() * INITIAL_VARIANCE;
    let mut belief = StateAndCovariance::new(Vector5::zeros(), start);
    let mut failures = 0_usize;
    for input in inputs {
        let u = [input.forward_m_per_s2, input.turn_rad_per_s2];
        let (next, f) = moved((*belief.state()).into(), u);
        let f = Matrix5::from_fn(|i, j| f[i][j]);
        let motion = Motion { next: next.into(), f, ft: f.transpose(), q };
        let prior = motion.predict(&belief);
        let joseph = CovarianceUpdateMethod::JosephForm;
        match observed.update(&prior, &input.observed.into(), joseph) {
            Ok(posterior) => belief = posterior,
            Err(_) => failures += 1,
        }
    }
    assert_eq!(failures, 0, "S is positive definite");
    FilterState { mean: (*belief.state()).into(), covariance: (*belief.covariance()).into() }
}

//! What must hold for every measurement update, for any state, observation and order, and the update against the textbook's.

use nalgebra::{
    Matrix1, Matrix2, Matrix2x4, Matrix3, Matrix4, Matrix5, RowVector4, RowVector5, SMatrix, Vector1, Vector2, Vector3,
    Vector4, Vector5,
};
use posebridge_estimator::models::planar_speeds::{self, Acceleration};
use posebridge_estimator::numerics::covariance::symmetrise;
use posebridge_estimator::update::{
    LinearizedMeasurement, ScalarMeasurement, UpdateOutcome, apply_measurement, preview_scalar, use_scalar,
};
use proptest::prelude::*;

use crate::support::any::cases;
use crate::support::textbook;

/// Largest difference of two computations of the same value: rounding over all steps, at numbers of about one.
const AGREEMENT: f64 = 1e-9;

/// A positive definite matrix with eigenvalues from a thousandth up.
fn covariances<const N: usize>() -> impl Strategy<Value = SMatrix<f64, N, N>> {
    prop::collection::vec(-1.0..1.0, N * N).prop_map(|values: Vec<f64>| {
        let root = SMatrix::<f64, N, N>::from_column_slice(&values);
        let product = root * root.transpose() + SMatrix::identity() * 1e-3;
        0.5 * (product + product.transpose())
    })
}

fn vectors<const N: usize>() -> impl Strategy<Value = [f64; N]> {
    prop::array::uniform::<_, N>(-2.0..2.0_f64)
}

/// A scalar observation of two different rows of five, its noise over six decades.
fn scalars() -> impl Strategy<Value = ScalarMeasurement<2>> {
    let rows = (0..5_usize, 1..5_usize).prop_map(|(first, offset)| [first, (first + offset) % 5]);
    let variance = (-5.0..1.0_f64).prop_map(|exponent| 10.0_f64.powf(exponent));
    (-2.0..2.0_f64, rows, vectors::<2>(), variance).prop_map(|(innovation, rows, by_row, variance)| ScalarMeasurement {
        innovation,
        rows,
        jacobian: by_row,
        variance,
    })
}

/// One step of a filter's life.
#[derive(Clone, Debug)]
enum FilterStep {
    Predict(f64, [f64; 2]),
    Use(ScalarMeasurement<2>, f64),
}

fn steps() -> impl Strategy<Value = FilterStep> {
    prop_oneof![
        1 => (0.001..1.0_f64, vectors::<2>()).prop_map(|(dt, input)| FilterStep::Predict(dt, input)),
        3 => (scalars(), prop_oneof![Just(f64::INFINITY), Just(10.83)])
            .prop_map(|(scalar, gate)| FilterStep::Use(scalar, gate)),
    ]
}

fn measurements() -> impl Strategy<Value = LinearizedMeasurement<5, 3>> {
    (vectors::<3>(), vectors::<15>(), covariances::<3>()).prop_map(|(innovation, jacobian, noise)| {
        LinearizedMeasurement {
            innovation: Vector3::from(innovation),
            jacobian: SMatrix::<f64, 3, 5>::from_row_slice(&jacobian),
            // Away from zero, so that the textbook's inverse keeps enough digits to be compared with.
            noise: noise + Matrix3::identity() * 0.05,
        }
    })
}

proptest! {
    #![proptest_config(cases(256, 0x5ca1_ab1e))]

    #[test]
    fn over_any_sequence_the_covariance_stays_symmetric_and_positive_definite(
        start in covariances::<5>(),
        steps in prop::collection::vec(steps(), 1..200),
    ) {
        let mut mean = Vector5::zeros();
        let mut covariance = start;
        for step in steps {
            match step {
                FilterStep::Predict(interval_s, [forward_m_per_s2, turn_rad_per_s2]) => {
                    let motion = planar_speeds::PredictionStep { interval_s, variances: [1e-6; 5] };
                    let input = Acceleration { forward_m_per_s2, turn_rad_per_s2 };
                    motion.predict(&mut mean, &mut covariance, input);
                }
                FilterStep::Use(scalar, gate) => {
                    let trace = covariance.trace();
                    let outcome = use_scalar(&mut mean, &mut covariance, &scalar, gate);
                    prop_assert_ne!(outcome.outcome, UpdateOutcome::Indefinite);
                    prop_assert!(outcome.innovation_variance >= scalar.variance);
                    prop_assert!(covariance.trace() <= trace, "an observation takes doubt away");
                }
            }
            prop_assert_eq!(covariance, covariance.transpose());
            prop_assert!(covariance.cholesky().is_some(), "{}", covariance);
        }
    }

    #[test]
    fn a_preview_of_some_rows_equals_their_update(
        covariance in covariances::<5>(),
        at in vectors::<5>(),
        scalar in scalars(),
        is_indefinite in any::<bool>(),
    ) {
        let before = Vector5::from(at);
        let scalar = ScalarMeasurement {
            variance: if is_indefinite { -1e9 } else { scalar.variance },
            ..scalar
        };
        let rows = [0, 2, 3];
        let predicted = preview_scalar(&before, &covariance, &scalar, rows);
        let (mut mean, mut after) = (before, covariance);
        let outcome = use_scalar(&mut mean, &mut after, &scalar, f64::INFINITY);
        let made = (rows.map(|row| mean[row]), rows.map(|i| rows.map(|j| after[(i, j)])));
        let expected = (outcome.outcome == UpdateOutcome::Used).then_some(made);
        prop_assert_eq!(predicted, expected, "to the last bit");
    }

    #[test]
    fn correlated_components_are_whitened_and_equal_the_batch_update(
        start in covariances::<5>(),
        at in vectors::<5>(),
        measurement in measurements(),
    ) {
        let before = Vector5::from(at);
        let (mut expected, mut expected_covariance) = (before, start);
        let z = measurement.innovation + measurement.jacobian * before;
        textbook::update(&mut expected, &mut expected_covariance, &measurement.jacobian, &measurement.noise, &z);
        let (mut mean, mut covariance) = (before, start);
        prop_assert!(apply_measurement(&mut mean, &mut covariance, &measurement));
        prop_assert!((mean - expected).amax() < AGREEMENT);
        prop_assert!((covariance - expected_covariance).amax() < AGREEMENT);
        prop_assert_eq!(covariance, covariance.transpose());
    }

    #[test]
    fn a_scalar_equals_the_textbooks_update(start in covariances::<5>(), at in vectors::<5>(), scalar in scalars()) {
        let before = Vector5::from(at);
        let mut h = RowVector5::zeros();
        h[scalar.rows[0]] = scalar.jacobian[0];
        h[scalar.rows[1]] = scalar.jacobian[1];
        let z = Vector1::new(scalar.innovation) + h * before;
        let (mut expected, mut expected_covariance) = (before, start);
        textbook::update(&mut expected, &mut expected_covariance, &h, &Matrix1::new(scalar.variance), &z);
        let (mut mean, mut covariance) = (before, start);
        let s = scalar.innovation_variance(&start);
        let outcome = use_scalar(&mut mean, &mut covariance, &scalar, f64::INFINITY);
        prop_assert_eq!(outcome.outcome, UpdateOutcome::Used);
        prop_assert!((outcome.innovation_variance / s - 1.0).abs() < AGREEMENT);
        prop_assert!((outcome.nis * s / scalar.innovation.powi(2) - 1.0).abs() < AGREEMENT || scalar.innovation == 0.0);
        prop_assert!((mean - expected).amax() < AGREEMENT * (1.0 + expected.amax()));
        prop_assert!((covariance - expected_covariance).amax() < AGREEMENT);
    }

    #[test]
    fn a_gated_scalar_changes_nothing_and_reports_its_innovation(
        start in covariances::<5>(),
        at in vectors::<5>(),
        scalar in scalars(),
        share in 0.0..0.999_f64,
    ) {
        let (mut mean, mut covariance) = (Vector5::from(at), start);
        let open = use_scalar(&mut mean, &mut covariance, &scalar, f64::INFINITY);
        prop_assume!(open.nis > 0.0);
        let (mut mean, mut covariance) = (Vector5::from(at), start);
        let shut = use_scalar(&mut mean, &mut covariance, &scalar, share * open.nis);
        prop_assert_eq!(shut.outcome, UpdateOutcome::Gated);
        prop_assert_eq!((shut.nis, shut.innovation_variance), (open.nis, open.innovation_variance));
        prop_assert_eq!((mean, covariance), (Vector5::from(at), start));
    }

    #[test]
    fn a_scalar_that_makes_no_sense_changes_nothing(
        start in covariances::<5>(),
        at in vectors::<5>(),
        scalar in scalars(),
        bad in prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e9]),
        field in 0..3_usize,
    ) {
        let mut scalar = scalar;
        match field {
            // -1e9 is a number like any other in an innovation, 1e300 squared is not.
            0 => scalar.innovation = if bad == -1e9 { 1e300 } else { bad },
            1 => scalar.variance = bad,
            _ => scalar.jacobian[1] = if bad == -1e9 { 1e300 } else { bad },
        }
        let (mut mean, mut covariance) = (Vector5::from(at), start);
        let outcome = use_scalar(&mut mean, &mut covariance, &scalar, f64::INFINITY);
        prop_assert_eq!(outcome.outcome, UpdateOutcome::Indefinite, "{:?}", outcome);
        prop_assert_eq!((mean, covariance), (Vector5::from(at), start));
    }
}

#[test]
fn two_hundred_steps_of_a_linear_system_equal_the_textbooks() {
    // Two positions, each before its speed, a tenth of a second on.
    let mut transition = Matrix4::<f64>::identity();
    transition[(0, 1)] = 0.1;
    transition[(2, 3)] = 0.1;
    let drift = Matrix4::from_diagonal(&Vector4::<f64>::new(1e-4, 1e-2, 1e-4, 1e-2));
    let (mut mean, mut covariance) = (Vector4::<f64>::new(1.0, -0.5, 0.2, 2.0), Matrix4::<f64>::identity());
    let (mut expected, mut expected_covariance) = (mean, covariance);
    for step in 0..200_u32 {
        mean = transition * mean;
        covariance = transition * covariance * transition.transpose() + drift;
        symmetrise(&mut covariance);
        expected = transition * expected;
        expected_covariance = transition * expected_covariance * transition.transpose() + drift;
        let at_s = 0.1 * f64::from(step);
        if step.is_multiple_of(2) {
            // Both positions, with correlated noise.
            let jacobian = Matrix2x4::<f64>::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0);
            let noise = Matrix2::<f64>::new(0.02, 0.01, 0.01, 0.03);
            let z = Vector2::new(at_s.sin(), 2.0 * at_s.cos());
            let measurement = LinearizedMeasurement { innovation: z - jacobian * mean, jacobian, noise };
            assert!(apply_measurement(&mut mean, &mut covariance, &measurement), "step {step}");
            textbook::update(&mut expected, &mut expected_covariance, &jacobian, &noise, &z);
        } else {
            // A sum of both speeds.
            let jacobian = RowVector4::<f64>::new(0.0, 0.5, 0.0, 1.0);
            let z = Vector1::new(0.5 * at_s.cos() - 2.0 * at_s.sin());
            let innovation = (z - jacobian * mean)[0];
            let scalar = ScalarMeasurement { innovation, rows: [1, 3], jacobian: [0.5, 1.0], variance: 0.04 };
            let outcome = use_scalar(&mut mean, &mut covariance, &scalar, f64::INFINITY);
            assert_eq!(outcome.outcome, UpdateOutcome::Used, "step {step}");
            textbook::update(&mut expected, &mut expected_covariance, &jacobian, &Matrix1::new(0.04), &z);
        }
        assert_eq!(covariance, covariance.transpose(), "step {step}");
        assert!((mean - expected).amax() < AGREEMENT, "step {step}: {mean} {expected}");
        assert!((covariance - expected_covariance).amax() < AGREEMENT, "step {step}: {covariance}");
    }
}

#[test]
fn noise_that_is_no_covariance_changes_nothing() {
    let mut mean = Vector3::new(1.0, -2.0, 0.5);
    let mut covariance = Matrix3::identity();
    let measurement = LinearizedMeasurement {
        innovation: Vector2::new(0.7, -0.4),
        jacobian: SMatrix::<f64, 2, 3>::identity(),
        noise: Matrix2::new(0.4, 5.0, 5.0, 0.2),
    };
    assert!(!apply_measurement(&mut mean, &mut covariance, &measurement));
    assert_eq!((mean, covariance), (Vector3::new(1.0, -2.0, 0.5), Matrix3::identity()));
}

#[test]
fn a_covariance_that_is_none_changes_nothing() {
    for bad in [f64::NAN, f64::INFINITY, -10.0] {
        let mut covariance = Matrix5::identity();
        covariance[(2, 2)] = bad;
        let before = covariance.map(f64::to_bits);
        let mut mean = Vector5::repeat(0.5);
        let scalar = ScalarMeasurement { innovation: 0.1, rows: [2], jacobian: [1.0], variance: 0.01 };
        let outcome = use_scalar(&mut mean, &mut covariance, &scalar, f64::INFINITY);
        assert_eq!(outcome.outcome, UpdateOutcome::Indefinite, "{bad}");
        assert_eq!(covariance.map(f64::to_bits), before, "{bad}");
        assert_eq!(mean, Vector5::repeat(0.5), "{bad}");
    }
}

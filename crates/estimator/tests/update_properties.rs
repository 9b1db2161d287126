//! What must hold for every measurement update, whatever the state, the observation and the order: laws, not examples.

use nalgebra::{Matrix3, Matrix5, SMatrix, Vector3, Vector5};
use posebridge_estimator::models::planar_speeds::{self, Acceleration};
use posebridge_estimator::update::{
    LinearizedMeasurement, ScalarMeasurement, UpdateOutcome, apply_measurement, preview_scalar, use_scalar,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// How far two ways to compute the same thing may lie apart: rounding, at numbers of about one.
const AGREEMENT: f64 = 1e-9;

fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        rng_seed: RngSeed::Fixed(0x5ca1_ab1e),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

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

/// The textbook's update of all components at once, by a matrix inverse.
fn batch(
    mean: &Vector5<f64>,
    covariance: &Matrix5<f64>,
    measurement: &LinearizedMeasurement<5, 3>,
) -> Option<(Vector5<f64>, Matrix5<f64>)> {
    let h = measurement.jacobian;
    let inverse = measurement.innovation_covariance(covariance).try_inverse()?;
    let gain = covariance * h.transpose() * inverse;
    let keep = Matrix5::identity() - gain * h;
    Some((mean + gain * measurement.innovation, keep * covariance))
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
    #![proptest_config(cases(256))]

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
    fn what_is_foretold_of_some_rows_is_what_the_update_makes_of_them(
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
        let foretold = preview_scalar(&before, &covariance, &scalar, rows);
        let (mut mean, mut after) = (before, covariance);
        let outcome = use_scalar(&mut mean, &mut after, &scalar, f64::INFINITY);
        let made = (rows.map(|row| mean[row]), rows.map(|i| rows.map(|j| after[(i, j)])));
        let expected = (outcome.outcome == UpdateOutcome::Used).then_some(made);
        prop_assert_eq!(foretold, expected, "to the last bit");
    }

    #[test]
    fn scalars_one_after_the_other_equal_the_batch_update(
        start in covariances::<5>(),
        at in vectors::<5>(),
        mut measurement in measurements(),
    ) {
        measurement.noise = Matrix3::from_diagonal(&measurement.noise.diagonal());
        let before = Vector5::from(at);
        let expected = batch(&before, &start, &measurement).unwrap();
        let (mut mean, mut covariance) = (before, start);
        for i in 0..3 {
            let row = measurement.jacobian.row(i);
            let scalar = ScalarMeasurement {
                innovation: measurement.innovation[i] - (row * (mean - before))[0],
                rows: [0, 1, 2, 3, 4],
                jacobian: std::array::from_fn(|j| row[j]),
                variance: measurement.noise[(i, i)],
            };
            let outcome = use_scalar(&mut mean, &mut covariance, &scalar, f64::INFINITY);
            prop_assert_eq!(outcome.outcome, UpdateOutcome::Used);
        }
        prop_assert!((mean - expected.0).amax() < AGREEMENT);
        prop_assert!((covariance - expected.1).amax() < AGREEMENT);
    }

    #[test]
    fn correlated_components_are_whitened_and_equal_the_batch_update(
        start in covariances::<5>(),
        at in vectors::<5>(),
        measurement in measurements(),
    ) {
        let before = Vector5::from(at);
        let expected = batch(&before, &start, &measurement).unwrap();
        let (mut mean, mut covariance) = (before, start);
        prop_assert!(apply_measurement(&mut mean, &mut covariance, &measurement));
        prop_assert!((mean - expected.0).amax() < AGREEMENT);
        prop_assert!((covariance - expected.1).amax() < AGREEMENT);
        prop_assert_eq!(covariance, covariance.transpose());
    }

    #[test]
    fn a_scalar_of_few_rows_equals_the_same_one_with_zeros_for_the_others(
        start in covariances::<5>(),
        at in vectors::<5>(),
        scalar in scalars(),
    ) {
        let (mut sparse_mean, mut sparse) = (Vector5::from(at), start);
        let (mut full_mean, mut full) = (Vector5::from(at), start);
        let mut by_row = [0.0; 5];
        by_row[scalar.rows[0]] = scalar.jacobian[0];
        by_row[scalar.rows[1]] = scalar.jacobian[1];
        let of_all_rows = ScalarMeasurement {
            innovation: scalar.innovation,
            rows: [0, 1, 2, 3, 4],
            jacobian: by_row,
            variance: scalar.variance,
        };
        let few = use_scalar(&mut sparse_mean, &mut sparse, &scalar, f64::INFINITY);
        let all = use_scalar(&mut full_mean, &mut full, &of_all_rows, f64::INFINITY);
        prop_assert!((few.nis - all.nis).abs() <= AGREEMENT * all.nis.max(1.0));
        prop_assert!((sparse_mean - full_mean).amax() < AGREEMENT);
        prop_assert!((sparse - full).amax() < AGREEMENT);
    }

    #[test]
    fn a_gated_scalar_changes_nothing_and_says_by_how_much_it_missed(
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
        place in 0..3_usize,
    ) {
        let mut scalar = scalar;
        match place {
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

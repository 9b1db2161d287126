//! The dynamic measurement filter of paper 2: its worked example, its equality with least squares, its noise, its speed.

use nalgebra::{DMatrix, DVector};
use posebridge_estimator::filters::dynamic::DynamicFilter;
use posebridge_estimator::models::dynamic_measurement::{DynamicModel, ROWS};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    BrickClock, Celsius, FusionOutcome, FusionRecord, ObservationKind, ScalarEstimate, SensorId, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::support::observe;
use crate::support::robot::config;

const ONE: SensorId = SensorId::THERMOMETER;
const OTHER: SensorId = SensorId(20);
/// The worked example: one sample a minute, the transient falls to two thirds from one to the next.
const MINUTE_S: f64 = 60.0;
const SIGMA_K: f64 = 0.5;

fn tau_of_example_s() -> f64 {
    MINUTE_S / 1.5_f64.ln()
}

fn configured(sigma_k: f64) -> FilterConfig {
    let mut config = config();
    config.noise.temperature_k = sigma_k;
    config
}

fn filter(sigma_k: f64, model: DynamicModel) -> DynamicFilter {
    DynamicFilter::with_model(&configured(sigma_k), model)
}

fn observe(filter: &mut DynamicFilter, sensor: SensorId, at_s: f64, celsius: f64) -> FusionRecord {
    filter.observe(&observe::at_s(at_s, sensor, ObservationKind::Temperature(Celsius(celsius))))
}

fn now(filter: &DynamicFilter) -> ScalarEstimate {
    let latest: Timestamp<BrickClock> = filter.latest_time().expect("it was given a sample");
    filter.scalar_at(latest).expect("it was given a sample")
}

/// One sample: sensor, time, value.
type Sample = (SensorId, f64, f64);

fn play(sigma_k: f64, model: &DynamicModel, samples: &[Sample]) -> ScalarEstimate {
    let mut filter = filter(sigma_k, model.clone());
    for &(sensor, at_s, value) in samples {
        assert_eq!(observe(&mut filter, sensor, at_s, value).outcome, FusionOutcome::Accepted);
    }
    now(&filter)
}

/// The rows [G, C e^(A t)] of all samples for [u; x at the first sample]: paper 2's stacked system, unused columns left out.
fn stacked(model: &DynamicModel, samples: &[Sample]) -> (DMatrix<f64>, DVector<f64>) {
    let columns = 1 + model.states();
    let start_s = samples[0].1;
    let mut matrix = DMatrix::zeros(samples.len(), columns);
    for (i, &(sensor, at_s, _)) in samples.iter().enumerate() {
        let row = model.row_of(sensor).unwrap();
        let since = model.transition(at_s - start_s);
        for column in 0..columns {
            matrix[(i, column)] = (0..ROWS).map(|k| row[k] * since[(k, column)]).sum();
        }
    }
    let values = DVector::from_iterator(samples.len(), samples.iter().map(|sample| sample.2));
    (matrix, values)
}

/// The filter's prior as rows: u = the first sample, x = 0, each with so many sigmas.
fn with_prior(
    (matrix, values): (DMatrix<f64>, DVector<f64>),
    start: f64,
    prior_sigmas: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let (rows, columns) = matrix.shape();
    let mut matrix = matrix.resize_vertically(rows + columns, 0.0);
    let mut values = values.resize_vertically(rows + columns, 0.0);
    for k in 0..columns {
        matrix[(rows + k, k)] = 1.0 / prior_sigmas;
    }
    values[rows] = start / prior_sigmas;
    (matrix, values)
}

/// Block least squares by singular values: u and its standard deviation per sigma.
fn by_svd((matrix, values): (DMatrix<f64>, DVector<f64>)) -> (f64, f64) {
    let svd = matrix.svd(true, true);
    let solution = svd.solve(&values, 0.0).unwrap();
    let v_t = svd.v_t.as_ref().unwrap();
    let variance: f64 = (0..svd.singular_values.len()).map(|k| (v_t[(k, 0)] / svd.singular_values[k]).powi(2)).sum();
    (solution[0], variance.sqrt())
}

fn example_samples(count: usize) -> Vec<Sample> {
    (0..count).map(|k| (ONE, MINUTE_S * k as f64, 3.0 + 18.0 * (2.0_f64 / 3.0).powi(k as i32))).collect()
}

fn first_order() -> DynamicModel {
    DynamicModel::first_order(ONE, tau_of_example_s()).unwrap()
}

#[test]
fn the_worked_example_gives_three_degrees_after_two_samples() {
    let example = [(ONE, 0.0, 21.0), (ONE, 60.0, 15.0), (ONE, 120.0, 11.0)];
    for count in [2, 3] {
        let found = play(SIGMA_K, &first_order(), &example[..count]);
        assert!((found.value - 3.0).abs() < 1e-5, "{count}: {found:?}");
    }
}

#[test]
fn the_first_sample_starts_it_by_the_papers_rule() {
    let model = DynamicModel::empty().with_lags(ONE, 2.0, &[100.0]).unwrap();
    let mut filter = filter(SIGMA_K, model);
    let record = observe(&mut filter, ONE, 5.0, 42.0);
    assert_eq!(record.innovation[0], 0.0, "it predicts itself");
    let found = now(&filter);
    assert_eq!(found.value, 21.0);
    assert!(found.sigma > 1e4, "one sample says next to nothing");
}

#[test]
fn noise_is_amplified_as_the_table_says() {
    for (count, gain) in [(2, 3.61), (3, 1.87), (5, 0.927), (10, 0.440), (20, 0.258)] {
        let found = play(SIGMA_K, &first_order(), &example_samples(count));
        let found_gain = found.sigma / SIGMA_K;
        assert!((found_gain - gain).abs() < 0.006, "{count} samples: {found_gain}");
    }
}

/// Models of several orders and sensors, with samples at irregular times that are full of noise.
fn hard_cases() -> Vec<(&'static str, DynamicModel, Vec<Sample>)> {
    let two_lags = DynamicModel::empty().with_lags(ONE, 1.0, &[5.3, 22.0]).unwrap();
    // (s + 1/4)(s + 1/15)
    let second_order = DynamicModel::empty().with_coefficients(ONE, 1.0, &[1.0 / 60.0, 19.0 / 60.0]).unwrap();
    let two_sensors =
        DynamicModel::first_order(ONE, 40.0).unwrap().with_coefficients(OTHER, 0.5, &[0.02, 0.2]).unwrap();
    [
        ("first order", first_order()),
        ("two lags", two_lags),
        ("second order by coefficients", second_order),
        ("two sensors", two_sensors),
    ]
    .into_iter()
    .map(|(name, model)| {
        let mut rng = Pcg64::seed_from_u64(7);
        let mut at_s = 3.0;
        let samples = (0..40)
            .map(|k| {
                // Whole milliseconds: a stamp has no more digits than nanoseconds.
                at_s += f64::from(rng.random_range(500..3_500)) * 1e-3;
                let is_other = k % 3 == 1 && model.row_of(OTHER).is_some();
                let sensor = if is_other { OTHER } else { ONE };
                (sensor, at_s, 20.0 * rng.random::<f64>())
            })
            .collect();
        (name, model, samples)
    })
    .collect()
}

#[test]
fn the_filter_is_block_least_squares() {
    for (name, model, samples) in hard_cases() {
        for count in [1, 2, 8, 40] {
            let samples = &samples[..count];
            let start = samples[0].2 / model.row_of(samples[0].0).unwrap()[0];
            let mut filter = filter(SIGMA_K, model.clone()).with_prior_sigma(100.0 * SIGMA_K);
            for &(sensor, at_s, value) in samples {
                observe(&mut filter, sensor, at_s, value);
            }
            let found = now(&filter);
            let (block, gain) = by_svd(with_prior(stacked(&model, samples), start, 100.0));
            for (what, error) in [("value", found.value - block), ("sigma", found.sigma - gain * SIGMA_K)] {
                assert!(error.abs() < 1e-9, "{name}, {count}: {what} {error:e}");
            }
        }
    }
}

/// With the default prior P begins at 1e10 sigma^2; ten of its digits go in the first updates.
#[test]
fn next_to_no_prior_leaves_plain_least_squares() {
    for (name, model, samples) in hard_cases() {
        for count in [20, 40] {
            let samples = &samples[..count];
            let found = play(SIGMA_K, &model, samples);
            let (plain, gain) = by_svd(stacked(&model, samples));
            let error_sigmas = (found.value - plain) / (gain * SIGMA_K);
            assert!(error_sigmas.abs() < 1e-4, "{name}, {count}: {error_sigmas}");
            let ratio = found.sigma / (gain * SIGMA_K);
            assert!((ratio - 1.0).abs() < 1e-4, "{name}, {count}: {ratio}");
        }
    }
}

#[test]
fn a_sample_that_comes_late_from_another_sensor_counts_at_its_own_time() {
    let (_, model, samples) = hard_cases().pop().unwrap();
    let mut swapped = samples.clone();
    let k = (1..swapped.len()).find(|&k| swapped[k].0 == OTHER && swapped[k + 1].1 - swapped[k].1 < 2.0).unwrap();
    swapped.swap(k, k + 1);
    let (in_order, late) = (play(SIGMA_K, &model, &samples), play(SIGMA_K, &model, &swapped));
    assert!((in_order.value - late.value).abs() < 1e-6, "{in_order:?} {late:?}");
}

/// A quantity that walks as configured, measured by sensors of first and of second order.
#[test]
fn a_quantity_with_the_configured_walk_has_errors_that_fit_sigma() {
    let first = DynamicModel::first_order(ONE, 20.0).unwrap();
    // (s + 1/4)(s + 1/15)
    let coefficients = [1.0 / 60.0, 19.0 / 60.0];
    let second = DynamicModel::empty().with_coefficients(ONE, 1.0, &coefficients).unwrap();
    for (name, model) in [("first", first), ("second", second)] {
        let (mut squares, mut count) = (0.0, 0.0);
        for seed in 0..10 {
            let mut normals = Pcg64::seed_from_u64(seed);
            let mut normal = || normals.sample::<f64, _>(StandardNormal);
            let mut configured = configured(0.1);
            configured.params.dynamic_walk_k_per_sqrt_s = 0.05;
            let mut filter = DynamicFilter::with_model(&configured, model.clone());
            let (mut u, mut y, mut slope) = (15.0, 15.0, 0.0);
            for k in 0..1_500 {
                observe(&mut filter, ONE, f64::from(k), y + 0.1 * normal());
                let found = now(&filter);
                if k > 200 {
                    squares += ((found.value - u) / found.sigma).powi(2);
                    count += 1.0;
                }
                // Twenty small steps of the truth to a sample.
                for _ in 0..20 {
                    u += 0.05 * 0.05_f64.sqrt() * normal();
                    if name == "first" {
                        y += 0.05 * (u - y) / 20.0;
                    } else {
                        slope += 0.05 * (coefficients[0] * (u - y) - coefficients[1] * slope);
                        y += 0.05 * slope;
                    }
                }
            }
        }
        // Errors hold for tens of samples: 13 000 of them are a few hundred independent ones.
        let nees: f64 = squares / count;
        println!("{name} order: NEES {nees:.2}");
        assert!((0.75..1.25).contains(&nees), "{name}: {nees}");
    }
}

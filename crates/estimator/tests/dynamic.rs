//! The dynamic measurement filter of paper 2: its worked example, its equality with least squares, its noise, its speed.
#![expect(
    clippy::expect_used,
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where a filter gives nothing"
)]

#[path = "support/robot.rs"]
mod robot;

use nalgebra::{DMatrix, DVector};
use posebridge_estimator::filters::dynamic::DynamicFilter;
use posebridge_estimator::models::dynamic_measurement::{DynamicModel, ROWS};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    BrickClock, Celsius, FusionOutcome, FusionRecord, Observation, ObservationKind, ScalarEstimate, SensorId,
    TimeDelta, Timestamp,
};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use robot::config;

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
    filter.observe(&Observation {
        sensor,
        stamp: Timestamp::from_secs_f64(at_s),
        stamp_sigma: TimeDelta::ZERO,
        measurement: ObservationKind::Temperature(Celsius(celsius)),
    })
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

/// Recursive least squares for the constants [u; x_ini], in the textbook's form.
fn by_rls((matrix, values): &(DMatrix<f64>, DVector<f64>), start: f64, prior_sigmas: f64) -> f64 {
    let columns = matrix.ncols();
    let mut theta = DVector::zeros(columns);
    theta[0] = start;
    let mut p = DMatrix::identity(columns, columns) * prior_sigmas * prior_sigmas;
    for (i, &value) in values.iter().enumerate() {
        let phi = matrix.row(i).transpose();
        let gain = &p * &phi / (1.0 + (phi.transpose() * &p * &phi)[0]);
        theta += &gain * (value - phi.dot(&theta));
        p -= &gain * (phi.transpose() * &p);
    }
    theta[0]
}

fn example_samples(count: usize, noise: impl FnMut() -> f64) -> Vec<Sample> {
    let mut noise = noise;
    (0..count)
        .map(|k| {
            let clean = 3.0 + 18.0 * (2.0_f64 / 3.0).powi(k as i32);
            (ONE, MINUTE_S * k as f64, clean + noise())
        })
        .collect()
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
    // With the time constant unknown the paper's own formula says the same.
    let (a, b, c) = (21.0_f64, 15.0, 11.0);
    assert_eq!((a * c - b * b) / (a + c - 2.0 * b), 3.0);
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
        let found = play(SIGMA_K, &first_order(), &example_samples(count, || 0.0));
        let found_gain = found.sigma / SIGMA_K;
        assert!((found_gain - gain).abs() < 0.006, "{count} samples: {found_gain}");
    }
}

#[test]
fn the_noise_of_many_runs_is_what_sigma_says() {
    let mut normals = Pcg64::seed_from_u64(20_260_201);
    let runs = 2_000;
    let mut squares = 0.0;
    for _ in 0..runs {
        let samples = example_samples(5, || SIGMA_K * normals.sample::<f64, _>(StandardNormal));
        let found = play(SIGMA_K, &first_order(), &samples);
        squares += ((found.value - 3.0) / found.sigma).powi(2);
    }
    // Chi-square over 2000 runs: four standard deviations are 4 sqrt(2/2000) = 0.13.
    let mean: f64 = squares / f64::from(runs);
    assert!((mean - 1.0).abs() < 0.13, "{mean}");
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

/// What filter, recursion and block make of samples with a prior of so many sigmas: the three values and the two sigmas.
fn three_ways(model: &DynamicModel, samples: &[Sample], prior_sigmas: f64) -> ([f64; 3], [f64; 2]) {
    let start = samples[0].2 / model.row_of(samples[0].0).unwrap()[0];
    let mut filter = filter(SIGMA_K, model.clone()).with_prior_sigma(prior_sigmas * SIGMA_K);
    for &(sensor, at_s, value) in samples {
        observe(&mut filter, sensor, at_s, value);
    }
    let found = now(&filter);
    let system = stacked(model, samples);
    let recursive = by_rls(&system, start, prior_sigmas);
    let (block, gain) = by_svd(with_prior(system, start, prior_sigmas));
    ([found.value, recursive, block], [found.sigma, gain * SIGMA_K])
}

#[test]
fn filter_recursive_and_block_least_squares_are_one() {
    for (name, model, samples) in hard_cases() {
        for count in [1, 2, 8, 40] {
            let ([filtered, recursive, block], [sigma, block_sigma]) = three_ways(&model, &samples[..count], 100.0);
            for (what, error) in
                [("filter", filtered - block), ("recursion", recursive - block), ("sigma", sigma - block_sigma)]
            {
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

#[test]
fn two_sensors_know_it_better_than_either_alone() {
    let (_, model, samples) = hard_cases().pop().unwrap();
    let of = |sensor| -> Vec<_> {
        let own = samples.iter().filter(|sample| sample.0 == sensor);
        own.copied().collect()
    };
    let both = play(SIGMA_K, &model, &samples).sigma;
    let alone = [ONE, OTHER].map(|sensor| play(SIGMA_K, &model, &of(sensor)).sigma);
    assert!(both < alone[0] && both < alone[1], "{both} {alone:?}");
}

/// Instants from which on a series stays within 2 % of a step of 18 K down to 3.
fn settled(series: &[(f64, f64)]) -> f64 {
    let last_outside = series.iter().rposition(|(_, value)| (value - 3.0).abs() > 0.02 * 18.0);
    series[last_outside.map_or(0, |k| k + 1)].0
}

#[test]
fn it_is_within_two_percent_of_the_step_long_before_the_sensor() {
    let tau_s = tau_of_example_s();
    let mut shares = vec![];
    for seed in 0..20 {
        let mut normals = Pcg64::seed_from_u64(seed);
        let mut filter = filter(0.1, first_order());
        let (mut raw, mut predicted) = (vec![], vec![]);
        for k in 0..1_200 {
            let at_s = f64::from(k);
            let noise = 0.1 * normals.sample::<f64, _>(StandardNormal);
            let shown = 3.0 + 18.0 * (-at_s / tau_s).exp();
            observe(&mut filter, ONE, at_s, shown + noise);
            raw.push((at_s, shown));
            predicted.push((at_s, now(&filter).value));
        }
        let raw_s = settled(&raw);
        assert!((raw_s - 50.0_f64.ln() * tau_s).abs() < 1.0, "{raw_s}");
        shares.push(settled(&predicted) / raw_s);
    }
    shares.sort_by(f64::total_cmp);
    println!("share of the sensor's own time: median {:.3}, worst {:.3}", shares[10], shares[19]);
    assert!(shares[19] < 0.25, "{shares:?}");
}

#[test]
fn a_walking_quantity_is_followed_only_if_it_is_said_to_walk() {
    let trend = |walk| {
        let mut configured = configured(0.1);
        configured.params.dynamic_walk_k_per_sqrt_s = walk;
        let mut filter = DynamicFilter::with_model(&configured, DynamicModel::first_order(ONE, 20.0).unwrap());
        // A ramp of 0.01 K/s through the same sensor: it lags by its time constant.
        for k in 0..2_000 {
            let at_s = f64::from(k);
            let shown = 0.01 * (at_s - 20.0 * (1.0 - (-at_s / 20.0).exp()));
            observe(&mut filter, ONE, at_s, shown);
        }
        let found = now(&filter);
        ((found.value - 19.99).abs(), found.sigma)
    };
    let (constant_error, constant_sigma) = trend(0.0);
    let (walking_error, walking_sigma) = trend(0.05);
    assert!(constant_error > 5.0 && constant_sigma < 0.01, "confident and wrong");
    println!("a ramp is missed by {constant_error:.2} K, and by {walking_error:.2} K if it is said to walk");
    assert!(walking_error < 0.2 && walking_sigma > 0.05, "{walking_error} {walking_sigma}");
}

/// A quantity that walks as the filter is told, seen through sensors of first and of second order.
#[test]
fn a_quantity_that_walks_as_told_is_known_as_well_as_sigma_says() {
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

/// A device's samples from the plunge on, in seconds since.
fn plunge(folder: &std::path::Path, name: &str) -> Vec<(f64, f64)> {
    let text = std::fs::read_to_string(folder.join(format!("sensor_{name}.csv"))).unwrap();
    let all: Vec<(f64, f64)> = text
        .lines()
        .skip(1)
        .map(|line| {
            let mut cells = line.split(',');
            let millis: f64 = cells.next().unwrap().parse().unwrap();
            (millis * 1e-3, cells.nth(1).unwrap().parse().unwrap())
        })
        .collect();
    let steepest = (1..all.len() - 1)
        .min_by(|&a, &b| {
            let slope = |k: usize| (all[k].1 - all[k - 1].1) / (all[k].0 - all[k - 1].0);
            slope(a).total_cmp(&slope(b))
        })
        .unwrap();
    let start_s = all[steepest - 1].0;
    all.iter()
        .map(|(at_s, value)| (at_s - start_s, *value))
        .filter(|(since_s, _)| (0.0..215.0).contains(since_s))
        .collect()
}

/// Real thermometers plunged into ice water. One lag does not describe them; two do, roughly.
#[test]
fn real_thermometers_are_predicted_by_two_lags_and_not_by_one() {
    let Some(data) = std::env::var_os("POSEBRIDGE_DATA") else {
        return println!("POSEBRIDGE_DATA is not set: the recordings were not looked at");
    };
    let folder = std::path::Path::new(&data).join("ds18b20-step");
    for name in ["LG", "KM", "KiS"] {
        let samples = plunge(&folder, name);
        let last = samples.len() - 15;
        let end = samples[last..].iter().map(|sample| sample.1).sum::<f64>() / 15.0;
        let within = |series: &[(f64, f64)], share: f64| {
            let limit = share * (samples[0].1 - end);
            let outside = series.iter().rposition(|(_, value)| (value - end).abs() > limit);
            series.get(outside.map_or(0, |k| k + 1)).map(|entry| entry.0)
        };
        for lags in [vec![12.0], vec![5.3, 22.0]] {
            let model = DynamicModel::empty().with_lags(ONE, 1.0, &lags).unwrap();
            let mut filter = filter(0.0625, model);
            let predicted: Vec<_> = samples
                .iter()
                .map(|&(at_s, value)| {
                    observe(&mut filter, ONE, at_s, value);
                    (at_s, now(&filter).value)
                })
                .collect();
            println!(
                "{name}, lags {lags:?} s: within 10 / 5 / 2 % after {:?}, sensor {:?}",
                [0.1, 0.05, 0.02].map(|share| within(&predicted, share)),
                [0.1, 0.05, 0.02].map(|share| within(&samples, share)),
            );
            if lags.len() == 2 {
                let (filtered_s, sensor_s) = (within(&predicted, 0.1).unwrap(), within(&samples, 0.1).unwrap());
                assert!(filtered_s < sensor_s, "{name}: {filtered_s} {sensor_s}");
            }
        }
    }
}

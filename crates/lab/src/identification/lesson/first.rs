//! First sections: the worked example, three equivalent methods, the start, the price in noise, several sensors.

use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_estimator::numerics::statistics::mean;
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_telemetry::SensorId;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::paper_filter::{DynamicFilterConfig, first_order};
use super::section::{LessonSection, band, filter_values, sample_points, temperatures};
use crate::identification::known_dynamics::{block_least_squares, final_value_from_three, recursive_least_squares};
use crate::identification::prediction::{BOUND_RATE, EndPrediction, predict};
use crate::identification::sensor_kind::{RunSimilarity, describe_sensor};
use crate::identification::step::{StepOptions, identify_step};
use crate::identification::step_response::{SimulatedSensor, step_input};
use crate::identification::{TimedSample, settling_time_s};

/// The worked example of the paper: three readings a minute apart, of a thermometer that goes from 21 to 3 degrees.
const EXAMPLE: [f64; 3] = [21.0, 15.0, 11.0];
const MINUTE_S: f64 = 60.0;
const SIGMA_K: f64 = 0.1;
const FIRST_SENSOR: SensorId = SensorId::THERMOMETER;
const SECOND_SENSOR: SensorId = SensorId(20);

/// 60 s / ln(3/2): the transient of the example falls to two thirds in a minute.
fn example_tau_s() -> f64 {
    MINUTE_S / 1.5_f64.ln()
}

fn example() -> Vec<TimedSample> {
    let at = |(k, value): (usize, f64)| TimedSample { at_s: MINUTE_S * k as f64, value };
    EXAMPLE.into_iter().enumerate().map(at).collect()
}

pub(super) fn worked_example(_seed: u64) -> LessonSection {
    let by_formula = final_value_from_three(EXAMPLE);
    let by_filter = DynamicFilterConfig::constant(SIGMA_K).run_sensor(&first_order(example_tau_s()), &example());
    let mut section = LessonSection::new(
        "worked_example",
        "The worked example: 21, 15, 11",
        "A thermometer shows 21, 15 and 11 degrees, a minute apart. The differences fall by q = 4/6, so it will end at (21 x 11 - 15^2) / (21 + 11 - 2 x 15). \
             With q known two samples are enough.",
        &["samples", "q", "final value"],
    );
    let mut row = |samples: &str, q: &str, name: &str, value: Option<f64>| {
        let cell = value.map_or_else(String::new, |value| format!("{value:.6}"));
        section.rows.push(vec![samples.to_owned(), q.to_owned(), cell]);
        section.record_value(name, value);
    };
    row("3", "unknown, by the formula", "three_samples", by_formula);
    let after = |k: usize| by_filter.get(k - 1).map(|(_, value, _)| *value);
    row("2", "known, by the filter", "two_samples_known_q", after(2));
    row("3", "known, by the filter", "three_samples_known_q", after(3));
    section
}

fn models() -> Vec<(&'static str, DynamicModel)> {
    let two_lags = DynamicModel::empty().with_lags(FIRST_SENSOR, 1.0, &[5.3, 22.0]);
    // (s + 1/4)(s + 1/15)
    let second_order = DynamicModel::empty().with_coefficients(FIRST_SENSOR, 1.0, &[1.0 / 60.0, 19.0 / 60.0]);
    let two_sensors = first_order(40.0).with_coefficients(SECOND_SENSOR, 0.5, &[0.02, 0.2]);
    [
        ("first order", Ok(first_order(example_tau_s()))),
        ("two lags", two_lags),
        ("second order", second_order),
        ("two sensors", two_sensors),
    ]
    .into_iter()
    .filter_map(|(name, model)| Some((name, model.ok()?)))
    .collect()
}

/// Noisy steps of 20 K, a sample every two seconds.
fn samples_of(model: &DynamicModel, seed: u64) -> Vec<(SensorId, TimedSample)> {
    let sensor = SimulatedSensor::first_order(15.0, SIGMA_K, 2.0);
    let has_other = model.row_of(SECOND_SENSOR).is_some();
    let run = sensor.run(seed, 40, step_input(23.0, 3.0, 1.0));
    let of = |(k, sample): (usize, TimedSample)| {
        let is_other = has_other && k % 3 == 1;
        (if is_other { SECOND_SENSOR } else { FIRST_SENSOR }, sample)
    };
    run.into_iter().enumerate().map(of).collect()
}

pub(super) fn three_methods(seed: u64) -> LessonSection {
    const PRIOR_SIGMAS: f64 = 100.0;
    let mut section = LessonSection::new(
        "three_ways",
        "Least squares three ways",
        "All samples at once, one after the other, and as a Kalman filter of the state [u; x] without process noise: the same numbers. The table has the largest \
             difference from block least squares over 1, 2, 8 and 40 samples, in kelvin, from the same prior of 100 sigma.",
        &["sensor", "recursive", "Kalman filter"],
    );
    let mut worst = [0.0_f64; 2];
    for (name, model) in models() {
        let samples = samples_of(&model, seed);
        let known =
            DynamicFilterConfig { prior_sigma: Some(PRIOR_SIGMAS * SIGMA_K), ..DynamicFilterConfig::constant(SIGMA_K) };
        let filtered = known.run_sensors(&model, &samples);
        let mut differences = [0.0_f64; 2];
        for count in [1, 2, 8, 40] {
            let so_far = samples.get(..count).unwrap_or_default();
            let block = block_least_squares(&model, so_far, PRIOR_SIGMAS);
            let recursive = recursive_least_squares(&model, so_far, PRIOR_SIGMAS);
            let kalman = filtered.get(count - 1).map(|(_, value, _)| *value);
            let recursive = recursive.map(|found| found.value);
            for (difference, other) in differences.iter_mut().zip([recursive, kalman]) {
                let apart = block.zip(other).map(|(block, other)| (block.value - other).abs());
                *difference = difference.max(apart.unwrap_or(f64::INFINITY));
            }
        }
        let cells = differences.map(|difference| format!("{difference:.1e}"));
        section.rows.push([vec![name.to_owned()], cells.to_vec()].concat());
        for (worst, difference) in worst.iter_mut().zip(differences) {
            *worst = worst.max(difference);
        }
    }
    section.record_value("recursive_difference", worst[0]);
    section.record_value("kalman_difference", worst[1]);
    section
}

pub(super) fn start(seed: u64) -> LessonSection {
    let tau_s = example_tau_s();
    let sensor = SimulatedSensor::first_order(tau_s, SIGMA_K, 10.0);
    // The thermometer is read from the moment on in which it is dipped in.
    let samples: Vec<TimedSample> = sensor.run(seed, 60, step_input(21.0, 3.0, 0.5)).into_iter().skip(1).collect();
    let found = DynamicFilterConfig::constant(SIGMA_K).run_sensor(&first_order(tau_s), &samples);
    let mut section = LessonSection::new(
        "start",
        "The start from the first sample",
        "Nothing is known before the first sample: it is the first estimate, with a sigma of 1e5 times that of a sample. With the second one the bound is finite.",
        &["sample", "time [s]", "shown", "predicted", "sigma"],
    );
    for (k, (sample, (_, value, sigma))) in samples.iter().zip(&found).enumerate() {
        if k < 6 {
            section.rows.push(vec![
                format!("{}", k + 1),
                format!("{:.0}", sample.at_s),
                format!("{:.2}", sample.value),
                format!("{value:.2}"),
                format!("{sigma:.2}"),
            ]);
        }
    }
    let first = samples.first().zip(found.first());
    section.record_value("first_difference", first.map(|(sample, (_, value, _))| (sample.value - value).abs()));
    section.record_value("sixth_error_k", found.get(5).map(|(_, value, _)| (value - 3.0).abs()));
    let later: Vec<_> = found.iter().skip(1).copied().collect();
    let curves = vec![
        Curve::line("predicted", filter_values(&later)),
        Curve::line("shown", sample_points(&samples)),
        Curve::new("truth", CurveShape::Level(3.0)),
        band("95 % bound", &later),
    ];
    let picture = temperatures("A slow thermometer in cold water", vec![curves]);
    section.figure = Some((picture, "Shown and predicted, from the second sample on.".to_owned()));
    section
}

pub(super) fn noise_gain(_seed: u64) -> LessonSection {
    let tau_s = example_tau_s();
    let model = first_order(tau_s);
    let left = |count: usize| 18.0 * (-MINUTE_S * (count as f64 - 1.0) / tau_s).exp();
    let samples: Vec<(SensorId, TimedSample)> = (1..=30)
        .map(|count| {
            let at_s = MINUTE_S * (count as f64 - 1.0);
            (FIRST_SENSOR, TimedSample { at_s, value: 3.0 + left(count) })
        })
        .collect();
    let gain = |count: usize| {
        let so_far = samples.get(..count)?;
        Some(block_least_squares(&model, so_far, 1e6)?.noise_gain)
    };
    let mut section = LessonSection::new(
        "noise_gain",
        "What it costs: noise",
        "Early on the prediction is right on average and noisy; the reading is quiet and wrong. Where the curves cross a plain reading is as good. The time constant is \
             that of the example, a sample a minute.",
        &["samples", "sigma of prediction / sigma of sample", "plain reading is off by [K]"],
    );
    for count in [2, 3, 5, 10, 20] {
        let cell = gain(count).map_or_else(String::new, |gain| format!("{gain:.3}"));
        section.rows.push(vec![count.to_string(), cell, format!("{:.3}", left(count))]);
        section.record_value(format!("after_{count}"), gain(count));
    }
    let gains: Vec<(f64, f64)> = (2..=30).filter_map(|count| Some((count as f64, gain(count)?.log10()))).collect();
    let offsets = (2..=30).map(|count| (count as f64, left(count).log10())).collect();
    let crossing = gains.iter().find(|(count, gain)| left(*count as usize).log10() < gain + 0.5_f64.log10());
    section.record_value("reading_is_better_from_sample_at_sigma_half_k", crossing.map(|(count, _)| *count));
    section.figure = Some((
        noise_plot(gains, offsets),
        "A sensor with less noise moves the first curve down, and the crossing to the right.".to_owned(),
    ));
    section
}

fn noise_plot(gains: Vec<(f64, f64)>, offsets: Vec<(f64, f64)>) -> Plot {
    let axes = Axes::new(
        "samples",
        "log10 of K, sigma of a sample 1 K",
        240.0,
        [Curve::line("sigma of prediction", gains), Curve::line("error of reading", offsets)],
    );
    Plot::new("Noise of the prediction against the error of the reading", "", vec![axes])
}

pub(super) fn several_sensors(seed: u64) -> LessonSection {
    let (slow, fast) = (148.0, 40.0);
    let truth = || step_input(21.0, 3.0, 0.5);
    let run = |tau_s, seed| {
        let sensor = SimulatedSensor::first_order(tau_s, SIGMA_K, 5.0);
        let samples = sensor.run(seed, 60, truth());
        samples.into_iter().skip(1).collect::<Vec<_>>()
    };
    let samples = [run(slow, seed), run(fast, seed.wrapping_add(1))];
    let both_model = first_order(slow).with_lags(SECOND_SENSOR, 1.0, &[fast]);
    let both: Vec<(SensorId, TimedSample)> =
        samples[0].iter().zip(&samples[1]).flat_map(|(a, b)| [(FIRST_SENSOR, *a), (SECOND_SENSOR, *b)]).collect();
    let known = DynamicFilterConfig::constant(SIGMA_K);
    let alone = [known.run_sensor(&first_order(slow), &samples[0]), known.run_sensor(&first_order(fast), &samples[1])];
    let together: Vec<_> = both_model
        .map(|model| known.run_sensors(&model, &both))
        .unwrap_or_default()
        .into_iter()
        .skip(1)
        .step_by(2)
        .collect();
    let mut section = LessonSection::new(
        "several_sensors",
        "Several sensors",
        "Two thermometers in the same water, with time constants of 148 s and 40 s: their rows are stacked, each has a transient of its own, and the water is the same. \
             The table has the sigma of the prediction in kelvin.",
        &["samples of each", "slow alone", "fast alone", "both"],
    );
    for count in [3, 5, 10, 20] {
        let sigma = |all: &[(f64, f64, f64)]| all.get(count - 1).map(|(_, _, sigma)| *sigma);
        let sigmas = [sigma(&alone[0]), sigma(&alone[1]), sigma(&together)];
        let cells = sigmas.map(|sigma| sigma.map_or_else(String::new, |sigma| format!("{sigma:.3}")));
        section.rows.push([vec![count.to_string()], cells.to_vec()].concat());
        for (name, sigma) in ["slow", "fast", "both"].into_iter().zip(sigmas) {
            section.record_value(format!("{name}_sigma_after_{count}_k"), sigma);
        }
    }
    section
}

/// A load cell that rings: 1.5 Hz, a tenth of the critical damping; a load of 500 g, read fifty times a second.
const RINGING_RAD_PER_S: f64 = 3.0 * std::f64::consts::PI;
const DAMPING: f64 = 0.1;
const LOAD_G: f64 = 500.0;
const LOAD_SIGMA_G: f64 = 2.0;
const LOAD_PERIOD_S: f64 = 0.02;

pub(super) fn load_cell(seed: u64) -> LessonSection {
    let coefficients = [RINGING_RAD_PER_S * RINGING_RAD_PER_S, 2.0 * DAMPING * RINGING_RAD_PER_S];
    let damped_rad_per_s = RINGING_RAD_PER_S * (1.0 - DAMPING * DAMPING).sqrt();
    let mut random = Pcg64::seed_from_u64(seed);
    let samples: Vec<TimedSample> = (1..=400)
        .map(|k| {
            let at_s = LOAD_PERIOD_S * f64::from(k);
            let (sin, cos) = (damped_rad_per_s * at_s).sin_cos();
            let decay = (-DAMPING * RINGING_RAD_PER_S * at_s).exp();
            let left = decay * (cos + DAMPING * RINGING_RAD_PER_S / damped_rad_per_s * sin);
            let noise = LOAD_SIGMA_G * random.sample::<f64, _>(StandardNormal);
            TimedSample { at_s, value: LOAD_G * (1.0 - left) + noise }
        })
        .collect();
    let model = DynamicModel::empty().with_coefficients(FIRST_SENSOR, 1.0, &coefficients).ok();
    let model = model.unwrap_or_else(DynamicModel::empty);
    let found = DynamicFilterConfig::constant(LOAD_SIGMA_G).run_sensor(&model, &samples);
    let mut section = LessonSection::new(
        "load_cell",
        "Another slow sensor: a load cell",
        "A scale rings when a load of 500 g is put on it: a sensor of second order with complex roots, a_0 = w^2 and a_1 = 2 d w. Nothing in the filter is about temperatures; with the \
             coefficients known it weighs before the first swing is over.",
        &["time [s]", "shown [g]", "predicted [g]", "sigma [g]"],
    );
    for at_s in [0.1, 0.2, 0.3, 0.5, 1.0, 2.0] {
        let index = (at_s / LOAD_PERIOD_S).round() as usize - 1;
        if let (Some(sample), Some((_, value, sigma))) = (samples.get(index), found.get(index)) {
            let cells =
                [format!("{at_s}"), format!("{:.1}", sample.value), format!("{value:.1}"), format!("{sigma:.1}")];
            section.rows.push(cells.to_vec());
        }
    }
    let settled = |series: &[(f64, f64)]| settling_time_s(series, 0.0, LOAD_G, 0.02 * LOAD_G);
    section.record_value("shown_2_percent_s", settled(&sample_points(&samples)));
    section.record_value("predicted_2_percent_s", settled(&filter_values(&found)));
    section
}

const TAU_S: f64 = 5.0;
const PERIOD_S: f64 = 0.25;
const DIPPED_S: f64 = 5.0;
/// Steps for identification (small) and for use (large), so that the uncertainty of tau matters.
const IDENTIFICATION_STEP: (f64, f64) = (20.0, 18.0);
const PREDICTED_STEP: (f64, f64) = (20.0, 4.0);
/// Times after the step at which the bound is tested: half a time constant, one, and two.
const CHECKED_AT_S: [f64; 3] = [2.5, 5.0, 10.0];
const METHODS: [&str; 3] = ["known", "taken_for_known", "identified"];

/// For each instant and method whether the bound contained the final value; `None` without a bound.
pub type BoundRun = [[Option<bool>; 3]; 3];

/// Identifies the sensor by one noisy step and predicts the end of another.
pub fn bound_run(seed: u64) -> BoundRun {
    let sensor = SimulatedSensor::first_order(TAU_S, SIGMA_K, PERIOD_S);
    let count = |until_s: f64| (until_s / PERIOD_S) as usize + 1;
    let teaching = sensor.run(
        seed.wrapping_mul(2),
        count(40.0),
        step_input(IDENTIFICATION_STEP.0, IDENTIFICATION_STEP.1, DIPPED_S),
    );
    let options = StepOptions { order: Some(1), ..StepOptions::with_sigma(SIGMA_K) };
    let identified = identify_step(&teaching, &options).ok();
    let found_s = identified.as_ref().and_then(|found| Some(found.lags().first()?.time_constant_s));
    let description = identified.and_then(|found| describe_sensor(&[found], RunSimilarity::SameSensor));
    let samples = sensor.run(
        seed.wrapping_mul(2).wrapping_add(1),
        count(DIPPED_S + CHECKED_AT_S[2]),
        step_input(PREDICTED_STEP.0, PREDICTED_STEP.1, DIPPED_S),
    );
    let dipped: Vec<TimedSample> = samples.iter().filter(|sample| sample.at_s >= DIPPED_S).copied().collect();
    let by_paper = |tau_s: f64| -> Vec<EndPrediction> {
        let found = DynamicFilterConfig::constant(SIGMA_K).run_sensor(&first_order(tau_s), &dipped);
        let of = |(at_s, value, sigma)| EndPrediction { at_s, value, sigma, is_settling: true };
        found.into_iter().map(of).collect()
    };
    let predictions = [
        Some(by_paper(TAU_S)),
        found_s.map(by_paper),
        description.map(|description| predict(&samples, SIGMA_K, &description)),
    ];
    CHECKED_AT_S.map(|since_s| {
        predictions.each_ref().map(|predictions| {
            let last = predictions.as_ref()?.iter().rfind(|one| one.at_s <= DIPPED_S + since_s)?;
            (last.at_s > DIPPED_S + since_s - PERIOD_S).then(|| last.holds(PREDICTED_STEP.1))
        })
    })
}

pub fn bounds_section(runs: &[BoundRun]) -> LessonSection {
    let count = runs.len().max(1) as f64;
    // Two standard deviations of a share of this number of runs.
    let half = 1.96 * (BOUND_RATE * (1.0 - BOUND_RATE) / count).sqrt();
    let mut section = LessonSection::new(
        "bounds",
        "Do the bounds hold?",
        format!(
            "{} runs. The sensor (5 s) is identified by a step of 2 K with a noise of 0.1 K, and then used for a step of 16 K. The 95 % bound should contain the end in 95 % of the runs, give or take \
             {:.1} %. Taken for known, the identified time constant gives bounds that are too narrow. The filter that does not trust it has bounds that are too wide: it expects a sensor with faults of its own, and this simulated one has none.",
            runs.len(),
            100.0 * half
        ),
        &["time constants since the step", "known", "identified, taken for known", "identified, uncertain"],
    );
    for (at, since_s) in CHECKED_AT_S.into_iter().enumerate() {
        let time_constants = since_s / TAU_S;
        let mut cells = vec![format!("{time_constants}")];
        for (method, name) in METHODS.into_iter().enumerate() {
            let rate = mean(runs.iter().filter_map(|run| run[at][method]).map(f64::from));
            let cell = rate.map_or_else(String::new, |rate| format!("{:.1} %", 100.0 * rate));
            cells.push(cell);
            section.record_value(format!("{name}_rate_at_{time_constants}"), rate);
        }
        section.rows.push(cells);
    }
    section.record_value("half_width", half);
    section
}

//! What the paper shows first: the worked example, three ways that are one, the start, the price in noise, several sensors.

use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_report::chart::{Axes, Plot};
use posebridge_telemetry::SensorId;

use super::super::TimedSample;
use super::super::known_dynamics::{block_least_squares, final_value_from_three, recursive_least_squares};
use super::super::simulated::{SimulatedSensor, step_input};
use super::live::{DynamicFilterConfig, band, filter_values, first_order, level, line, sample_points, temperatures};
use super::section::{LessonSection, header};

/// The worked example of the paper: a minute apart, of a thermometer that goes from 21 to 3 degrees.
const EXAMPLE: [f64; 3] = [21.0, 15.0, 11.0];
const MINUTE_S: f64 = 60.0;
/// Noise of a sample of a good thermometer, in kelvin.
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
    let mut section = LessonSection {
        name: "worked_example",
        title: "The worked example: 21, 15, 11".to_owned(),
        paragraphs: vec![
            "A thermometer shows 21, 15 and 11 degrees, a minute apart. The differences fall by q = 4/6, so it will end at (21 x 11 - 15^2) / (21 + 11 - 2 x 15). \
             With q known two samples are enough.".to_owned(),
        ],
        header: header(&["samples", "q", "final value"]),
        ..LessonSection::default()
    };
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

/// Sensors of several kinds.
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

/// Samples of these sensors: steps of 20 K with noise, a sample every two seconds.
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

pub(super) fn three_ways(seed: u64) -> LessonSection {
    const PRIOR_SIGMAS: f64 = 100.0;
    let mut section = LessonSection {
        name: "three_ways",
        title: "Least squares three ways".to_owned(),
        paragraphs: vec![
            "All samples at once, one after the other, and as a Kalman filter of the state [u; x] without process noise: the same numbers. The table has the largest \
             difference from block least squares over 1, 2, 8 and 40 samples, in kelvin, from the same prior of 100 sigma.".to_owned(),
        ],
        header: header(&["sensor", "recursive", "Kalman filter"]),
        ..LessonSection::default()
    };
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
    let mut section = LessonSection {
        name: "start",
        title: "The start from the first sample".to_owned(),
        paragraphs: vec![
            "Nothing is known before the first sample: it is the first estimate, with a sigma of 1e5 times that of a sample. With the second one the bound is finite.".to_owned(),
        ],
        header: header(&["sample", "time [s]", "shown", "predicted", "sigma"]),
        ..LessonSection::default()
    };
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
        line("predicted", filter_values(&later)),
        line("shown", sample_points(&samples)),
        level("truth", 3.0),
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
    let mut section = LessonSection {
        name: "noise_gain",
        title: "What it costs: noise".to_owned(),
        paragraphs: vec![
            "Early on the prediction is right on average and noisy; the reading is quiet and wrong. Where the curves cross a plain reading is as good. The time constant is \
             that of the example, a sample a minute.".to_owned(),
        ],
        header: header(&["samples", "sigma of prediction / sigma of sample", "plain reading is off by [K]"]),
        ..LessonSection::default()
    };
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
    let axes = Axes {
        x_name: "samples".to_owned(),
        y_name: "log10 of K, sigma of a sample 1 K".to_owned(),
        height_px: 240.0,
        is_map: false,
        curves: vec![line("sigma of prediction", gains), line("error of reading", offsets)],
    };
    Plot {
        title: "Noise of the prediction against the error of the reading".to_owned(),
        key_figures: String::new(),
        axes: vec![axes],
    }
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
    let mut section = LessonSection {
        name: "several_sensors",
        title: "Several sensors".to_owned(),
        paragraphs: vec![
            "Two thermometers in the same water, with time constants of 148 s and 40 s: their rows are stacked, each has a transient of its own, and the water is the same. \
             The table has the sigma of the prediction in kelvin.".to_owned(),
        ],
        header: header(&["samples of each", "slow alone", "fast alone", "both"]),
        ..LessonSection::default()
    };
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

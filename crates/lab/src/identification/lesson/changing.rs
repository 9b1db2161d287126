//! Sections on a quantity that is not constant, and on a sensor that rounds.

use posebridge_estimator::numerics::statistics::mean;
use posebridge_report::chart::Curve;
use posebridge_telemetry::estimate::NORMAL_95;

use super::identified::{DIPPED_S, DipTemperatures, IdentifiedModels, LAGS, simulate_dip};
use super::paper_filter::{DynamicFilterConfig, first_order};
use super::section::{LessonSection, band, filter_values, sample_points, seconds, share_inside, temperatures};
use crate::identification::prediction::EndPrediction;
use crate::identification::step_response::{SimulatedSensor, step_input};
use crate::identification::{TimedSample, settling_time_s};
use crate::statistics::median;

const TAU_S: f64 = 20.0;
const SIGMA_K: f64 = 0.1;
/// Random walk of the quantity in the extended filter, in kelvin per root of a second.
const WALK: f64 = 0.05;

type FilteredSeries = Vec<(f64, f64, f64)>;

/// The paper's filter, and the one with a random walk of the quantity.
fn run_filters(samples: &[TimedSample]) -> [FilteredSeries; 2] {
    [0.0, WALK].map(|walk_per_sqrt_s| {
        let known = DynamicFilterConfig { walk_per_sqrt_s, ..DynamicFilterConfig::constant(SIGMA_K) };
        known.run_sensor(&first_order(TAU_S), samples)
    })
}

/// Mean error and mean sigma over the last half, and the share of samples whose bound contains the truth.
fn score(followed: &FilteredSeries, truth: impl Fn(f64) -> f64) -> (f64, f64, f64) {
    let half = followed.len() / 2;
    let last = followed.get(half..).unwrap_or_default();
    let error = |at_s: f64, value: f64| (value - truth(at_s)).abs();
    let errors = last.iter().map(|(at_s, value, _)| error(*at_s, *value));
    let sigmas = last.iter().map(|(_, _, sigma)| *sigma);
    let inside = last.iter().map(|(at_s, value, sigma)| error(*at_s, *value) <= NORMAL_95 * sigma);
    let inside = mean(inside.map(|is_inside| f64::from(u8::from(is_inside))));
    (mean(errors).unwrap_or_default(), mean(sigmas).unwrap_or_default(), inside.unwrap_or_default())
}

const COMPARISON_HEADER: [&str; 4] = ["filter", "mean error [K]", "mean sigma [K]", "truth within the bound"];

fn add_comparison(section: &mut LessonSection, samples: &[TimedSample], truth: impl Fn(f64) -> f64) {
    let followed = run_filters(samples);
    for (name, followed) in ["constant", "walking"].into_iter().zip(&followed) {
        let (error, sigma, inside) = score(followed, &truth);
        section.rows.push(vec![
            name.to_owned(),
            format!("{error:.3}"),
            format!("{sigma:.3}"),
            format!("{:.0} %", 100.0 * inside),
        ]);
        section.record_value(format!("{name}_error_k"), error);
        section.record_value(format!("{name}_sigma_k"), sigma);
        section.record_value(format!("{name}_inside"), inside);
    }
    let later = |all: &FilteredSeries| all.iter().skip(20).copied().collect::<FilteredSeries>();
    let [constant, walking] = followed.map(|all| later(&all));
    let curves = vec![
        Curve::line("truth", samples.iter().map(|sample| (sample.at_s, truth(sample.at_s)))),
        Curve::line("constant", filter_values(&constant)),
        Curve::line("walking", filter_values(&walking)),
        Curve::line("shown", sample_points(samples)),
        band("walking, 95 %", &walking),
    ];
    let title = section.title.clone();
    section.figure = Some((
        temperatures(&title, vec![curves]),
        "The filter of the paper, and the one that lets the quantity walk.".to_owned(),
    ));
}

pub(super) fn trend(seed: u64) -> LessonSection {
    let truth = |at_s: f64| 15.0 + 0.02 * at_s;
    let sensor = SimulatedSensor::first_order(TAU_S, SIGMA_K, 1.0);
    let samples = sensor.run(seed, 400, truth);
    let mut section = LessonSection::new(
        "trend",
        "Data with a trend",
        "The quantity rises by 0.02 K a second, and the paper's filter believes it to be constant: it becomes ever more certain of a mean of the past. A random walk of \
             0.05 K per root of a second lets it follow; the bound is then honest about it.",
        &COMPARISON_HEADER,
    );
    add_comparison(&mut section, &samples, truth);
    section
}

pub(super) fn walking(seed: u64) -> LessonSection {
    // Slow waves with a step in the middle of them.
    let truth = |at_s: f64| {
        let leap = if at_s < 250.0 { 0.0 } else { 3.0 };
        15.0 + leap + 1.5 * (at_s / 60.0).sin()
    };
    let sensor = SimulatedSensor::first_order(TAU_S, SIGMA_K, 1.0);
    let samples = sensor.run(seed, 500, truth);
    let mut section = LessonSection::new(
        "walking",
        "A quantity that changes",
        "Waves of 1.5 K, and a leap of 3 K after 250 s, through a sensor of 20 s. With the walk the filter undoes most of the lag of the sensor all the time.",
        &COMPARISON_HEADER,
    );
    add_comparison(&mut section, &samples, truth);
    let lag = samples.iter().skip(250).map(|sample| (sample.value - truth(sample.at_s)).abs());
    section.record_value("shown_error_k", mean(lag));
    section
}

pub(super) fn quantised(seed: u64) -> LessonSection {
    const RUNS: u64 = 40;
    const AFTER_SAMPLES: usize = 30;
    let mut section = LessonSection::new(
        "quantised",
        "Rounded samples",
        "A thermometer that rounds to a digit d adds an error of d over the root of 12, if its noise or the change from sample to sample is not much less than d. The table has the \
             error of the prediction after 30 samples, root mean square over 40 runs, against what the filter claims when it is told that sigma.",
        &["digit [K]", "error [K]", "claimed sigma [K]"],
    );
    for last_digit in [0.0, 0.0625, 0.5, 1.0_f64] {
        let sigma = (0.05_f64.powi(2) + last_digit * last_digit / 12.0).sqrt();
        let sensor = SimulatedSensor { resolution: last_digit, ..SimulatedSensor::first_order(TAU_S, 0.05, 1.0) };
        let (mut squares, mut claimed) = (0.0, 0.0);
        for run in 0..RUNS {
            // Each run ends at another place between two digits.
            let end = 4.0 + 0.37 * run as f64;
            let samples = sensor.run(seed.wrapping_add(run), AFTER_SAMPLES + 1, step_input(end + 18.0, end, 0.5));
            let samples = samples.get(1..).unwrap_or_default();
            let followed = DynamicFilterConfig::constant(sigma).run_sensor(&first_order(TAU_S), samples);
            if let Some((_, value, sigma)) = followed.last() {
                squares += (value - end).powi(2) / RUNS as f64;
                claimed += sigma / RUNS as f64;
            }
        }
        let error = f64::sqrt(squares);
        section.rows.push(vec![format!("{last_digit}"), format!("{error:.3}"), format!("{claimed:.3}")]);
        section.record_value(format!("digit_{last_digit}_error_k"), error);
        section.record_value(format!("digit_{last_digit}_sigma_k"), claimed);
    }
    section
}

const FACTORS: [f64; 7] = [0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3];
const RUNS: u64 = 3;
const DIP: DipTemperatures = DipTemperatures { before: 20.0, after: 4.0 };
const SHARE: f64 = 0.05;

/// Settling times to 5 % of one run: of the reading, with lags taken as exact, and with lags estimated.
type SettlingTimes = [Option<f64>; 3];

const METHODS: [&str; 3] = ["shown", "certain", "estimated"];

pub(super) fn mismatch(seed: u64) -> LessonSection {
    let mut section = LessonSection::new(
        "mismatch",
        "How wrong may the lags be?",
        format!(
            "The sensor is identified on one run. The next ones have every lag shorter or longer by up to 30 %. Seconds until within 5 % of the step for good, the middle one of {RUNS} runs, \
             and how often the 95 % bound contained the end."
        ),
        &["lags", "shown", "taken for certain", "estimated", "inside, certain", "inside, estimated"],
    );
    let models = match IdentifiedModels::of(&simulate_dip(&LAGS, seed, DipTemperatures { before: 22.0, after: 8.0 })) {
        Ok(models) => models,
        Err(why) => {
            section.paragraphs.push(format!("Nothing was identified: {why}."));
            return section;
        }
    };
    for (index, factor) in FACTORS.into_iter().enumerate() {
        let first = seed.wrapping_add(1 + RUNS * index as u64);
        let runs: Vec<(SettlingTimes, [f64; 2])> =
            (0..RUNS).map(|run| one_run(&models, factor, first.wrapping_add(run))).collect();
        add_row(&mut section, factor, &runs);
    }
    section
}

fn one_run(models: &IdentifiedModels, factor: f64, seed: u64) -> (SettlingTimes, [f64; 2]) {
    let samples = simulate_dip(&LAGS.map(|(tau_s, share)| (factor * tau_s, share)), seed, DIP);
    let [certain, estimated] = models.predictions(&samples);
    let limit = SHARE * (DIP.after - DIP.before).abs();
    let settled = |series: &[(f64, f64)]| settling_time_s(series, DIPPED_S, DIP.after, limit);
    let values = |all: &[EndPrediction]| -> Vec<(f64, f64)> { all.iter().map(|p| (p.at_s, p.value)).collect() };
    let all = [settled(&sample_points(&samples)), settled(&values(&certain)), settled(&values(&estimated))];
    (all, [&certain, &estimated].map(|all| share_inside(all, DIP.after).unwrap_or(0.0)))
}

fn add_row(section: &mut LessonSection, factor: f64, runs: &[(SettlingTimes, [f64; 2])]) {
    let mut row = vec![format!("{:+.0} %", 100.0 * (factor - 1.0))];
    for (method, name) in METHODS.into_iter().enumerate() {
        // A run that never settles counts as the largest.
        let settled = runs.iter().map(|(settled, _)| settled[method].unwrap_or(f64::INFINITY));
        let middle = median(settled).filter(|middle_s| middle_s.is_finite());
        row.push(seconds(middle));
        section.record_value(format!("{name}_5_percent_s_at_{factor}"), middle);
    }
    for (method, name) in METHODS.into_iter().skip(1).enumerate() {
        let inside = mean(runs.iter().map(|(_, inside)| inside[method])).unwrap_or_default();
        row.push(format!("{:.0} %", 100.0 * inside));
        section.record_value(format!("{name}_inside_at_{factor}"), inside);
    }
    section.rows.push(row);
}

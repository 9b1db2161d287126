//! Where the quantity is not constant, and where the sensor rounds.

use super::super::TimedSample;
use super::super::simulated::{SimulatedSensor, step_input};
use super::live::{DynamicFilterConfig, band, filter_values, first_order, line, sample_points, temperatures};
use super::section::{LessonSection, header};

const TAU_S: f64 = 20.0;
const SIGMA_K: f64 = 0.1;
/// How fast the quantity may walk in the extended filter, in kelvin per root of a second.
const WALK: f64 = 0.05;

type FilteredSeries = Vec<(f64, f64, f64)>;

/// The paper's filter, and the one that lets the quantity walk.
fn run_filters(samples: &[TimedSample]) -> [FilteredSeries; 2] {
    [0.0, WALK].map(|walk_per_sqrt_s| {
        let known = DynamicFilterConfig { walk_per_sqrt_s, ..DynamicFilterConfig::constant(SIGMA_K) };
        known.run_sensor(&first_order(TAU_S), samples)
    })
}

/// Mean error and mean sigma over the last half, and the share of samples at which the truth is within the bound.
fn score(followed: &FilteredSeries, truth: impl Fn(f64) -> f64) -> (f64, f64, f64) {
    let half = followed.len() / 2;
    let last = followed.get(half..).unwrap_or_default();
    let count = last.len().max(1) as f64;
    let errors = last.iter().map(|(at_s, value, _)| (value - truth(*at_s)).abs());
    let inside = last
        .iter()
        .filter(|(at_s, value, sigma)| (value - truth(*at_s)).abs() <= super::super::prediction::BOUND_SIGMAS * sigma);
    (
        errors.sum::<f64>() / count,
        last.iter().map(|(_, _, sigma)| sigma).sum::<f64>() / count,
        inside.count() as f64 / count,
    )
}

fn add_comparison(section: &mut LessonSection, samples: &[TimedSample], truth: impl Fn(f64) -> f64) {
    let followed = run_filters(samples);
    section.header = header(&["filter", "mean error [K]", "mean sigma [K]", "truth within the bound"]);
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
        line("truth", samples.iter().map(|sample| (sample.at_s, truth(sample.at_s))).collect()),
        line("constant", filter_values(&constant)),
        line("walking", filter_values(&walking)),
        line("shown", sample_points(samples)),
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
    let mut section = LessonSection {
        name: "trend",
        title: "Data with a trend".to_owned(),
        paragraphs: vec![
            "The quantity rises by 0.02 K a second, and the paper's filter believes it to be constant: it becomes ever more certain of a mean of the past. A random walk of \
             0.05 K per root of a second lets it follow; the bound is then honest about it.".to_owned(),
        ],
        ..LessonSection::default()
    };
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
    let mut section = LessonSection {
        name: "walking",
        title: "A quantity that changes".to_owned(),
        paragraphs: vec![
            "Waves of 1.5 K, and a leap of 3 K after 250 s, through a sensor of 20 s. With the walk the filter undoes most of the lag of the sensor all the time.".to_owned(),
        ],
        ..LessonSection::default()
    };
    add_comparison(&mut section, &samples, truth);
    let lag = samples.iter().skip(250).map(|sample| (sample.value - truth(sample.at_s)).abs());
    section.record_value("shown_error_k", lag.sum::<f64>() / 250.0);
    section
}

pub(super) fn quantised(seed: u64) -> LessonSection {
    /// Runs over which the error is averaged.
    const RUNS: u64 = 40;
    const AFTER_SAMPLES: usize = 30;
    let mut section = LessonSection {
        name: "quantised",
        title: "Rounded samples".to_owned(),
        paragraphs: vec![
            "A thermometer that rounds to a digit d adds an error of d over the root of 12, if its noise or the change from sample to sample is not much less than d. The table has the \
             error of the prediction after 30 samples, root mean square over 40 runs, against what the filter claims when it is told that sigma.".to_owned(),
        ],
        header: header(&["digit [K]", "error [K]", "claimed sigma [K]"]),
        ..LessonSection::default()
    };
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

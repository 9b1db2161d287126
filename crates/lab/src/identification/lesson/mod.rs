//! The lesson of the slow thermometer: one section for each result or open question of paper 2, on a simulated sensor.
//!
//! A section is a value: text, a table, a plot and named numbers. The program renders pages, terminal text and JSON.
//! docs/lab/thermometer.md has the same order.

mod changing;
mod first;
mod identified;
mod paper_filter;
mod section;

use posebridge_estimator::models::slow_sensor::SensorDynamics;
use posebridge_estimator::numerics::statistics::{mean, quantile};
use posebridge_report::chart::{Curve, CurveShape};

use self::section::{band, sample_points, seconds, settling_times_s, share_inside, temperatures};
use super::prediction::{EndPrediction, predict};
use super::prior::StepDirection;
use super::sensor_kind::{RunSimilarity, describe_sensor};
use super::step::IdentifiedStep;
use crate::statistics::median;

pub use self::first::{BoundRun, bound_run, bounds_section};
pub use self::section::LessonSection;

pub type SectionBuilder = fn(u64) -> LessonSection;

/// In order, except [`bounds_section`], which accumulates many runs.
pub const SECTIONS: [SectionBuilder; 13] = [
    first::worked_example,
    first::three_methods,
    first::start,
    first::noise_gain,
    identified::orders,
    identified::other_data,
    identified::both_directions,
    changing::trend,
    changing::walking,
    first::several_sensors,
    first::load_cell,
    changing::quantised,
    changing::mismatch,
];

// Sections on recordings: the identified models, and predictions of runs that were not used for them.

#[derive(Clone, Debug)]
pub struct RecordedRun {
    pub name: String,
    /// Of a run that is only predicted, this finds the step and its end.
    pub identified: IdentifiedStep,
}

#[derive(Clone, Debug)]
pub struct RecordedPrediction {
    pub name: String,
    /// Empty where nothing is known of the sensor, as live without a description.
    pub identified_from: Vec<String>,
    /// One for each sample from which the end can be told.
    pub predictions: Vec<EndPrediction>,
    /// Settling times of the sensor to 10, 5 and 2 % of its step.
    pub shown_s: [Option<f64>; 3],
    pub predicted_s: [Option<f64>; 3],
    /// Share of the predictions from the onset until the sensor has settled whose 95 % bound contains the end.
    pub inside: Option<f64>,
    /// Share of the samples from the onset until the sensor has settled for which there is a prediction.
    pub told: f64,
    /// Error at the first prediction after a third of the settling time; median error from there until the sensor has settled.
    pub error_at_third: Option<f64>,
    pub error_after_third: Option<f64>,
}

impl RecordedPrediction {
    /// Predicts a run from others, or without any from nothing; `None` if the others have no lags.
    pub fn predict_run(run: &RecordedRun, others: &[&RecordedRun], similarity: RunSimilarity) -> Option<Self> {
        let used: Vec<IdentifiedStep> = others.iter().map(|other| other.identified.clone()).collect();
        let description = if used.is_empty() { SensorDynamics::UNKNOWN } else { describe_sensor(&used, similarity)? };
        let step = &run.identified;
        let predictions = predict(&step.samples, step.sigma, &description);
        let series: Vec<(f64, f64)> = predictions.iter().map(|p| (p.at_s, p.value)).collect();
        let response = step.response();
        let size = (step.end - response.start).abs();
        let settled = |series: &[(f64, f64)]| settling_times_s(series, response.onset_s, step.end, size);
        let settling_s = response.settling_time_s(SETTLED_SHARE);
        let since_s = |p: &EndPrediction| p.at_s - response.onset_s;
        let approach: Vec<EndPrediction> =
            predictions.iter().filter(|p| (0.0..=settling_s).contains(&since_s(p))).copied().collect();
        let moving = step.samples.iter().map(|sample| sample.at_s - response.onset_s);
        let moving_count = moving.filter(|since_s| (0.0..=settling_s).contains(since_s)).count();
        let later = approach.iter().filter(|p| since_s(p) >= settling_s / 3.0);
        let errors: Vec<f64> = later.map(|p| (p.value - step.end).abs()).collect();
        Some(Self {
            name: run.name.clone(),
            identified_from: others.iter().map(|other| other.name.clone()).collect(),
            shown_s: settled(&sample_points(&step.samples)),
            predicted_s: settled(&series),
            inside: share_inside(&approach, step.end),
            told: approach.len() as f64 / moving_count.max(1) as f64,
            error_at_third: errors.first().copied(),
            error_after_third: quantile(&errors, 0.5),
            predictions,
        })
    }

    /// Its name among the numbers: that of the run, and whether it is predicted by nothing.
    fn key(&self) -> String {
        if self.identified_from.is_empty() { format!("{}.by_nothing", self.name) } else { self.name.clone() }
    }

    fn identified_from_text(&self) -> String {
        if self.identified_from.is_empty() { "nothing".to_owned() } else { self.identified_from.join(" ") }
    }
}

/// A sensor has settled when this share of the step is left.
const SETTLED_SHARE: f64 = 0.02;

/// The result on the simulated sensor in two sentences.
pub fn simulated_answer(sections: &[LessonSection]) -> String {
    let value = |section: &str, name: &str| {
        sections.iter().find(|found| found.name == section).and_then(|found| found.value(name))
    };
    let settled = |method: &str| value("other_data", &format!("same_{method}_5_percent_s"));
    let inside = value("bounds", "identified_rate_at_1");
    answer_text("After another step", settled("estimated"), settled("shown"), inside.map(|rate| (rate, "runs")))
}

/// The result on recorded steps in two sentences: of the runs that others predict, else of those that nothing does.
pub fn recorded_answer(predicted: &[(RecordedRun, RecordedPrediction)]) -> String {
    let has_model = |run: &&RecordedPrediction| !run.identified_from.is_empty();
    let all: Vec<&RecordedPrediction> = predicted.iter().map(|(_, run)| run).collect();
    let modelled: Vec<&RecordedPrediction> = all.iter().copied().filter(has_model).collect();
    let (runs, source) = if modelled.is_empty() { (all, "nothing") } else { (modelled, "the others") };
    let middle = |settled: fn(&RecordedPrediction) -> Option<f64>| {
        // A run that never settles counts as the longest.
        median(runs.iter().map(|run| settled(run).unwrap_or(f64::INFINITY))).filter(|middle_s| middle_s.is_finite())
    };
    let steps = match runs.len() {
        1 => format!("One step, predicted from {source}:"),
        count => format!("{count} steps, each predicted from {source}: in the median"),
    };
    let inside = mean(runs.iter().filter_map(|run| run.inside)).map(|share| (share, "predictions, on average"));
    answer_text(&steps, middle(|run| run.predicted_s[1]), middle(|run| run.shown_s[1]), inside)
}

/// `inside`: the share of what has a 95 % bound that contains the end.
fn answer_text(
    subject: &str,
    predicted_s: Option<f64>,
    shown_s: Option<f64>,
    inside: Option<(f64, &'static str)>,
) -> String {
    let after =
        |settled_s: Option<f64>| settled_s.map_or_else(|| "at no time".to_owned(), |at_s| format!("after {at_s:.1} s"));
    let inside =
        inside.map(|(share, of)| format!(" The 95 % bound contained the end in {:.0} % of the {of}.", 100.0 * share));
    format!(
        "{subject} the prediction is within 5 % of the end {} and the sensor {}.{}",
        after(predicted_s),
        after(shown_s),
        inside.unwrap_or_default()
    )
}

pub fn recorded_sections(
    identified: &[RecordedRun],
    predicted: &[(RecordedRun, RecordedPrediction)],
) -> Vec<LessonSection> {
    let first = [identification_section(identified), overview_section(predicted), recorded_bounds_section(predicted)];
    first.into_iter().chain(predicted.iter().map(|(run, recorded)| run_section(run, recorded))).collect()
}

fn identification_section(runs: &[RecordedRun]) -> LessonSection {
    let mut section = LessonSection::new(
        "identified",
        "What was identified",
        "Each run by itself, with the order that its own data ask for.",
        &["run", "way", "from", "to", "order", "lags [s]", "shares", "left over, rms"],
    );
    for run in runs {
        let found = &run.identified;
        let lags = found.lags();
        let of = |text: Vec<String>| text.join(", ");
        section.rows.push(vec![
            run.name.clone(),
            StepDirection::from_step(found.response().step).name().to_owned(),
            format!("{:.2}", found.response().start),
            format!("{:.2}", found.end),
            found.order().to_string(),
            of(lags
                .iter()
                .map(|lag| format!("{:.2} +- {:.2}", lag.time_constant_s, lag.time_constant_sigma_s))
                .collect()),
            of(lags.iter().map(|lag| format!("{:.3} +- {:.3}", lag.share, lag.share_sigma)).collect()),
            format!("{:.3}", found.chosen().residual_rms),
        ]);
        section.record_value(format!("{}.order", run.name), found.order() as f64);
        for (j, lag) in lags.iter().enumerate() {
            section.record_value(format!("{}.lag_{}_s", run.name, j + 1), lag.time_constant_s);
            section.record_value(format!("{}.lag_{}_sigma_s", run.name, j + 1), lag.time_constant_sigma_s);
        }
    }
    section
}

fn overview_section(predicted: &[(RecordedRun, RecordedPrediction)]) -> LessonSection {
    let mut section = LessonSection::new(
        "predicted",
        "How the predictions did",
        "Seconds from the onset until within 10, 5 and 2 % of the step for good, as shown and as predicted. The end is what the sensor itself shows in the last tenth of its step. Each run \
             is predicted by the runs named beside it, and by nothing, as live without a description; a sample is used when it comes, and no later one.",
        &["run", "by", "shown 10 %", "5 %", "2 %", "predicted 10 %", "5 %", "2 %"],
    );
    for (_, run) in predicted {
        let cells = run.shown_s.into_iter().chain(run.predicted_s).map(seconds);
        section.rows.push([run.name.clone(), run.identified_from_text()].into_iter().chain(cells).collect());
        for (what, settled) in [("shown", run.shown_s), ("predicted", run.predicted_s)] {
            for (share, settled) in ["10", "5", "2"].into_iter().zip(settled) {
                section.record_value(format!("{}.{what}_{share}_percent_s", run.key()), settled);
            }
        }
    }
    section
}

fn recorded_bounds_section(predicted: &[(RecordedRun, RecordedPrediction)]) -> LessonSection {
    let mut section = LessonSection::new(
        "recorded_bounds",
        "What the bounds were worth",
        "Until 2 % of the step are left: the share of the samples that have a prediction, and of those the share whose 95 % bound contains the end. The error is that of the first \
             prediction after a third of this time, and the median from there on, in the sensor's unit.",
        &["run", "by", "told", "end within bound", "error at a third", "median after it"],
    );
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.2}"));
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    for (_, run) in predicted {
        section.rows.push(vec![
            run.name.clone(),
            run.identified_from_text(),
            percent(run.told),
            run.inside.map_or_else(String::new, percent),
            number(run.error_at_third),
            number(run.error_after_third),
        ]);
        for (what, value) in [
            ("told", Some(run.told)),
            ("inside", run.inside),
            ("error_at_third", run.error_at_third),
            ("error_after_third", run.error_after_third),
        ] {
            section.record_value(format!("{}.{what}", run.key()), value);
        }
    }
    section
}

fn run_section(run: &RecordedRun, recorded: &RecordedPrediction) -> LessonSection {
    let step = &run.identified;
    let size = (step.end - step.response().start).abs();
    // Before a step is seen, and while nothing is known, the bound would be all of the picture.
    let known: Vec<(f64, f64, f64)> = recorded
        .predictions
        .iter()
        .filter(|p| p.is_settling && p.sigma < 0.2 * size)
        .map(|p| (p.at_s, p.value, p.sigma))
        .collect();
    let curves = vec![
        Curve::new("end", CurveShape::Level(step.end)),
        Curve::line("predicted", known.iter().map(|(at_s, value, _)| (*at_s, *value))),
        Curve::line("shown", sample_points(&step.samples)),
        band("95 % bound", &known),
    ];
    let title = format!("{}, by {}", run.name, recorded.identified_from_text());
    let caption = format!("{} shown and predicted.", run.name);
    LessonSection {
        name: "run",
        title: title.clone(),
        figure: Some((temperatures(&title, vec![curves]), caption)),
        ..LessonSection::default()
    }
}

//! The lesson of the slow thermometer: one section for each result or open question of paper 2, on a simulated sensor.
//!
//! A section is a value: text, a table, a plot and named numbers. The program renders pages, terminal text and JSON.
//! docs/lab/thermometer.md has the same order.

mod changing;
mod first;
mod identified;
mod section;

use posebridge_report::chart::{Curve, CurveShape};

use self::section::{band, sample_points, seconds, settling_times_s, share_inside, temperatures};
use super::prediction::EndPrediction;
use super::prior::StepDirection;
use super::sensor_kind::{RunSimilarity, SensorKind, predict};
use super::step::IdentifiedStep;

pub use self::first::{BoundRun, bound_run, bounds_section};
pub use self::section::LessonSection;

pub type SectionBuilder = fn(u64) -> LessonSection;

/// In order, except [`bounds_section`], which accumulates many runs.
pub const SECTIONS: [SectionBuilder; 12] = [
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
    pub identified_from: Vec<String>,
    pub order: usize,
    /// One for each sample, fewer later on.
    pub predictions: Vec<EndPrediction>,
    /// Settling times of the sensor to 10, 5 and 2 % of its step.
    pub shown_s: [Option<f64>; 3],
    pub predicted_s: [Option<f64>; 3],
    /// Share of predictions whose 95 % bound contained the end.
    pub inside: Option<f64>,
}

impl RecordedPrediction {
    /// Predicts a run from others; `None` without others, or without a common order.
    pub fn predict_run(run: &RecordedRun, others: &[&RecordedRun], likeness: RunSimilarity) -> Option<Self> {
        let used: Vec<IdentifiedStep> = others.iter().map(|other| other.identified.clone()).collect();
        let kind = SensorKind::from_runs(&used, likeness).ok()?;
        let step = &run.identified;
        let predictions = predict(&step.samples, step.sigma, &kind);
        let series: Vec<(f64, f64)> = predictions.iter().map(|p| (p.at_s, p.value)).collect();
        let response = step.response();
        let size = (step.end - response.start).abs();
        let settled = |series: &[(f64, f64)]| settling_times_s(series, response.onset_s, step.end, size);
        Some(Self {
            name: run.name.clone(),
            identified_from: others.iter().map(|other| other.name.clone()).collect(),
            order: kind.order(),
            shown_s: settled(&sample_points(&step.samples)),
            predicted_s: settled(&series),
            inside: share_inside(&predictions, step.end),
            predictions,
        })
    }
}

pub fn recorded_sections(
    identified: &[RecordedRun],
    predicted: &[(RecordedRun, RecordedPrediction)],
) -> Vec<LessonSection> {
    let first = [identification_section(identified), overview_section(predicted)];
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
        "Seconds from the onset until within 10, 5 and 2 % of the step for good. The end is what the sensor itself shows in the last tenth of its step. Each run is predicted by the runs \
             named beside it; a sample is used when it comes, and no later one.",
        &["run", "by", "order", "shown 10 %", "5 %", "2 %", "predicted 10 %", "5 %", "2 %", "end within bound"],
    );
    for (_, run) in predicted {
        let inside = run.inside.map_or_else(String::new, |inside| format!("{:.0} %", 100.0 * inside));
        let cells = run.shown_s.into_iter().chain(run.predicted_s).map(seconds);
        let names = [run.name.clone(), run.identified_from.join(" "), run.order.to_string()];
        section.rows.push(names.into_iter().chain(cells).chain([inside]).collect());
        section.record_value(format!("{}.order", run.name), run.order as f64);
        for (what, settled) in [("shown", run.shown_s), ("predicted", run.predicted_s)] {
            for (share, settled) in ["10", "5", "2"].into_iter().zip(settled) {
                section.record_value(format!("{}.{what}_{share}_percent_s", run.name), settled);
            }
        }
        section.record_value(format!("{}.inside", run.name), run.inside);
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
    let title = format!("{}, by {}", run.name, recorded.identified_from.join(" and "));
    let caption = format!("{} shown and predicted, order {}.", run.name, recorded.order);
    LessonSection {
        name: "run",
        title: title.clone(),
        figure: Some((temperatures(&title, vec![curves]), caption)),
        ..LessonSection::default()
    }
}

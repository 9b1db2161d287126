//! The same on recordings: what was identified, and how predictions did on runs that were not used for it.

use super::super::kind::{Kind, Likeness, Way};
use super::super::prediction::{Prediction, predict};
use super::super::settled_after_s;
use super::super::step::IdentifiedStep;
use super::identified::SHARES;
use super::live::{band, level, line, shown, temperatures};
use super::{Section, header, seconds};

/// A run of a recording that holds a step.
#[derive(Clone, Debug)]
pub struct RecordedRun {
    /// Its name.
    pub name: String,
    /// What was identified on it. Of a run that is only predicted, this finds the step and its end.
    pub identified: IdentifiedStep,
}

/// A run that was predicted, with those by which it was.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The run.
    pub name: String,
    /// Names of the runs that were used.
    pub by: Vec<String>,
    /// The order that was chosen.
    pub order: usize,
    /// One prediction for each sample, or sparser later on.
    pub predictions: Vec<Prediction>,
    /// Until the sensor is within 10, 5 and 2 % of its step for good, in seconds.
    pub shown_s: [Option<f64>; 3],
    /// The same of the prediction.
    pub predicted_s: [Option<f64>; 3],
    /// The share of predictions whose 95 % bound contained the end.
    pub inside: Option<f64>,
}

impl Recorded {
    /// Predicts a run by others; `None` where there are none, or none of a common order.
    #[must_use]
    pub fn of(run: &RecordedRun, others: &[&RecordedRun], likeness: Likeness) -> Option<Self> {
        let used: Vec<IdentifiedStep> = others.iter().map(|other| other.identified.clone()).collect();
        let kind = Kind::of(&used, likeness).ok()?;
        let step = &run.identified;
        let predictions = predict(&step.samples, step.sigma, &kind);
        let series: Vec<(f64, f64)> = predictions.iter().map(|p| (p.at_s, p.value)).collect();
        let moving: Vec<&Prediction> = predictions.iter().filter(|p| p.is_on_its_way).collect();
        let inside = moving.iter().filter(|prediction| {
            let (low, high) = prediction.bound();
            low <= step.end && step.end <= high
        });
        let inside = inside.count() as f64 / moving.len() as f64;
        Some(Self {
            name: run.name.clone(),
            by: others.iter().map(|other| other.name.clone()).collect(),
            order: kind.order(),
            shown_s: settling(step, &shown(&step.samples)),
            predicted_s: settling(step, &series),
            inside: inside.is_finite().then_some(inside),
            predictions,
        })
    }
}

fn settling(step: &IdentifiedStep, series: &[(f64, f64)]) -> [Option<f64>; 3] {
    let response = step.response();
    let size = (step.end - response.start).abs();
    SHARES.map(|share| settled_after_s(series, response.onset_s, (step.end, share * size)))
}

/// The sections on recordings: what was identified, and a section for each run that was predicted.
#[must_use]
pub fn recorded(identified: &[RecordedRun], predicted: &[(RecordedRun, Recorded)]) -> Vec<Section> {
    let first = [identification(identified), overview(predicted)];
    first.into_iter().chain(predicted.iter().map(pictured)).collect()
}

fn identification(runs: &[RecordedRun]) -> Section {
    let mut section = Section {
        name: "identified",
        title: "What was identified".to_owned(),
        words: vec!["Each run by itself, with the order that its own data ask for.".to_owned()],
        header: header(&["run", "way", "from", "to", "order", "lags [s]", "shares", "left over, rms"]),
        ..Section::default()
    };
    for run in runs {
        let found = &run.identified;
        let lags = found.lags();
        let of = |text: Vec<String>| text.join(", ");
        let way = match Way::of_step(found.response().step) {
            Way::Up => "up",
            Way::Down => "down",
        };
        section.rows.push(vec![
            run.name.clone(),
            way.to_owned(),
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
        section.note(format!("{}.order", run.name), found.order() as f64);
        for (j, lag) in lags.iter().enumerate() {
            section.note(format!("{}.lag_{}_s", run.name, j + 1), lag.time_constant_s);
            section.note(format!("{}.lag_{}_sigma_s", run.name, j + 1), lag.time_constant_sigma_s);
        }
    }
    section
}

fn overview(predicted: &[(RecordedRun, Recorded)]) -> Section {
    let mut section = Section {
        name: "predicted",
        title: "How the predictions did".to_owned(),
        words: vec![
            "Seconds from the onset until within 10, 5 and 2 % of the step for good. The end is what the sensor itself shows in the last tenth of its step. Each run is predicted by the runs \
             named beside it; a sample is used when it comes, and no later one.".to_owned(),
        ],
        header: header(&["run", "by", "order", "shown 10 %", "5 %", "2 %", "predicted 10 %", "5 %", "2 %", "end within bound"]),
        ..Section::default()
    };
    for (_, run) in predicted {
        let inside = run.inside.map_or_else(String::new, |inside| format!("{:.0} %", 100.0 * inside));
        let cells = run.shown_s.into_iter().chain(run.predicted_s).map(seconds);
        let names = [run.name.clone(), run.by.join(" "), run.order.to_string()];
        section.rows.push(names.into_iter().chain(cells).chain([inside]).collect());
        section.note(format!("{}.order", run.name), run.order as f64);
        for (what, settled) in [("shown", run.shown_s), ("predicted", run.predicted_s)] {
            for (share, settled) in ["10", "5", "2"].into_iter().zip(settled) {
                section.note(format!("{}.{what}_{share}_percent_s", run.name), settled);
            }
        }
        section.note(format!("{}.inside", run.name), run.inside);
    }
    section
}

fn pictured((run, recorded): &(RecordedRun, Recorded)) -> Section {
    let step = &run.identified;
    let size = (step.end - step.response().start).abs();
    // Before a step is seen, and while nothing is known, the bound would be all of the picture.
    let known: Vec<(f64, f64, f64)> = recorded
        .predictions
        .iter()
        .filter(|p| p.is_on_its_way && p.sigma < 0.2 * size)
        .map(|p| (p.at_s, p.value, p.sigma))
        .collect();
    let curves = vec![
        level("end", step.end),
        line("predicted", known.iter().map(|(at_s, value, _)| (*at_s, *value)).collect()),
        line("shown", shown(&step.samples)),
        band("95 % bound", &known),
    ];
    let title = format!("{}, by {}", run.name, recorded.by.join(" and "));
    let caption = format!("{} shown and predicted, order {}.", run.name, recorded.order);
    Section {
        name: "run",
        title: title.clone(),
        picture: Some((temperatures(&title, vec![curves]), caption)),
        ..Section::default()
    }
}

//! What `tune` prints and draws.

use std::fmt::Write as _;

use posebridge_analysis::SourceTally;
use posebridge_analysis::figures::{Axes, Curve, Plot, Shape, plot};
use posebridge_analysis::report::page::{Page, Part};
use posebridge_analysis::report::{NO_VALUE, Table};
use posebridge_analysis::tuning::{Ending, RunFit, joint_rms};
use serde_json::{Value, json};

use super::Tuned;
use super::runs::{RunScore, Set};

/// Height of a panel.
const PANEL_PX: f64 = 220.0;

/// Why parts of the filter stand still while it is tuned.
const SWITCHED_OFF: &str = "While tuning, the filter takes its noise as told: adapt_gain = 0 (noise that is learned on line would hide the one that is tuned), \
no slip test (a slip widens S by what is to be explained, so that too small a noise would cost nothing) and the widest gate. \
The position error is that of the filter as it runs live, with all of them on.";

pub(super) fn text(tuned: &Tuned) -> String {
    let mut text = parameters(tuned);
    let found = &tuned.found;
    let ended = match found.ending {
        Ending::Settled => "settled",
        Ending::OutOfRounds => "rounds used up before it settled",
    };
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "\nlog-likelihood {:.1} -> {:.1} ({:+.1}) in {} rounds, {ended}\n",
        found.start_value,
        found.value,
        found.value - found.start_value,
        found.rounds.len()
    );
    text += &sets(tuned);
    text.push('\n');
    text += &sources(tuned);
    text.push('\n');
    text += &by_run(tuned);
    let _ = writeln!(text, "\n{SWITCHED_OFF}");
    text
}

fn parameters(tuned: &Tuned) -> String {
    let mut table = Table::new(["parameter", "before", "after", "factor", "sigma of ln"]);
    for (i, key) in tuned.keys.iter().enumerate() {
        let (before, after) = tuned.values.get(i).copied().unwrap_or((f64::NAN, f64::NAN));
        let sigma = tuned.found.sigma.get(i).copied().flatten();
        table.push([
            key.name(),
            format!("{before:.5}"),
            format!("{after:.5}"),
            format!("{:.3}", after / before),
            sigma.map_or("flat".to_owned(), |sigma| format!("{sigma:.2}")),
        ]);
    }
    table.render()
}

/// Columns of what is compared.
fn columns(tuned: &Tuned) -> Vec<(&'static str, &[RunScore])> {
    let given = tuned
        .as_given
        .as_deref()
        .map(|scores| ("as in the file", scores));
    given
        .into_iter()
        .chain([
            ("before", tuned.before.as_slice()),
            ("after", tuned.after.as_slice()),
        ])
        .collect()
}

fn sets(tuned: &Tuned) -> String {
    let mut table = Table::new([
        "set",
        "noise",
        "runs",
        "innovations",
        "ln p each",
        "position rms",
    ]);
    for (name, set) in [("tuned on", Set::Training), ("held out", Set::HeldOut)] {
        for (noise, scores) in columns(tuned) {
            let of_set: Vec<&RunScore> = scores.iter().filter(|score| score.set == set).collect();
            if of_set.is_empty() {
                continue;
            }
            let fit = joined(&of_set);
            table.push([
                name.to_owned(),
                noise.to_owned(),
                of_set.len().to_string(),
                fit.components().to_string(),
                number(each(&fit), 4),
                millimetres(rms_m(&of_set)),
            ]);
        }
    }
    table.render()
}

fn sources(tuned: &Tuned) -> String {
    let mut table = Table::new([
        "why",
        "noise",
        "sensor",
        "innovations",
        "NIS",
        "rho(1)",
        "live NIS",
        "live refused",
    ]);
    for (name, set) in [("tuned on", Set::Training), ("held out", Set::HeldOut)] {
        for (noise, scores) in columns(tuned) {
            let of_set: Vec<&RunScore> = scores.iter().filter(|score| score.set == set).collect();
            let live = live_tallies(&of_set);
            for fit in joined(&of_set).sources {
                let tally = live.iter().find(|tally| tally.sensor == fit.sensor);
                table.push([
                    name.to_owned(),
                    noise.to_owned(),
                    fit.sensor.name().to_owned(),
                    fit.count.to_string(),
                    number(fit.nis(), 2),
                    number(fit.rho_1(), 2),
                    number(tally.and_then(SourceTally::mean_nis_per_dof), 2),
                    tally.map_or(NO_VALUE.to_owned(), |tally| tally.gated.to_string()),
                ]);
            }
        }
    }
    table.render()
}

fn by_run(tuned: &Tuned) -> String {
    let mut table = Table::new(["run", "ln p before", "after", "gain", "rms before", "after"]);
    for (before, after) in tuned.before.iter().zip(&tuned.after) {
        let (was, is) = (before.fit.log_likelihood(), after.fit.log_likelihood());
        table.push([
            before.name.clone(),
            format!("{was:.1}"),
            format!("{is:.1}"),
            format!("{:+.1}", is - was),
            millimetres(before.position_rms_m),
            millimetres(after.position_rms_m),
        ]);
    }
    table.render()
}

fn joined(scores: &[&RunScore]) -> RunFit {
    let mut all = RunFit::default();
    for score in scores {
        all.absorb(&score.fit);
    }
    all
}

fn live_tallies(scores: &[&RunScore]) -> Vec<SourceTally> {
    let mut all: Vec<SourceTally> = Vec::new();
    for tally in scores.iter().flat_map(|score| &score.sources) {
        match all.iter_mut().find(|known| known.sensor == tally.sensor) {
            Some(known) => known.absorb(tally),
            None => all.push(*tally),
        }
    }
    all
}

fn each(fit: &RunFit) -> Option<f64> {
    (fit.components() > 0).then(|| fit.log_likelihood() / fit.components() as f64)
}

fn rms_m(scores: &[&RunScore]) -> Option<f64> {
    let of_runs: Vec<f64> = scores
        .iter()
        .filter_map(|score| score.position_rms_m)
        .collect();
    joint_rms(&of_runs)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.digits$}"))
}

fn millimetres(value_m: Option<f64>) -> String {
    value_m.map_or(NO_VALUE.to_owned(), |value_m| {
        format!("{:.2} mm", value_m * 1e3)
    })
}

pub(super) fn page(tuned: &Tuned, tables: &str) -> Page {
    Page {
        title: "Noise parameters by the likelihood of the innovations".to_owned(),
        parts: vec![
            Part::Text(
                "The better noise is the one under which what came was more probable, each time before it was used. Runs that are held out \
                 were not seen by the search."
                    .to_owned(),
            ),
            Part::Lines(tables.to_owned()),
            Part::Figure {
                svg: plot(&picture(tuned)),
                caption: "Log-likelihood and parameters, round by round".to_owned(),
            },
        ],
    }
}

fn picture(tuned: &Tuned) -> Plot {
    let found = &tuned.found;
    let rounds = || found.rounds.iter().zip(1_u32..);
    let values = rounds().map(|(round, number)| (f64::from(number), round.value));
    let values = std::iter::once((0.0, found.start_value))
        .chain(values)
        .collect();
    let curves = tuned.keys.iter().enumerate().map(|(i, key)| {
        let at =
            rounds().filter_map(|(round, number)| Some((f64::from(number), *round.at.get(i)?)));
        let points = std::iter::once((0.0, 0.0))
            .chain(at)
            .map(|(x, ln)| (x, ln / std::f64::consts::LN_10));
        Curve {
            name: key.name(),
            shape: Shape::Line(points.collect()),
        }
    });
    let axes = |y_name: &str, curves: Vec<Curve>| Axes {
        x_name: "round".to_owned(),
        y_name: y_name.to_owned(),
        height_px: PANEL_PX,
        is_map: false,
        curves,
    };
    let likelihood = Curve {
        name: "log-likelihood".to_owned(),
        shape: Shape::Line(values),
    };
    Plot {
        title: "Tuning".to_owned(),
        key_figures: format!(
            "log-likelihood {:.1} -> {:.1}",
            found.start_value, found.value
        ),
        axes: vec![
            axes("ln L", vec![likelihood]),
            axes("log10 of the factor", curves.collect()),
        ],
    }
}

pub(super) fn json(tuned: &Tuned) -> Value {
    let parameters: Vec<Value> = tuned
        .keys
        .iter()
        .zip(&tuned.values)
        .zip(&tuned.found.sigma)
        .map(|((key, (before, after)), sigma)| json!({"key": key.name(), "before": before, "after": after, "sigma_ln": sigma}))
        .collect();
    let runs = |scores: &[RunScore]| -> Vec<Value> {
        scores
            .iter()
            .map(|score| {
                json!({
                    "name": score.name,
                    "held_out": score.set == Set::HeldOut,
                    "log_likelihood": score.fit.log_likelihood(),
                    "components": score.fit.components(),
                    "position_rms_m": score.position_rms_m,
                    "sources": score.fit.sources.iter().map(|fit| json!({
                        "name": fit.sensor.name(), "innovations": fit.count, "nis": fit.nis(), "rho_1": fit.rho_1(),
                    })).collect::<Vec<_>>(),
                })
            })
            .collect()
    };
    json!({
        "parameters": parameters,
        "start_factor": tuned.start_factor,
        "log_likelihood": {"before": tuned.found.start_value, "after": tuned.found.value},
        "settled": tuned.found.ending == Ending::Settled,
        "rounds": tuned.found.rounds.len(),
        "as_given": tuned.as_given.as_deref().map(runs),
        "before": runs(&tuned.before),
        "after": runs(&tuned.after),
    })
}

//! What `tune` prints and draws.

use std::fmt::Write as _;

use posebridge_lab::tuning::{ChoiceReason, QualityLoss, RunFit, SHARES, SearchTermination, joint_rms};
use posebridge_report::SourceTally;
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot, render_plot};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::{NO_VALUE, TextTable};
use serde_json::{Value, json};

use super::result::{KeptValues, TuneResult};
use super::run::{RunScore, RunSet};

/// Height of a panel.
const PANEL_PX: f64 = 220.0;

/// Why parts of the filter stand still while it is tuned.
const SWITCHED_OFF: &str = "While tuning, the filter takes its noise as told: adapt_gain = 0 (noise that is learned on line would hide the one that is tuned), \
no slip test (a slip widens S by what is to be explained, so that too small a noise would cost nothing) and the widest gate. \
The position error is that of the filter as it runs live, with all of them on.";

pub(super) fn text(tuned: &TuneResult) -> String {
    let mut text = parameters(tuned);
    let found = &tuned.optimum;
    let ended = match found.termination {
        SearchTermination::Converged => "settled",
        SearchTermination::RoundLimit => "rounds used up before it settled",
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
    text += &search_path_text(tuned);
    let _ = writeln!(text, "\nkept: {}\n", kept(tuned));
    text += &sets(tuned);
    text.push('\n');
    text += &sources(tuned);
    text.push('\n');
    text += &by_run(tuned);
    let _ = writeln!(text, "\n{SWITCHED_OFF}");
    text
}

fn parameters(tuned: &TuneResult) -> String {
    let mut table = TextTable::new(["parameter", "before", "at the maximum", "after", "factor", "sigma of ln"]);
    for (i, (key, values)) in tuned.keys.iter().zip(&tuned.values).enumerate() {
        let sigma = tuned.optimum.sigma.get(i).copied().flatten();
        table.push([
            key.name(),
            format!("{:.5}", values.before),
            format!("{:.5}", values.at_maximum),
            format!("{:.5}", values.after),
            format!("{:.3}", values.after / values.before),
            sigma.map_or("flat".to_owned(), |sigma| format!("{sigma:.2}")),
        ]);
    }
    table.render()
}

/// How far to go: what data that the search did not see say of each share of the way.
fn search_path_text(tuned: &TuneResult) -> String {
    let choice = &tuned.choice;
    let mut table = TextTable::new(["share of the way", "gain of ln p", "position rms", ""]);
    let rows = SHARES.iter().zip(&choice.gains).zip(&choice.position_rms_m);
    for (i, ((share, gain), rms_m)) in rows.enumerate() {
        table.push([
            format!("{share:.3}"),
            format!("{gain:+.1}"),
            millimetres(*rms_m),
            if i == choice.index { "<-" } else { "" }.to_owned(),
        ]);
    }
    format!(
        "of parts of the runs that the search did not see (standard error of the largest gain: {:.1})\n{}",
        choice.standard_error,
        table.render()
    )
}

/// Which numbers are kept, and why.
pub(super) fn kept(tuned: &TuneResult) -> String {
    let share = tuned.choice.share();
    let start = "the numbers to start from, because";
    match tuned.kept {
        KeptValues::Tuned => format!(
            "the tuned numbers, {share:.3} of the way to the maximum{}",
            match tuned.choice.reason {
                ChoiceReason::Likelihood => "",
                ChoiceReason::Position =>
                    ": beyond that, positions that were not shown are missed by more than at the start",
                ChoiceReason::NoFolds => "; the runs are too short to ask what the search did not see",
            }
        ),
        KeptValues::StartByFolds(ChoiceReason::Position) => {
            format!("{start} tuned ones miss positions by more, on parts of the runs that the search did not see")
        }
        KeptValues::StartByFolds(_) => format!(
            "{start} the gain of tuned ones is not beyond chance, on parts of the runs that the search did not see"
        ),
        KeptValues::StartByHeldOut(loss) => format!(
            "{start} the runs that were held out are {} by the tuned ones, {share:.3} of the way",
            match loss {
                QualityLoss::Likelihood => "explained less well",
                QualityLoss::Position => "missed by more",
                QualityLoss::Both => "explained less well and missed by more",
            }
        ),
    }
}

/// Columns of what is compared.
fn columns(tuned: &TuneResult) -> Vec<(&'static str, &[RunScore])> {
    let given = tuned.as_given.as_deref().map(|scores| ("as in the file", scores));
    given
        .into_iter()
        .chain([
            ("before", tuned.before.as_slice()),
            (if tuned.kept == KeptValues::Tuned { "after" } else { "tuned, not kept" }, tuned.proposed.as_slice()),
        ])
        .collect()
}

fn sets(tuned: &TuneResult) -> String {
    let mut table = TextTable::new(["set", "noise", "runs", "innovations", "ln p each", "position rms"]);
    for (name, set) in [("tuned on", RunSet::Training), ("held out", RunSet::HeldOut)] {
        for (noise, scores) in columns(tuned) {
            let of_set: Vec<&RunScore> = scores.iter().filter(|score| score.set == set).collect();
            if of_set.is_empty() {
                continue;
            }
            let fit = merged_fit(&of_set);
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

fn sources(tuned: &TuneResult) -> String {
    let mut table =
        TextTable::new(["why", "noise", "sensor", "innovations", "NIS", "rho(1)", "live NIS", "live refused"]);
    for (name, set) in [("tuned on", RunSet::Training), ("held out", RunSet::HeldOut)] {
        for (noise, scores) in columns(tuned) {
            let of_set: Vec<&RunScore> = scores.iter().filter(|score| score.set == set).collect();
            let live = live_tallies(&of_set);
            for fit in merged_fit(&of_set).sources {
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

fn by_run(tuned: &TuneResult) -> String {
    let mut table = TextTable::new(["run", "ln p before", "tuned", "gain", "rms before", "tuned"]);
    for (before, after) in tuned.before.iter().zip(&tuned.proposed) {
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

pub(super) fn merged_fit(scores: &[&RunScore]) -> RunFit {
    let mut all = RunFit::default();
    for score in scores {
        all.merge(&score.fit);
    }
    all
}

fn live_tallies(scores: &[&RunScore]) -> Vec<SourceTally> {
    let mut all: Vec<SourceTally> = Vec::new();
    for tally in scores.iter().flat_map(|score| &score.sources) {
        match all.iter_mut().find(|known| known.sensor == tally.sensor) {
            Some(known) => known.merge(tally),
            None => all.push(*tally),
        }
    }
    all
}

pub(super) fn each(fit: &RunFit) -> Option<f64> {
    (fit.components() > 0).then(|| fit.log_likelihood() / fit.components() as f64)
}

pub(super) fn rms_m(scores: &[&RunScore]) -> Option<f64> {
    let of_runs: Vec<f64> = scores.iter().filter_map(|score| score.position_rms_m).collect();
    joint_rms(&of_runs)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.digits$}"))
}

fn millimetres(value_m: Option<f64>) -> String {
    value_m.map_or(NO_VALUE.to_owned(), |value_m| format!("{:.2} mm", value_m * 1e3))
}

pub(super) fn page(tuned: &TuneResult, tables: &str) -> ReportPage {
    ReportPage {
        title: "Noise parameters by the likelihood of the innovations".to_owned(),
        blocks: vec![
            ReportBlock::Text(
                "The better noise is the one under which what came was more probable, each time before it was used. How far to go towards them is decided by parts \
                 of the runs that the search did not see. Runs that are held out were not seen at all."
                    .to_owned(),
            ),
            ReportBlock::PreformattedText(tables.to_owned()),
            ReportBlock::Figure {
                svg: render_plot(&picture(tuned)),
                caption: "Log-likelihood and parameters, round by round".to_owned(),
            },
        ],
    }
}

fn picture(tuned: &TuneResult) -> Plot {
    let found = &tuned.optimum;
    let rounds = || found.rounds.iter().zip(1_u32..);
    let values = rounds().map(|(round, number)| (f64::from(number), round.value));
    let values = std::iter::once((0.0, found.start_value)).chain(values).collect();
    let curves = tuned.keys.iter().enumerate().map(|(i, key)| {
        let at = rounds().filter_map(|(round, number)| Some((f64::from(number), *round.at.get(i)?)));
        let points = std::iter::once((0.0, 0.0)).chain(at).map(|(x, ln)| (x, ln / std::f64::consts::LN_10));
        Curve { name: key.name(), shape: CurveShape::Line(points.collect()) }
    });
    let axes = |y_name: &str, curves: Vec<Curve>| Axes {
        x_name: "round".to_owned(),
        y_name: y_name.to_owned(),
        height_px: PANEL_PX,
        is_map: false,
        curves,
    };
    let likelihood = Curve { name: "log-likelihood".to_owned(), shape: CurveShape::Line(values) };
    Plot {
        title: "Tuning".to_owned(),
        key_figures: format!("log-likelihood {:.1} -> {:.1}", found.start_value, found.value),
        axes: vec![axes("ln L", vec![likelihood]), axes("log10 of the factor", curves.collect())],
    }
}

pub(super) fn json(tuned: &TuneResult) -> Value {
    let parameters: Vec<Value> = tuned
        .keys
        .iter()
        .zip(&tuned.values)
        .zip(&tuned.optimum.sigma)
        .map(|((key, values), sigma)| {
            json!({
                "key": key.name(), "before": values.before, "at_maximum": values.at_maximum, "proposed": values.proposed,
                "after": values.after, "sigma_ln": sigma,
            })
        })
        .collect();
    let runs = |scores: &[RunScore]| -> Vec<Value> {
        scores
            .iter()
            .map(|score| {
                json!({
                    "name": score.name,
                    "held_out": score.set == RunSet::HeldOut,
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
        "log_likelihood": {"before": tuned.optimum.start_value, "after": tuned.optimum.value},
        "settled": tuned.optimum.termination == SearchTermination::Converged,
        "rounds": tuned.optimum.rounds.len(),
        "kept": kept(tuned),
        "is_tuned": tuned.kept == KeptValues::Tuned,
        "share": tuned.choice.share(),
        "unseen": {
            "shares": SHARES,
            "gains": tuned.choice.gains,
            "standard_error": tuned.choice.standard_error,
            "position_rms_m": tuned.choice.position_rms_m,
        },
        "as_given": tuned.as_given.as_deref().map(runs),
        "before": runs(&tuned.before),
        "proposed": runs(&tuned.proposed),
        "after": runs(tuned.after()),
    })
}

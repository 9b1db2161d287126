//! Text and figures of `tune`.

use posebridge_estimator::numerics::statistics::mean;
use posebridge_lab::tuning::{
    ChoiceReason, QualityLoss, RunFit, SHARES, SearchResult, ShareChoice, SourceFit, TunedKey,
};
use posebridge_report::SourceTally;
use posebridge_report::chart::{Axes, Curve, Plot};
use posebridge_report::metrics::merge_tally;
use posebridge_report::quantity::{Format, Quantity, Unit};
use posebridge_report::report::{Report, Table};
use serde_json::json;

use super::runs::{RunScore, RunSet};

const PANEL_PX: f64 = 220.0;

const SWITCHED_OFF: &str = "While tuning, the filter takes its noise as told: adapt_gain = 0 (noise that is learned on line would hide the one that is tuned), \
no slip test (a slip widens S by what is to be explained, so that too small a noise would cost nothing) and the widest gate. \
The position error is that of the filter as it runs live, with all of them on.";

pub(super) struct TuneResult {
    pub(super) keys: Vec<TunedKey>,
    pub(super) optimum: SearchResult,
    /// Step length towards the maximum, selected by data that the search did not use.
    pub(super) choice: ShareChoice,
    pub(super) kept: KeptValues,
    pub(super) start_factor: f64,
    /// Of the first training run.
    pub(super) values: Vec<ParameterValues>,
    pub(super) before: Vec<RunScore>,
    /// With the parameters of the selected step length, kept or not.
    pub(super) proposed: Vec<RunScore>,
    /// With the parameters of the file, if the search started from others.
    pub(super) as_given: Option<Vec<RunScore>>,
}

pub(super) struct ParameterValues {
    pub(super) before: f64,
    /// At the maximum likelihood of all training runs.
    pub(super) at_maximum: f64,
    /// At the selected step length.
    pub(super) proposed: f64,
    pub(super) after: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KeptValues {
    Tuned,
    /// The start values: no other ones were better on data that the search did not use.
    StartByFolds(ChoiceReason),
    /// The start values: the tuned ones are worse on the withheld runs.
    StartByHeldOut(QualityLoss),
}

impl TuneResult {
    pub(super) fn after(&self) -> &[RunScore] {
        match self.kept {
            KeptValues::Tuned => &self.proposed,
            KeptValues::StartByFolds(_) | KeptValues::StartByHeldOut(_) => &self.before,
        }
    }
}

const LIKELIHOOD: Format = Format::new(Unit::None, 1);
const POSITION: Format = Format::new(Unit::Millimetres, 2);

pub(super) fn report(tuned: &TuneResult) -> Report {
    let mut report = Report::new("tune", "Noise parameters by the likelihood of the innovations");
    report.background(
        "The better noise is the one under which what came was more probable, each time before it was used. How far to go towards them is decided by parts \
         of the runs that the search did not see. Runs that are held out were not seen at all.",
    );
    report.paragraph(format!("kept: {}", kept(tuned)));
    add_parameters(&mut report, tuned);
    add_search(&mut report, tuned);
    add_shares(&mut report, tuned);
    let groups = run_groups(tuned);
    add_groups(&mut report, &groups);
    add_sources(&mut report, &groups);
    add_runs(&mut report, tuned);
    report.paragraph(SWITCHED_OFF);
    report.chart(&plot(tuned), "Log-likelihood and parameters, round by round");
    report.data("kept", json!(kept(tuned)));
    report.data("is_tuned", json!(tuned.kept == KeptValues::Tuned));
    report.data("start_factor", json!(tuned.start_factor));
    report.data("as_given", json!(tuned.as_given.as_deref().map(runs_json)));
    report.data("before", runs_json(&tuned.before));
    report.data("proposed", runs_json(&tuned.proposed));
    report.data("after", runs_json(tuned.after()));
    report
}

fn add_parameters(report: &mut Report, tuned: &TuneResult) {
    let rows: Vec<((&TunedKey, &ParameterValues), &Option<f64>)> =
        tuned.keys.iter().zip(&tuned.values).zip(&tuned.optimum.sigma).collect();
    let value = Format::new(Unit::None, 5);
    let table = Table::of(&rows)
        .text("key", "parameter", |((key, _), _)| key.name())
        .number("before", "before", value, |((_, values), _)| Some(values.before))
        .number("at_maximum", "optimum", value, |((_, values), _)| Some(values.at_maximum))
        .data("proposed", |((_, values), _)| json!(values.proposed))
        .number("after", "after", value, |((_, values), _)| Some(values.after))
        .number("", "factor", Format::new(Unit::None, 3), |((_, values), _)| Some(values.after / values.before))
        // A dash where the likelihood is flat.
        .number("sigma_ln", "sigma of ln", Format::new(Unit::None, 2), |(_, sigma)| **sigma);
    report.table("parameters", &table);
}

fn add_search(report: &mut Report, tuned: &TuneResult) {
    let found = &tuned.optimum;
    report.values([
        Quantity::new("", "log-likelihood before", found.start_value, LIKELIHOOD),
        Quantity::new("", "log-likelihood after", found.value, LIKELIHOOD),
        Quantity::new("", "gain", found.value - found.start_value, LIKELIHOOD.signed()),
        Quantity::new("", "rounds", found.rounds.len() as f64, Format::new(Unit::None, 0)),
    ]);
    if found.has_converged {
        report.paragraph("The search has settled.");
    } else {
        report.warning("the rounds were used up before the search settled");
    }
    report.data("log_likelihood", json!({ "before": found.start_value, "after": found.value }));
    report.data("settled", json!(found.has_converged));
    report.data("rounds", json!(found.rounds.len()));
}

/// Scores of each step length on data that the search did not use.
fn add_shares(report: &mut Report, tuned: &TuneResult) {
    let choice = &tuned.choice;
    let rows: Vec<_> = SHARES.iter().zip(&choice.gains).zip(&choice.position_rms_m).enumerate().collect();
    let table = Table::of(&rows)
        .number("", "share of the way", Format::new(Unit::None, 3), |(_, ((share, _), _))| Some(**share))
        .number("", "gain of ln p", LIKELIHOOD.signed(), |(_, ((_, gain), _))| Some(**gain))
        .number("", "position rms", POSITION, |(_, (_, rms_m))| **rms_m)
        .text("", "", |(index, _)| if *index == choice.index { "<-" } else { "" }.to_owned());
    report.heading("Parts of the runs that the search did not see");
    report.table("", &table);
    report.values([Quantity::new("", "standard error of the largest gain", choice.standard_error, LIKELIHOOD)]);
    report.data("share", json!(choice.share()));
    report.data(
        "unseen",
        json!({
            "shares": SHARES,
            "gains": choice.gains,
            "standard_error": choice.standard_error,
            "position_rms_m": choice.position_rms_m,
        }),
    );
}

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

struct RunGroup<'a> {
    set: &'static str,
    noise: &'static str,
    scores: Vec<&'a RunScore>,
    fit: RunFit,
}

/// Groups of runs with the compared parameters; empty without runs.
fn run_groups(tuned: &TuneResult) -> Vec<RunGroup<'_>> {
    let proposed = if tuned.kept == KeptValues::Tuned { "after" } else { "tuned, not kept" };
    let compared = [
        ("as in the file", tuned.as_given.as_deref().unwrap_or_default()),
        ("before", &tuned.before),
        (proposed, &tuned.proposed),
    ];
    let mut groups = Vec::new();
    for (name, set) in [("tuned on", RunSet::Training), ("held out", RunSet::HeldOut)] {
        for (noise, scores) in compared {
            let scores: Vec<&RunScore> = scores.iter().filter(|score| score.set == set).collect();
            if !scores.is_empty() {
                groups.push(RunGroup { set: name, noise, fit: merged_fit(&scores), scores });
            }
        }
    }
    groups
}

fn add_groups(report: &mut Report, groups: &[RunGroup<'_>]) {
    let table = Table::of(groups)
        .text("", "set", |group| group.set.to_owned())
        .text("", "noise", |group| group.noise.to_owned())
        .count("", "runs", |group| group.scores.len())
        .text("", "innovations", |group| group.fit.components().to_string())
        .number("", "ln p each", Format::new(Unit::None, 4), |group| each(&group.fit))
        .number("", "position rms", POSITION, |group| rms_m(&group.scores));
    report.table("", &table);
}

struct SourceRow<'a> {
    group: &'a RunGroup<'a>,
    fit: &'a SourceFit,
    /// Fusion outcomes in the online filter.
    live: Option<SourceTally>,
}

fn add_sources(report: &mut Report, groups: &[RunGroup<'_>]) {
    let mut rows = Vec::new();
    for group in groups {
        let live = live_tallies(&group.scores);
        rows.extend(group.fit.sources.iter().map(|fit| SourceRow {
            group,
            fit,
            live: live.iter().find(|tally| tally.sensor == fit.sensor).copied(),
        }));
    }
    let two = Format::new(Unit::None, 2);
    let table = Table::of(&rows)
        .text("", "set", |row| row.group.set.to_owned())
        .text("", "noise", |row| row.group.noise.to_owned())
        .text("", "sensor", |row| row.fit.sensor.name().to_owned())
        .text("", "innovations", |row| row.fit.count.to_string())
        .number("", "NIS", two, |row| row.fit.nis())
        .number("", "rho(1)", two, |row| row.fit.rho_1())
        .number("", "live NIS", two, |row| row.live?.mean_nis_per_dof())
        .optional_count("", "live refused", |row| Some(row.live?.gated as usize))
        .labels(3);
    report.table("", &table);
}

fn add_runs(report: &mut Report, tuned: &TuneResult) {
    let rows: Vec<(&RunScore, &RunScore)> = tuned.before.iter().zip(&tuned.proposed).collect();
    let table = Table::of(&rows)
        .text("", "run", |(before, _)| before.name.clone())
        .number("", "ln p before", LIKELIHOOD, |(before, _)| Some(before.fit.log_likelihood()))
        .number("", "tuned", LIKELIHOOD, |(_, after)| Some(after.fit.log_likelihood()))
        .number("", "gain", LIKELIHOOD.signed(), |(before, after)| {
            Some(after.fit.log_likelihood() - before.fit.log_likelihood())
        })
        .number("", "rms before", POSITION, |(before, _)| before.position_rms_m)
        .number("", "rms tuned", POSITION, |(_, after)| after.position_rms_m);
    report.table("", &table);
}

fn runs_json(scores: &[RunScore]) -> serde_json::Value {
    let source = |fit: &SourceFit| json!({ "name": fit.sensor.name(), "innovations": fit.count, "nis": fit.nis(), "rho_1": fit.rho_1() });
    let runs = scores.iter().map(|score| {
        json!({
            "name": score.name,
            "held_out": score.set == RunSet::HeldOut,
            "log_likelihood": score.fit.log_likelihood(),
            "components": score.fit.components(),
            "position_rms_m": score.position_rms_m,
            "sources": score.fit.sources.iter().map(source).collect::<Vec<_>>(),
        })
    });
    runs.collect()
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
        merge_tally(&mut all, tally);
    }
    all
}

pub(super) fn each(fit: &RunFit) -> Option<f64> {
    (fit.components() > 0).then(|| fit.log_likelihood() / fit.components() as f64)
}

pub(super) fn rms_m(scores: &[&RunScore]) -> Option<f64> {
    mean(scores.iter().filter_map(|score| score.position_rms_m).map(|rms| rms * rms)).map(f64::sqrt)
}

fn plot(tuned: &TuneResult) -> Plot {
    let found = &tuned.optimum;
    let rounds = || found.rounds.iter().zip(1_u32..);
    let values = rounds().map(|(round, number)| (f64::from(number), round.value));
    let values = std::iter::once((0.0, found.start_value)).chain(values);
    let curves = tuned.keys.iter().enumerate().map(|(i, key)| {
        let at = rounds().filter_map(|(round, number)| Some((f64::from(number), *round.at.get(i)?)));
        let points = std::iter::once((0.0, 0.0)).chain(at).map(|(x, ln)| (x, ln / std::f64::consts::LN_10));
        Curve::line(key.name(), points)
    });
    let likelihood = Curve::line("log-likelihood", values);
    Plot::new(
        "Tuning",
        format!("log-likelihood {:.1} -> {:.1}", found.start_value, found.value),
        vec![
            Axes::new("round", "ln L", PANEL_PX, [likelihood]),
            Axes::new("round", "log10 of the factor", PANEL_PX, curves),
        ],
    )
}

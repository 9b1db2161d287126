//! The report of a session, or of the runs of a foreign recording: verdict, path, errors, sensors, calibration, links, clock, and
//! events. `report --json` prints the same as one object, documented in docs/reports.md.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use posebridge_report::chart::session::{
    self, CalibrationSeries, InnovationSeries, display_unit, learning, render_clock, render_errors, render_innovations,
    render_link,
};
use posebridge_report::page::{ReportBlock, ReportFigure};
use posebridge_report::report::Report;
use posebridge_report::tables::{EstimatorRow, NO_VALUE, estimator_table, runs_table};
use posebridge_report::{ErrorSummary, FilterVerdict, PoseTrack, RunLayers, SourceTally, source_verdicts};
use posebridge_telemetry::{Calibration, LinkCounter, TimeDelta, UncertainValue};
use serde_json::{Map, Value, json};

use super::session_history::SessionHistory;
use crate::config::learnable_keys;
use crate::station::learned_calibration::LearnedCalibration;
use crate::tools::replay::SmoothedRun;
use crate::tools::replay::own::errors_of;

pub const LINK_COUNTERS: [LinkCounter; 8] = [
    LinkCounter::FRAMES_IN,
    LinkCounter::FRAMES_OUT,
    LinkCounter::FRAMES_LOST,
    LinkCounter::CHECKSUM_ERRORS,
    LinkCounter::GARBAGE_BYTES,
    LinkCounter::TIMEOUTS,
    LinkCounter::UNSENT,
    LinkCounter::RECONNECTS,
];

pub struct SessionSummary {
    pub recording: String,
    pub facts: Vec<(String, String)>,
    pub filter: String,
    /// Changes of the recorded configuration.
    pub changed: Vec<String>,
    pub notes: Vec<String>,
    /// The whole session, or the runs of a descriptor.
    pub runs: Vec<RunSummary>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScoreReference {
    Truth,
    WithheldFixes,
    None,
}

pub struct RunSummary {
    pub name: String,
    pub history: SessionHistory,
    /// As in `replay`.
    pub errors: ErrorSummary,
    pub reference: ScoreReference,
    pub truth: Option<PoseTrack>,
    /// By the brick's own odometry, or by the wheels alone.
    pub odometry: Option<PoseTrack>,
    pub learned: Option<LearnedCalibration>,
    /// Given the whole run, if that was asked for.
    pub smoothed: Option<SmoothedRun>,
}

impl RunSummary {
    pub fn verdict(&self) -> FilterVerdict {
        FilterVerdict::new(&self.errors, 1, source_verdicts(&self.history.collector.sources))
    }
}

impl ScoreReference {
    pub const fn description(self) -> &'static str {
        match self {
            Self::Truth => "the truth",
            Self::WithheldFixes => "fixes that were withheld",
            Self::None => "nothing",
        }
    }
}

/// The report without the data for programs: in a terminal errors and verdicts, on the page everything.
pub fn report(session: &SessionSummary) -> Report {
    let mut report = Report::new("report", format!("Report of {}, filter {}", session.recording, session.filter));
    add_summary(&mut report, session);
    for (index, run) in session.runs.iter().enumerate() {
        if session.runs.len() > 1 {
            report.heading(format!("Run {}", run.name));
        }
        add_run(&mut report, run, index);
    }
    report.background(format!(
        "Made by posebridge {} from the recorded inputs alone, by the engine that runs live.",
        env!("CARGO_PKG_VERSION")
    ));
    report
}

fn add_summary(report: &mut Report, session: &SessionSummary) {
    let facts = session.facts.iter().map(|(name, value)| vec![name.clone(), value.clone()]);
    let filter = vec!["filter".to_owned(), session.filter.clone()];
    report.page_only(ReportBlock::CodeTable {
        header: vec!["recording".to_owned(), session.recording.clone()],
        rows: facts.chain([filter]).collect(),
    });
    if !session.changed.is_empty() {
        report.paragraph(format!("Replayed with {}: this is not what ran.", session.changed.join(", ")));
    }
    if !session.notes.is_empty() {
        report.page_only(ReportBlock::List(session.notes.clone()));
    }
    for run in &session.runs {
        let verdict = run.verdict();
        let label = if session.runs.len() > 1 { format!("{}:", run.name) } else { "Filter:".to_owned() };
        report.verdict(verdict.tone(), label, verdict.to_string());
        report.paragraph(in_figures(run));
    }
    let runs = session.runs.iter();
    let rows: Vec<EstimatorRow<'_>> = runs
        .map(|run| EstimatorRow {
            name: &run.name,
            errors: &run.errors,
            runs: 1,
            sources: &run.history.collector.sources,
        })
        .collect();
    report.code(runs_table(&rows));
}

fn add_run(report: &mut Report, run: &RunSummary, index: usize) {
    report.page_only(ReportBlock::FigureGrid(main_pictures(run, index)));
    add_compared(report, run);
    add_sources(report, run, index);
    let blocks = [calibration_blocks(run, index), link_blocks(run, index), timeline_blocks(&run.history)];
    for block in blocks.into_iter().flatten() {
        report.page_only(block);
    }
}

/// Duration, counts and errors in one sentence each.
fn in_figures(run: &RunSummary) -> String {
    let history = &run.history;
    let mut text = format!("{:.1} s, {} observations.", history.length().as_secs_f64(), history.collector.observations);
    let errors = &run.errors;
    if let (Some(rms_m), Some(max_m), Some(end_m)) =
        (errors.position_rms_m, errors.position_max_m, errors.position_end_m)
    {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            " Against {} the position is {} mm off (root mean square), at most {} mm, at the end {} mm.",
            run.reference.description(),
            millimetres(rms_m),
            millimetres(max_m),
            millimetres(end_m)
        );
    }
    if let Some(heading_rad) = errors.heading_rms_rad {
        // Writing to a String cannot fail.
        let _ = write!(text, " The heading is {:.2} degrees off.", heading_rad.to_degrees());
    }
    if let Some(smoothed) = &run.smoothed {
        text += &in_hindsight(smoothed);
    }
    if let Some(steps) = history.collector.quantity_steps_text() {
        // Writing to a String cannot fail.
        let _ = write!(text, " Filter of one quantity: {steps}.");
    }
    if run.reference == ScoreReference::None {
        text += " No truth is known: errors cannot be told.";
    }
    text
}

fn in_hindsight(smoothed: &SmoothedRun) -> String {
    let mut text = String::new();
    if let (Some(rms_m), Some(max_m)) = (smoothed.errors.position_rms_m, smoothed.errors.position_max_m) {
        let (rms, max) = (millimetres(rms_m), millimetres(max_m));
        // Writing to a String cannot fail.
        let _ = write!(text, " Given the whole run it is {rms} mm off (root mean square), at most {max} mm.");
    }
    if let Some(reason) = smoothed.reason() {
        // Writing to a String cannot fail.
        let _ = write!(text, " The smoothed path: {reason}.");
    }
    text
}

fn millimetres(length_m: f64) -> String {
    format!("{:.1}", length_m * 1e3)
}

fn picture(index: usize, name: &str, svg: String, caption: &str) -> ReportFigure {
    ReportFigure { name: format!("run{}-{name}", index + 1), svg, caption: caption.to_owned() }
}

fn main_pictures(run: &RunSummary, index: usize) -> Vec<ReportFigure> {
    let collector = &run.history.collector;
    let estimates = run.history.estimates();
    let smoothed = run.smoothed.as_ref().and_then(SmoothedRun::track);
    let compared = collector.compared_tracks();
    let layers = RunLayers {
        compared: &compared,
        title: &run.name,
        truth: run.truth.as_ref(),
        odometry: run.odometry.as_ref(),
        estimates: &estimates,
        smoothed: smoothed.as_ref(),
        fixes: collector.fixes.items(),
        ..RunLayers::default()
    };
    let mut pictures = vec![picture(
        index,
        "path",
        session::render_path(&layers),
        "The path. An ellipse holds the robot in 95 of 100 cases, if its claims are right.",
    )];
    if let Some(truth) = &run.truth {
        pictures.push(picture(
            index,
            "errors",
            render_errors("Error of the estimate", &run.history.errors(truth)),
            "How far the estimate was from the truth, and twice the standard deviation that it claimed.",
        ));
    }
    pictures
}

/// The filters that ran beside the one that sent: errors for the terminal as well, the NIS of each sensor on the page.
fn add_compared(report: &mut Report, run: &RunSummary) {
    let compared = &run.history.collector.compared;
    if compared.is_empty() {
        return;
    }
    report.page_only(ReportBlock::Subheading("Filters compared".to_owned()));
    let errors: Vec<ErrorSummary> =
        compared.iter().map(|filter| errors_of(filter.estimates.items(), run.truth.as_ref())).collect();
    let rows: Vec<EstimatorRow<'_>> = compared
        .iter()
        .zip(&errors)
        .map(|(filter, errors)| EstimatorRow { name: filter.name, errors, runs: 1, sources: &filter.sources })
        .collect();
    report.code(estimator_table(&rows));
    let nis = compared.iter().flat_map(|filter| {
        let judged = filter.sources.iter().filter_map(|tally| Some((tally, tally.mean_nis_per_dof()?)));
        judged.map(|(tally, nis)| {
            let counts = [tally.used, tally.gated].map(|count| count.to_string());
            let [used, gated] = counts;
            vec![filter.name.to_owned(), tally.sensor.name().to_owned(), used, gated, format!("{nis:.3}")]
        })
    });
    report.page_only(ReportBlock::table(&["filter", "sensor", "used", "gated", "NIS/dof"], nis.collect()));
}

fn add_sources(report: &mut Report, run: &RunSummary, index: usize) {
    let tallies = &run.history.collector.sources;
    if tallies.is_empty() {
        return;
    }
    report.page_only(ReportBlock::Subheading("Sensors".to_owned()));
    for tally in tallies {
        let verdict = tally.verdict();
        report.verdict(verdict.tone(), format!("{}:", tally.sensor.name()), verdict.to_string());
    }
    let headings = ["sensor"].into_iter().chain(SourceTally::COUNT_HEADINGS).chain(["NIS/dof", "dof", "correlation"]);
    let headings: Vec<&str> = headings.collect();
    report.page_only(ReportBlock::table(&headings, tallies.iter().map(source_row).collect()));
    let predicted = run.history.sources.iter().filter(|source| !source.samples.items().is_empty());
    let pictures = predicted.map(|source| {
        let name = source.sensor.name();
        let series = InnovationSeries {
            name: &format!("Innovations: {name}"),
            kind: source.kind,
            samples: source.samples.items(),
        };
        picture(
            index,
            &format!("innovations-{}", name.replace(' ', "-")),
            render_innovations(&series),
            "Observed minus predicted, with two standard deviations of what was claimed. Below, the normalised square: what lies above \
             the panel is drawn on its edge.",
        )
    });
    let pictures: Vec<ReportFigure> = pictures.collect();
    if !pictures.is_empty() {
        report.page_only(ReportBlock::FigureGrid(pictures));
    }
}

fn source_row(tally: &SourceTally) -> Vec<String> {
    let number = |value: Option<f64>| value.map_or_else(|| NO_VALUE.to_owned(), |value| format!("{value:.3}"));
    let counts = tally.counts().into_iter().map(|count| count.to_string());
    let consistency =
        [number(tally.mean_nis_per_dof()), tally.degrees_of_freedom().to_string(), number(tally.verdict().correlation)];
    std::iter::once(tally.sensor.name().to_owned()).chain(counts).chain(consistency).collect()
}

fn calibration_blocks(run: &RunSummary, index: usize) -> Vec<ReportBlock> {
    let Some(learned) = &run.learned else {
        return Vec::new();
    };
    let smoothed = run.smoothed.as_ref().and_then(|smoothed| Some(&smoothed.learned.as_ref()?.calibration));
    let mut header = vec!["entry", "unit", "before", "after"];
    header.extend(smoothed.map(|_| "given the whole run"));
    let open = learnable_keys().filter(|entry| (entry.read)(&learned.prior).sigma > 0.0);
    let rows: Vec<Vec<String>> = open
        .map(|entry| {
            let (unit, factor) = display_unit(entry.key);
            let text = |calibration: &Calibration| {
                let known = (entry.read)(calibration);
                format!("{:.3} ± {:.3}", known.value * factor, known.sigma * factor)
            };
            let known = [&learned.prior, &learned.calibration].into_iter().chain(smoothed);
            [entry.key.to_owned(), unit.to_owned()].into_iter().chain(known.map(text)).collect()
        })
        .collect();
    if rows.is_empty() {
        return Vec::new();
    }
    let mut parts =
        vec![ReportBlock::Subheading("What was learned of the robot".to_owned()), ReportBlock::table(&header, rows)];
    let series: Vec<CalibrationSeries<'_>> = run
        .history
        .learned()
        .map(|learned| CalibrationSeries { key: learned.key, samples: learned.samples.items() })
        .collect();
    if !series.is_empty() {
        parts.push(ReportBlock::FigureGrid(vec![picture(
            index,
            "learned",
            learning("Learned", &series),
            "What was believed of each systematic error, with two standard deviations.",
        )]));
    }
    parts
}

fn link_blocks(run: &RunSummary, index: usize) -> Vec<ReportBlock> {
    let history = &run.history;
    let mut pictures: Vec<ReportFigure> = history
        .links
        .iter()
        .map(|(id, samples)| {
            picture(
                index,
                &format!("link-{id}"),
                render_link(&format!("Link {id}"), samples.items()),
                "What came and left per second; what never happened is not shown.",
            )
        })
        .collect();
    if !history.clock.items().is_empty() {
        pictures.push(picture(
            index,
            "clock",
            render_clock("The brick's clock", history.clock.items()),
            "Brick time less host time, and how far it may be off.",
        ));
    }
    if pictures.is_empty() {
        return Vec::new();
    }
    vec![ReportBlock::Subheading("Links and clock".to_owned()), link_table(history), ReportBlock::FigureGrid(pictures)]
}

fn link_table(history: &SessionHistory) -> ReportBlock {
    let links = history.collector.links.iter();
    let mut header = vec!["link"];
    header.extend(LINK_COUNTERS.iter().map(|counter| counter.label));
    header.push("round trip [ms]");
    let rows = links.map(|(id, report)| {
        let round_trip = report.health.round_trip;
        let mut row = vec![id.to_string()];
        row.extend(LINK_COUNTERS.iter().map(|counter| (counter.read)(&report.health).to_string()));
        row.push(round_trip.map_or_else(|| NO_VALUE.to_owned(), |duration| format!("{:.1}", duration.as_millis_f64())));
        row
    });
    ReportBlock::table(&header, rows.collect())
}

fn timeline_blocks(history: &SessionHistory) -> Vec<ReportBlock> {
    let all = &history.timeline;
    if all.entries.is_empty() {
        return Vec::new();
    }
    let rows = all.entries.iter().map(|one| vec![format!("{:.2}", one.t_s), one.text.clone()]);
    let mut rows: Vec<Vec<String>> = rows.collect();
    if all.omitted > 0 {
        rows.push(vec![String::new(), format!("and {} more", all.omitted)]);
    }
    vec![
        ReportBlock::Subheading("What happened".to_owned()),
        ReportBlock::CodeTable { header: vec!["time [s]".to_owned(), "what".to_owned()], rows },
    ]
}

pub fn add_data(report: &mut Report, session: &SessionSummary) {
    let facts: BTreeMap<&str, &str> =
        session.facts.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
    report.data("recording", json!(session.recording));
    report.data("facts", json!(facts));
    report.data("filter", json!(session.filter));
    report.data("changed", json!(session.changed));
    report.data("notes", json!(session.notes));
    report.data("runs", session.runs.iter().map(run).collect());
}

fn run(run: &RunSummary) -> Value {
    let errors = &run.errors;
    let history = &run.history;
    let reference = match run.reference {
        ScoreReference::Truth => Some("truth"),
        ScoreReference::WithheldFixes => Some("withheld"),
        ScoreReference::None => None,
    };
    let entries = history.timeline.entries.iter();
    json!({
        "name": run.name,
        "length_s": history.length().as_secs_f64(),
        "observations": history.collector.observations,
        "consistency": run.verdict().finding.as_text(),
        "verdict": run.verdict().to_string(),
        "yardstick": reference,
        "position_rms_m": errors.position_rms_m,
        "position_max_m": errors.position_max_m,
        "position_end_m": errors.position_end_m,
        "heading_rms_rad": errors.heading_rms_rad,
        "anees": errors.anees,
        "sources": history.collector.sources.iter().map(source).collect::<Vec<_>>(),
        "calibration": run.learned.as_ref().map(calibration),
        "smooth": run.smoothed.as_ref().map(smooth),
        "links": links(run),
        "happenings": entries.map(|one| json!({ "t_s": one.t_s, "what": one.text })).collect::<Vec<_>>(),
        "further_happenings": history.timeline.omitted,
    })
}

fn source(tally: &SourceTally) -> Value {
    let verdict = tally.verdict();
    json!({
        "name": tally.sensor.name(),
        "used": tally.used + tally.reset_to,
        "gated": tally.gated,
        "too_old": tally.too_old,
        "mean_nis_per_dof": tally.mean_nis_per_dof(),
        "degrees_of_freedom": tally.degrees_of_freedom(),
        "finding": verdict.finding.as_text(),
        "due": verdict.band.map(|band| [band.low, band.high]),
        "correlation": verdict.correlation,
        "correlation_bound": verdict.correlation_bound,
        "gated_share": verdict.gated_share,
        "verdict": verdict.to_string(),
    })
}

fn smooth(smoothed: &SmoothedRun) -> Value {
    let errors = &smoothed.errors;
    json!({
        "position_rms_m": errors.position_rms_m,
        "position_max_m": errors.position_max_m,
        "heading_rms_rad": errors.heading_rms_rad,
        "anees": errors.anees,
        "reason": smoothed.reason(),
        "calibration": smoothed.learned.as_ref().map(calibration),
    })
}

fn calibration(learned: &LearnedCalibration) -> Value {
    let entries = learnable_keys().map(|entry| {
        let UncertainValue { value, sigma } = (entry.read)(&learned.calibration);
        (entry.key.to_owned(), json!({ "value": value, "sigma": sigma }))
    });
    Value::Object(entries.collect::<Map<String, Value>>())
}

fn links(run: &RunSummary) -> Value {
    let links = run.history.collector.links.iter().map(|(id, report)| {
        let health = &report.health;
        let mut fields = json!({ "link": id.0, "round_trip_s": health.round_trip.map(TimeDelta::as_secs_f64) });
        for counter in LINK_COUNTERS {
            fields[counter.key] = json!((counter.read)(health));
        }
        fields
    });
    Value::Array(links.collect())
}

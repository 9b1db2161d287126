//! `posebridge report`: a recording as a self-contained page, with every figure also as a file.
//! All results come from replaying the recorded inputs through the engine, by the code of `replay`; no output of the live run is used,
//! except the ground truth of a simulated one. Docs: docs/reports.md.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use clap::Args;
use posebridge_report::PoseTrack;
use posebridge_station::Robot;
use posebridge_telemetry::Timestamp;

use super::dataset::report_bad_rows;
use super::experiment_output::OutputArgs;
use super::own_recording::is_own;
use super::replay::SmoothingSpan;
use super::replay::foreign::{self, ForeignRecording, check_filter, replay_run, truth_of};
use super::replay::own::{self, OwnRecording, WHOLE_RUN, changed_settings};
use super::replay::watch::{ReplayLane, Window};
use super::session_history::SessionHistory;
use super::session_report::{self, RunSummary, ScoreReference, SessionSummary};
use crate::config::{RobotFile, utc_date};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::SessionFlags;
use crate::station::event_collector::EventCollector;
use crate::station::learned_calibration::LearnedCalibration;
use crate::station::per_robot::{PerRobot, RobotEntry};

const DEFAULT_FILTER: &str = "pose";
/// Filter for the odometry if the brick sent none.
const DEAD_RECKONING: &str = "odometry";
/// A page of more runs would be too long to read.
const MOST_RUNS: usize = 12;

/// Flags of `report`.
#[derive(Args, Clone, Debug)]
pub struct ReportArgs {
    /// What to report on.
    #[command(flatten)]
    pub session: SessionFlags,
    /// Filter. Default: the filter of the recording.
    #[arg(long, visible_alias = "estimator", value_name = "NAME")]
    pub filter: Option<String>,
    /// Show only this robot of a recording with several, by name or as link/system/component. Can be repeated.
    #[arg(long, value_name = "ROBOT")]
    pub only: Vec<String>,
    /// Also show the path given the whole run, and what it has taught.
    #[arg(long, conflicts_with_all = ["from", "to"])]
    pub smooth: bool,
    /// Where the page goes, and what is printed.
    #[command(flatten)]
    pub output: OutputArgs,
}

pub fn execute(args: &ReportArgs) -> Result<(), Failure> {
    let window = Window::from_flags(&args.session).before_start()?;
    let session = if is_own(&args.session.recording) {
        summarize_recording(args, window)?
    } else {
        summarize_foreign(args, window)?
    };
    for note in &session.notes {
        print_line(&format!("{}: {note}", session.recording));
    }
    let folder: PathBuf = args.output.folder()?;
    let mut report = session_report::report(&session);
    session_report::add_data(&mut report, &session);
    args.output.write_outcome(&folder, &report)
}

fn summarize_recording(args: &ReportArgs, window: Window) -> Result<SessionSummary, Failure> {
    let flags = &args.session;
    let recording = OwnRecording::open(flags).before_start()?;
    let config = recording.config(flags, args.filter.as_deref()).before_start()?;
    let filters: Vec<String> = args.filter.iter().cloned().collect();
    let changed = recording.changes(flags, &filters).before_start()?;
    let stations = OwnRecording::stations(flags, &config).before_start()?;
    let alone = recording.config(flags, Some(DEAD_RECKONING)).before_start()?;
    let alone = OwnRecording::stations(flags, &alone).before_start()?;
    let origin = recording.origin();
    let retains_observations = args.smooth;
    let mut histories = PerRobot::new(move || {
        let mut history = SessionHistory::new(origin);
        if retains_observations {
            history.collector = EventCollector::with_observations();
        }
        history
    });
    let mut dead_reckoning = PerRobot::new(EventCollector::default);
    let mut lanes = [
        ReplayLane { stations, watcher: &mut histories },
        ReplayLane { stations: alone, watcher: &mut dead_reckoning },
    ];
    let summary = recording.run(&mut lanes, window, None).while_running()?;
    let [ReplayLane { stations, .. }, _] = lanes;
    let mut notes = summary.notes;
    let robots = chosen_robots(args, histories.into_entries(), &mut notes).before_start()?;
    let described = if robots.are_several { &config.robot } else { config.robot_file(stations.robots().next()) };
    let mut facts = own_facts(&recording, described);
    let mut runs = Vec::new();
    for robot in robots.chosen {
        let known = recording.ground_truth(flags.truth.as_deref(), robot.robot).before_start()?;
        let reference = known.truth.as_ref().map_or(ScoreReference::None, |_| ScoreReference::Truth);
        let engine = stations.robots().find(|engine| Some(engine.id()) == robot.robot);
        let file = config.robot_file(engine);
        let mut filter_config = config.filter_config_of(file).before_start()?;
        let prior = filter_config.calibration;
        filter_config.geometry = engine.map_or(filter_config.geometry, Robot::geometry);
        let collector = &robot.value.collector;
        let smoothed = args.smooth.then(|| {
            let truth = known.truth.as_ref();
            own::smoothed((WHOLE_RUN, file), &filter_config, collector, truth, SmoothingSpan::WholeRun)
        });
        let of_wheels = dead_reckoning.entries().iter().find(|wheels| wheels.robot == robot.robot);
        runs.push(RunSummary {
            name: if robots.are_several { robot.label } else { title_of(file) },
            errors: own::errors_of(robot.value.collector.estimates.items(), known.truth.as_ref()),
            reference,
            truth: known.truth,
            odometry: known.odometry.or_else(|| track_of(&of_wheels?.value)),
            learned: engine.and_then(|engine| LearnedCalibration::of_robot(engine, WHOLE_RUN, file, &prior)),
            smoothed,
            history: robot.value,
        });
    }
    if let Some(run) = runs.first() {
        let length = format!("{:.1} s", run.history.length().as_secs_f64());
        facts.insert(facts.len() - 1, ("length".to_owned(), length));
    }
    Ok(SessionSummary { facts, recording: recording.name, filter: config.filter.name, changed, notes, runs })
}

struct ChosenRobots {
    chosen: Vec<RobotEntry<SessionHistory>>,
    are_several: bool,
}

/// The robots named by the flags, else the first; adds a note about omitted ones.
fn chosen_robots(
    args: &ReportArgs,
    robots: Vec<RobotEntry<SessionHistory>>,
    notes: &mut Vec<String>,
) -> Result<ChosenRobots> {
    let labels: Vec<String> = robots.iter().map(|robot| robot.label.clone()).collect();
    let unknown = args.only.iter().find(|requested| !labels.contains(requested));
    if let Some(unknown) = unknown {
        bail!("--only {unknown}: the session has no such robot; it has {}", labels.join(", "));
    }
    ensure!(
        args.only.len() <= MOST_RUNS,
        "--only names {} robots, and a page holds up to {MOST_RUNS}",
        args.only.len()
    );
    let are_several = robots.len() > 1;
    let mut chosen: Vec<_> =
        robots.into_iter().filter(|robot| args.only.is_empty() || args.only.contains(&robot.label)).collect();
    if chosen.len() > MOST_RUNS {
        notes.push(format!("{} of {} robots are shown: choose others with --only", MOST_RUNS, chosen.len()));
        chosen.truncate(MOST_RUNS);
    }
    Ok(ChosenRobots { chosen, are_several })
}

/// A filter's estimates of the robot; `None` without any.
fn track_of(collector: &EventCollector) -> Option<PoseTrack> {
    let track = collector.track();
    (!track.samples().is_empty()).then_some(track)
}

fn title_of(robot: &RobotFile) -> String {
    if robot.name.is_empty() { "Path".to_owned() } else { robot.name.clone() }
}

fn own_facts(recording: &OwnRecording, robot: &RobotFile) -> Vec<(String, String)> {
    let header = recording.header();
    let fact = |name: &str, value: String| (name.to_owned(), value);
    let mut facts = vec![fact("robot", robot.name.clone())];
    if header.utc_start_micros > 0 {
        facts.push(fact("recorded", utc_date(header.utc_start_micros)));
    }
    for (index, url) in header.links.iter().enumerate() {
        facts.push(fact(&format!("link {index}"), url.clone()));
    }
    facts.push(fact("recorded by", format!("posebridge {}", header.program_version)));
    facts
}

fn summarize_foreign(args: &ReportArgs, window: Window) -> Result<SessionSummary, Failure> {
    let flags = &args.session;
    let foreign = ForeignRecording::open(flags).before_start()?;
    check_runs(&foreign).before_start()?;
    let filter = args.filter.as_deref().unwrap_or(DEFAULT_FILTER);
    check_filter(filter).before_start()?;
    let mut session = SessionSummary {
        recording: foreign.data.descriptor.name.clone(),
        facts: foreign_facts(&foreign),
        filter: filter.to_owned(),
        changed: changed_settings(flags),
        notes: Vec::new(),
        runs: Vec::new(),
    };
    for name in &foreign.data.runs {
        let robot_run = foreign.load(name).before_start()?;
        let bad_rows = report_bad_rows(&robot_run);
        if bad_rows > 0 {
            let note = format!("run {name}: {bad_rows} rows could not be used");
            session.notes.push(note);
        }
        let first = robot_run.run.observations.first();
        let origin = first.map_or(Timestamp::ZERO, |first| first.arrival);
        let mut history = SessionHistory::new(origin);
        let scored = replay_run(&robot_run, filter, &mut history, window, None).while_running()?;
        let mut dead_reckoning = EventCollector::default();
        replay_run(&robot_run, DEAD_RECKONING, &mut dead_reckoning, window, None).while_running()?;
        let truth = truth_of(&robot_run);
        let reference = match (&truth, robot_run.run.withheld.is_empty()) {
            (Some(_), _) => ScoreReference::Truth,
            (None, false) => ScoreReference::WithheldFixes,
            (None, true) => ScoreReference::None,
        };
        session.runs.push(RunSummary {
            name: name.clone(),
            errors: scored.errors,
            reference,
            truth,
            odometry: track_of(&dead_reckoning),
            learned: scored.learned,
            smoothed: args.smooth.then(|| foreign::smoothed(&robot_run, SmoothingSpan::WholeRun)),
            history,
        });
    }
    Ok(session)
}

fn check_runs(foreign: &ForeignRecording) -> Result<()> {
    let runs = &foreign.data.runs;
    ensure!(
        runs.len() <= MOST_RUNS,
        "{} runs are selected, and a page holds up to {MOST_RUNS}: choose with --run, for example --run {}",
        runs.len(),
        runs.first().map_or("", String::as_str)
    );
    if runs.is_empty() {
        bail!("no run is selected");
    }
    Ok(())
}

fn foreign_facts(foreign: &ForeignRecording) -> Vec<(String, String)> {
    let descriptor = &foreign.data.descriptor;
    [
        ("source", descriptor.source.clone()),
        ("licence", descriptor.licence.clone()),
        ("runs", foreign.data.runs.join(", ")),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

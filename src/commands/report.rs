//! `posebridge report`: a recording as a page that needs nothing else, with every picture as a file of its own.
//!
//! All that it says comes from the recorded inputs, given to the engine that runs live, by the code of `replay`; nothing is read that
//! the live run has computed but the truth of a simulated one. Docs: docs/report.md.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use clap::Args;
use posebridge_analysis::Track;
use posebridge_analysis::report::{EstimatorRow, runs_table};
use posebridge_telemetry::Stamp;

use super::lab::outcome::{Outcome, OutputArgs};
use super::replay::foreign::{Foreign, check_filter, replay_run, truth_of};
use super::replay::own::{self, WHOLE};
use super::replay::recording::{OwnRecording, changed_settings};
use super::replay::watch::{Lane, Window};
use super::{Failure, Stage};
use crate::cli::SessionFlags;
use crate::collect::Collector;
use crate::config::{Config, utc_date};
use crate::data::tell_bad_rows;
use crate::learned::Learned;
use crate::own_recording::is_own;
use crate::report::chronicle::Chronicle;
use crate::report::story::{RunStory, Story, Yardstick};
use crate::report::{session_json, session_page};
use crate::stderr::say;

/// The filter of a foreign recording unless another is asked for.
const USUAL_FILTER: &str = "pose";
/// The filter that shows what the wheels alone say, where the brick has told no belief of its own.
const DEAD_RECKONING: &str = "odometry";
/// A page of more runs would be too long to read.
const MOST_RUNS: usize = 12;

/// Flags of `report`.
#[derive(Args, Clone, Debug)]
pub struct ReportArgs {
    /// What to report on.
    #[command(flatten)]
    pub session: SessionFlags,
    /// Estimator, instead of the recording's.
    #[arg(long, visible_alias = "estimator", value_name = "NAME")]
    pub filter: Option<String>,
    /// Where the page goes, and what is printed.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Makes the page.
///
/// # Errors
/// The recording cannot be read or makes no sense, or a file cannot be written.
pub fn execute(args: &ReportArgs) -> Result<(), Failure> {
    let window = Window::of(&args.session).at_start()?;
    let story = if is_own(&args.session.recording) { of_own(args, window)? } else { of_foreign(args, window)? };
    for note in &story.notes {
        say(&format!("{}: {note}", story.recording));
    }
    let folder: PathBuf = args.output.folder()?;
    let outcome = Outcome {
        name: "report",
        page: session_page::page(&story),
        text: text(&story),
        json: session_json::object(&story),
    };
    args.output.deliver(&folder, &outcome)
}

fn of_own(args: &ReportArgs, window: Window) -> Result<Story, Failure> {
    let flags = &args.session;
    let recording = OwnRecording::open(flags).at_start()?;
    let config = recording.config(flags, args.filter.as_deref()).at_start()?;
    let filters: Vec<String> = args.filter.iter().cloned().collect();
    let changed = recording.changes(flags, &filters).at_start()?;
    let known = recording.known(flags.truth.as_deref()).at_start()?;
    let pipeline = OwnRecording::pipeline(flags, &config).at_start()?;
    let alone = recording.config(flags, Some(DEAD_RECKONING)).at_start()?;
    let alone = OwnRecording::pipeline(flags, &alone).at_start()?;
    let mut chronicle = Chronicle::new(recording.origin());
    let mut dead_reckoning = Collector::default();
    let mut lanes = [Lane { pipeline, watch: &mut chronicle }, Lane { pipeline: alone, watch: &mut dead_reckoning }];
    let passage = recording.run(&mut lanes, window, None).while_running()?;
    let [Lane { pipeline, .. }, _] = lanes;
    let prior = config.filter_config().at_start()?.calibration;
    let learned = Learned::of(&pipeline, WHOLE, &config.robot, &prior);
    let yardstick = match known.truth {
        Some(_) => Yardstick::Truth,
        None => Yardstick::None,
    };
    let run = RunStory {
        name: title_of(&config),
        errors: own::errors(&chronicle.collector, known.truth.as_ref()),
        yardstick,
        truth: known.truth,
        odometry: known.odometry.or_else(|| track_of(&dead_reckoning)),
        learned,
        chronicle,
    };
    Ok(Story {
        facts: own_facts(&recording, &config, &run),
        recording: recording.name,
        filter: config.filter.name,
        changed,
        notes: passage.notes,
        runs: vec![run],
    })
}

/// Where a filter believed the robot; `None` if it never knew.
fn track_of(collector: &Collector) -> Option<Track> {
    let track = collector.track();
    (!track.samples().is_empty()).then_some(track)
}

/// A robot without a name has a path all the same.
fn title_of(config: &Config) -> String {
    if config.robot.name.is_empty() { "Path".to_owned() } else { config.robot.name.clone() }
}

fn own_facts(recording: &OwnRecording, config: &Config, run: &RunStory) -> Vec<(String, String)> {
    let header = &recording.header;
    let chronicle = &run.chronicle;
    let fact = |name: &str, value: String| (name.to_owned(), value);
    let mut facts = vec![fact("robot", config.robot.name.clone())];
    if header.utc_start_micros > 0 {
        facts.push(fact("recorded", utc_date(header.utc_start_micros)));
    }
    for (index, url) in header.links.iter().enumerate() {
        facts.push(fact(&format!("link {index}"), url.clone()));
    }
    let length = format!("{:.1} s", chronicle.length().as_secs_f64());
    facts.push(fact("length", length));
    facts.push(fact("recorded by", format!("posebridge {}", header.program_version)));
    facts
}

fn of_foreign(args: &ReportArgs, window: Window) -> Result<Story, Failure> {
    let flags = &args.session;
    let foreign = Foreign::open(flags).at_start()?;
    check_runs(&foreign).at_start()?;
    let filter = args.filter.as_deref().unwrap_or(USUAL_FILTER);
    check_filter(filter).at_start()?;
    let mut story = Story {
        recording: foreign.data.descriptor.name.clone(),
        facts: foreign_facts(&foreign),
        filter: filter.to_owned(),
        changed: changed_settings(flags),
        notes: Vec::new(),
        runs: Vec::new(),
    };
    for name in &foreign.data.runs {
        let robot_run = foreign.load(name).at_start()?;
        let bad_rows = tell_bad_rows(&robot_run);
        if bad_rows > 0 {
            let note = format!("run {name}: {bad_rows} rows could not be used");
            story.notes.push(note);
        }
        let first = robot_run.run.observations.first();
        let origin = first.map_or(Stamp::ZERO, |first| first.arrival);
        let mut chronicle = Chronicle::new(origin);
        let scored = replay_run(&robot_run, filter, &mut chronicle, (window, None)).while_running()?;
        let mut dead_reckoning = Collector::default();
        let alone = (window, None);
        replay_run(&robot_run, DEAD_RECKONING, &mut dead_reckoning, alone).while_running()?;
        let truth = truth_of(&robot_run);
        let yardstick = match (&truth, robot_run.run.withheld.is_empty()) {
            (Some(_), _) => Yardstick::Truth,
            (None, false) => Yardstick::WithheldFixes,
            (None, true) => Yardstick::None,
        };
        story.runs.push(RunStory {
            name: name.clone(),
            errors: scored.errors,
            yardstick,
            truth,
            odometry: track_of(&dead_reckoning),
            learned: scored.learned,
            chronicle,
        });
    }
    Ok(story)
}

fn check_runs(foreign: &Foreign) -> Result<()> {
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

fn foreign_facts(foreign: &Foreign) -> Vec<(String, String)> {
    let descriptor = &foreign.data.descriptor;
    [
        ("source", descriptor.source.clone()),
        ("licence", descriptor.licence.clone()),
        ("runs", foreign.data.runs.join(", ")),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

/// What a terminal shows: errors, and a verdict for each sensor.
fn text(story: &Story) -> String {
    let rows: Vec<EstimatorRow<'_>> =
        story.runs.iter().map(|run| EstimatorRow { name: &run.name, errors: &run.errors, runs: 1 }).collect();
    let mut text = format!("{}, filter {}\n\n", story.recording, story.filter);
    text += &runs_table(&rows);
    for run in &story.runs {
        let _ = writeln!(text, "\n{}", run.name);
        for verdict in run.verdicts() {
            let _ = writeln!(text, "  {}: {}", verdict.sensor.name(), verdict.judgement);
        }
    }
    text
}

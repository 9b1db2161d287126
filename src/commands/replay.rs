//! `posebridge replay`: the estimators over a recording, offline, with the same engine as live.
//!
//! A recording of ours (`*.mcap`) is given to the pipeline exactly as it was given live, so its events are those of the live run,
//! bit for bit. A descriptor of a foreign recording (`*.toml`) is read into observations; each estimator is then scored against the
//! truth or against the fixes that were withheld.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use posebridge_analysis::metrics::{errors_of_estimates, summarise};
use posebridge_analysis::report::{estimator_table, source_table};
use posebridge_analysis::{
    ErrorSummary, EstimatorRow, FIGURES, RunLayers, SourceTally, TimedPose, Track, mean_over_runs,
};
use posebridge_link::HostTimer;
use posebridge_pipeline::{DescriptionPolicy, Pipeline, PipelineConfig};
use posebridge_recording::container::{Ending, Reader};
use posebridge_telemetry::{Address, Input, Output, Point2, Span, Stamp};

use super::{Failure, Stage};
use crate::cli::ReplayArgs;
use crate::collect::{Collector, LONGEST_GAP};
use crate::config;
use crate::data::{DataSet, RobotRun, tell_bad_rows};
use crate::report::json;
use crate::score::{Scorer, pose_at};
use crate::stderr::say;
use crate::stdout;
use crate::tasks::observer::{create, write_event};
use crate::truth_file;

/// The estimators of a foreign recording unless others are asked for.
const USUAL_FILTERS: [&str; 2] = ["odometry", "pose"];

/// What one estimator did over everything that was replayed.
pub struct Outcome {
    /// Its name.
    pub name: String,
    /// Its errors, the mean over the runs.
    pub errors: ErrorSummary,
    /// How each sensor's observations fared, over all runs.
    pub sources: Vec<SourceTally>,
}

/// Everything that was replayed.
pub struct Replayed {
    /// The recording's name.
    pub recording: String,
    /// Names of the runs.
    pub runs: Vec<String>,
    /// How many observations one estimator was given.
    pub observations: u64,
    /// Rows that could not be used.
    pub bad_rows: u64,
    /// One per estimator.
    pub outcomes: Vec<Outcome>,
}

/// Replays.
///
/// # Errors
/// The recording cannot be read or makes no sense, or an output cannot be written.
pub fn execute(args: &ReplayArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let is_descriptor = args
        .recording
        .extension()
        .is_some_and(|extension| extension == "toml");
    let replayed = if is_descriptor {
        descriptor(args)?
    } else {
        recording(args)?
    };
    print(args, &replayed, timer.now() - Stamp::ZERO).while_running()
}

fn print(args: &ReplayArgs, replayed: &Replayed, wall: Span) -> Result<()> {
    if args.json {
        stdout::print(&(json::text(replayed, wall, cpu_time()?)? + "\n"))?;
        return Ok(());
    }
    let runs = replayed.runs.len();
    let mut rows = Vec::new();
    for Outcome { name, errors, .. } in &replayed.outcomes {
        rows.push(EstimatorRow {
            name,
            errors,
            runs: runs as u64,
        });
    }
    let mut text = format!(
        "{}: {} observations, {runs} run(s)\n\n",
        replayed.recording, replayed.observations
    );
    text += &estimator_table(&rows);
    for outcome in &replayed.outcomes {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\n{}\n{}",
            outcome.name,
            source_table(&outcome.sources)
        );
    }
    if replayed.bad_rows > 0 {
        say(&format!("{} rows could not be used", replayed.bad_rows));
    }
    stdout::print(&text)?;
    Ok(())
}

/// User and system time of this process.
fn cpu_time() -> Result<Span> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_SELF)?;
    let micros = |time: nix::sys::time::TimeVal| {
        Span::from_micros(time.tv_sec() * 1_000_000 + time.tv_usec())
    };
    Ok(micros(usage.user_time()) + micros(usage.system_time()))
}

/// A recording of ours.
fn recording(args: &ReplayArgs) -> Result<Replayed, Failure> {
    if args.data.run.is_some() || args.data.use_every.is_some() {
        return Err(anyhow!(
            "--run and --use-every choose from a descriptor's data, not from a recording of ours"
        ))
        .at_start();
    }
    let name = args.recording.display().to_string();
    let bytes = std::fs::read(&args.recording)
        .with_context(|| format!("reading the recording `{name}`"))
        .at_start()?;
    let mut reader = Reader::open(&bytes)
        .with_context(|| format!("recording `{name}`"))
        .at_start()?;
    let config = recorded_config(args, &reader.header().config_toml).at_start()?;
    let truth = args
        .truth
        .as_deref()
        .map(read_truth)
        .transpose()
        .at_start()?;
    let mut events = args.events.as_deref().map(create).transpose().at_start()?;
    let mut pipeline = Pipeline::new(config.pipeline().at_start()?, Stamp::ZERO).at_start()?;
    let mut collector = Collector::default();
    for item in &mut reader {
        match item {
            Ok((now, input)) => pipeline.handle(now, &input),
            // What is whole behind the damage is still worth replaying.
            Err(error) => say(&format!(
                "{name}: {error}; the replay is not that of the live run any more"
            )),
        }
        take_outputs(&mut pipeline, &mut collector, events.as_mut()).while_running()?;
    }
    if let Some(mut events) = events {
        events.flush().while_running()?;
    }
    if let Ending::Torn { offset, what } = reader.ending() {
        say(&format!(
            "{name}: cut off at byte {offset} ({what}); everything before was replayed"
        ));
    }
    let errors = truth.as_ref().map_or_else(ErrorSummary::default, |truth| {
        summarise(&errors_of_estimates(collector.estimates.items(), truth))
    });
    draw(args, &name, &collector, truth.as_ref()).while_running()?;
    Ok(Replayed {
        recording: name,
        runs: vec!["recording".to_owned()],
        observations: collector.observations,
        bad_rows: 0,
        outcomes: vec![Outcome {
            name: config.filter.name,
            errors,
            sources: collector.sources,
        }],
    })
}

/// The configuration that a recording was made with, and what the flags change of it.
fn recorded_config(args: &ReplayArgs, header: &str) -> Result<config::Config> {
    let origin = "the recording's own configuration";
    let mut config = config::load_text(origin, header, &args.data.settings)?.config;
    match args.filters.as_slice() {
        [] => {}
        [filter] => config.filter.name.clone_from(filter),
        _ => bail!("a recording of ours is replayed with one filter: give --filter once"),
    }
    Ok(config)
}

fn read_truth(path: &Path) -> Result<Track> {
    let name = path.display();
    let text =
        std::fs::read_to_string(path).with_context(|| format!("reading the truth `{name}`"))?;
    truth_file::read(&text).with_context(|| format!("truth `{name}`"))
}

fn take_outputs(
    pipeline: &mut Pipeline,
    collector: &mut Collector,
    mut events: Option<&mut std::io::BufWriter<std::fs::File>>,
) -> Result<()> {
    while let Some(output) = pipeline.poll() {
        if let Output::Event(event) = output {
            collector.take(&event);
            if let Some(file) = events.as_deref_mut() {
                write_event(file, &event).context("writing the events")?;
            }
        }
    }
    Ok(())
}

/// A foreign recording.
fn descriptor(args: &ReplayArgs) -> Result<Replayed, Failure> {
    if args.truth.is_some() {
        return Err(anyhow!(
            "--truth is for recordings of ours: a descriptor names its own truth"
        ))
        .at_start();
    }
    let data = DataSet::open(&args.recording, &args.data).at_start()?;
    let filters: Vec<String> = if args.filters.is_empty() {
        USUAL_FILTERS
            .iter()
            .map(|name| (*name).to_owned())
            .collect()
    } else {
        args.filters.clone()
    };
    for filter in &filters {
        let known = posebridge_estimator::filter_named(filter).is_some();
        if !known {
            return Err(anyhow!(
                "unknown filter `{filter}`; `posebridge config schema` lists them"
            ))
            .at_start();
        }
    }
    let mut events = args.events.as_deref().map(create).transpose().at_start()?;
    let mut observations = 0;
    let mut bad_rows = 0;
    let mut per_filter: Vec<(Vec<ErrorSummary>, Collector)> =
        filters.iter().map(|_| Default::default()).collect();
    for name in &data.runs {
        let robot_run = data.load(name, &args.data).at_start()?;
        observations += robot_run.run.observations.len() as u64;
        bad_rows += tell_bad_rows(&robot_run);
        for (filter, (summaries, collector)) in filters.iter().zip(&mut per_filter) {
            let mut one = Collector::default();
            let errors =
                replay_run(&robot_run, filter, &mut one, events.as_mut()).while_running()?;
            summaries.push(errors);
            if Some(filter) == filters.last() {
                draw_run(args, &robot_run, &one).while_running()?;
            }
            merge(collector, one);
        }
    }
    let outcomes = filters
        .into_iter()
        .zip(per_filter)
        .map(|(name, (summaries, collector))| Outcome {
            name,
            errors: mean_over_runs(&summaries),
            sources: collector.sources,
        });
    Ok(Replayed {
        recording: data.descriptor.name.clone(),
        outcomes: outcomes.collect(),
        runs: data.runs,
        observations,
        bad_rows,
    })
}

fn replay_run(
    robot_run: &RobotRun,
    filter: &str,
    collector: &mut Collector,
    mut events: Option<&mut std::io::BufWriter<std::fs::File>>,
) -> Result<ErrorSummary> {
    let config = PipelineConfig {
        own: Address::default(),
        filter: filter.to_owned(),
        filter_config: robot_run.filter_config.clone(),
        description: DescriptionPolicy::Ignore,
        robot_system: None,
        tag_in_body: Point2::ORIGIN,
        timesync_period: Span::from_millis(1_000),
        wanted: vec![],
        links: vec![],
    };
    let Some(first) = robot_run.run.observations.first() else {
        bail!("the run is empty")
    };
    let mut pipeline = Pipeline::new(config, first.arrival)?;
    let mut scorer = Scorer::new(&robot_run.run);
    for timed in &robot_run.run.observations {
        pipeline.handle(timed.arrival, &Input::Observation(timed.observation));
        take_outputs(&mut pipeline, collector, events.as_deref_mut())?;
        scorer.observed(
            &timed.observation.observed,
            timed.observation.stamp,
            &pipeline,
        );
    }
    scorer.finish(&pipeline);
    Ok(summarise(&scorer.errors))
}

/// Adds one run's tallies to those of all runs.
fn merge(all: &mut Collector, one: Collector) {
    for tally in one.sources {
        match all
            .sources
            .iter_mut()
            .find(|known| known.sensor == tally.sensor)
        {
            Some(known) => known.absorb(&tally),
            None => all.sources.push(tally),
        }
    }
}

fn draw_run(args: &ReplayArgs, robot_run: &RobotRun, collector: &Collector) -> Result<()> {
    let run = &robot_run.run;
    let truth = run.truth.iter().map(|truth| TimedPose {
        stamp: truth.stamp,
        pose: pose_at(truth.position, truth.heading),
    });
    let truth = Track::new(truth, LONGEST_GAP);
    let truth = (!run.truth.is_empty()).then_some(&truth);
    draw(args, &run.name, collector, truth)
}

fn draw(
    args: &ReplayArgs,
    title: &str,
    collector: &Collector,
    truth: Option<&Track>,
) -> Result<()> {
    let (Some(path), Some(figure)) = (&args.figure, FIGURES.first()) else {
        return Ok(());
    };
    let layers = RunLayers {
        title,
        truth,
        estimates: collector.estimates.items(),
        fixes: collector.fixes.items(),
        ..RunLayers::default()
    };
    std::fs::write(path, (figure.render)(&layers))
        .with_context(|| format!("writing `{}`", path.display()))
}

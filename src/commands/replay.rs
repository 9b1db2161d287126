//! `posebridge replay`: the estimators over a recording, offline, with the same engine as live.
//!
//! A recording of ours (`*.mcap`) is given to the pipeline exactly as it was given live, so its events are those of the live run,
//! bit for bit. A descriptor of a foreign recording (`*.toml`) is read into observations; each estimator is then scored against the
//! truth or against the fixes that were withheld.

mod foreign;

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use posebridge_analysis::metrics::{errors_of_estimates, summarise};
use posebridge_analysis::report::{estimator_table, source_table};
use posebridge_analysis::{ErrorSummary, EstimatorRow, FIGURES, RunLayers, SourceTally, Track};
use posebridge_link::HostTimer;
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{Ending, Reader};
use posebridge_telemetry::{Output, Span, Stamp};

use super::{Failure, Stage};
use crate::cli::ReplayArgs;
use crate::collect::Collector;
use crate::config::{self, Provenance};
use crate::learned::{Learned, learned_table, save};
use crate::report::json;
use crate::stderr::say;
use crate::stdout;
use crate::tasks::observer::{create, write_event};
use crate::truth_file;

/// What one estimator did over everything that was replayed.
pub struct Outcome {
    /// Its name.
    pub name: String,
    /// Its errors, the mean over the runs.
    pub errors: ErrorSummary,
    /// Its root mean square position error at the withheld fixes' own stamps, where `errors` is corrected for a delay that it
    /// has learned; the mean over the runs.
    pub position_rms_uncorrected_m: Option<f64>,
    /// What it has learned about the robot, one per run; empty for a filter that learns nothing.
    pub learned: Vec<Learned>,
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
        foreign::replay(args)?
    } else {
        recording(args)?
    };
    print(args, &replayed, timer.now() - Stamp::ZERO).while_running()?;
    save_calibration(args, &replayed, timer.utc_start()).while_running()
}

/// Writes the robot that the last estimator which learns at all has learned.
fn save_calibration(args: &ReplayArgs, replayed: &Replayed, utc_micros: u64) -> Result<()> {
    let Some(path) = &args.save_calibration else {
        return Ok(());
    };
    let mut learners = replayed.outcomes.iter().rev();
    let Some((filter, learned)) =
        learners.find_map(|outcome| Some((&outcome.name, outcome.learned.last()?)))
    else {
        let names: Vec<_> = replayed.outcomes.iter().map(|o| o.name.as_str()).collect();
        bail!(
            "there is no calibration to save: of {} none learns one",
            names.join(", ")
        )
    };
    let provenance = Provenance {
        utc_micros,
        source: format!("{}, {}", replayed.recording, learned.run),
        filter: filter.clone(),
    };
    save(path, learned, &provenance)
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
        if let Some(rms_m) = outcome.position_rms_uncorrected_m {
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{}: judged at the fixes' stamps less the delay that it has learned; at the stamps themselves {:.1} mm rms",
                outcome.name,
                rms_m * 1e3
            );
        }
    }
    for outcome in &replayed.outcomes {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\n{}\n{}{}",
            outcome.name,
            source_table(&outcome.sources),
            learned_table(&outcome.learned),
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
    let prior = config.filter_config().at_start()?.calibration;
    let learned = Learned::of(&pipeline, "recording", &config.robot, &prior);
    Ok(Replayed {
        recording: name,
        runs: vec!["recording".to_owned()],
        observations: collector.observations,
        bad_rows: 0,
        outcomes: vec![Outcome {
            name: config.filter.name,
            errors,
            position_rms_uncorrected_m: None,
            learned: learned.into_iter().collect(),
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

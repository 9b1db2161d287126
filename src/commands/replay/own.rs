//! A recording of ours: the pipeline is given what it was given live, so its events are those of the live run, bit for bit.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use posebridge_analysis::metrics::{errors_of_estimates, summarise};
use posebridge_analysis::{ErrorSummary, Track};
use posebridge_estimator::FilterConfig;
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{Ending, Reader};
use posebridge_telemetry::Stamp;

use super::{NoPath, Outcome, Replayed, SmoothedRun, draw, finish_events, robot, take_outputs};
use crate::cli::ReplayArgs;
use crate::collect::Collector;
use crate::commands::{Failure, Stage};
use crate::config;
use crate::learned::Learned;
use crate::signing;
use crate::stderr::say;
use crate::tasks::observer::create;
use crate::truth_file;

/// What a recording of ours is called among runs.
const WHOLE: &str = "recording";

/// Replays it with the filter of its configuration, or another one.
///
/// # Errors
/// The recording, its configuration or a flag makes no sense, or an output cannot be written.
pub(super) fn replay(args: &ReplayArgs) -> Result<Replayed, Failure> {
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
    let events = args.events.as_deref().map(create).transpose().at_start()?;
    let mut pipeline_config = config.pipeline().at_start()?;
    signing::recall(&config, &args.keys, &mut pipeline_config).at_start()?;
    let mut pipeline = Pipeline::new(pipeline_config, Stamp::ZERO).at_start()?;
    let mut collector = if args.smooth {
        Collector::keeping_observations()
    } else {
        Collector::default()
    };
    run_through(&name, &mut reader, &mut pipeline, &mut collector, events).while_running()?;
    let errors = truth.as_ref().map_or_else(ErrorSummary::default, |truth| {
        summarise(&errors_of_estimates(collector.estimates.items(), truth))
    });
    let mut filter_config = config.filter_config().at_start()?;
    let learned = Learned::of(&pipeline, WHOLE, &config.robot, &filter_config.calibration);
    // The robot may have described another geometry than the configuration.
    filter_config.geometry = pipeline.geometry();
    let smoothed = args
        .smooth
        .then(|| smoothed(&filter_config, &collector, truth.as_ref()));
    let path = smoothed.as_ref().and_then(SmoothedRun::track);
    draw(args, &name, &collector, (truth.as_ref(), path.as_ref())).while_running()?;
    Ok(Replayed {
        recording: name,
        runs: vec![WHOLE.to_owned()],
        observations: collector.observations,
        bad_rows: 0,
        outcomes: vec![Outcome {
            name: config.filter.name,
            errors,
            position_rms_uncorrected_m: None,
            learned: learned.into_iter().collect(),
            sources: collector.sources,
        }],
        smoothed: smoothed.into_iter().collect(),
    })
}

/// Gives the pipeline what it was given live, at the same instants.
fn run_through(
    name: &str,
    reader: &mut Reader<'_>,
    pipeline: &mut Pipeline,
    collector: &mut Collector,
    mut events: Option<BufWriter<File>>,
) -> Result<()> {
    for item in &mut *reader {
        match item {
            Ok((now, input)) => pipeline.handle(now, &input),
            // What is whole behind the damage is still worth replaying.
            Err(error) => say(&format!(
                "{name}: {error}; the replay is not that of the live run any more"
            )),
        }
        take_outputs(pipeline, collector, events.as_mut())?;
    }
    if let Some(events) = events {
        finish_events(events)?;
    }
    if let Ending::Torn { offset, what } = reader.ending() {
        say(&format!(
            "{name}: cut off at byte {offset} ({what}); everything before was replayed"
        ));
    }
    Ok(())
}

/// The whole recording in hindsight, held against the truth at its own stamps as the filter's estimates are at theirs.
fn smoothed(config: &FilterConfig, collector: &Collector, truth: Option<&Track>) -> SmoothedRun {
    if collector.restarts > 0 {
        return SmoothedRun::without_path(WHOLE, NoPath::Restarted(collector.restarts));
    }
    let mut smoothed = SmoothedRun::new(WHOLE, config, &collector.kept);
    if let Some(truth) = truth {
        smoothed.errors = summarise(&errors_of_estimates(&smoothed.estimates(), truth));
    }
    smoothed
}

/// The configuration that a recording was made with, and what the flags change of it.
fn recorded_config(args: &ReplayArgs, header: &str) -> Result<config::Config> {
    let origin = "the recording's own configuration";
    let settings = robot::settings(args, &["robot"])?;
    let mut config = config::load_text(origin, header, &settings)?.config;
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

//! A session: the station from its start until something ends it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use posebridge_link::{HostTimer, PortSet};
use posebridge_pipeline::Pipeline;
use posebridge_telemetry::{Span, Stamp};
use tokio_util::sync::CancellationToken;

use super::links::{Driven, Embedded, Laps, SimulatedSession, open_links, stop_brick};
use super::onlookers::Onlookers;
use super::records::{Recorded, output_folder, start_recorder, start_tlog};
use super::signals::Signals;
use crate::cli::RunArgs;
use crate::collect::Collector;
use crate::commands::{Failure, Stage};
use crate::config::Config;
use crate::failures::Failures;
use crate::learned::Learned;
use crate::report::live::LiveView;
use crate::report::off::Off;
use crate::signing::{SigningSession, warn_of_open_listeners};
use crate::stderr::say;
use crate::tasks::dashboard;
use crate::tasks::desk::Desk;
use crate::tasks::observer::{Observer, ObserverConfig};
use crate::tasks::recorder::Recorder;
use crate::tasks::shard::{Ending, Shard};
use crate::tasks::sim_brick::CommandSender;
use crate::tasks::tlog_recorder::{TlogRecorder, TlogWritten};
use crate::tasks::truth_tap::TruthTap;

/// What a session has left.
pub(super) struct Session {
    pub(super) timer: HostTimer,
    pub(super) folder: PathBuf,
    pub(super) collector: Collector,
    pub(super) recorded: Recorded,
    pub(super) driven: Option<Driven>,
    pub(super) learned: Option<Learned>,
    /// Whether the stamps of signed links were kept.
    pub(super) kept: Result<()>,
    /// What could not be written to its end.
    pub(super) failures: Failures,
}

impl Session {
    /// Whether everything was written that had to be.
    pub(super) fn whole(self) -> Result<()> {
        let mut failures = self.failures;
        failures.note(self.kept);
        for (_, kept) in &self.recorded.inputs {
            failures.note(kept.whole().context("the recording is not whole"));
        }
        failures.told()
    }
}

/// Runs the station until something ends it.
pub(super) async fn session(
    args: &RunArgs,
    config: &Config,
    (file_name, laps): (&str, Laps),
) -> Result<Session, Failure> {
    let timer = HostTimer::start();
    let signing = SigningSession::open(config, timer.utc_start()).at_start()?;
    let pipeline = pipeline(args, config, &signing).at_start()?;
    if let Some(warning) = config.filter.warning(&config.robot) {
        say(&warning);
    }
    let reserved = dashboard::reserve(&args.page, config).at_start()?;
    let folder = output_folder(args, config, &timer).at_start()?;
    let stop = CancellationToken::new();
    let signals = Signals::listen().at_start()?;
    let place = (timer, folder.as_path());
    let opened = open(args, config, (place, laps), &stop).await;
    let (ports, mut embedded) = opened.at_start()?;
    let recording = folder.join(file_name);
    let for_recordings = signing.recorded(config);
    let (commands, truth) = simulated_brick(embedded.as_mut());
    let observer = observer(args, embedded.as_ref()).at_start()?;
    let keeper = signing.keep().at_start()?;
    let mut failures = Failures::default();
    let recorder = start_recorder(args, &for_recordings, &timer, &recording, &mut failures).at_start()?;
    let tlog = start_tlog(args, config, &timer, &recording, &mut failures).at_start()?;
    let current = recorder.as_ref().map(|_| recording);
    let configs = (config.clone(), for_recordings);
    let (mut onlookers, outlet) = Onlookers::start(reserved, (args, config), place, embedded.as_ref()).at_start()?;
    let mut shard = Shard {
        pipeline,
        ports,
        timer,
        recorder,
        given: 0,
        tlog,
        observer,
        failures,
        signing: keeper,
        desk: Desk::new(folder.clone(), timer, configs, current).with_brick(commands),
        truth,
        dashboard: outlet,
    };
    let ending = ending(args, embedded.as_ref(), &stop);
    until_ended((&mut shard, &ending), signals, &mut onlookers).await;
    let driven = stop_brick(embedded, &stop).while_running()?;
    let kept = shard.keep_last_stamps();
    let learned = learned_of(&shard.pipeline, config).at_start()?;
    shard.show_truth();
    let closed = close(shard).while_running()?;
    onlookers.finish().while_running()?;
    Ok(Session {
        timer,
        folder,
        collector: closed.collector,
        recorded: closed.recorded,
        driven,
        learned,
        kept,
        failures: closed.failures,
    })
}

/// Runs the shard until its run is over, or somebody ends it.
async fn until_ended((shard, ending): (&mut Shard, &Ending), mut signals: Signals, onlookers: &mut Onlookers) {
    tokio::select! {
        () = shard.run(ending) => {}
        () = signals.received() => {}
        () = onlookers.quit() => {}
    }
    onlookers.leave_terminal();
}

/// Opens the links.
async fn open(
    args: &RunArgs,
    config: &Config,
    ((timer, folder), laps): ((HostTimer, &Path), Laps),
    stop: &CancellationToken,
) -> Result<(PortSet, Option<Embedded>)> {
    let session = SimulatedSession { timer, folder, laps };
    let opened = open_links(args, config, session, stop).await;
    match &opened {
        Ok((ports, _)) => warn_of_open_listeners(ports, config),
        // Only a folder that is still empty goes.
        Err(_) => drop(std::fs::remove_dir(session.folder)),
    }
    opened
}

/// What a desk hands to the simulated brick, and who hears where that is, if there is one.
fn simulated_brick(embedded: Option<&mut Embedded>) -> (Option<CommandSender>, Option<TruthTap>) {
    let brick = embedded.map(|embedded| &mut embedded.brick);
    brick.map_or((None, None), |brick| (Some(brick.hands.commands.clone()), brick.truth.take()))
}

/// Shows people what happens.
fn observer(args: &RunArgs, embedded: Option<&Embedded>) -> Result<Observer> {
    let view = if args.views.tui {
        // The terminal view shows all that and more.
        LiveView::silent()
    } else {
        live_view(embedded)
    };
    Observer::start(ObserverConfig { events: args.events.as_deref(), view })
}

fn live_view(embedded: Option<&Embedded>) -> LiveView {
    let progress = embedded.map(|embedded| embedded.brick.progress.clone());
    let off = embedded.map(|embedded| Off::new(TruthTap::new(&embedded.brick.hands.truth)));
    LiveView::new(progress).with_truth(off)
}

/// When the run ends by itself: at the latest with its simulated brick.
fn ending(args: &RunArgs, embedded: Option<&Embedded>, stop: &CancellationToken) -> Ending {
    Ending {
        stop: embedded.map_or_else(|| stop.clone(), |embedded| embedded.brick.finished.clone()),
        progress: embedded.map(|embedded| embedded.brick.progress.clone()),
        at: args.duration.map(Stamp::from_secs_f64),
        silence: args.until_silent.map(Span::from_secs_f64),
    }
}

/// The engine; a filter that learns nothing is refused where what it learns shall be saved, before the robot drives for nothing.
fn pipeline(args: &RunArgs, config: &Config, signing: &SigningSession) -> Result<Pipeline> {
    let mut pipeline_config = config.pipeline()?;
    signing.lay_into(&mut pipeline_config);
    let pipeline = Pipeline::new(pipeline_config, Stamp::ZERO)?;
    if args.save_calibration.is_some() && pipeline.calibration().is_none() {
        bail!("--save-calibration: the filter `{}` learns no calibration", config.filter.name);
    }
    Ok(pipeline)
}

fn learned_of(pipeline: &Pipeline, config: &Config) -> Result<Option<Learned>> {
    let prior = config.filter_config()?.calibration;
    Ok(Learned::of(pipeline, "live run", &config.robot, &prior))
}

/// What recorder and observer leave.
struct Closed {
    collector: Collector,
    recorded: Recorded,
    failures: Failures,
}

/// Closes the links, then lets recorder and observer finish what waits.
fn close(shard: Shard) -> Result<Closed> {
    let Shard { recorder, tlog, observer, ports, mut failures, desk, .. } = shard;
    let unsent: u64 = ports.iter().map(|port| port.counters().drops_out).sum();
    if unsent > 0 {
        say(&format!("{unsent} messages were not sent: a link was down or too slow"));
    }
    drop(ports);
    let last = desk.current().map(Path::to_owned);
    // A disk that fails now must not cost the tables, nor one file the others.
    let mut recorded = desk.finish(&mut failures);
    let kept = recorder.map(Recorder::finish).transpose();
    let kept = failures.note(kept.context("the recording is not whole"));
    recorded.extend(last.zip(kept.flatten()));
    let tlog = tlog.map(TlogRecorder::finish).transpose();
    let tlog = failures.note(tlog.context("the telemetry log is not whole"));
    let tlog = tlog.flatten();
    if let Some(TlogWritten { dropped: 1.., .. }) = tlog {
        say("the telemetry log has holes: the disk was too slow for it");
    }
    let (collector, dropped) = observer.finish()?;
    if dropped > 0 {
        tracing::warn!(dropped, "events were not shown because the terminal was slow");
    }
    Ok(Closed { collector, recorded: Recorded { inputs: recorded, tlog }, failures })
}

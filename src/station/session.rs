//! A session: the station from start to end.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use posebridge_link::{HostTimer, LinkSet};
use posebridge_station::Station;
use posebridge_telemetry::{TimeDelta, Timestamp};
use tokio_util::sync::CancellationToken;

use super::args::RunArgs;
use super::cameras::Cameras;
use super::event_collector::EventCollector;
use super::fleet::Fleet;
use super::learned_calibration::LearnedCalibration;
use super::link_log::LinkLog;
use super::links::{FinishedSimulation, LapLimit, SimulatedSession, open_links, stop_bricks};
use super::live_status::{ErrorToTruth, LiveView};
use super::observer::{Observer, ObserverResults};
use super::per_robot::PerRobot;
use super::recorder::Recorder;
use super::recording_files::{RecordedFiles, output_folder, start_bag, start_recorder, start_tlog};
use super::requests::{ReachableBrick, RequestHandler};
use super::ros2::Ros2Publisher;
use super::setup::{RobotSetup, SetupChecklists};
use super::side_file::{SideFile, SideFileFormat, WrittenSideFile};
use super::signing::{SigningSession, warn_of_open_listeners};
use super::simulator::EmbeddedBricks;
use super::station_loop::{StationLoop, StopConditions};
use super::viewers::{ShownSession, Viewers, reserve_dashboard};
use super::watchdog::{OnStall, Watchdog};
use super::wiring_fix::WiringReport;
use crate::config::Config;
use crate::console::print_line;
use crate::exit::{DeferredErrors, ExitStage, Failure, Signals};
use crate::stderr_writer::BackgroundStderr;

pub(super) struct Session {
    pub(super) timer: HostTimer,
    pub(super) folder: PathBuf,
    pub(super) collectors: PerRobot<EventCollector>,
    pub(super) recorded: RecordedFiles,
    pub(super) simulations: Vec<FinishedSimulation>,
    pub(super) learned: Vec<LearnedCalibration>,
    pub(super) wiring: Vec<WiringReport>,
    /// What vehicles sent and what they lack, a line each.
    pub(super) missing_sensors: Vec<String>,
    /// At the end, of each robot.
    pub(super) setup: Vec<RobotSetup>,
    pub(super) signing_result: Result<()>,
    pub(super) failures: DeferredErrors,
}

impl Session {
    /// Fails if a required output is incomplete: signing state, recording or telemetry log.
    pub(super) fn into_result(self) -> Result<()> {
        let mut failures = self.failures;
        failures.record(self.signing_result);
        for (_, kept) in &self.recorded.inputs {
            failures.record(kept.check_complete().context("the recording is not whole"));
        }
        failures.into_result()
    }
}

pub(super) async fn session(
    args: &RunArgs,
    config: &Config,
    file_name: &str,
    laps: LapLimit,
) -> Result<Session, Failure> {
    // Before the first message: a terminal that takes none must not keep a robot waiting.
    let _stderr = BackgroundStderr::start().before_start()?;
    let timer = HostTimer::start();
    let signing = SigningSession::open(config, timer.utc_start()).before_start()?;
    let station = build_station(args, config, &signing).before_start()?;
    if let Some(warning) = config.filter.warning(&config.robot) {
        print_line(&warning);
    }
    let mut fleet = Fleet::start(config, timer).before_start()?;
    let ros2 = Ros2Publisher::start(config, timer).before_start()?;
    let reserved = reserve_dashboard(&args.page, config).before_start()?;
    let folder = output_folder(args, config, &timer).before_start()?;
    let stop = CancellationToken::new();
    let signals = Signals::listen().before_start()?;
    let kept = args.record.record_video.then_some(folder.as_path());
    let cameras = Cameras::new(config, kept).before_start()?;
    let simulated = SimulatedSession { timer, folder: &folder, laps, cameras: &cameras };
    let opened = open(args, config, simulated, &stop).await;
    let (ports, mut embedded) = opened.before_start()?;
    let recording = folder.join(file_name);
    let for_recordings = signing.config_for_recording(config);
    // From the very start.
    let bricks = embedded.as_mut().map_or(&mut [][..], |link| &mut link.bricks);
    let truth = bricks.iter_mut().filter_map(|brick| brick.truth.take()).collect();
    let reachable = bricks.iter().map(|brick| {
        let commands = brick.controls.commands.clone();
        ReachableBrick { robot: brick.robot, commands }
    });
    let reachable = reachable.collect();
    let observer = observer(args, embedded.as_ref()).before_start()?;
    let keeper = signing.start_writer().before_start()?;
    let mut failures = DeferredErrors::default();
    let recorder = start_recorder(args, &for_recordings, &timer, &recording, &mut failures).before_start()?;
    let tlog = start_tlog(args, config, &timer, &recording, &mut failures).before_start()?;
    let bag = start_bag(args, config, &timer, &recording, &mut failures).before_start()?;
    let current = recorder.as_ref().map(|_| recording);
    let (cameras, shared) = (cameras.sources(), fleet.as_ref().map(Fleet::source));
    let shown = ShownSession { timer, folder: &folder, embedded: embedded.as_ref(), cameras, fleet: shared };
    let viewers = Viewers::start(reserved, args, config, shown);
    let (mut viewers, dashboard) = viewers.before_start()?;
    if let Some(fleet) = &mut fleet {
        fleet.set_operator_tokens(viewers.operator_tokens());
    }
    let on_stall = if args.watchdog.watchdog_exit { OnStall::Exit } else { OnStall::Tell };
    let mut station_loop = StationLoop {
        station,
        links: ports,
        timer,
        recorder,
        input_count: 0,
        tlog,
        bag,
        ros2,
        observer,
        failures,
        signing: keeper,
        fleet,
        requests: RequestHandler::new(folder.clone(), timer, config.clone(), for_recordings, current)
            .with_bricks(reachable),
        truth,
        dashboard,
        setup: SetupChecklists::default(),
        first_pose: args.set_pose,
        watchdog: Watchdog::start(timer, on_stall).before_start()?,
        link_log: LinkLog::default(),
    };
    let ending = stop_conditions(args, embedded.as_ref(), &stop);
    wait_for_end(&mut station_loop, &ending, signals, &mut viewers).await;
    station_loop.leave_fleet();
    let driven = stop_bricks(embedded, &stop).while_running()?;
    let kept = station_loop.save_signing_state();
    let learned = LearnedCalibration::of_session(&station_loop.station, "live run", config).before_start()?;
    let wiring = WiringReport::of_session(station_loop.station.robots(), config);
    let setup = station_loop.setup.items(timer.now(), &station_loop.station);
    let missing_sensors = station_loop.station.missing_sensors();
    station_loop.record_truth();
    let closed = close(station_loop).while_running()?;
    viewers.finish().while_running()?;
    Ok(Session {
        timer,
        folder,
        collectors: closed.collectors,
        recorded: closed.recorded,
        simulations: driven,
        learned,
        wiring,
        missing_sensors,
        setup,
        signing_result: kept,
        failures: closed.failures,
    })
}

/// Runs the station loop until its end conditions or a signal.
async fn wait_for_end(
    station_loop: &mut StationLoop,
    ending: &StopConditions,
    mut signals: Signals,
    viewers: &mut Viewers,
) {
    tokio::select! {
        () = station_loop.run(ending) => {}
        () = signals.received() => {}
        () = viewers.quit() => {}
    }
    viewers.close_terminal();
}

async fn open(
    args: &RunArgs,
    config: &Config,
    session: SimulatedSession<'_>,
    stop: &CancellationToken,
) -> Result<(LinkSet, Option<EmbeddedBricks>)> {
    let opened = open_links(args, config, session, stop).await;
    match &opened {
        Ok((ports, _)) => warn_of_open_listeners(ports, config),
        // Only a folder that is still empty goes.
        Err(_) => drop(std::fs::remove_dir(session.folder)),
    }
    opened
}

fn observer(args: &RunArgs, embedded: Option<&EmbeddedBricks>) -> Result<Observer> {
    let bricks = embedded.map_or(&[][..], |link| &link.bricks);
    // The bricks drive one path in one time.
    let progress = bricks.first().map(|brick| brick.progress.clone());
    let errors = || bricks.iter().map(|brick| ErrorToTruth::new(brick.truth_tap())).collect();
    // The terminal view shows all that and more.
    let view = if args.views.tui { LiveView::silent() } else { LiveView::new(progress, errors()) };
    Observer::start(args.events.as_deref(), view)
}

/// The end conditions: at the latest the end of the simulated brick.
fn stop_conditions(args: &RunArgs, embedded: Option<&EmbeddedBricks>, stop: &CancellationToken) -> StopConditions {
    StopConditions {
        stop: embedded.map_or_else(|| stop.clone(), |link| link.finished.clone()),
        progress: embedded.and_then(|link| Some(link.bricks.first()?.progress.clone())),
        at: args.duration.map(Timestamp::from_secs_f64),
        silence: args.until_silent.map(TimeDelta::from_secs_f64),
    }
}

/// Builds the engine; fails if a calibration shall be saved but the filter is not adaptive, before the robot drives in vain.
fn build_station(args: &RunArgs, config: &Config, signing: &SigningSession) -> Result<Station> {
    let mut station_config = config.station_config()?;
    signing.apply_to(&mut station_config);
    let station = Station::new(station_config, Timestamp::ZERO)?;
    if args.save_calibration.is_some() && station.first_robot().calibration().is_none() {
        bail!("--save-calibration: the filter `{}` learns no calibration", config.filter.name);
    }
    Ok(station)
}

struct StoppedStation {
    collectors: PerRobot<EventCollector>,
    recorded: RecordedFiles,
    failures: DeferredErrors,
}

/// Closes the links, then waits for recorder and observer.
fn close(station_loop: StationLoop) -> Result<StoppedStation> {
    let StationLoop { recorder, tlog, bag, ros2, observer, links: ports, mut failures, requests, .. } = station_loop;
    let unsent: u64 = ports.iter().map(|port| port.counters().drops_out).sum();
    if unsent > 0 {
        print_line(&format!("{unsent} messages were not sent: a link was down or too slow"));
    }
    drop(ports);
    if let Some(ros2) = ros2 {
        ros2.finish();
    }
    let last = requests.current().map(Path::to_owned);
    // A disk that fails now must not cost the tables, nor one file the others.
    let mut recorded = requests.finish(&mut failures);
    let kept = recorder.map(Recorder::finish).transpose();
    let kept = failures.record(kept.context("the recording is not whole"));
    recorded.extend(last.zip(kept.flatten()));
    let tlog = close_side_file(tlog, &mut failures);
    let bag = close_side_file(bag, &mut failures);
    let ObserverResults { collectors, dropped, event_file } = observer.finish()?;
    failures.record(event_file);
    if dropped > 0 {
        tracing::warn!(dropped, "events are missing in the tables: this computer was too slow for them");
    }
    Ok(StoppedStation { collectors, recorded: RecordedFiles { inputs: recorded, tlog, bag }, failures })
}

/// `None` without the file, or if it is not whole.
fn close_side_file<F: SideFileFormat>(
    file: Option<SideFile<F>>,
    failures: &mut DeferredErrors,
) -> Option<WrittenSideFile> {
    let kind = F::KIND;
    let written = file.map(SideFile::finish).transpose();
    let written = failures.record(written.with_context(|| format!("the {kind} is not whole"))).flatten();
    if let Some(WrittenSideFile { dropped: 1.., .. }) = written {
        print_line(&format!("the {kind} has holes: the disk was too slow for it"));
    }
    written
}

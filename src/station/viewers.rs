//! The viewers of a running station: dashboard, terminal view, PlotJuggler. The station loop waits for none of them: it sends to the
//! dashboard through [`DashboardHandle`], which never blocks and also receives commands. The server itself, with its own thread and
//! runtime, is in `crates/dashboard`.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use posebridge_dashboard::model::{ArenaRow, ParameterRow, PlaceRow, SimulatorFacts, SimulatorNow};
use posebridge_dashboard::{
    BoundListener, CameraSource, Dashboard, DashboardInputs, DashboardStartError, EventBatch, EventFeed, FleetSource,
    FrameTap, FrameTaps, ListenAddress, OperatorTokens, SimulatedTruth, StationInfo, StationStatus, TokenPolicy,
};
use posebridge_estimator::{PARAMS, Params};
use posebridge_link::HostTimer;
use posebridge_sim::impairment::PROFILES;
use posebridge_sim::{Scenario, Simulation, Steering};
use posebridge_telemetry::{Arena, Event, HostClock, Input, Point2, RobotId, TimeDelta, Timestamp};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::args::RunArgs;
use super::dead_reckoning::dead_reckoning;
use super::page_history;
use super::plotjuggler::{self, PlotJuggler, SendCounts};
use super::requests::SimulatorOverrides;
use super::simulator::{EmbeddedBrick, EmbeddedBricks, TimedTruthSample, TruthTap};
use super::tui::{self, TerminalInputs, TerminalView};
use crate::config::Config;
use crate::console::print_line;
use crate::flags::DashboardFlags;

#[derive(Default)]
pub(super) struct Viewers {
    terminal: Option<TerminalView>,
    plotjuggler: Option<PlotJuggler>,
    /// Dropped last, because its end ends the others.
    dashboard: Option<Dashboard>,
    quit: CancellationToken,
}

/// The parts of a session that viewers show.
pub(super) struct ShownSession<'a> {
    pub(super) timer: HostTimer,
    pub(super) folder: &'a Path,
    pub(super) embedded: Option<&'a EmbeddedBricks>,
    pub(super) cameras: Vec<CameraSource>,
    pub(super) fleet: Option<FleetSource>,
}

impl Viewers {
    /// Starts them; returns the station loop's end of the channels, if there are any.
    pub(super) fn start(
        reserved: Option<ReservedListener>,
        args: &RunArgs,
        config: &Config,
        shown: ShownSession<'_>,
    ) -> Result<(Self, Option<DashboardHandle>)> {
        let facts = shown.embedded.map(simulator_facts);
        let fleet = shown.fleet.clone();
        let mut taps = FrameTaps::default();
        let terminal_frames = args.views.tui.then(|| taps.add(tui::WAITING_FRAMES));
        let configured = config.plotjuggler.checked()?;
        let plotted = args.views.plotjuggler.or_else(|| config.plotjuggler.enabled.then_some(configured));
        let plotted = plotted.map(|address| (address, taps.add(plotjuggler::WAITING_FRAMES)));
        let started = start_dashboard(reserved, &args.page, config, shown, taps)?;
        let Some((dashboard, handle)) = started else {
            return Ok((Self::default(), None));
        };
        let mut viewers = Self { dashboard: Some(dashboard), ..Self::default() };
        if let Some((address, frames)) = plotted {
            viewers.plotjuggler = Some(PlotJuggler::start(address, frames)?);
            print_line(&format!("plotjuggler: sending to udp://{address}"));
        }
        // Last: from here on the screen is the view's.
        if let Some(frames) = terminal_frames {
            viewers.terminal = Some(viewers.view(frames, facts, fleet)?);
        }
        Ok((viewers, Some(handle)))
    }

    fn view(
        &self,
        frames: FrameTap,
        simulator: Option<SimulatorFacts>,
        fleet: Option<FleetSource>,
    ) -> Result<TerminalView> {
        let dashboard = self.dashboard.as_ref();
        let dashboard = dashboard.context("the view has no source of messages")?;
        // Not the whole address: a token is printed once.
        let page = dashboard.address();
        let greeting =
            page.map_or_else(|| "there is no page".to_owned(), |address| format!("the page listens at {address}"));
        TerminalView::start(TerminalInputs {
            frames,
            commands: dashboard.commander(),
            quit: self.quit.clone(),
            simulator,
            fleet,
            greeting,
        })
    }

    /// None without a page.
    pub(super) fn operator_tokens(&self) -> OperatorTokens {
        self.dashboard.as_ref().map_or_else(OperatorTokens::default, Dashboard::operator_tokens)
    }

    /// Completes when the user quits in the terminal view.
    pub(super) async fn quit(&self) {
        self.quit.cancelled().await;
    }

    /// Restores the terminal, so that messages are visible again.
    pub(super) fn close_terminal(&mut self) {
        self.terminal = None;
    }

    pub(super) fn finish(self) -> Result<()> {
        drop(self.terminal);
        drop(self.dashboard);
        let Some(plotjuggler) = self.plotjuggler else {
            return Ok(());
        };
        let SendCounts { datagrams, dropped, missed } = plotjuggler.finish()?;
        print_line(&match (dropped, missed) {
            (0, 0) => format!("plotjuggler: {datagrams} datagrams sent"),
            _ => format!(
                "plotjuggler: {datagrams} datagrams sent, {dropped} could not be, {missed} messages were missed"
            ),
        });
        Ok(())
    }
}

/// The station loop's ends of the channels to and from the dashboard.
pub struct DashboardHandle {
    feed: EventFeed,
    commands: mpsc::Receiver<Input>,
    timer: HostTimer,
    /// Initial settings of the simulated brick, if there is one.
    simulator: Option<SimulatorNow>,
}

pub(super) struct ReservedListener {
    bound: BoundListener,
    listen: ListenAddress,
}

/// Binds the dashboard's address, if it is enabled, before anything else is created that a failed start would leave behind. It is no
/// error if all default ports are taken: a robot may wait.
pub(super) fn reserve_dashboard(flags: &DashboardFlags, config: &Config) -> Result<Option<ReservedListener>> {
    let Some(listen) = listen_config(flags, config)? else {
        return Ok(None);
    };
    if let Some(folder) = &flags.ui_dir {
        let page = folder.join("index.html");
        ensure!(page.is_file(), "--ui-dir: there is no `{}`", page.display());
    }
    match BoundListener::new(listen) {
        Ok(bound) => Ok(Some(ReservedListener { bound, listen })),
        Err(error @ DashboardStartError::AllPortsInUse { .. }) => {
            tracing::warn!("there is no dashboard: {error}");
            Ok(None)
        }
        Err(error) => Err(error).context("starting the dashboard"),
    }
}

/// Starts the dashboard, if it has an address or another view in this process needs its messages, and prints its address.
fn start_dashboard(
    reserved: Option<ReservedListener>,
    flags: &DashboardFlags,
    config: &Config,
    shown: ShownSession<'_>,
    taps: FrameTaps,
) -> Result<Option<(Dashboard, DashboardHandle)>> {
    let ShownSession { timer, folder, embedded, cameras, fleet } = shown;
    if reserved.is_none() && taps.is_empty() {
        return Ok(None);
    }
    let (bound, listen) = reserved.map(|reserved| (reserved.bound, reserved.listen)).unzip();
    let facts = facts_of(config, embedded)?;
    let simulator = facts.simulator.as_ref().map(|simulator| SimulatorNow {
        steering: simulator.steering.clone(),
        link_profile: simulator.link_profile.clone(),
    });
    let truth = embedded.map(|link| truth_of(link.bricks.iter().map(EmbeddedBrick::truth_tap).collect()));
    let sources = DashboardInputs {
        clock: Box::new(move || timer.now()),
        truth,
        recordings: folder.to_owned(),
        replay: Box::new(|path| page_history::build_history(path).map_err(|error| format!("{error:#}"))),
        ui_dir: flags.ui_dir.clone(),
        taps,
        cameras,
        fleet,
    };
    let started = Dashboard::start(bound, facts, sources);
    let (dashboard, feed, commands) = started.context("starting the dashboard")?;
    print_address(&dashboard, listen, config.dashboard.token_file.as_deref());
    if let (true, Some(url)) = (flags.open, dashboard.url()) {
        open_in_browser(url)?;
    }
    let handle = DashboardHandle { feed, commands, timer, simulator };
    Ok(Some((dashboard, handle)))
}

fn listen_config(flags: &DashboardFlags, config: &Config) -> Result<Option<ListenAddress>> {
    if let Some(address) = flags.dashboard {
        return Ok(Some(ListenAddress::Exact(address)));
    }
    let configured = config.dashboard.checked()?;
    let is_enabled = config.dashboard.enabled && !flags.no_dashboard;
    Ok(is_enabled.then_some(configured))
}

fn print_address(dashboard: &Dashboard, listen: Option<ListenAddress>, token_file: Option<&str>) {
    let Some(address) = dashboard.address() else {
        return;
    };
    if let Some(ListenAddress::FirstFree(first)) = listen
        && first != address
    {
        print_line(&format!("{first} is in use, perhaps by another station: the dashboard takes the next free port"));
    }
    for url in dashboard.urls() {
        print_line(&format!("dashboard: {url}"));
    }
    if let Some(url) = dashboard.reader_url() {
        print_line(&format!("to look only: {url}"));
    }
    if let Some(file) = token_file.filter(|_| dashboard.needs_token()) {
        print_line(&format!("the page asks for a token of `{file}`: put ?token=TOKEN behind the address"));
    } else if !address.ip().is_loopback() {
        print_line("the address holds a token that lets anybody command this station, and it travels unencrypted");
    }
}

fn open_in_browser(url: String) -> Result<()> {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let work = move || {
        let opened = std::process::Command::new(opener)
            .arg(&url)
            .stdin(std::process::Stdio::null())
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .status();
        if !opened.is_ok_and(|status| status.success()) {
            print_line(&format!("`{opener}` opened no browser: open the address yourself"));
        }
    };
    std::thread::Builder::new().name("open".to_owned()).spawn(work).map(drop).context("starting a browser")
}

/// Returns the samples since the last call, one by one.
fn truth_of(mut taps: Vec<TruthTap>) -> Box<dyn FnMut() -> Option<SimulatedTruth> + Send> {
    let mut waiting = VecDeque::new();
    Box::new(move || {
        if waiting.is_empty() {
            for tap in &mut taps {
                let robot = tap.robot();
                waiting.extend(tap.drain().into_iter().map(|live| (robot, live)));
            }
        }
        waiting.pop_front().map(|(robot, live): (Option<RobotId>, TimedTruthSample)| SimulatedTruth {
            robot,
            now: live.at,
            time: live.sample.brick_time,
            pose: live.sample.pose,
            odometry: Some(live.sample.odometry),
        })
    })
}

fn facts_of(config: &Config, embedded: Option<&EmbeddedBricks>) -> Result<StationInfo> {
    let filter = config.filter_config()?;
    let map = Arc::clone(&filter.arena_map);
    let place = |id: u32, at: &Point2<Arena>| PlaceRow { id, x_m: at.x.0, y_m: at.y.0 };
    Ok(StationInfo {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        links: config.links.iter().map(|link| link.url.clone()).collect(),
        parameters: parameter_rows(&filter.params),
        simulator: embedded.map(simulator_facts),
        arena: ArenaRow {
            landmarks: map.landmarks.iter().map(|(id, at)| place(id.0, at)).collect(),
            beacons: map.beacons.iter().map(|(id, at)| place(id.0, at)).collect(),
            walls: map.walls.iter().map(|wall| [wall.from, wall.to].map(|end| [end.x.0, end.y.0])).collect(),
        },
        dead_reckoning: if embedded.is_some() { None } else { dead_reckoning(filter) },
        token: if config.dashboard.always_token { TokenPolicy::Always } else { TokenPolicy::RemoteOnly },
        token_file: config.dashboard.token_file.as_ref().map(PathBuf::from),
        public_names: config.dashboard.public_names.clone(),
    })
}

fn simulator_facts(link: &EmbeddedBricks) -> SimulatorFacts {
    // One lap of the first: the others are driven on the same path, and the other robots beside it.
    let scenario = link.bricks.first().map_or_else(Scenario::default, |first| first.scenario.clone());
    let steering = scenario.steering;
    let world = Simulation::new(scenario.with_laps(1));
    SimulatorFacts {
        scenario: link.name.clone(),
        path: world.path().iter().map(|at| [at.x.0, at.y.0]).collect(),
        link_profiles: PROFILES.iter().map(|(name, _)| (*name).to_owned()).collect(),
        steering: match steering {
            Steering::Odometry => "odometry".to_owned(),
            Steering::Estimate => "estimate".to_owned(),
        },
        // The default is a cable.
        link_profile: None,
    }
}

fn parameter_rows(params: &Params) -> Vec<ParameterRow> {
    let rows = PARAMS.iter().map(|row| ParameterRow {
        name: row.key.to_owned(),
        value: (row.read)(params),
        default: row.default,
        least: *row.range.start(),
        most: *row.range.end(),
        unit: row.unit.to_owned(),
        help: row.doc.to_owned(),
        mavlink_name: row.key.to_ascii_uppercase(),
    });
    rows.collect()
}

impl DashboardHandle {
    /// Sends the outputs of an input; drops them if the dashboard is behind.
    pub fn publish_events(&self, now: Timestamp<HostClock>, events: &Arc<[Event]>) {
        self.feed.publish(EventBatch {
            now,
            latency: self.timer.now() - now,
            events: Arc::clone(events),
            status: None,
        });
    }

    /// Sends the present state with the changed settings of the simulated brick.
    pub fn publish_status(&self, now: Timestamp<HostClock>, status: StationStatus, overrides: SimulatorOverrides) {
        let simulator = self.simulator.as_ref().map(|begun| SimulatorNow {
            steering: overrides.steering.map_or_else(|| begun.steering.clone(), |by| by.as_str().to_owned()),
            link_profile: overrides.link_profile.map(|name| name.as_str().to_owned()),
        });
        let status = StationStatus { simulator, ..status };
        self.feed.publish(EventBatch { now, latency: TimeDelta::ZERO, events: Arc::default(), status: Some(status) });
    }
}

/// The next command from the page; pending forever without a dashboard.
pub async fn next_command(handle: &mut Option<DashboardHandle>) -> Input {
    if let Some(handle) = handle
        && let Some(command) = handle.commands.recv().await
    {
        return command;
    }
    std::future::pending().await
}

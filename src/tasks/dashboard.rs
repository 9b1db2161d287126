//! The dashboard's place in the station: what it is told, what it may ask for, and where it is printed.
//!
//! The shard tells it through [`Outlet`], which never waits; commands come back through the same. The server itself, with a thread and a
//! runtime of its own, is in `crates/dashboard`.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use posebridge_dashboard::model::{CalibrationRow, ParameterRow, ParameterValue, SimulatorFacts, SimulatorNow};
use posebridge_dashboard::{
    Batch, Bound, Dashboard, Facts, Feed, Listen, Sources, Standing, StartError, Taps, TokenPolicy, TruthSample,
};
use posebridge_estimator::{PARAMS, Params};
use posebridge_link::HostTimer;
use posebridge_pipeline::Pipeline;
use posebridge_sim::impairment::PROFILES;
use posebridge_sim::{Scenario, Simulation, Steering};
use posebridge_telemetry::{Calibration, Command, Event, HostClock, Span, Stamp};
use tokio::sync::mpsc;

use super::desk::BrickOrders;
use super::recorder::Recorder;
use super::sim_brick::LiveTruth;
use super::truth_tap::TruthTap;
use crate::cli::DashboardFlags;
use crate::config::{CALIBRATION_KEYS, Config};
use crate::stderr::say;
use crate::trails;

/// The shard's ends of the channels to and from the dashboard.
pub struct Outlet {
    feed: Feed,
    commands: mpsc::Receiver<Command>,
    timer: HostTimer,
    /// How the simulated brick was set when the run began, if there is one.
    simulator: Option<SimulatorNow>,
}

/// The simulated brick of a run, as the page shows it.
pub struct Simulated<'a> {
    /// The scenario's name.
    pub name: &'a str,
    /// What it drives.
    pub scenario: &'a Scenario,
    /// Where it is.
    pub truth: TruthTap,
}

/// An address that was taken for the dashboard, as it was asked for.
pub struct Reserved {
    bound: Bound,
    listen: Listen,
}

/// Takes the dashboard's address, if there is to be one: before anything is made that a start that fails would leave behind.
///
/// # Errors
/// It cannot listen where it was told to, or its files are not there. That all ports behind the default are taken is no error: a robot
/// may wait.
pub fn reserve(flags: &DashboardFlags, config: &Config) -> Result<Option<Reserved>> {
    let Some(listen) = wanted(flags, config)? else {
        return Ok(None);
    };
    if let Some(folder) = &flags.ui_dir {
        let page = folder.join("index.html");
        ensure!(page.is_file(), "--ui-dir: there is no `{}`", page.display());
    }
    match Bound::new(listen) {
        Ok(bound) => Ok(Some(Reserved { bound, listen })),
        Err(error @ StartError::AllTaken { .. }) => {
            tracing::warn!("there is no dashboard: {error}");
            Ok(None)
        }
        Err(error) => Err(error).context("starting the dashboard"),
    }
}

/// Starts the dashboard, if an address was taken for it or somebody in this process wants to hear the same, and says where it is.
///
/// # Errors
/// The system has no random bytes or no thread for it.
pub fn start(
    reserved: Option<Reserved>,
    (flags, config): (&DashboardFlags, &Config),
    (timer, folder): (HostTimer, &Path),
    (simulated, taps): (Option<Simulated<'_>>, Taps),
) -> Result<Option<(Dashboard, Outlet)>> {
    if reserved.is_none() && taps.is_empty() {
        return Ok(None);
    }
    let (bound, listen) = reserved.map(|reserved| (reserved.bound, reserved.listen)).unzip();
    let facts = facts_of(config, simulated.as_ref())?;
    let simulator = facts.simulator.as_ref().map(|simulator| SimulatorNow {
        steering: simulator.steering.clone(),
        link_profile: simulator.link_profile.clone(),
    });
    let truth = simulated.map(|simulated| truth_of(simulated.truth));
    let sources = Sources {
        clock: Box::new(move || timer.now()),
        truth,
        recordings: folder.to_owned(),
        replay: Box::new(|path| trails::of(path).map_err(|error| format!("{error:#}"))),
        ui_dir: flags.ui_dir.clone(),
        taps,
    };
    let started = Dashboard::start(bound, facts, sources);
    let (dashboard, feed, commands) = started.context("starting the dashboard")?;
    tell(&dashboard, listen);
    if let (true, Some(url)) = (flags.open, dashboard.url()) {
        open_in_browser(url)?;
    }
    let outlet = Outlet { feed, commands, timer, simulator };
    Ok(Some((dashboard, outlet)))
}

fn wanted(flags: &DashboardFlags, config: &Config) -> Result<Option<Listen>> {
    if let Some(address) = flags.dashboard {
        return Ok(Some(Listen::Exactly(address)));
    }
    let configured = config.dashboard.checked()?;
    let is_wanted = config.dashboard.enabled && !flags.no_dashboard;
    Ok(is_wanted.then_some(configured))
}

fn tell(dashboard: &Dashboard, listen: Option<Listen>) {
    let Some(address) = dashboard.address() else {
        return;
    };
    if let Some(Listen::OrNext(first)) = listen
        && first != address
    {
        say(&format!("{first} is in use, perhaps by another station: the dashboard takes the next free port"));
    }
    for url in dashboard.urls() {
        say(&format!("dashboard: {url}"));
    }
    if !address.ip().is_loopback() {
        say("the address holds a token that lets anybody command this station, and it travels unencrypted");
    }
}

/// Opens an address with what the desktop opens addresses with.
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
            say(&format!("`{opener}` opened no browser: open the address yourself"));
        }
    };
    std::thread::Builder::new().name("open".to_owned()).spawn(work).map(drop).context("starting a browser")
}

/// Gives what was shown since it was asked last, one by one.
fn truth_of(mut tap: TruthTap) -> Box<dyn FnMut() -> Option<TruthSample> + Send> {
    let mut waiting = VecDeque::new();
    Box::new(move || {
        if waiting.is_empty() {
            waiting.extend(tap.take());
        }
        waiting.pop_front().map(|live: LiveTruth| TruthSample {
            now: live.at,
            stamp: live.sample.brick,
            pose: live.sample.pose,
            odometry: Some(live.sample.odometry),
        })
    })
}

fn facts_of(config: &Config, simulated: Option<&Simulated<'_>>) -> Result<Facts> {
    let params = config.filter_config()?.params;
    Ok(Facts {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        links: config.links.iter().map(|link| link.url.clone()).collect(),
        parameters: parameter_rows(&params),
        simulator: simulated.map(simulator_facts),
        token: if config.dashboard.always_token { TokenPolicy::Always } else { TokenPolicy::Elsewhere },
    })
}

/// What the page tells of a simulated brick.
#[must_use]
pub fn simulator_facts(simulated: &Simulated<'_>) -> SimulatorFacts {
    // One lap: the others are driven on the same path.
    let world = Simulation::new(simulated.scenario.clone().with_laps(1));
    SimulatorFacts {
        scenario: simulated.name.to_owned(),
        path: world.path().iter().map(|at| [at.x.0, at.y.0]).collect(),
        link_profiles: PROFILES.iter().map(|(name, _)| (*name).to_owned()).collect(),
        steering: match simulated.scenario.steering {
            Steering::Odometry => "odometry".to_owned(),
            Steering::Estimate => "estimate".to_owned(),
        },
        // Where nobody has asked for another one, the brick is at a cable.
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

fn parameter_values(params: &Params) -> Vec<ParameterValue> {
    let values = PARAMS.iter().map(|row| ParameterValue { name: row.key.to_owned(), value: (row.read)(params) });
    values.collect()
}

/// What was learned about a robot, as the page shows it.
#[must_use]
pub fn calibration_rows(learned: &Calibration) -> Vec<CalibrationRow> {
    let rows = CALIBRATION_KEYS.iter().map(|row| {
        let known = (row.read)(learned);
        CalibrationRow {
            name: row.key.to_owned(),
            value: known.value,
            sigma: known.sigma,
            unit: unit_of(row.key).to_owned(),
            ..CalibrationRow::default()
        }
    });
    rows.collect()
}

/// The unit that stands in a key's name.
fn unit_of(key: &str) -> &'static str {
    let units = [("_rad_per_s", "rad/s"), ("_s", "s"), ("_m", "m")];
    let found = units.iter().find(|(ending, _)| key.ends_with(ending));
    found.map_or("", |(_, unit)| unit)
}

/// What stands in a pipeline, and into which file it is recorded.
#[must_use]
pub fn standing_of(pipeline: &Pipeline, recorder: Option<&Recorder>) -> Standing {
    let learned = pipeline.calibration();
    let recording = recorder.map(Recorder::current);
    let name = recording.as_deref().and_then(Path::file_name);
    Standing {
        calibration: learned.map_or_else(Vec::new, |learned| calibration_rows(&learned)),
        parameters: parameter_values(pipeline.params()),
        recording: name.map(|name| name.to_string_lossy().into_owned()),
        switched_off: pipeline.switched_off().map(|sensor| sensor.0).collect(),
        simulator: None,
    }
}

impl Outlet {
    /// Tells what an input has led to; drops it if the dashboard is behind.
    pub fn tell(&self, now: Stamp<HostClock>, events: &Arc<[Event]>) {
        self.feed.tell(Batch { now, took: self.timer.now() - now, events: Arc::clone(events), standing: None });
    }

    /// Tells what stands, and how the simulated brick was set since the run began.
    pub fn tell_standing(&self, now: Stamp<HostClock>, standing: Standing, orders: BrickOrders) {
        let simulator = self.simulator.as_ref().map(|begun| SimulatorNow {
            steering: orders.steering.map_or_else(|| begun.steering.clone(), |by| by.word().to_owned()),
            link_profile: orders.link_profile.map(|name| name.as_str().to_owned()),
        });
        let standing = Standing { simulator, ..standing };
        self.feed.tell(Batch { now, took: Span::ZERO, events: Arc::default(), standing: Some(standing) });
    }
}

/// The next command that somebody gives on the page; without a dashboard, or when it is gone, never.
pub async fn next_command(outlet: &mut Option<Outlet>) -> Command {
    if let Some(outlet) = outlet
        && let Some(command) = outlet.commands.recv().await
    {
        return command;
    }
    std::future::pending().await
}

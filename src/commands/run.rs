//! `posebridge run`: the station.
//!
//! Opens the links, decodes, aligns the clocks, fuses, sends the estimate back, records everything that came in, and shows one
//! status block. With a simulated brick of its own it ends when the path is driven, prints who was how far off and draws two
//! pictures; otherwise it runs until Ctrl-C, `--duration` or `--until-silent`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use posebridge_link::{HostTimer, LinkUrl, Port, PortConfig, PortSet, Role};
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::TruthSample;
use posebridge_sim::{Scenario, Simulation, Steering};
use posebridge_telemetry::{LinkId, Span, Stamp};
use tokio_util::sync::CancellationToken;

use super::{Failure, Stage};
use crate::cli::RunArgs;
use crate::collect::Collector;
use crate::config::{self, Config, LinkSection, Provenance, RobotProfile, Setting};
use crate::failures::Failures;
use crate::learned::{Learned, learned_table, save};
use crate::link_target::{LinkTarget, load_scenario};
use crate::report::live::LiveView;
use crate::report::run::{self as report, Truth};
use crate::signing::{SigningSession, warn_of_open_listeners};
use crate::stderr::say;
use crate::stdout;
use crate::tasks::desk::{Desk, RECORDING, header};
use crate::tasks::observer::{Observer, ObserverConfig};
use crate::tasks::recorder::{Kept, Recorder};
use crate::tasks::shard::{Ending, Shard};
use crate::tasks::sim_brick::EmbeddedBrick;
use crate::tasks::tlog_recorder::{TlogRecorder, TlogWritten};
use crate::virtual_run;

/// Runs the station.
///
/// # Errors
/// The configuration makes no sense, a link cannot be opened for good, or the recording cannot be written.
pub fn execute(args: &RunArgs) -> Result<(), Failure> {
    let config = configuration(args).at_start()?;
    let mut session = in_runtime(session(args, &config, RECORDING))?;
    // What cannot be drawn or saved must not cost the rest.
    let mut failures = Failures::default();
    failures.note(finish(
        &config,
        &session.folder,
        &session.collector,
        session.driven.take(),
        &session.recorded,
    ));
    failures.note(report_learned(args, &config, &session));
    failures.note(session.whole());
    failures.told().while_running()
}

/// Records a robot without any report of its own: for those who evaluate the recording at once. It is recorded whatever the
/// configuration says, into the file of this name in the flags' folder; gives how the observations of each sensor fared, as a table.
///
/// # Errors
/// As [`execute`].
pub(crate) fn record(args: &RunArgs, file_name: &str) -> Result<String, Failure> {
    let mut config = configuration(args).at_start()?;
    config.record.enabled = true;
    let session = in_runtime(session(args, &config, file_name))?;
    let heard = report::sources(&session.collector);
    session.whole().while_running()?;
    Ok(heard)
}

fn in_runtime<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .at_start()?;
    let result = runtime.block_on(work);
    // An attempt to open a device that hangs must not keep the program alive.
    runtime.shutdown_background();
    result
}

/// The configuration with the command line's flags laid over it.
fn configuration(args: &RunArgs) -> Result<Config> {
    let is_of = |setting: &Setting, sections: &[&str]| {
        let section = setting.path.first();
        section.is_some_and(|section| sections.contains(&section.as_str()))
    };
    let mut settings = args.config.settings.clone();
    if args.robot.is_some() {
        // They may be single keys of the file's robot, and make no sense without it.
        settings.retain(|setting| !is_of(setting, &["robot"]));
    }
    let mut config = config::load(args.config.config.as_deref(), &settings)?.config;
    let flags = &args.links.0;
    if !flags.is_empty() {
        let links = flags.iter().map(|flag| LinkSection {
            listen: flag.role == Role::Listen,
            ..LinkSection::new(&flag.url)
        });
        config.links = links.collect();
    }
    for url in &args.ground_stations {
        let section = LinkSection::for_ground_stations(url);
        config
            .links
            .push(section.with_context(|| format!("--gcs {url}"))?);
    }
    if let (Some(name), Some(first)) = (&args.brick, config.links.first_mut()) {
        first.brick = Some(name.clone());
    }
    if let Some(path) = &args.robot {
        config = config.with_robot(RobotProfile::read(path)?);
        // What is set by hand is meant for the robot of the file, too.
        let mut settings = args.config.settings.clone();
        settings.retain(|setting| is_of(setting, &["robot", "filter"]));
        config = config::lay_over(&config, &settings)?;
    }
    if let Some(name) = &args.filter {
        config.filter.name.clone_from(name);
    }
    for (target, _) in config.targets()? {
        if let LinkTarget::Sim(name) = target {
            config = config.with_tag_of(&load_scenario(&name)?);
        }
    }
    config.pipeline()?;
    Ok(config)
}

/// The simulated brick of a run, if it has one.
struct Embedded {
    brick: EmbeddedBrick,
    scenario: Scenario,
    name: String,
    link: LinkId,
}

/// A simulated brick that has stopped.
struct Driven {
    simulation: Simulation,
    scenario: Scenario,
    name: String,
    link: LinkId,
    /// Whether it drove its path to the end: a lap that was cut short cannot be compared with a whole one.
    is_whole: bool,
}

impl Driven {
    /// Where the robot was, as its recording keeps it.
    fn truth(&self) -> Vec<TruthSample> {
        let sample = |sample: &posebridge_sim::TruthSample| TruthSample {
            stamp: sample.brick,
            pose: sample.pose,
            odometry: Some(sample.odometry),
        };
        self.simulation.truth().iter().map(sample).collect()
    }
}

/// What was written down while a session ran.
#[derive(Default)]
struct Recorded {
    /// The recordings and what they hold.
    inputs: Vec<(PathBuf, Kept)>,
    /// The telemetry log.
    tlog: Option<TlogWritten>,
}

/// What a session has left.
struct Session {
    timer: HostTimer,
    folder: PathBuf,
    collector: Collector,
    recorded: Recorded,
    driven: Option<Driven>,
    learned: Option<Learned>,
    /// Whether the stamps of signed links were kept.
    kept: Result<()>,
    /// What could not be written to its end.
    failures: Failures,
}

impl Session {
    /// Whether everything was written that had to be.
    fn whole(self) -> Result<()> {
        let mut failures = self.failures;
        failures.note(self.kept);
        for (_, kept) in &self.recorded.inputs {
            failures.note(kept.whole().context("the recording is not whole"));
        }
        failures.told()
    }
}

/// Runs the station until something ends it.
async fn session(args: &RunArgs, config: &Config, file_name: &str) -> Result<Session, Failure> {
    let timer = HostTimer::start();
    let signing = SigningSession::open(config, timer.utc_start()).at_start()?;
    let pipeline = pipeline(args, config, &signing).at_start()?;
    let folder = output_folder(args, config, &timer).at_start()?;
    let stop = CancellationToken::new();
    let mut signals = Signals::listen().at_start()?;
    let opened = open_links(args, config, timer, &folder, &stop).await;
    if opened.is_err() {
        // Only a folder that is still empty goes.
        drop(std::fs::remove_dir(&folder));
    }
    let (ports, embedded) = opened.at_start()?;
    warn_of_open_listeners(&ports, config);
    let recording = folder.join(file_name);
    let for_recordings = signing.recorded(config);
    let mut failures = Failures::default();
    let recorder =
        start_recorder(args, &for_recordings, &timer, &recording, &mut failures).at_start()?;
    let tlog = start_tlog(args, config, &timer, &recording, &mut failures).at_start()?;
    let current = recorder.as_ref().map(|_| recording);
    let configs = (config.clone(), for_recordings);
    let mut shard = Shard {
        pipeline,
        ports,
        timer,
        recorder,
        given: 0,
        tlog,
        observer: observer(args, embedded.as_ref()).at_start()?,
        failures,
        signing: signing.keep().at_start()?,
        desk: Desk::new(folder.clone(), timer, configs, current),
    };
    let ending = ending(args, embedded.as_ref(), &stop);
    tokio::select! {
        () = shard.run(&ending) => {}
        () = signals.received() => {}
    }
    let driven = stop_brick(embedded, &stop).while_running()?;
    let kept = shard.keep_last_stamps();
    let learned = learned_of(&shard.pipeline, config).at_start()?;
    let closed = close(shard, driven.as_ref()).while_running()?;
    Ok(Session {
        timer,
        folder,
        collector: closed.collector,
        recorded: Recorded {
            inputs: closed.recorded,
            tlog: closed.tlog,
        },
        driven,
        learned,
        kept,
        failures: closed.failures,
    })
}

/// Shows people what happens.
fn observer(args: &RunArgs, embedded: Option<&Embedded>) -> Result<Observer> {
    let progress = embedded.map(|embedded| embedded.brick.progress.clone());
    Observer::start(ObserverConfig {
        events: args.events.as_deref(),
        view: LiveView::new(progress),
    })
}

/// Tells everybody to stop and waits for the simulated brick, if there is one.
fn stop_brick(embedded: Option<Embedded>, stop: &CancellationToken) -> Result<Option<Driven>> {
    // Whoever is stopped is finished as well.
    let is_whole = embedded
        .as_ref()
        .is_some_and(|embedded| embedded.brick.finished.is_cancelled());
    stop.cancel();
    let Some(embedded) = embedded else {
        return Ok(None);
    };
    Ok(Some(Driven {
        is_whole,
        simulation: embedded.brick.finish()?,
        scenario: embedded.scenario,
        name: embedded.name,
        link: embedded.link,
    }))
}

/// When the run ends by itself: at the latest with its simulated brick.
fn ending(args: &RunArgs, embedded: Option<&Embedded>, stop: &CancellationToken) -> Ending {
    Ending {
        stop: embedded.map_or_else(|| stop.clone(), |embedded| embedded.brick.finished.clone()),
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
        bail!(
            "--save-calibration: the filter `{}` learns no calibration",
            config.filter.name
        );
    }
    Ok(pipeline)
}

fn learned_of(pipeline: &Pipeline, config: &Config) -> Result<Option<Learned>> {
    let prior = config.filter_config()?.calibration;
    Ok(Learned::of(pipeline, "live run", &config.robot, &prior))
}

/// Prints and saves what the filter has learned about the robot.
fn report_learned(args: &RunArgs, config: &Config, session: &Session) -> Result<()> {
    let learned = session.learned.as_ref();
    if let Some(learned) = learned {
        stdout::print(&learned_table(std::slice::from_ref(learned)))?;
    }
    let Some(path) = &args.save_calibration else {
        return Ok(());
    };
    let learned = learned.context("nothing was observed, so there is no calibration to save")?;
    let provenance = Provenance {
        utc_micros: session.timer.utc_start(),
        source: format!("live run, {}", session.folder.display()),
        filter: config.filter.name.clone(),
    };
    save(path, learned, &provenance)
}

/// What recorder and observer leave.
struct Closed {
    collector: Collector,
    recorded: Vec<(PathBuf, Kept)>,
    tlog: Option<TlogWritten>,
    failures: Failures,
}

/// Closes the links, then lets recorder and observer finish what waits.
fn close(shard: Shard, driven: Option<&Driven>) -> Result<Closed> {
    let Shard {
        mut recorder,
        tlog,
        observer,
        ports,
        mut failures,
        desk,
        ..
    } = shard;
    let unsent: u64 = ports.iter().map(|port| port.counters().drops_out).sum();
    if unsent > 0 {
        say(&format!(
            "{unsent} messages were not sent: a link was down or too slow"
        ));
    }
    drop(ports);
    if let (Some(recorder), Some(driven)) = (&mut recorder, driven) {
        recorder.record_truth(driven.truth());
    }
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
        tracing::warn!(
            dropped,
            "events were not shown because the terminal was slow"
        );
    }
    Ok(Closed {
        collector,
        recorded,
        tlog,
        failures,
    })
}

/// Opens what must open at once and starts simulated bricks.
async fn open_links(
    args: &RunArgs,
    config: &Config,
    timer: HostTimer,
    folder: &Path,
    stop: &CancellationToken,
) -> Result<(PortSet, Option<Embedded>)> {
    let mut ports = Vec::new();
    let mut embedded = None;
    for (index, (target, role)) in config.targets()?.into_iter().enumerate() {
        let (url, role) = match target {
            LinkTarget::Url(url) => (url, role),
            LinkTarget::Sim(name) => {
                if embedded.is_some() {
                    bail!("only one link may be sim://");
                }
                let scenario = load_scenario(&name)?;
                let scenario = args
                    .seed
                    .map_or_else(|| scenario.clone(), |seed| scenario.clone().with_seed(seed));
                let path = folder.join("brick.tty");
                let brick = EmbeddedBrick::start(scenario.clone(), &path, stop.clone())?;
                embedded = Some(Embedded {
                    brick,
                    scenario,
                    name,
                    link: LinkId(index as u16),
                });
                (LinkUrl::serial(&path)?, Role::Dial)
            }
        };
        ports.push(Port::new(
            PortConfig {
                id: LinkId(index as u16),
                url,
                role,
            },
            timer,
        ));
    }
    let mut ports = PortSet::new(ports);
    ports.open_first().await.map_err(|(id, error)| {
        anyhow::Error::from(error).context(format!("opening link {}", id.0 + 1))
    })?;
    for port in &ports {
        if let (true, Some(address)) = (port.is_listening(), port.local_address()) {
            say(&format!("listening on {address}"));
        }
    }
    Ok((ports, embedded))
}

/// Ctrl-C and requests to terminate, listened for from the beginning: they must not get lost while links open.
pub(crate) struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

impl Signals {
    /// Starts to listen.
    ///
    /// # Errors
    /// The system refuses.
    pub(crate) fn listen() -> Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    /// Until one comes.
    pub(crate) async fn received(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

fn output_folder(args: &RunArgs, config: &Config, timer: &HostTimer) -> Result<PathBuf> {
    let folder = match &args.out {
        Some(folder) => folder.clone(),
        None => {
            Path::new(&config.record.directory).join(format!("run-{}", timer.utc_start() / 1_000))
        }
    };
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("creating the folder `{}`", folder.display()))?;
    Ok(folder)
}

fn start_recorder(
    args: &RunArgs,
    config: &Config,
    timer: &HostTimer,
    path: &Path,
    failures: &mut Failures,
) -> Result<Option<Recorder>> {
    if args.no_record || !config.record.enabled {
        return Ok(None);
    }
    let started = Recorder::start_limited(path, &header(config, timer)?, config.record.limits());
    unless_it_was_made("recording", started, path, failures)
}

/// A file that cannot be begun is told once and costs the exit code, not the run: a robot may steer by us. One that is there
/// already is a slip of who started the run, and cheap to mend before the robot drives.
fn unless_it_was_made<T>(
    what: &str,
    started: Result<T>,
    path: &Path,
    failures: &mut Failures,
) -> Result<Option<T>> {
    match started {
        Ok(started) => Ok(Some(started)),
        Err(error) if path.exists() => Err(error),
        Err(error) => {
            let reason = format!("{error:#}");
            tracing::error!(error = reason, "there is no {what}; the run goes on");
            failures.note::<()>(Err(error.context(format!("the {what} is not whole"))));
            Ok(None)
        }
    }
}

/// The telemetry log beside the recording, if it is asked for.
fn start_tlog(
    args: &RunArgs,
    config: &Config,
    timer: &HostTimer,
    recording: &Path,
    failures: &mut Failures,
) -> Result<Option<TlogRecorder>> {
    if args.no_record || !(args.tlog || config.record.tlog) {
        return Ok(None);
    }
    let path = recording.with_extension("tlog");
    let links = config.pipeline()?.links;
    let floor_bytes = config.record.limits().floor_bytes;
    let started = TlogRecorder::start(&path, timer.utc_start(), &links, floor_bytes);
    unless_it_was_made("telemetry log", started, &path, failures)
}

/// Tables and pictures.
fn finish(
    config: &Config,
    folder: &Path,
    collector: &Collector,
    driven: Option<Driven>,
    recorded: &Recorded,
) -> Result<()> {
    let mut title = "live run".to_owned();
    let mut truth = None;
    let mut other = None;
    if let Some(driven) = driven {
        title = format!("{}, seed {}", driven.name, driven.scenario.seed);
        if driven.is_whole {
            other = Some(steered_the_other_way(config, &driven)?);
        }
        truth = Some(Truth::of(&driven.simulation));
    }
    let mut text = report::sources(collector) + "\n" + &report::links(collector) + "\n";
    if let Some(truth) = &truth {
        text += &report::table(collector, truth, other.as_ref());
        text += "\n";
    }
    let drawn = report::draw(folder, &title, collector, truth.as_ref());
    for picture in drawn.iter().flatten() {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "picture    {}", picture.display());
    }
    for (recording, kept) in &recorded.inputs {
        let (file, inputs) = (recording.display(), kept.inputs);
        let parts = match kept.parts {
            ..=1 => String::new(),
            parts => format!(", {parts} parts"),
        };
        let _ = writeln!(text, "recording  {file} ({inputs} inputs{parts})");
    }
    if let Some(tlog) = &recorded.tlog {
        let (path, frames) = (tlog.path.display(), tlog.frames);
        let _ = writeln!(text, "tlog       {path} ({frames} frames)");
    }
    stdout::print(&text)?;
    drawn.map(drop).context("not all pictures are drawn")
}

/// The same world, steered by the brick's own odometry where the run steered by the estimate, and the other way round.
fn steered_the_other_way(config: &Config, driven: &Driven) -> Result<Truth> {
    let other = match driven.scenario.steering {
        Steering::Odometry => Steering::Estimate,
        Steering::Estimate => Steering::Odometry,
    };
    let mut pipeline = config.pipeline()?;
    pipeline.links.retain(|link| link.id == driven.link);
    let run = virtual_run::run(driven.scenario.clone().with_steering(other), pipeline)?;
    Ok(Truth::of(&run.simulation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{Cli, Command};
    use clap::Parser as _;

    /// Commands of the pages, each in one line, without comments and quotes.
    fn commands(page: &Path) -> Vec<Vec<String>> {
        let text = std::fs::read_to_string(page).unwrap();
        let shells = text.split("```sh\n").skip(1);
        let blocks = shells.filter_map(|rest| rest.split("```").next());
        let lines: Vec<String> = blocks
            .flat_map(|block| {
                let joined = block.replace("\\\n", " ");
                joined.lines().map(str::to_owned).collect::<Vec<_>>()
            })
            .collect();
        lines
            .iter()
            .map(|line| line.split(" #").next().unwrap_or_default())
            .filter(|line| line.starts_with("posebridge run") && line.contains("config/robots"))
            .map(|line| {
                line.split_whitespace()
                    .map(|word| word.trim_matches('\'').to_owned())
                    .collect()
            })
            .collect()
    }

    #[test]
    fn the_commands_of_the_pages_about_bricks_make_sense() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut found = 0;
        for folder in ["docs/bricks", "docs/protocols"] {
            for entry in std::fs::read_dir(root.join(folder)).unwrap() {
                for command in commands(&entry.unwrap().path()) {
                    let cli = Cli::try_parse_from(&command).unwrap();
                    let Some(Command::Run(args)) = cli.command else {
                        panic!("{command:?} does not run");
                    };
                    if let Err(error) = configuration(&args) {
                        panic!("{}: {error:#}", command.join(" "));
                    }
                    found += 1;
                }
            }
        }
        assert!(found >= 5, "{found} commands");
    }
}

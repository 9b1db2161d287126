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
use posebridge_recording::container::Header;
use posebridge_sim::{Scenario, Steering};
use posebridge_telemetry::{LinkId, Span, Stamp};
use tokio_util::sync::CancellationToken;

use super::{Failure, Stage};
use crate::cli::RunArgs;
use crate::collect::Collector;
use crate::config::{self, Config, LinkSection, Provenance, RobotProfile};
use crate::learned::{Learned, learned_table, save};
use crate::link_target::{LinkTarget, load_scenario};
use crate::report::live::LiveView;
use crate::report::run::{self as report, Truth};
use crate::signing::{SigningSession, warn_of_open_listeners};
use crate::stderr::say;
use crate::stdout;
use crate::tasks::observer::{Observer, ObserverConfig};
use crate::tasks::recorder::Recorder;
use crate::tasks::shard::{Ending, Shard};
use crate::tasks::sim_brick::EmbeddedBrick;
use crate::virtual_run;

/// Runs the station.
///
/// # Errors
/// The configuration makes no sense, a link cannot be opened for good, or the recording cannot be written.
pub fn execute(args: &RunArgs) -> Result<(), Failure> {
    let config = configuration(args).at_start()?;
    let mut session = in_runtime(session(args, &config, RECORDING))?;
    finish(
        &config,
        &session.folder,
        &session.collector,
        session.embedded.take(),
        session.recorded.as_ref(),
    )
    .while_running()?;
    report_learned(args, &config, &session).while_running()?;
    session.whole().while_running()
}

/// Records a robot without any report of its own: for those who evaluate the recording at once. It is recorded whatever the
/// configuration says, into the file of this name in the flags' folder; gives how the observations of each sensor fared, as a table.
///
/// # Errors
/// As [`execute`].
pub(crate) fn record(args: &RunArgs, file_name: &str) -> Result<String, Failure> {
    let mut config = configuration(args).at_start()?;
    config.record.enabled = true;
    let mut session = in_runtime(session(args, &config, file_name))?;
    if let Some((embedded, _)) = session.embedded.take() {
        embedded.brick.finish().while_running()?;
    }
    let heard = report::sources(&session.collector);
    session.whole().while_running()?;
    Ok(heard)
}

/// The name of a run's recording in its folder.
const RECORDING: &str = "recording.mcap";

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
    let mut config = config::load(args.config.config.as_deref(), &args.config.settings)?.config;
    if !args.links.is_empty() || !args.listen.is_empty() {
        let dialled = args.links.iter().map(|url| LinkSection::new(url));
        let awaited = args.listen.iter().map(|url| LinkSection {
            listen: true,
            ..LinkSection::new(url)
        });
        config.links = dialled.chain(awaited).collect();
    }
    if let (Some(name), Some(first)) = (&args.brick, config.links.first_mut()) {
        first.brick = Some(name.clone());
    }
    if let Some(path) = &args.robot {
        config = config.with_robot(RobotProfile::read(path)?);
        // What is set by hand is meant for the robot of the file, too.
        for setting in &args.config.settings {
            let section = setting.path.first().map(String::as_str);
            if let Some("robot" | "filter") = section {
                config = config::lay_over(&config, setting)?;
            }
        }
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

/// What a session has left.
struct Session {
    timer: HostTimer,
    folder: PathBuf,
    collector: Collector,
    /// The recording and how many inputs it holds.
    recorded: Option<(PathBuf, u64)>,
    /// The simulated brick, and whether it drove its path to the end: a lap that was cut short cannot be compared with a whole one.
    embedded: Option<(Embedded, bool)>,
    learned: Option<Learned>,
    /// Whether the stamps of signed links were kept.
    kept: Result<()>,
    /// Why the recording ended before the session.
    recording_failure: Option<anyhow::Error>,
}

impl Session {
    /// Whether everything was written that had to be.
    fn whole(self) -> Result<()> {
        self.kept?;
        self.recording_failure
            .map_or(Ok(()), Err)
            .context("the recording is not whole")
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
    let progress = embedded
        .as_ref()
        .map(|embedded| embedded.brick.progress.clone());
    let observed = ObserverConfig {
        events: args.events.as_deref(),
        view: LiveView::new(progress),
    };
    warn_of_open_listeners(&ports, config);
    let recording = folder.join(file_name);
    let recorder = start_recorder(args, &signing.recorded(config), &timer, &recording);
    let mut shard = Shard {
        pipeline,
        ports,
        timer,
        recorder: recorder.at_start()?,
        observer: Observer::start(observed).at_start()?,
        recording_failure: None,
        signing: signing.keep().at_start()?,
    };
    let ending = ending(args, embedded.as_ref(), &stop);
    tokio::select! {
        () = shard.run(&ending) => {}
        () = signals.received() => {}
    }
    let is_whole = embedded
        .as_ref()
        .is_some_and(|embedded| embedded.brick.finished.is_cancelled());
    stop.cancel();
    let kept = shard.keep_last_stamps();
    let recording_failure = shard.recording_failure.take();
    let learned = learned_of(&shard.pipeline, config).at_start()?;
    let (collector, inputs) = close(shard).while_running()?;
    Ok(Session {
        timer,
        folder,
        collector,
        recorded: inputs.map(|inputs| (recording, inputs)),
        embedded: embedded.map(|embedded| (embedded, is_whole)),
        learned,
        kept,
        recording_failure,
    })
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

/// Closes the links, then lets recorder and observer finish what waits.
fn close(shard: Shard) -> Result<(Collector, Option<u64>)> {
    let Shard {
        recorder,
        observer,
        ports,
        ..
    } = shard;
    let unsent: u64 = ports.iter().map(|port| port.counters().drops_out).sum();
    if unsent > 0 {
        say(&format!(
            "{unsent} messages were not sent: a link was down or too slow"
        ));
    }
    drop(ports);
    let recorded = recorder.map(Recorder::finish).transpose()?;
    let (collector, dropped) = observer.finish()?;
    if dropped > 0 {
        tracing::warn!(
            dropped,
            "events were not shown because the terminal was slow"
        );
    }
    Ok((collector, recorded))
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
) -> Result<Option<Recorder>> {
    if args.no_record || !config.record.enabled {
        return Ok(None);
    }
    let header = Header {
        format: posebridge_recording::container::FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros: timer.utc_start(),
        config_toml: toml::to_string(config)
            .context("writing the configuration into the recording")?,
        links: config.links.iter().map(|link| link.url.clone()).collect(),
    };
    Recorder::start(path, &header).map(Some)
}

/// Tables and pictures.
fn finish(
    config: &Config,
    folder: &Path,
    collector: &Collector,
    embedded: Option<(Embedded, bool)>,
    recorded: Option<&(PathBuf, u64)>,
) -> Result<()> {
    let mut title = "live run".to_owned();
    let mut truth = None;
    let mut other = None;
    if let Some((embedded, is_whole)) = embedded {
        title = format!("{}, seed {}", embedded.name, embedded.scenario.seed);
        if is_whole {
            other = Some(steered_the_other_way(config, &embedded)?);
        }
        truth = Some(Truth::of(&embedded.brick.finish()?));
    }
    let mut text = report::sources(collector) + "\n" + &report::links(collector) + "\n";
    if let Some(truth) = &truth {
        text += &report::table(collector, truth, other.as_ref());
        text += "\n";
    }
    for picture in report::draw(folder, &title, collector, truth.as_ref())? {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "picture    {}", picture.display());
    }
    if let Some((recording, inputs)) = recorded {
        let _ = writeln!(text, "recording  {} ({inputs} inputs)", recording.display());
    }
    stdout::print(&text)?;
    Ok(())
}

/// The same world, steered by the brick's own odometry where the run steered by the estimate, and the other way round.
fn steered_the_other_way(config: &Config, embedded: &Embedded) -> Result<Truth> {
    let other = match embedded.scenario.steering {
        Steering::Odometry => Steering::Estimate,
        Steering::Estimate => Steering::Odometry,
    };
    let mut pipeline = config.pipeline()?;
    pipeline.links.retain(|link| link.id == embedded.link);
    let run = virtual_run::run(embedded.scenario.clone().with_steering(other), pipeline)?;
    Ok(Truth::of(&run.simulation))
}

//! `posebridge sim`: simulated bricks in a separate process.
//! It listens for a station, or connects to one, drives its path and writes the truth to a file on request. The truth is never sent
//! over the link. The camera of a brick without MAVLink has a separate link.

#[cfg(feature = "camera")]
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use posebridge_link::HostTimer;
use posebridge_sim::scenario::Personality;
use posebridge_sim::{Scenario, Simulation, Steering, ev3_beacon};
use tokio_util::sync::CancellationToken;

use super::ground_truth::write_truth_file;
use crate::config::load_scenario;
use crate::console::print_line;
use crate::exit::{ExitStage, Failure, Signals};
use crate::flags::{LinkFlag, StationLink};
use crate::runtime::run_in_runtime;
#[cfg(feature = "camera")]
use crate::station::simulator::RenderedPictures;
use crate::station::simulator::{Announcement, BrickDrive, BrickPorts, SimulatedCable, drive};

/// Placeholder for a robot's system in a URL or file name.
const SYSTEM_PLACEHOLDER: &str = "{}";

/// How the simulated brick steers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SteerBy {
    /// By its own odometry.
    Odometry,
    /// By the estimate that the station sends back.
    Estimate,
}

/// Protocol of the simulated robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BrickKind {
    /// MAVLink 2; the camera uses the same link.
    Mavlink,
    /// Direct commands of a LEGO NXT with its original firmware.
    Nxt,
    /// A LEGO NXT with a program that sends compact MAVLink frames.
    NxtPush,
    /// Direct commands of a LEGO EV3 with its original firmware.
    Ev3,
    /// Lines of text from a board that prints; it hears nothing.
    Line,
}

/// The camera's own link to the station, where brick and camera do not share one.
#[derive(Args, Clone, Debug, Default)]
#[group(multiple = false)]
pub struct CameraLink {
    /// Link of the camera of a simulated LEGO brick, which cannot share the brick's link: wait for the station.
    #[arg(long, value_name = "URL")]
    pub camera_listen: Option<String>,
    /// Link of the camera of a simulated LEGO brick: connect to the station.
    #[arg(long, value_name = "URL")]
    pub camera_link: Option<String>,
}

/// Flags of `sim`.
#[derive(Args, Clone, Debug)]
pub struct SimArgs {
    /// Scenario: square, circle, figure-eight, waypoints, straight, rough, thermometer, by-hand, or a TOML file.
    #[arg(default_value = "square")]
    pub scenario: String,
    /// The link to the station.
    #[command(flatten)]
    pub link: StationLink,
    /// Protocol of the robot. Default: that of the scenario (docs/simulator.md).
    #[arg(long, value_enum, value_name = "KIND")]
    pub brick: Option<BrickKind>,
    /// The camera's link, where it has one of its own.
    #[command(flatten)]
    pub camera: CameraLink,
    /// Link for an external camera program: it receives the tag corners of each simulated image as JSON lines, and the simulated
    /// camera sends no fixes (docs/protocols/camera-json.md).
    #[arg(long, value_name = "URL")]
    pub images_listen: Option<String>,
    /// Render the pictures of the simulated camera, with tags on the floor and on the robot, and serve them to
    /// `posebridge run --camera http://IP:PORT/`; the camera sends no fixes then (docs/camera.md).
    #[cfg(feature = "camera")]
    #[arg(long, value_name = "IP:PORT")]
    pub pictures_listen: Option<SocketAddr>,
    /// Announce the simulated EV3 to this UDP address once per second, e.g. udp://127.0.0.1:3015. It must listen on a TCP port of
    /// four digits.
    #[arg(long, value_name = "URL", requires = "listen")]
    pub announce: Option<String>,
    /// Seed. Default: that of the scenario.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Number of laps. Default: that of the scenario.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub laps: Option<u32>,
    /// Pose that the robot steers by. Default: that of the scenario.
    #[arg(long, value_enum)]
    pub steer: Option<SteerBy>,
    /// At the end, write the ground truth to this CSV file. It is never sent over the link.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Number of simulated robots, each with its own wheels, seed and MAVLink system id. In the URL of --listen and in the name
    /// of --truth, {} stands for the system id, e.g. pty:brick-{}.tty. All robots can use one --link.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=250))]
    pub robots: Option<u8>,
}

/// Runs the brick until its path ends or it is stopped.
pub fn execute(args: &SimArgs) -> Result<(), Failure> {
    let scenario = scenario(args).before_start()?;
    let scenarios = match args.robots {
        Some(count) => scenario.side_by_side(count).before_start()?,
        None => vec![scenario],
    };
    let simulations = run_in_runtime(run_bricks(scenarios, args)).before_start()??;
    if let Some(path) = &args.truth {
        for simulation in &simulations {
            write_truth(path, simulation).while_running()?;
        }
    }
    Ok(())
}

fn scenario(args: &SimArgs) -> Result<Scenario> {
    let mut scenario = load_scenario(&args.scenario)?;
    if let Some(seed) = args.seed {
        scenario = scenario.with_seed(seed);
    }
    if let Some(laps) = args.laps {
        scenario = scenario.with_laps(laps);
    }
    if let Some(steer) = args.steer {
        scenario = scenario.with_steering(match steer {
            SteerBy::Odometry => Steering::Odometry,
            SteerBy::Estimate => Steering::Estimate,
        });
    }
    if let Some(kind) = args.brick {
        scenario = scenario.with_personality(match kind {
            BrickKind::Mavlink => Personality::Mavlink,
            BrickKind::Nxt => Personality::Nxt,
            BrickKind::NxtPush => Personality::NxtPush,
            BrickKind::Ev3 => Personality::Ev3,
            BrickKind::Line => Personality::Line,
        });
    }
    #[cfg(feature = "camera")]
    if args.pictures_listen.is_some() {
        scenario = scenario.with_rendered_camera();
    }
    check_links(args, scenario.brick.personality)?;
    check_robots(args, scenario.brick.personality)?;
    Ok(scenario)
}

/// Rejects settings that several robots cannot share.
fn check_robots(args: &SimArgs, personality: Personality) -> Result<()> {
    if args.robots.is_none_or(|count| count == 1) {
        return Ok(());
    }
    if personality != Personality::Mavlink {
        bail!("--robots is for bricks that speak MAVLink; start the others one by one");
    }
    if args.images_listen.is_some() {
        bail!("--robots: the images of several cameras cannot go to one camera program");
    }
    #[cfg(feature = "camera")]
    if args.pictures_listen.is_some() {
        bail!("--robots: the simulated camera renders the tag of one robot only");
    }
    let has_placeholder = |text: &str| text.contains(SYSTEM_PLACEHOLDER);
    if args.link.listen.as_deref().is_some_and(|url| !has_placeholder(url)) {
        bail!(
            "--robots: each robot listens for itself; write {SYSTEM_PLACEHOLDER} for its system, e.g. --listen pty:brick-{{}}.tty"
        );
    }
    if args.truth.as_ref().is_some_and(|path| !has_placeholder(&path.to_string_lossy())) {
        bail!(
            "--robots: each robot has a truth of its own; write {SYSTEM_PLACEHOLDER} for its system, e.g. --truth truth-{{}}.csv"
        );
    }
    Ok(())
}

fn for_system(text: &str, system: u8) -> String {
    text.replace(SYSTEM_PLACEHOLDER, &system.to_string())
}

/// Rejects a link that would stay silent.
fn check_links(args: &SimArgs, personality: Personality) -> Result<()> {
    let has_camera_link = args.camera.camera_listen.is_some() || args.camera.camera_link.is_some();
    if has_camera_link && personality.shares_link_with_camera() {
        bail!("the camera shares the brick's link; it has one of its own with --brick nxt, nxt-push, ev3 or line only");
    }
    if args.announce.is_some() && personality != Personality::Ev3 {
        bail!("--announce is for --brick ev3; other bricks do not announce themselves");
    }
    Ok(())
}

/// Without a truth file the simulation keeps no history, so that it may run for days.
fn simulation(scenario: Scenario, args: &SimArgs) -> Simulation {
    let mut simulation = Simulation::new(scenario);
    if args.images_listen.is_some() {
        simulation = simulation.with_images();
    }
    if args.truth.is_some() { simulation } else { simulation.without_history() }
}

async fn run_bricks(scenarios: Vec<Scenario>, args: &SimArgs) -> Result<Vec<Simulation>, Failure> {
    let timer = HostTimer::start();
    let mut signals = Signals::listen().before_start()?;
    let mut bricks = Vec::new();
    for scenario in scenarios {
        let system = scenario.brick.system;
        let mut link = args.link.flag().before_start()?;
        link.url = for_system(&link.url, system);
        let (ports, endpoint) = ports(args, &link, &scenario, timer).await.before_start()?;
        let simulation = simulation(scenario, args);
        let name = args.robots.map_or_else(|| "brick".to_owned(), |_| format!("brick {system}"));
        print_line(&format!("{name} up, seed {}, {endpoint}", simulation.scenario().seed));
        bricks.push(BrickDrive::unattended(simulation, ports));
    }
    let stop = CancellationToken::new();
    let driving = drive(bricks, timer, &stop);
    tokio::pin!(driving);
    tokio::select! {
        simulations = &mut driving => simulations,
        () = signals.received() => {
            stop.cancel();
            driving.await
        }
    }
    .while_running()
}

/// All open ports of a brick, and a description of them.
async fn ports(
    args: &SimArgs,
    link: &LinkFlag,
    #[cfg_attr(not(feature = "camera"), expect(unused_variables, reason = "only a camera needs it"))]
    scenario: &Scenario,
    timer: HostTimer,
) -> Result<(BrickPorts, String)> {
    let (brick, mut places) = link.open(timer).await?;
    let beacon_port = brick.local_address().map(|address| address.port());
    let mut ports = BrickPorts::of(SimulatedCable::fixed(brick));
    let CameraLink { camera_listen, camera_link } = &args.camera;
    if let Some(camera) = LinkFlag::from_values(camera_listen.as_deref(), camera_link.as_deref()) {
        let (port, place) = camera.open(timer).await?;
        ports.camera = Some(port);
        places = format!("{places}; its camera {place}");
    }
    if let Some(images) = LinkFlag::from_values(args.images_listen.as_deref(), None) {
        let (port, place) = images.open(timer).await?;
        ports.images = Some(port);
        places = format!("{places}; its images {place}");
    }
    #[cfg(feature = "camera")]
    if let Some(address) = args.pictures_listen {
        let listener = TcpListener::bind(address).with_context(|| format!("--pictures-listen {address}"))?;
        let settings = scenario.camera.pictures.clone().unwrap_or_default();
        let pictures = RenderedPictures::start(listener, &settings, scenario.seed, timer)?;
        places = format!("{places}; pictures of its camera: {}", pictures.url());
        ports.pictures = Some(pictures);
    }
    if let Some(announce) = LinkFlag::from_values(None, args.announce.as_deref()) {
        let beacon = beacon_of(beacon_port)?;
        let (port, _) = announce.open(timer).await?;
        ports.announcement = Some(Announcement::new(port, beacon));
    }
    Ok((ports, places))
}

/// The UDP beacon of an EV3 that listens on this port.
fn beacon_of(tcp_port: Option<u16>) -> Result<Vec<u8>> {
    match tcp_port {
        // Four digits is what the clients of the real brick look for.
        Some(number @ 1_000..=9_999) => Ok(ev3_beacon(number)),
        _ => {
            bail!("--announce needs a TCP port of four digits, e.g. --listen tcp://127.0.0.1:5555")
        }
    }
}

fn write_truth(path: &Path, simulation: &Simulation) -> Result<()> {
    let text = write_truth_file(simulation.truth());
    let path = PathBuf::from(for_system(&path.to_string_lossy(), simulation.scenario().brick.system));
    std::fs::write(&path, text).with_context(|| format!("writing the truth to `{}`", path.display()))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::{Cli, Command};

    /// What `posebridge sim square --listen pty:x` with these arguments would simulate.
    fn scenario_of(arguments: &[&str]) -> Result<Scenario> {
        let all = [&["posebridge", "sim", "square", "--listen", "pty:x"], arguments].concat();
        let Some(Command::Sim(args)) = Cli::try_parse_from(all)?.command else {
            bail!("another command");
        };
        scenario(&args)
    }

    #[test]
    fn the_kind_of_brick_is_chosen_by_its_name() {
        let cases = [
            ("mavlink", Personality::Mavlink),
            ("nxt", Personality::Nxt),
            ("nxt-push", Personality::NxtPush),
            ("ev3", Personality::Ev3),
            ("line", Personality::Line),
        ];
        for (name, personality) in cases {
            let scenario = scenario_of(&["--brick", name]).unwrap();
            assert_eq!(scenario.brick.personality, personality);
        }
    }

    #[test]
    fn what_several_robots_cannot_share_is_refused() {
        let scenario_of = |arguments: &[&str]| {
            let all = [&["posebridge", "sim", "--robots", "3"], arguments].concat();
            let Some(Command::Sim(args)) = Cli::try_parse_from(all)?.command else {
                bail!("another command");
            };
            scenario(&args)
        };
        for (arguments, expected) in [
            (&["--listen", "pty:x"][..], "pty:brick-{}.tty"),
            (&["--link", "udp://127.0.0.1:1", "--truth", "t.csv"], "truth-{}.csv"),
            (&["--link", "udp://127.0.0.1:1", "--brick", "nxt"], "speak MAVLink"),
            (&["--link", "udp://127.0.0.1:1", "--images-listen", "udp://:0"], "images"),
        ] {
            let message = scenario_of(arguments).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        assert!(scenario_of(&["--listen", "pty:x-{}", "--truth", "t-{}.csv"]).is_ok());
    }

    #[test]
    fn links_that_would_stay_silent_are_refused() {
        let message = |arguments: &[&str]| scenario_of(arguments).unwrap_err().to_string();
        let camera = message(&["--camera-listen", "udp://:0"]);
        assert!(camera.contains("shares the brick's link"), "{camera}");
        let beacon = message(&["--brick", "nxt", "--announce", "udp://127.0.0.1:3015"]);
        assert!(beacon.contains("--brick ev3"), "{beacon}");
        let both = ["--brick", "nxt", "--camera-listen", "udp://:0", "--camera-link", "udp://x:1"];
        assert!(message(&both).contains("cannot be used with"));
        assert!(scenario_of(&["--brick", "nxt", "--camera-listen", "udp://:0"]).is_ok());
    }
}

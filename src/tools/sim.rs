//! `posebridge sim`: the simulated brick as a process of its own.
//!
//! It waits on a link for a station, or calls one, drives its path and writes the truth to a file if asked. The truth never
//! goes over the link. The camera of a brick that speaks no MAVLink has a link of its own.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use posebridge_link::{HostTimer, Link};
use posebridge_sim::scenario::Personality;
use posebridge_sim::{Scenario, Simulation, Steering, ev3_beacon};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::station_link;
use super::truth_file;
use crate::config::load_scenario;
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::StationLink;
use crate::station::signals::Signals;
use crate::station::simulator::{Announcement, BrickPorts, DriveContext, SimulatedCable, drive};

/// How the simulated brick steers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SteerBy {
    /// By its own dead reckoning.
    Odometry,
    /// By the estimate that comes back.
    Estimate,
}

/// What the simulated brick speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BrickKind {
    /// MAVLink 2, on one link with the camera.
    Mavlink,
    /// The telegrams of a LEGO NXT as it comes out of the box.
    Nxt,
    /// A LEGO NXT whose program pushes compact MAVLink frames.
    NxtPush,
    /// The commands of a LEGO EV3 as it comes out of the box.
    Ev3,
}

/// The camera's own link to the station, where brick and camera do not share one.
#[derive(Args, Clone, Debug, Default)]
#[group(multiple = false)]
pub struct CameraLink {
    /// Wait for the station on this link for the camera of a LEGO brick, which cannot share the brick's.
    #[arg(long, value_name = "URL")]
    pub camera_listen: Option<String>,
    /// Call the station on this link for the camera of a LEGO brick.
    #[arg(long, value_name = "URL")]
    pub camera_link: Option<String>,
}

/// Flags of `sim`.
#[derive(Args, Clone, Debug)]
pub struct SimArgs {
    /// A bundled scenario's name (square, circle, figure-eight, waypoints, straight, rough, thermometer) or a TOML file.
    #[arg(default_value = "square")]
    pub scenario: String,
    /// The link to the station.
    #[command(flatten)]
    pub link: StationLink,
    /// What the brick speaks, instead of what the scenario says (docs/simulated-bricks.md).
    #[arg(long, value_enum, value_name = "KIND")]
    pub brick: Option<BrickKind>,
    /// The camera's link, where it has one of its own.
    #[command(flatten)]
    pub camera: CameraLink,
    /// Play the eye of a camera program, which calls this link: the corners of the tag in each image go there as lines of JSON, and the
    /// simulated camera sends no fixes (docs/protocols/camera-json.md).
    #[arg(long, value_name = "URL")]
    pub images_listen: Option<String>,
    /// Tell this UDP address once per second that there is an EV3, as one on a network does, e.g. udp://127.0.0.1:3015; it has to listen
    /// on a TCP port of four digits.
    #[arg(long, value_name = "URL", requires = "listen")]
    pub announce: Option<String>,
    /// Seed, instead of the scenario's.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Laps, instead of the scenario's.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub laps: Option<u32>,
    /// By what to steer, instead of what the scenario says.
    #[arg(long, value_enum)]
    pub steer: Option<SteerBy>,
    /// Write the truth to this CSV file at the end; it never goes over the link.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
}

/// Runs the brick until its path ends or somebody stops it.
///
/// # Errors
/// The scenario or the link makes no sense, or the truth cannot be written.
pub fn execute(args: &SimArgs) -> Result<(), Failure> {
    let scenario = scenario(args).before_start()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().before_start()?;
    let simulation = runtime.block_on(brick(simulation(scenario, args), args))?;
    if let Some(path) = &args.truth {
        write_truth(path, &simulation).while_running()?;
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
        });
    }
    check_links(args, scenario.brick.personality)?;
    Ok(scenario)
}

/// A link that would stay silent is refused.
fn check_links(args: &SimArgs, personality: Personality) -> Result<()> {
    let has_camera_link = args.camera.camera_listen.is_some() || args.camera.camera_link.is_some();
    if has_camera_link && personality.shares_link_with_camera() {
        bail!("the camera speaks on the brick's link; it has one of its own with --brick nxt, nxt-push or ev3 only");
    }
    if args.announce.is_some() && personality != Personality::Ev3 {
        bail!("--announce is for --brick ev3; other bricks do not announce themselves");
    }
    Ok(())
}

/// The world; without a file for its truth it keeps none, so that it may run for days.
fn simulation(scenario: Scenario, args: &SimArgs) -> Simulation {
    let mut simulation = Simulation::new(scenario);
    if args.images_listen.is_some() {
        simulation = simulation.with_images();
    }
    if args.truth.is_some() { simulation } else { simulation.without_history() }
}

async fn brick(mut simulation: Simulation, args: &SimArgs) -> Result<Simulation, Failure> {
    let timer = HostTimer::start();
    let mut signals = Signals::listen().before_start()?;
    let (mut ports, place) = ports(args, timer).await.before_start()?;
    print_line(&format!("brick up, seed {}, {place}", simulation.scenario().seed));
    let stop = CancellationToken::new();
    let (progress, _) = watch::channel(0.0);
    let company = DriveContext { stop: &stop, progress: &progress, controls: None };
    tokio::select! {
        () = drive(&mut simulation, &mut ports, timer, company) => {}
        () = signals.received() => {}
    }
    Ok(simulation)
}

/// All ports, open, and where they are, for people.
async fn ports(args: &SimArgs, timer: HostTimer) -> Result<(BrickPorts, String)> {
    let (brick, mut place) = open(&args.link, timer).await?;
    let beacon_port = brick.local_address().map(|address| address.port());
    let mut ports = BrickPorts::of(SimulatedCable::fixed(brick));
    let camera = StationLink { listen: args.camera.camera_listen.clone(), link: args.camera.camera_link.clone() };
    if camera.listen.is_some() || camera.link.is_some() {
        let (port, its_place) = open(&camera, timer).await?;
        ports.camera = Some(port);
        place.push_str("; its camera ");
        place.push_str(&its_place);
    }
    if args.images_listen.is_some() {
        let eye = StationLink { listen: args.images_listen.clone(), link: None };
        let (port, its_place) = open(&eye, timer).await?;
        ports.images = Some(port);
        place.push_str("; its images ");
        place.push_str(&its_place);
    }
    if let Some(url) = &args.announce {
        let beacon = beacon_of(beacon_port)?;
        let to = StationLink { listen: None, link: Some(url.clone()) };
        let (port, _) = open(&to, timer).await?;
        ports.announcement = Some(Announcement::new(port, beacon));
    }
    Ok((ports, place))
}

async fn open(link: &StationLink, timer: HostTimer) -> Result<(Link, String)> {
    let mut port = station_link::port(link, timer)?;
    let place = station_link::open(link, &mut port).await?;
    Ok((port, place))
}

/// What an EV3 that listens there says of itself.
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
    let text = truth_file::write(simulation.truth());
    std::fs::write(path, text).with_context(|| format!("writing the truth to `{}`", path.display()))
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
        ];
        for (name, personality) in cases {
            let scenario = scenario_of(&["--brick", name]).unwrap();
            assert_eq!(scenario.brick.personality, personality);
        }
    }

    #[test]
    fn links_that_would_stay_silent_are_refused() {
        let message = |arguments: &[&str]| scenario_of(arguments).unwrap_err().to_string();
        let camera = message(&["--camera-listen", "udp://:0"]);
        assert!(camera.contains("on the brick's link"), "{camera}");
        let beacon = message(&["--brick", "nxt", "--announce", "udp://127.0.0.1:3015"]);
        assert!(beacon.contains("--brick ev3"), "{beacon}");
        let both = ["--brick", "nxt", "--camera-listen", "udp://:0", "--camera-link", "udp://x:1"];
        assert!(message(&both).contains("cannot be used with"));
        assert!(scenario_of(&["--brick", "nxt", "--camera-listen", "udp://:0"]).is_ok());
    }
}

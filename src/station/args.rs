//! Flags of `run`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use posebridge_telemetry::{Arena, Command, Pose};

use crate::config::{FleetSection, PLOTJUGGLER_ADDRESS, Ros2Section};
use crate::flags::{ConfigFlags, DashboardFlags, DetailFlags, LinkFlags, positive};

/// What a run records.
#[derive(Args, Clone, Debug, Default)]
pub struct RecordFlags {
    /// Do not record.
    #[arg(long)]
    pub no_record: bool,
    /// Also keep the pictures of the cameras, in a folder for each beside the recording (docs/camera.md).
    #[arg(long, conflicts_with = "no_record")]
    pub record_video: bool,
    /// Write a telemetry log (.tlog) beside the recording, for other ground stations.
    #[arg(long, conflicts_with = "no_record")]
    pub tlog: bool,
    /// Write an MCAP file for other programs beside the recording: a ROS 2 bag with the estimates (docs/recordings.md).
    #[arg(long, value_name = "PROFILE", conflicts_with = "no_record")]
    pub mcap: Option<McapProfile>,
}

/// The programs that an MCAP file beside the recording is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum McapProfile {
    /// A bag, as `posebridge export --format ros2` makes it.
    Ros2,
}

/// Flags of `run`.
#[derive(Args, Clone, Debug, Default)]
pub struct RunArgs {
    /// Configuration.
    #[command(flatten)]
    pub config: ConfigFlags,
    /// Links, in their order.
    #[command(flatten)]
    pub links: LinkFlags,
    /// Link to a ground station, which sees the robot as a vehicle, e.g. udp://127.0.0.1:14550 or tcp://127.0.0.1:5760. In
    /// addition to the other links. Can be repeated (docs/ground-stations.md).
    #[arg(long = "gcs", value_name = "URL")]
    pub ground_stations: Vec<String>,
    /// Camera above the floor, in whose pictures robots' tags are looked for: its file of `posebridge camera calibrate`, or to
    /// see whether it sees any /dev/video0, http://... of a phone, a video file or a folder of pictures. In addition to the other
    /// links. Can be repeated (docs/camera.md).
    #[arg(long = "camera", value_name = "FILE.toml|SOURCE")]
    pub cameras: Vec<String>,
    /// Protocol of the robot on the first link: mavlink, nxt, nxt-push, ev3, line, columns or camera-json (docs/protocols/mavlink.md).
    #[arg(long, value_name = "PROTOCOL")]
    pub brick: Option<String>,
    /// Use the `[robot]` table of this file: a robot profile or the descriptor of a recording.
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// What is known of a slow sensor: a file of `posebridge identify step --save` (docs/lab/thermometer.md). It stands for
    /// `[robot.sensor]`: it holds for thermometers that are not configured one by one, of robots without a block of their own.
    #[arg(long, value_name = "FILE.toml")]
    pub sensor: Option<PathBuf>,
    /// Filter; `posebridge config schema` lists them.
    #[arg(long, value_name = "NAME")]
    pub filter: Option<String>,
    /// Filters that follow each robot beside the one that sends, separated by commas: their paths, errors and NIS are shown
    /// and recorded.
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    pub compare: Vec<String>,
    /// Seed of the simulated robot. Default: the seed of its scenario.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Number of simulated robots. Each has its own wheels and seed; all connect to one UDP port of the station.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=250))]
    pub robots: Option<u8>,
    /// Stop after this number of laps of the simulated robot. Default: drive until Ctrl-C.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub laps: Option<u32>,
    /// Folder for the recording and the pictures. Default: a new folder named after the time.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// What is recorded.
    #[command(flatten)]
    pub record: RecordFlags,
    /// Write every event to this file, as one JSON object per line.
    #[arg(long, value_name = "FILE")]
    pub events: Option<PathBuf>,
    /// The dashboard.
    #[command(flatten)]
    pub page: DashboardFlags,
    /// What is shown besides.
    #[command(flatten)]
    pub views: ViewFlags,
    /// Set the pose of the first robot that is heard, in metres and degrees. It is recorded as a command. Without it and
    /// without `robot.start` a robot counts from where it starts, until it is seen.
    #[arg(long, value_name = "X,Y,DEGREES", value_parser = Command::parse_pose, allow_hyphen_values = true)]
    pub set_pose: Option<Pose<Arena>>,
    /// How much is printed at the end.
    #[command(flatten)]
    pub detail: DetailFlags,
    /// The stations that this one shares robots with.
    #[command(flatten)]
    pub fleet: FleetFlags,
    /// What happens when the station stands still.
    #[command(flatten)]
    pub watchdog: WatchdogFlags,
    /// At the end, write a robot profile with the learned calibration, for --robot.
    #[arg(long, value_name = "FILE.toml")]
    pub save_calibration: Option<PathBuf>,
    /// At the end, print what was found to be connected, counted or configured wrongly, with the lines of the configuration
    /// that undo it (docs/getting-started.md).
    #[arg(long)]
    pub fix_wiring: bool,
    /// Stop after this number of seconds.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub duration: Option<f64>,
    /// Stop when no link has received a byte for this number of seconds. Counts from the first byte on.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub until_silent: Option<f64>,
}

/// What happens when the station stands still.
#[derive(Args, Clone, Debug, Default)]
pub struct WatchdogFlags {
    /// End with exit code 3 if the station stands still for a second, so that a supervisor can start it again. Without it that
    /// is told only.
    #[arg(long)]
    pub watchdog_exit: bool,
}

/// Stations that this one shares robots with, and nodes of ROS 2.
#[derive(Args, Clone, Debug, Default)]
pub struct FleetFlags {
    /// Share robots with the other stations of this fleet: each robot is served by one of them, and goes on at another one when
    /// that ends or the robot moves (docs/fleet.md).
    #[arg(long, value_name = "NAME")]
    pub fleet: Option<String>,
    /// Station of the fleet to connect to, e.g. tcp/192.168.1.5:7447. Can be repeated.
    #[arg(long, value_name = "ENDPOINT")]
    pub join: Vec<String>,
    /// Where other stations may connect, e.g. tcp/192.168.1.6:7447; without it only those of this computer can. Can be repeated.
    #[arg(long, value_name = "ENDPOINT")]
    pub fleet_listen: Vec<String>,
    /// Publish odometry, pose, transforms and diagnostics for nodes of ROS 2 with this ROS_DOMAIN_ID, over Zenoh (rmw_zenoh).
    /// Default: 0 (docs/ros2.md).
    #[arg(long, value_name = "DOMAIN", num_args = 0..=1, require_equals = true, default_missing_value = "0")]
    pub ros2: Option<u32>,
}

impl FleetFlags {
    /// Sets what is given.
    pub fn apply(&self, section: &mut FleetSection, ros2: &mut Ros2Section) {
        if let Some(name) = &self.fleet {
            section.name.clone_from(name);
        }
        if let Some(domain) = self.ros2 {
            (ros2.enabled, ros2.domain) = (true, domain);
        }
        section.join.extend(self.join.iter().cloned());
        section.listen.extend(self.fleet_listen.iter().cloned());
    }
}

/// What is shown besides the page.
#[derive(Args, Clone, Debug, Default)]
pub struct ViewFlags {
    /// Show map, pose, innovations, links and events in this terminal (docs/dashboard.md). q stops the run, ? explains the other
    /// keys.
    #[arg(long)]
    pub tui: bool,
    /// Send estimates and events as JSON to PlotJuggler's UDP server on this address. Default: 127.0.0.1:9870
    /// (docs/dashboard.md).
    #[arg(
        long,
        value_name = "IP:PORT",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = PLOTJUGGLER_ADDRESS
    )]
    pub plotjuggler: Option<SocketAddr>,
}

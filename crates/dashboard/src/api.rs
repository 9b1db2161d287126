//! The inputs of the dashboard, and its start errors.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use posebridge_telemetry::{DriveGeometry, HostClock, Observation, Odom, Pose, Timestamp};

use crate::cameras::CameraSource;
use crate::feed::SimulatedTruth;
use crate::fleet::FleetSource;
use crate::model::{ArenaRow, Frame, ParameterRow, SimulatorFacts};
use crate::taps::FrameTaps;
use crate::token_file::TokenFileError;

/// Replays a recording and returns its trails, or an error message of one line.
pub(crate) type ReplayLoader = dyn Fn(&Path) -> Result<Frame, String> + Send + Sync;

pub(crate) type HostClockSource = dyn Fn() -> Timestamp<HostClock> + Send + Sync;

/// Ports tried to find a free one.
pub(crate) const MAX_PORT_ATTEMPTS: u16 = 20;

/// When a request needs the token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TokenPolicy {
    /// Clients on addresses other than loopback.
    #[default]
    RemoteOnly,
    Always,
}

/// Dead reckoning by the wheels of one robot.
pub trait DeadReckoning: Send {
    /// Returns the pose after an observation that moved it.
    fn observe(&mut self, observation: &Observation) -> Option<Pose<Odom>>;

    /// Goes on after a restart of the brick, whose clock and counters begin again.
    fn restart_clock(&mut self);
}

type BuildDeadReckoning = dyn Fn(DriveGeometry) -> Box<dyn DeadReckoning> + Send + Sync;

/// The program's dead reckoning, for robots that send no odometry of their own.
#[derive(Clone)]
pub struct DeadReckoningBuilder(Arc<BuildDeadReckoning>);

impl DeadReckoningBuilder {
    pub fn new(build: impl Fn(DriveGeometry) -> Box<dyn DeadReckoning> + Send + Sync + 'static) -> Self {
        Self(Arc::new(build))
    }

    pub(crate) fn build(&self, geometry: DriveGeometry) -> Box<dyn DeadReckoning> {
        (self.0)(geometry)
    }
}

impl fmt::Debug for DeadReckoningBuilder {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("DeadReckoningBuilder")
    }
}

/// The properties of the station that do not change while it runs.
#[derive(Clone, Debug, Default)]
pub struct StationInfo {
    pub version: String,
    pub links: Vec<String>,
    pub parameters: Vec<ParameterRow>,
    /// `None` without a simulated brick.
    pub simulator: Option<SimulatorFacts>,
    pub arena: ArenaRow,
    /// `None` where bricks send their own odometry with their truth.
    pub dead_reckoning: Option<DeadReckoningBuilder>,
    pub token: TokenPolicy,
    /// Holds the tokens; `None`: they are new with every start.
    pub token_file: Option<PathBuf>,
    /// Hosts, each perhaps with a port, under which a proxy serves the page. With any, every request needs a token: those of the proxy come
    /// from this computer.
    pub public_names: Vec<String>,
}

/// The program's functions for the dashboard.
pub struct DashboardInputs {
    pub clock: Box<HostClockSource>,
    /// True poses of the simulated robot; `None` when no more are available for now.
    pub truth: Option<Box<dyn FnMut() -> Option<SimulatedTruth> + Send>>,
    /// Folder of this run's recordings.
    pub recordings: PathBuf,
    pub replay: Box<ReplayLoader>,
    /// Serves the page from this folder instead of from the program.
    pub ui_dir: Option<PathBuf>,
    pub taps: FrameTaps,
    pub cameras: Vec<CameraSource>,
    /// `None` for a station that is in no fleet.
    pub fleet: Option<FleetSource>,
}

/// Why the dashboard cannot start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DashboardStartError {
    #[error(
        "{address} is in use, perhaps by another station; choose another port with `--dashboard IP:PORT`, or `--no-dashboard`"
    )]
    AddressInUse { address: SocketAddr },
    #[error("{address} and the {MAX_PORT_ATTEMPTS} ports behind it are in use; choose one with `--dashboard IP:PORT`")]
    AllPortsInUse { address: SocketAddr },
    #[error("cannot listen on {address}")]
    Bind { address: SocketAddr, source: io::Error },
    #[error("no random bytes for a token")]
    Token { source: getrandom::Error },
    #[error(transparent)]
    TokenFile(#[from] TokenFileError),
    #[error("starting the dashboard's thread")]
    Thread { source: io::Error },
}

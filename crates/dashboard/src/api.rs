//! The inputs of the dashboard, and its start errors.

use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use posebridge_telemetry::{HostClock, Timestamp};

use crate::feed::SimulatedTruth;
use crate::model::{Frame, ParameterRow, SimulatorFacts};
use crate::taps::FrameTaps;

/// Replays a recording and returns its trails, or an error message of one line.
pub(crate) type ReplayLoader = dyn Fn(&Path) -> Result<Frame, String> + Send + Sync;

/// The session's clock.
pub(crate) type HostClockSource = dyn Fn() -> Timestamp<HostClock> + Send + Sync;

/// How many ports are tried to find a free one.
pub(crate) const MAX_PORT_ATTEMPTS: u16 = 20;

/// When a request needs the token.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TokenPolicy {
    /// Clients on other addresses than loopback.
    #[default]
    RemoteOnly,
    /// All clients.
    Always,
}

/// The properties of the station that do not change while it runs.
#[derive(Clone, Debug, Default)]
pub struct StationInfo {
    /// The program's version.
    pub version: String,
    /// The URL of each link, in order.
    pub links: Vec<String>,
    /// Every tunable at the start.
    pub parameters: Vec<ParameterRow>,
    /// The simulated brick, if the station has one of its own.
    pub simulator: Option<SimulatorFacts>,
    /// When a request needs the token.
    pub token: TokenPolicy,
}

/// The program's functions for the dashboard.
pub struct DashboardInputs {
    /// The session's clock.
    pub clock: Box<HostClockSource>,
    /// The true poses of the simulated robot; returns samples until there are no more for now.
    pub truth: Option<Box<dyn FnMut() -> Option<SimulatedTruth> + Send>>,
    /// The folder of this run's recordings.
    pub recordings: PathBuf,
    /// Replays a recording.
    pub replay: Box<ReplayLoader>,
    /// Serves the page from this folder instead of from the program.
    pub ui_dir: Option<PathBuf>,
    /// Readers in this process.
    pub taps: FrameTaps,
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
    #[error("starting the dashboard's thread")]
    Thread { source: io::Error },
}

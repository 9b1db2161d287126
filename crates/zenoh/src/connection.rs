//! How a session reaches others.

use std::path::PathBuf;

use serde_json::json;
use thiserror::Error;
use zenoh::{Config, Session, Wait as _};

/// A frozen station is gone for the others after this time, in milliseconds.
const LEASE_MS: u64 = 2_000;
/// Between attempts to connect, in milliseconds: a station that was frozen has to be back before it would serve alone.
const FIRST_RETRY_MS: u64 = 200;
const LAST_RETRY_MS: u64 = 1_000;

/// Whether stations are looked for by multicast.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scouting {
    /// Only the given endpoints, and what those tell of others.
    #[default]
    Off,
    /// On the local network.
    Multicast,
}

/// How a session reaches others. Endpoints are Zenoh's: `tcp/HOST:PORT` or `tls/HOST:PORT`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Connection {
    /// Endpoints to connect to; they are tried until they answer.
    pub join: Vec<String>,
    /// Endpoints to listen on. A session that listens passes messages on between those that join it. Without one, only programs of this
    /// computer can connect.
    pub listen: Vec<String>,
    pub scouting: Scouting,
    /// A configuration of Zenoh (JSON5), for TLS, users and passwords, access control. What is above counts more.
    pub zenoh_config: Option<PathBuf>,
}

/// Why there is no session.
#[derive(Debug, Error)]
pub enum ConnectionError {
    #[error("`{path}` is no configuration of Zenoh: {why}", path = path.display())]
    File { path: PathBuf, why: String },
    #[error("an endpoint of the fleet is wrong, such as `tcp/192.168.1.5:7447` would be right: {0}")]
    Endpoint(String),
    #[error("Zenoh opens no session: {0}")]
    Open(String),
}

impl Connection {
    /// Opens the session. It must not be called from a runtime's thread.
    pub(crate) fn open(&self) -> Result<Session, ConnectionError> {
        let config = self.to_config()?;
        zenoh::open(config).wait().map_err(|error| ConnectionError::Open(error.to_string()))
    }

    fn to_config(&self) -> Result<Config, ConnectionError> {
        let mut config = match &self.zenoh_config {
            Some(path) => Config::from_file(path)
                .map_err(|error| ConnectionError::File { path: path.clone(), why: error.to_string() })?,
            None => Config::default(),
        };
        // A router passes on between those that cannot reach each other.
        let mode = if self.listen.is_empty() { "peer" } else { "router" };
        let local = vec!["tcp/127.0.0.1:0".to_owned()];
        let listen = if self.listen.is_empty() { &local } else { &self.listen };
        let settings = [
            ("mode", json!(mode)),
            ("connect/endpoints", json!(self.join)),
            ("connect/timeout_ms", json!(-1)),
            ("connect/exit_on_failure", json!(false)),
            ("connect/retry", json!({ "period_init_ms": FIRST_RETRY_MS, "period_max_ms": LAST_RETRY_MS })),
            ("listen/endpoints", json!(listen)),
            ("listen/exit_on_failure", json!(true)),
            ("scouting/multicast/enabled", json!(self.scouting == Scouting::Multicast)),
            ("transport/link/tx/lease", json!(LEASE_MS)),
        ];
        for (key, value) in settings {
            config
                .insert_json5(key, &value.to_string())
                .map_err(|error| ConnectionError::Endpoint(format!("{key} {value}: {error}")))?;
        }
        Ok(config)
    }
}

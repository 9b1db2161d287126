//! Why a scenario cannot be loaded.

use std::io;
use std::path::PathBuf;

/// Why a scenario cannot be loaded. Lines count from 1.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// The text is not TOML, a key is unknown, or a value does not fit; the message shows the line and the key.
    #[error("scenario is not usable: {0}")]
    Toml(toml::de::Error),
    /// `[path.waypoints]` does not say, or says twice, where its points are.
    #[error("scenario is not usable: line {line}: {reason}")]
    Waypoints {
        /// Line of the scenario.
        line: usize,
        /// What is wrong and what to do.
        reason: &'static str,
    },
    /// The file of way-points could not be read.
    #[error("scenario is not usable: line {line}: way-points in {} cannot be read: {source}", file.display())]
    WaypointsUnread {
        /// Line of the scenario that names the file.
        line: usize,
        /// The file, as the scenario names it.
        file: PathBuf,
        /// The parser's error.
        source: io::Error,
    },
    /// A line in the file of way-points does not fit.
    #[error("way-points are not usable: {}, line {line}: {reason}", file.display())]
    WaypointsFile {
        /// The file, as the scenario names it.
        file: PathBuf,
        /// Line of that file; its last one if way-points are missing.
        line: usize,
        /// What is wrong and what to do.
        reason: String,
    },
    /// There are not enough MAVLink systems for the vehicles.
    #[error("{count} robots from system {first} on are too many: at most {most}")]
    TooManyRobots {
        /// How many were asked for.
        count: u8,
        /// The system of the first.
        first: u8,
        /// How many there can be.
        most: u8,
    },
    /// No bundled scenario is called like this.
    #[error("no bundled scenario is called \"{name}\"; there are {known}")]
    UnknownName {
        /// The name that was asked for.
        name: String,
        /// The names that exist, joined by commas.
        known: String,
    },
}

//! Why a run cannot be loaded.

use std::io;

/// Why a run cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// No run, or more than one, goes by this name.
    #[error("{matches} runs begin with `{asked}`: use one of: {known}")]
    Run {
        /// What was asked for.
        asked: String,
        /// How many runs begin so.
        matches: usize,
        /// The names of all runs.
        known: String,
    },
    /// A file path names a value that the run does not have.
    #[error("run `{run}`: {message}")]
    Template {
        /// The run.
        run: String,
        /// What is wrong.
        message: String,
    },
    /// A file could not be read.
    #[error("cannot read {path}: say with --data where the recordings lie")]
    Open {
        /// The file, as the descriptor names it.
        path: String,
        /// The system's error.
        source: io::Error,
    },
    /// A file could not be unpacked.
    #[error("{path} is damaged or not gzip")]
    Gzip {
        /// The file.
        path: String,
        /// The unpacker's error.
        source: io::Error,
    },
    /// A file is larger than any recording of a small robot.
    #[error("{path} unpacks to more than 1 GiB")]
    TooLarge {
        /// The file.
        path: String,
    },
    /// A column's name is not in the header line.
    #[error("{path}: there is no column `{column}`, the header has: {known}")]
    NoColumn {
        /// The file.
        path: String,
        /// The name that the descriptor gives.
        column: String,
        /// The names in the header.
        known: String,
    },
}

//! Foreign files as recordings of ours, so that everything that works on recordings works on them.
//!
//! A telemetry log and a descriptor's run become the inputs that a station would have been given, with a configuration in the header.
//! docs/recordings.md says what is kept and what is lost.

mod command;
mod descriptor;
mod recording;
mod timeline;
mod tlog;

use anyhow::Result;
use posebridge_telemetry::{HostClock, Input, Timestamp};

pub use command::{ImportArgs, execute};
pub use recording::{
    ImportSummary, ImportedSession, InputSource, LoggedInputs, StationOptions, import, logged_frames, recording_bytes,
    session,
};

/// Takes the inputs of a file as they are found.
pub type InputSink<'s> = dyn FnMut(Timestamp<HostClock>, &Input) -> Result<()> + 's;

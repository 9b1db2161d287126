//! The thread that owns the recording's file.

use std::fs::File;
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use posebridge_recording::container::{Header, Writer};
use posebridge_telemetry::{HostClock, Input, Span, Stamp};

use super::gulps::Gulps;

/// So many inputs wait for the disk before the shard waits too: several seconds of a busy link.
const WAITING: usize = 16_384;
/// What was recorded reaches the system at least this often, so that a killed program loses less than a second.
const FLUSH_PERIOD: Span = Span::from_millis(250);

/// A running recorder.
pub struct Recorder {
    sender: SyncSender<(Stamp<HostClock>, Input)>,
    thread: JoinHandle<Result<u64>>,
}

impl Recorder {
    /// Creates the file and starts the thread.
    ///
    /// # Errors
    /// The file cannot be created; one that is there already is never overwritten.
    pub fn start(path: &Path, header: &Header) -> Result<Self> {
        let name = path.display().to_string();
        let file =
            File::create_new(path).with_context(|| format!("creating the recording `{name}`"))?;
        let writer = Writer::create(file, header).with_context(|| format!("recording `{name}`"))?;
        let (sender, receiver) = sync_channel(WAITING);
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || {
                write(writer, Gulps::new(receiver)).with_context(|| format!("recording `{name}`"))
            })
            .context("starting the recorder's thread")?;
        Ok(Self { sender, thread })
    }

    /// Records an input; waits if the disk is behind.
    ///
    /// # Errors
    /// The recorder has stopped, because its file could not be written.
    pub fn record(&self, now: Stamp<HostClock>, input: Input) -> Result<()> {
        self.sender
            .send((now, input))
            .map_err(|_gone| anyhow!("the recorder has stopped"))
    }

    /// Writes what still waits, ends the file and says how many inputs it holds.
    ///
    /// # Errors
    /// The file could not be written.
    pub fn finish(self) -> Result<u64> {
        drop(self.sender);
        self.thread
            .join()
            .map_err(|_panic| anyhow!("the recorder's thread died"))?
    }
}

fn write(mut writer: Writer<File>, mut inputs: Gulps<(Stamp<HostClock>, Input)>) -> Result<u64> {
    let mut recorded = 0;
    let mut flushed = Stamp::<HostClock>::ZERO;
    loop {
        match inputs.next(Duration::from_nanos(FLUSH_PERIOD.as_nanos().unsigned_abs())) {
            Ok((now, input)) => {
                writer.record(now, &input)?;
                recorded += 1;
                if now - flushed >= FLUSH_PERIOD {
                    writer.flush()?;
                    flushed = now;
                }
            }
            Err(RecvTimeoutError::Timeout) => writer.flush()?,
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    writer.finish()?;
    Ok(recorded)
}

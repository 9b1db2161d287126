//! Writes the outputs of a session as a ROS 2 bag beside the recording, by a thread for which the station loop never waits. It is one file
//! in chunks of a second: after a crash everything before the last flush is readable.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use posebridge_recording::ros2::RosBagWriter;
use posebridge_telemetry::{Event, HostClock, Timestamp};

use super::live_log::{LiveLog, write_while_sent};
use super::recording_parts::WatchedFile;
use super::writer_thread::WriterThread;

/// Queued batches of events, one for each input; further ones are dropped.
const QUEUE_CAPACITY: usize = 8_192;

pub(super) struct EventBatch {
    now: Timestamp<HostClock>,
    events: Arc<[Event]>,
}

pub struct BagRecorder {
    pub path: PathBuf,
    sender: Sender<EventBatch>,
    thread: WriterThread<u64>,
    queued: u64,
    dropped: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagWritten {
    pub path: PathBuf,
    pub messages: u64,
    /// Inputs whose outputs are missing because the disk was too slow.
    pub dropped: u64,
}

impl BagRecorder {
    /// Creates the file and starts the thread. `utc_start_micros` is the date at the host clock's zero. The bag ends when the disk has less
    /// free space than `floor_bytes`. Never overwrites a file.
    pub fn start(path: &Path, utc_start_micros: u64, floor_bytes: u64) -> Result<Self> {
        let (out, file) = WatchedFile::create("ROS 2 bag", path)?;
        let bag = RosBagWriter::create(out, utc_start_micros).with_context(|| file.name())?;
        let (sender, batches) = bounded(QUEUE_CAPACITY);
        let thread = WriterThread::spawn("ros2-bag", move |written| write(bag, &batches, &file, floor_bytes, written))?;
        Ok(Self { path: path.to_owned(), sender, thread, queued: 0, dropped: 0 })
    }

    /// Fails if the bag has stopped because of a write error: [`Self::finish`] returns it.
    pub fn record(&mut self, now: Timestamp<HostClock>, events: &Arc<[Event]>) -> Result<()> {
        if events.is_empty() {
            return Ok(());
        }
        match self.sender.try_send(EventBatch { now, events: Arc::clone(events) }) {
            Ok(()) => self.queued += 1,
            Err(TrySendError::Full(_)) => self.dropped += 1,
            Err(TrySendError::Disconnected(_)) => return Err(anyhow!("the ROS 2 bag has stopped")),
        }
        Ok(())
    }

    pub fn finish(self) -> Result<BagWritten> {
        drop(self.sender);
        let messages = self.thread.wait(self.queued).with_context(|| format!("`{}`", self.path.display()))?;
        Ok(BagWritten { path: self.path, messages, dropped: self.dropped })
    }
}

/// Writes until all senders are dropped; returns the number of messages.
fn write(
    bag: RosBagWriter<File>,
    batches: &Receiver<EventBatch>,
    file: &WatchedFile,
    floor_bytes: u64,
    count: &AtomicU64,
) -> Result<u64> {
    let bag = write_while_sent(bag, batches, file, floor_bytes, count)?;
    let (_, messages) = bag.finish().with_context(|| file.name())?;
    file.sync()?;
    // A deleted file counts as not written.
    file.file_size()?;
    Ok(messages)
}

impl LiveLog for RosBagWriter<File> {
    type Item = EventBatch;

    fn write(&mut self, batch: &EventBatch) -> Result<Timestamp<HostClock>> {
        for event in &*batch.events {
            self.record(batch.now, event)?;
        }
        Ok(batch.now)
    }

    fn flush(&mut self) -> Result<()> {
        Ok(Self::flush(self)?)
    }
}

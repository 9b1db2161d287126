//! A file that a thread writes beside the recording, for which the station loop never waits: what comes is written at once, flushed each second,
//! and synced to the disk as often as the recording.
//!
//! Such a file is a single one; a deleted file, or a disk without space, ends it with an error, and the recording goes on.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::recording_parts::{SYNC_PERIOD, WatchedFile};
use super::writer_thread::WriterThread;

/// Period of flushes and of the checks of file and disk.
const FLUSH_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// The format of a [`SideFile`].
pub trait SideFileFormat: Send + Sized + 'static {
    type Item: Send;
    /// The name of the file's kind, for people.
    const KIND: &'static str;
    /// Name of the thread.
    const THREAD: &'static str;
    /// Items that wait for the disk at most; further ones are dropped.
    const QUEUE_CAPACITY: usize;

    /// Returns the time of the item.
    fn write(&mut self, item: &Self::Item) -> Result<Timestamp<HostClock>>;
    fn flush(&mut self) -> Result<()>;
    /// Ends the file; returns the number of its records.
    fn finish(self) -> Result<u64>;
}

pub struct SideFile<F: SideFileFormat> {
    path: PathBuf,
    sender: Sender<F::Item>,
    thread: WriterThread<u64>,
    queued: u64,
    dropped: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenSideFile {
    pub path: PathBuf,
    pub records: u64,
    /// Items that are missing because the disk was too slow.
    pub dropped: u64,
}

impl<F: SideFileFormat> SideFile<F> {
    /// Creates the file and starts its thread. The file ends when the disk has less free space than `floor_bytes`. Never overwrites a file.
    pub fn start(path: &Path, floor_bytes: u64, open: impl FnOnce(File) -> Result<F>) -> Result<Self> {
        let (out, file) = WatchedFile::create(F::KIND, path)?;
        let format = open(out).with_context(|| file.name())?;
        let (sender, items) = bounded(F::QUEUE_CAPACITY);
        let write = move |written: &AtomicU64| write_while_sent(format, &items, &file, floor_bytes, written);
        let thread = WriterThread::spawn(F::THREAD, write)?;
        Ok(Self { path: path.to_owned(), sender, thread, queued: 0, dropped: 0 })
    }

    /// Fails if the file has ended because of a write error: [`Self::finish`] returns it.
    pub fn offer(&mut self, item: F::Item) -> Result<()> {
        match self.sender.try_send(item) {
            Ok(()) => self.queued += 1,
            Err(TrySendError::Full(_)) => self.dropped += 1,
            Err(TrySendError::Disconnected(_)) => return Err(anyhow!("the {} has stopped", F::KIND)),
        }
        Ok(())
    }

    pub fn finish(self) -> Result<WrittenSideFile> {
        drop(self.sender);
        let records = self.thread.wait(self.queued).with_context(|| format!("`{}`", self.path.display()))?;
        Ok(WrittenSideFile { path: self.path, records, dropped: self.dropped })
    }
}

/// Writes until all senders are dropped; counts the items and returns the number of records.
fn write_while_sent<F: SideFileFormat>(
    mut format: F,
    items: &Receiver<F::Item>,
    file: &WatchedFile,
    floor_bytes: u64,
    count: &AtomicU64,
) -> Result<u64> {
    let (mut flushed, mut synced) = (Timestamp::<HostClock>::ZERO, Timestamp::<HostClock>::ZERO);
    let (mut is_synced, mut silent_flushes) = (true, 0);
    let flush_timeout = Duration::from_nanos(FLUSH_PERIOD.as_nanos().unsigned_abs());
    loop {
        let is_due = match items.recv_timeout(flush_timeout) {
            Ok(item) => {
                let now = format.write(&item).with_context(|| file.name())?;
                count.fetch_add(1, Ordering::Relaxed);
                (is_synced, silent_flushes) = (false, 0);
                let is_due = now - flushed >= FLUSH_PERIOD;
                if is_due {
                    flushed = now;
                }
                is_due
            }
            Err(RecvTimeoutError::Timeout) => {
                silent_flushes += 1;
                true
            }
            Err(RecvTimeoutError::Disconnected) => break,
        };
        if is_due {
            format.flush().with_context(|| file.name())?;
            // Without items their times do not show that a sync is due.
            let is_silent = silent_flushes == SYNC_PERIOD.as_nanos() / FLUSH_PERIOD.as_nanos();
            if !is_synced && (is_silent || flushed - synced >= SYNC_PERIOD) {
                file.sync()?;
                (is_synced, synced) = (true, flushed);
            }
            file.file_size()?;
            file.check_free_space(floor_bytes)?;
        }
    }
    let records = format.finish().with_context(|| file.name())?;
    file.sync()?;
    // A deleted file counts as not written.
    file.file_size()?;
    Ok(records)
}

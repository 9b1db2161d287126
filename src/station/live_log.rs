//! The loop of a thread that writes a file beside the recording: what comes is written at once, flushed each second, and synced to the disk
//! as often as the recording.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use crossbeam_channel::{Receiver, RecvTimeoutError};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::recording_parts::{SYNC_PERIOD, WatchedFile};

/// Period of flushes and of the checks of file and disk.
const FLUSH_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

pub(super) trait LiveLog {
    type Item;
    /// Returns the time of the item.
    fn write(&mut self, item: &Self::Item) -> Result<Timestamp<HostClock>>;
    fn flush(&mut self) -> Result<()>;
}

/// Writes until all senders are dropped; counts the items. Fails when the file is gone, or the disk has less free space than
/// `floor_bytes`.
pub(super) fn write_while_sent<L: LiveLog>(
    mut log: L,
    items: &Receiver<L::Item>,
    file: &WatchedFile,
    floor_bytes: u64,
    count: &AtomicU64,
) -> Result<L> {
    let (mut flushed, mut synced) = (Timestamp::<HostClock>::ZERO, Timestamp::<HostClock>::ZERO);
    let (mut is_synced, mut silent_flushes) = (true, 0);
    let flush_timeout = Duration::from_nanos(FLUSH_PERIOD.as_nanos().unsigned_abs());
    loop {
        let is_due = match items.recv_timeout(flush_timeout) {
            Ok(item) => {
                let now = log.write(&item).with_context(|| file.name())?;
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
            Err(RecvTimeoutError::Disconnected) => return Ok(log),
        };
        if is_due {
            log.flush().with_context(|| file.name())?;
            // In a silence no item brings it about.
            let is_silent = silent_flushes == SYNC_PERIOD.as_nanos() / FLUSH_PERIOD.as_nanos();
            if !is_synced && (is_silent || flushed - synced >= SYNC_PERIOD) {
                file.sync()?;
                (is_synced, synced) = (true, flushed);
            }
            file.file_size()?;
            file.check_free_space(floor_bytes)?;
        }
    }
}

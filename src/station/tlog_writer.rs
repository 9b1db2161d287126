//! The thread that writes a telemetry log beside the recording: what came and what was sent, as ground stations keep it.
//!
//! It hangs off the same place as the recorder but never makes the station loop wait: what does not fit into its queue is dropped
//! and counted, because the recording is whole without it. The frames are found here and not in the station loop.
//!
//! It is one file, however long the run, because its readers know no parts. Once a second it is looked at as a recording is: one that was
//! taken away, and one on a disk without room, ends with a reason.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TrySendError, bounded};
use posebridge_station::LinkConfig;
use posebridge_telemetry::{HostClock, Input, LinkId, PeerId, Priority, TimeDelta, Timestamp};

use super::traffic_log::TrafficLog;
use super::watched_file::WatchedFile;

/// Most chunks and frames that wait for the disk; further ones are dropped.
const QUEUE_CAPACITY: usize = 16_384;
/// What was written reaches the system at least this often; then file and disk are looked at.
const FLUSH_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// Bytes on their way to the file.
struct Traffic {
    now: Timestamp<HostClock>,
    link: LinkId,
    direction: Direction,
    bytes: Vec<u8>,
}

/// Which way they went.
enum Direction {
    /// A chunk that one peer of the link has sent.
    In(PeerId),
    /// One frame that was sent.
    Out(Priority),
}

/// A running recorder of a telemetry log.
pub struct TlogRecorder {
    /// Where it is written.
    pub path: PathBuf,
    sender: Sender<Traffic>,
    thread: JoinHandle<Result<u64>>,
    dropped: u64,
}

/// What a telemetry log has become.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlogWritten {
    /// Where it is.
    pub path: PathBuf,
    /// Frames in it.
    pub frames: u64,
    /// Chunks and frames that are missing in it because the disk was too slow.
    pub dropped: u64,
}

impl TlogRecorder {
    /// Creates the file and starts the thread. `utc_start_micros` is the date at the host clock's zero; of links whose bricks speak no
    /// MAVLink nothing is written. The log ends when the disk has less room than `floor_bytes`.
    ///
    /// # Errors
    /// The file cannot be created; one that is there already is never overwritten.
    pub fn start(path: &Path, utc_start_micros: u64, links: &[LinkConfig], floor_bytes: u64) -> Result<Self> {
        let (out, file) = WatchedFile::create("telemetry log", path)?;
        let (sender, traffic) = bounded(QUEUE_CAPACITY);
        let log = TrafficLog::new(BufWriter::new(out), utc_start_micros, links);
        let thread = std::thread::Builder::new()
            .name("tlog".to_owned())
            .spawn(move || write(log, &traffic, &file, floor_bytes))
            .context("starting the telemetry log's thread")?;
        Ok(Self { path: path.to_owned(), sender, thread, dropped: 0 })
    }

    /// Takes note of what was given to the station.
    ///
    /// # Errors
    /// The file could not be written; nothing more is taken.
    pub fn received(&mut self, now: Timestamp<HostClock>, input: &Input) -> Result<()> {
        let Input::Bytes { link, peer, bytes } = input else {
            return Ok(());
        };
        self.offer(Traffic { now, link: *link, direction: Direction::In(*peer), bytes: bytes.clone() })
    }

    /// Takes note of a frame that was sent.
    ///
    /// # Errors
    /// The file could not be written; nothing more is taken.
    pub fn sent(&mut self, now: Timestamp<HostClock>, link: LinkId, priority: Priority, frame: &[u8]) -> Result<()> {
        self.offer(Traffic { now, link, direction: Direction::Out(priority), bytes: frame.to_vec() })
    }

    /// Writes what still waits and ends the file.
    ///
    /// # Errors
    /// The file could not be written.
    pub fn finish(self) -> Result<TlogWritten> {
        drop(self.sender);
        let frames = self.thread.join().map_err(|_panic| anyhow!("the telemetry log's thread died"))??;
        Ok(TlogWritten { path: self.path, frames, dropped: self.dropped })
    }

    fn offer(&mut self, traffic: Traffic) -> Result<()> {
        match self.sender.try_send(traffic) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => {
                self.dropped += 1;
                Ok(())
            }
            Err(TrySendError::Disconnected(_)) => Err(anyhow!("the telemetry log has stopped")),
        }
    }
}

/// Writes until all senders are gone, and returns the number of frames.
fn write(
    mut log: TrafficLog<BufWriter<File>>,
    traffic: &Receiver<Traffic>,
    file: &WatchedFile,
    floor_bytes: u64,
) -> Result<u64> {
    let mut flushed = Timestamp::<HostClock>::ZERO;
    let patience = Duration::from_nanos(FLUSH_PERIOD.as_nanos().unsigned_abs());
    loop {
        let is_due = match traffic.recv_timeout(patience) {
            Ok(one) => {
                let written = match one.direction {
                    Direction::In(peer) => log.received(one.now, one.link, peer, &one.bytes),
                    Direction::Out(priority) => log.sent(one.now, one.link, priority, &one.bytes),
                };
                written.with_context(|| file.name())?;
                let is_due = one.now - flushed >= FLUSH_PERIOD;
                if is_due {
                    flushed = one.now;
                }
                is_due
            }
            Err(RecvTimeoutError::Timeout) => true,
            Err(RecvTimeoutError::Disconnected) => break,
        };
        if is_due {
            log.flush().with_context(|| file.name())?;
            file.file_size()?;
            file.check_free_space(floor_bytes)?;
        }
    }
    let (_, frames) = log.finish().with_context(|| file.name())?;
    // A deleted file counts as not written.
    file.file_size()?;
    Ok(frames)
}

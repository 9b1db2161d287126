//! The thread that writes the stamps down while a session runs: a disk that hangs must not hold up a robot.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, anyhow};
use posebridge_pipeline::Pipeline;
use posebridge_protocol::signing::{Ending, Key, Memory};
use posebridge_telemetry::{HostClock, LinkId, Span, Stamp};

use super::state_file::StateFile;
use crate::config::MemoryRecord;

/// How often the stamps are written down: twice as often as the second that is promised, because a shard may sleep for a second
/// when nothing happens. [`Memory::LARGEST_LOSS`] is what may at most go wrong with it.
const PERIOD: Span = Span::from_millis(500);

/// A link whose stamps are kept.
#[derive(Debug)]
pub(super) struct Kept {
    /// The link.
    pub(super) link: LinkId,
    /// Its key.
    pub(super) key: Key,
    /// Where its stamps are kept.
    pub(super) file: StateFile,
    /// What it began with.
    pub(super) begun: Memory,
}

/// The stamps of all signed links at one instant, in the order of the links that are kept.
struct Snapshot {
    memories: Vec<Option<Memory>>,
    ending: Ending,
}

/// Keeps the stamps of a running session.
#[derive(Debug)]
pub struct Keeper {
    links: Vec<LinkId>,
    sender: SyncSender<Snapshot>,
    thread: JoinHandle<Result<()>>,
    /// When the next writing is due.
    due: Stamp<HostClock>,
    /// How many streams had been met at the last one.
    met: u64,
}

impl Keeper {
    /// Writes down that a session has begun, before anything is signed, and starts the thread.
    ///
    /// # Errors
    /// The stamps cannot be written.
    pub(super) fn start(kept: Vec<Kept>) -> Result<Self> {
        for link in &kept {
            let record = MemoryRecord::of(&link.key, &link.begun);
            link.file.write(&record, Ending::Cut)?;
        }
        let links = kept.iter().map(|kept| kept.link).collect();
        let (sender, snapshots) = sync_channel(1);
        let thread = std::thread::Builder::new()
            .name("signing".to_owned())
            .spawn(move || write_all(&kept, &snapshots))
            .context("starting the thread that keeps the stamps of signatures")?;
        Ok(Self {
            links,
            sender,
            thread,
            due: Stamp::ZERO + PERIOD,
            met: 0,
        })
    }

    /// Has the stamps written down if it is time or if somebody new was heard. Never waits: while the disk is behind, the next
    /// call tries again.
    pub fn offer(&mut self, now: Stamp<HostClock>, pipeline: &Pipeline) {
        let met = pipeline.signing_streams_met();
        if now < self.due && met == self.met {
            return;
        }
        let snapshot = self.snapshot(now, pipeline, Ending::Cut);
        if let Err(TrySendError::Full(_)) = self.sender.try_send(snapshot) {
            return;
        }
        (self.due, self.met) = (now + PERIOD, met);
    }

    /// Writes down where the session has ended, and that it has.
    ///
    /// # Errors
    /// The last stamps could not be written: the next session goes on as after a crash.
    pub fn finish(self, now: Stamp<HostClock>, pipeline: &Pipeline) -> Result<()> {
        let last = self.snapshot(now, pipeline, Ending::Closed);
        // A thread that has died says so below.
        drop(self.sender.send(last));
        drop(self.sender);
        self.thread
            .join()
            .map_err(|_panic| anyhow!("the thread that keeps the stamps of signatures died"))?
    }

    fn snapshot(&self, now: Stamp<HostClock>, pipeline: &Pipeline, ending: Ending) -> Snapshot {
        let memories = self
            .links
            .iter()
            .map(|id| pipeline.signing_memory(*id, now));
        Snapshot {
            memories: memories.collect(),
            ending,
        }
    }
}

/// Writes every snapshot; the result is that of the last.
fn write_all(kept: &[Kept], snapshots: &Receiver<Snapshot>) -> Result<()> {
    let mut last = Ok(());
    for snapshot in snapshots {
        let result = write(kept, &snapshot);
        if let (Err(error), Ok(())) = (&result, &last) {
            tracing::error!(
                error = format!("{error:#}"),
                "the stamps of signatures cannot be kept: after a crash frames of this session could be sent again"
            );
        }
        last = result;
    }
    last
}

fn write(kept: &[Kept], snapshot: &Snapshot) -> Result<()> {
    for (link, memory) in kept.iter().zip(&snapshot.memories) {
        if let Some(memory) = memory {
            let record = MemoryRecord::of(&link.key, memory);
            link.file.write(&record, snapshot.ending)?;
        }
    }
    Ok(())
}

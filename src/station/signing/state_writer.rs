//! The thread that saves the signing timestamps during a session: a blocked disk must not delay a robot.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use anyhow::{Context, Result};
use crossbeam_channel::{Receiver, Sender, bounded};
use posebridge_protocol::signing::{ShutdownKind, SigningConfig, SigningState};
use posebridge_station::Station;
use posebridge_telemetry::{HostClock, LinkId, Timestamp};

use super::files::StateFile;
use crate::config::MemoryRecord;
use crate::station::writer_thread::{END_TIMEOUT, WriterThread};

#[derive(Debug)]
pub(super) struct SignedLink {
    pub(super) name: String,
    pub(super) link: LinkId,
    pub(super) signing: SigningConfig,
    pub(super) file: StateFile,
}

/// The timestamps of all signed links at one instant, in the order of `SignedLink`s.
struct StateSnapshot {
    memories: Vec<Option<SigningState>>,
    ending: ShutdownKind,
}

#[derive(Debug)]
pub struct SigningStateWriter {
    links: Vec<LinkId>,
    sender: Sender<StateSnapshot>,
    /// Whether the thread is writing a snapshot. Meanwhile none is taken: copying all streams for every datagram would delay the
    /// station loop.
    is_writing: Arc<AtomicBool>,
    thread: WriterThread<()>,
    queued: u64,
    due: Timestamp<HostClock>,
    /// Number of streams in the last snapshot.
    known_streams: u64,
}

impl SigningStateWriter {
    /// Saves the start of a session, before anything is signed, and starts the thread.
    pub(super) fn start(kept: Vec<SignedLink>) -> Result<Self> {
        for link in &kept {
            let record = MemoryRecord::of(&link.signing.key, &link.signing.state);
            link.file.write(&record, ShutdownKind::Interrupted)?;
        }
        let links = kept.iter().map(|kept| kept.link).collect();
        let (sender, snapshots) = bounded(1);
        let is_writing = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&is_writing);
        let thread = WriterThread::spawn("signing", move |written| write_all(&kept, &snapshots, &flag, written))?;
        Ok(Self {
            links,
            sender,
            is_writing,
            thread,
            queued: 0,
            due: Timestamp::ZERO + SigningState::WRITE_PERIOD,
            known_streams: 0,
        })
    }

    /// Saves the timestamps periodically, and when there is a new sender. Never waits: while the disk is behind, the next call tries
    /// again.
    pub fn save_if_due(&mut self, now: Timestamp<HostClock>, station: &Station) {
        let met = station.signing_stream_count();
        if now < self.due && met == self.known_streams || self.is_writing.load(Ordering::Acquire) {
            return;
        }
        self.is_writing.store(true, Ordering::Release);
        let snapshot = self.snapshot(now, station, ShutdownKind::Interrupted);
        // There is room, since nothing is being written; a thread that has died says so at the end.
        drop(self.sender.try_send(snapshot));
        self.queued += 1;
        (self.due, self.known_streams) = (now + SigningState::WRITE_PERIOD, met);
    }

    /// Saves the final timestamps and that the session has ended. If that fails, the next session continues as after a crash.
    pub fn finish(self, now: Timestamp<HostClock>, station: &Station) -> Result<()> {
        let last = self.snapshot(now, station, ShutdownKind::Clean);
        // A thread that has died says so below.
        drop(self.sender.send_timeout(last, END_TIMEOUT));
        drop(self.sender);
        self.thread.wait(self.queued + 1).context("keeping the stamps of signatures")
    }

    fn snapshot(&self, now: Timestamp<HostClock>, station: &Station, ending: ShutdownKind) -> StateSnapshot {
        let memories = self.links.iter().map(|id| station.signing_state(*id, now));
        StateSnapshot { memories: memories.collect(), ending }
    }
}

/// Writes every snapshot; returns the result of the last.
fn write_all(
    kept: &[SignedLink],
    snapshots: &Receiver<StateSnapshot>,
    is_writing: &AtomicBool,
    written: &AtomicU64,
) -> Result<()> {
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
        written.fetch_add(1, Ordering::Relaxed);
        is_writing.store(false, Ordering::Release);
    }
    last
}

/// Writes all links; returns the first error.
fn write(kept: &[SignedLink], snapshot: &StateSnapshot) -> Result<()> {
    let mut first = Ok(());
    for (link, memory) in kept.iter().zip(&snapshot.memories) {
        if let Some(memory) = memory {
            let record = MemoryRecord::of(&link.signing.key, memory);
            let written = link.file.write(&record, snapshot.ending);
            first = first.and(written.with_context(|| link.name.clone()));
        }
    }
    first
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    use posebridge_protocol::signing::{Key, SigningTime, UnsignedPolicy};

    use crate::config::Config;

    fn kept(folder: &Path, link: u16) -> SignedLink {
        std::fs::create_dir_all(folder).unwrap();
        SignedLink {
            name: format!("link {link}"),
            link: LinkId(link),
            signing: SigningConfig {
                key: Key::from_bytes([link as u8; 32]),
                link_id: 0,
                unsigned: UnsignedPolicy::Accept,
                state: SigningState::default(),
            },
            file: StateFile::lock(&folder.join("a.key"), 0).unwrap(),
        }
    }

    #[test]
    fn a_link_that_cannot_be_written_keeps_none_behind_it_from_being_written() {
        let root = tempfile::tempdir().unwrap();
        let folders = [1, 2, 3].map(|link| root.path().join(format!("stick-{link}")));
        let links: Vec<SignedLink> = folders.iter().zip(1..).map(|(folder, link)| kept(folder, link)).collect();
        for removed in &folders[..2] {
            std::fs::remove_dir_all(removed).unwrap();
        }
        let memory = SigningState { last_sent: SigningTime::from_units(7), ..SigningState::default() };
        let snapshot = StateSnapshot { memories: vec![Some(memory.clone()); 3], ending: ShutdownKind::Clean };
        let error = format!("{:#}", write(&links, &snapshot).unwrap_err());
        assert!(error.starts_with("link 1: "), "{error}");
        let read = links[2].file.read(&links[2].signing.key).unwrap();
        assert_eq!(read, Some((memory, ShutdownKind::Clean)));
    }

    #[test]
    fn while_the_disk_is_behind_no_snapshot_is_taken() {
        let station = Station::new(Config::default().station_config().unwrap(), Timestamp::ZERO).unwrap();
        let (sender, snapshots) = bounded(1);
        let mut keeper = SigningStateWriter {
            links: vec![],
            sender,
            is_writing: Arc::new(AtomicBool::new(false)),
            thread: WriterThread::spawn("signing", |_| Ok(())).unwrap(),
            queued: 0,
            due: Timestamp::ZERO,
            known_streams: 0,
        };
        let late = Timestamp::ZERO + SigningState::MAX_WRITE_GAP;
        keeper.save_if_due(late, &station);
        assert!(snapshots.try_recv().is_ok());
        assert!(keeper.is_writing.load(Ordering::Acquire));
        let later = late + SigningState::MAX_WRITE_GAP;
        keeper.save_if_due(later, &station);
        assert!(snapshots.try_recv().is_err(), "nobody has written the first");
        keeper.is_writing.store(false, Ordering::Release);
        keeper.save_if_due(later, &station);
        assert!(snapshots.try_recv().is_ok(), "the one that was put off");
    }

    #[test]
    fn the_thread_says_when_it_can_take_more() {
        let root = tempfile::tempdir().unwrap();
        let (sender, snapshots) = bounded(1);
        let nothing_new = StateSnapshot { memories: vec![None], ending: ShutdownKind::Interrupted };
        sender.send(nothing_new).unwrap();
        drop(sender);
        let is_writing = AtomicBool::new(true);
        write_all(&[kept(root.path(), 1)], &snapshots, &is_writing, &AtomicU64::new(0)).unwrap();
        assert!(!is_writing.load(Ordering::Acquire));
    }
}

//! Writes the received and sent frames of a session as a telemetry log: offline by [`TrafficLog`], live by a thread beside the
//! recording ([`TlogRecorder`]), for which the station loop never waits: the recording is complete without the log. It is one file,
//! because its readers support no parts; a deleted file, or a disk without space, ends it with an error.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;

use anyhow::{Context, Result, anyhow};
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, VerifiedFrame, verify};
use posebridge_protocol::routing::MAX_PEERS;
use posebridge_recording::tlog::{LINK_BITS, TlogWriter};
use posebridge_station::{AcceptedVersions, LinkConfig};
use posebridge_telemetry::{HostClock, Input, LinkId, PeerId, Priority, Timestamp};

use super::live_log::{LiveLog, write_while_sent};
use super::recording_parts::WatchedFile;
use super::writer_thread::WriterThread;

/// Queued chunks and frames; further ones are dropped.
const QUEUE_CAPACITY: usize = 16_384;

pub(super) struct Traffic {
    now: Timestamp<HostClock>,
    link: LinkId,
    direction: Direction,
    bytes: Vec<u8>,
}

enum Direction {
    /// A chunk from one peer of the link.
    In(PeerId),
    Out(Priority),
}

pub struct TlogRecorder {
    pub path: PathBuf,
    sender: Sender<Traffic>,
    thread: WriterThread<u64>,
    queued: u64,
    dropped: u64,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlogWritten {
    pub path: PathBuf,
    pub frames: u64,
    /// Chunks and frames lost because the disk was too slow.
    pub dropped: u64,
}

impl TlogRecorder {
    /// Creates the file and starts the thread. `utc_start_micros` is the date at the host clock's zero; links whose bricks do not use
    /// MAVLink are not logged. The log ends when the disk has less free space than `floor_bytes`. Never overwrites a file.
    pub fn start(path: &Path, utc_start_micros: u64, links: &[LinkConfig], floor_bytes: u64) -> Result<Self> {
        let (out, file) = WatchedFile::create("telemetry log", path)?;
        let (sender, traffic) = bounded(QUEUE_CAPACITY);
        let log = TrafficLog::new(BufWriter::new(out), utc_start_micros, links);
        let thread = WriterThread::spawn("tlog", move |written| write(log, &traffic, &file, floor_bytes, written))?;
        Ok(Self { path: path.to_owned(), sender, thread, queued: 0, dropped: 0 })
    }

    pub fn received(&mut self, now: Timestamp<HostClock>, input: &Input) -> Result<()> {
        let Input::Bytes { link, peer, bytes } = input else {
            return Ok(());
        };
        self.offer(Traffic { now, link: *link, direction: Direction::In(*peer), bytes: bytes.clone() })
    }

    pub fn sent(&mut self, now: Timestamp<HostClock>, link: LinkId, priority: Priority, frame: &[u8]) -> Result<()> {
        self.offer(Traffic { now, link, direction: Direction::Out(priority), bytes: frame.to_vec() })
    }

    pub fn finish(self) -> Result<TlogWritten> {
        drop(self.sender);
        let frames = self.thread.wait(self.queued).with_context(|| format!("`{}`", self.path.display()))?;
        Ok(TlogWritten { path: self.path, frames, dropped: self.dropped })
    }

    fn offer(&mut self, traffic: Traffic) -> Result<()> {
        match self.sender.try_send(traffic) {
            Ok(()) => {
                self.queued += 1;
                Ok(())
            }
            Err(TrySendError::Full(_)) => {
                self.dropped += 1;
                Ok(())
            }
            Err(TrySendError::Disconnected(_)) => Err(anyhow!("the telemetry log has stopped")),
        }
    }
}

/// Writes until all senders are dropped; returns the number of frames.
fn write(
    log: TrafficLog<BufWriter<File>>,
    traffic: &Receiver<Traffic>,
    file: &WatchedFile,
    floor_bytes: u64,
    count: &AtomicU64,
) -> Result<u64> {
    let log = write_while_sent(log, traffic, file, floor_bytes, count)?;
    let (_, frames) = log.finish().with_context(|| file.name())?;
    file.sync()?;
    // A deleted file counts as not written.
    file.file_size()?;
    Ok(frames)
}

impl LiveLog for TrafficLog<BufWriter<File>> {
    type Item = Traffic;

    fn write(&mut self, one: &Traffic) -> Result<Timestamp<HostClock>> {
        match one.direction {
            Direction::In(peer) => self.received(one.now, one.link, peer, &one.bytes)?,
            Direction::Out(priority) => self.sent(one.now, one.link, priority, &one.bytes)?,
        }
        Ok(one.now)
    }

    fn flush(&mut self) -> Result<()> {
        Ok(Self::flush(self)?)
    }
}

/// The stream of one peer of a link, which may end within a frame.
struct TrafficStream {
    last_seen: Timestamp<HostClock>,
    framer: Framer,
}

pub struct TrafficLog<W: Write> {
    writer: TlogWriter<W>,
    utc_start_micros: u64,
    links: BTreeMap<LinkId, FramerConfig>,
    peers: BTreeMap<(LinkId, PeerId), TrafficStream>,
    frames: u64,
}

impl<W: Write> TrafficLog<W> {
    /// `utc_start_micros` is the date at the host clock's zero; links whose bricks do not use MAVLink are not logged.
    pub fn new(out: W, utc_start_micros: u64, links: &[LinkConfig]) -> Self {
        Self {
            writer: TlogWriter::new(out),
            utc_start_micros,
            links: links.iter().filter_map(scanner_config).collect(),
            peers: BTreeMap::new(),
            frames: 0,
        }
    }

    /// Writes the frames that a chunk of one peer completes.
    pub fn received(
        &mut self,
        now: Timestamp<HostClock>,
        link: LinkId,
        peer: PeerId,
        bytes: &[u8],
    ) -> std::io::Result<()> {
        let Some(config) = self.links.get(&link) else {
            return Ok(());
        };
        let micros = self.utc_micros(now, link);
        let key = (link, peer);
        if self.peers.len() >= MAX_PEERS && !self.peers.contains_key(&key) {
            evict_oldest_peer(&mut self.peers);
        }
        let stream =
            self.peers.entry(key).or_insert_with(|| TrafficStream { last_seen: now, framer: Framer::new(*config) });
        stream.last_seen = now;
        let (writer, frames) = (&mut self.writer, &mut self.frames);
        let mut written = Ok(());
        stream.framer.push(now, bytes, &mut |found| {
            let (FramerOutput::Frame(frame) | FramerOutput::UnknownFrame(frame)) = found else {
                return;
            };
            if written.is_ok() {
                written = writer.record(micros, frame.raw);
                *frames += 1;
            }
        });
        written
    }

    /// Writes a sent frame; a forwarded one is already in the log as received, and output of a brick codec is not MAVLink.
    pub fn sent(
        &mut self,
        now: Timestamp<HostClock>,
        link: LinkId,
        priority: Priority,
        frame: &[u8],
    ) -> std::io::Result<()> {
        let is_ours = priority != Priority::Forwarded && self.links.contains_key(&link);
        if is_ours && verify(frame) != VerifiedFrame::Invalid {
            self.writer.record(self.utc_micros(now, link), frame)?;
            self.frames += 1;
        }
        Ok(())
    }

    pub fn flush(&mut self) -> std::io::Result<()> {
        self.writer.flush()
    }

    pub fn finish(self) -> std::io::Result<(W, u64)> {
        Ok((self.writer.finish()?, self.frames))
    }

    /// The timestamp of a record: the date, with the link number in its two lowest bits.
    fn utc_micros(&self, now: Timestamp<HostClock>, link: LinkId) -> u64 {
        let since_start = u64::try_from(now.as_micros()).unwrap_or(0);
        let micros = self.utc_start_micros.saturating_add(since_start);
        (micros & !LINK_BITS) | (u64::from(link.0) & LINK_BITS)
    }
}

/// Evicts the peer that was silent longest; the frame it may have begun is lost.
fn evict_oldest_peer(streams: &mut BTreeMap<(LinkId, PeerId), TrafficStream>) {
    let silent = streams.iter().min_by_key(|(_, stream)| stream.last_seen);
    let silent = silent.map(|(key, _)| *key);
    if let Some(silent) = silent {
        streams.remove(&silent);
    }
}

/// `None` if the link is not MAVLink.
fn scanner_config(link: &LinkConfig) -> Option<(LinkId, FramerConfig)> {
    link.brick.is_none().then(|| {
        let config = FramerConfig {
            accept_v1: link.accepted_versions == AcceptedVersions::V1AndV2,
            transport: link.framing,
            ..FramerConfig::default()
        };
        (link.id, config)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::WireVersion;
    use posebridge_protocol::message::Message;
    use posebridge_telemetry::Address;

    use crate::config::Config;

    /// Who calls again and again from another port is another peer each time.
    #[test]
    fn of_many_peers_the_most_silent_are_forgotten_and_no_whole_frame_is_lost() {
        let target = Address::new(1, 197);
        let mut frame = Vec::new();
        let request = Message::ParamRequestList { target };
        Encoder::new(WireVersion::V2).encode(Address::new(7, 1), &request, &mut frame);
        let (begun, rest) = frame.split_at(5);
        let links = Config::default().station_config().unwrap().links;
        let mut log = TrafficLog::new(Vec::new(), 0, &links);
        let link = links[0].id;
        let peers = 3 * MAX_PEERS as u32;
        for number in 0..peers {
            let now = Timestamp::from_millis(i64::from(number));
            log.received(now, link, PeerId(number), &frame).unwrap();
            log.received(now, link, PeerId(number), begun).unwrap();
            // One who goes on is not forgotten, however long ago he came.
            log.received(now, link, PeerId(0), &frame).unwrap();
            assert!(log.peers.len() <= MAX_PEERS);
        }
        let now = Timestamp::from_millis(i64::from(peers));
        log.received(now, link, PeerId(peers - 1), rest).unwrap();
        let (_, frames) = log.finish().unwrap();
        assert_eq!(frames, u64::from(2 * peers + 1));
    }
}

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
use posebridge_protocol::dialect::{Encoder, is_signed};
use posebridge_protocol::framing::{
    FrameRef, Framer, FramerConfig, FramerOutput, SequenceTracker, VerifiedFrame, WireVersion, verify,
};
use posebridge_protocol::routing::MAX_PEERS;
use posebridge_recording::tlog::{LINK_BITS, TlogWriter};
use posebridge_station::{AcceptedVersions, LinkConfig};
use posebridge_telemetry::{Address, HostClock, Input, LinkId, PeerId, Priority, Timestamp};

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
    losses: SequenceTracker,
}

/// Messages of standard dialects that the station sends and pymavlink's stock dialect, which is ArduPilot's, does not have:
/// PROTOCOL_VERSION, COMPONENT_INFORMATION_BASIC.
const UNKNOWN_TO_PYMAVLINK: [u32; 2] = [300, 396];
/// Those of our own dialect.
const OWN_MESSAGES: std::ops::RangeInclusive<u32> = 42_100..=42_104;

/// Gives the frames of each sender the numbers that a reader of the whole log expects. On the wire a sender has numbers for each link; in the
/// log its frames of all links and both directions stand one behind the other, and every gap would be a loss.
///
/// Readers count only messages that they know. So a message that programs without our dialect do not know gets the number before it once
/// more. What was lost on the way to the station stays a gap.
struct LogNumbering {
    encoder: Encoder,
    senders: BTreeMap<Address, SenderNumbering>,
    buffer: Vec<u8>,
}

#[derive(Clone, Copy)]
struct SenderNumbering {
    last: u8,
    /// Missing since then.
    lost: u8,
}

impl LogNumbering {
    const fn new(encoder: Encoder) -> Self {
        Self { encoder, senders: BTreeMap::new(), buffer: Vec::new() }
    }

    /// The frame with its number in the log. A signed one stays as it is, because only its sender can sign it anew; the sender's next ones
    /// follow its number.
    fn renumber<'f>(&'f mut self, frame: &FrameRef<'f>, lost: u8) -> &'f [u8] {
        let first = SenderNumbering { last: frame.sequence.wrapping_sub(1), lost: 0 };
        let sender = self.senders.entry(frame.source).or_insert(first);
        let is_uncounted = OWN_MESSAGES.contains(&frame.message_id) || UNKNOWN_TO_PYMAVLINK.contains(&frame.message_id);
        sender.lost = sender.lost.wrapping_add(lost);
        if is_signed(frame.raw) {
            *sender = SenderNumbering { last: frame.sequence, lost: 0 };
            return frame.raw;
        }
        if !is_uncounted {
            sender.last = sender.last.wrapping_add(1).wrapping_add(sender.lost);
            sender.lost = 0;
        }
        self.encoder.note_forwarded(frame.source, sender.last.wrapping_sub(1));
        self.buffer.clear();
        self.buffer.extend_from_slice(frame.raw);
        // What cannot be changed is written as it came.
        if self.encoder.readdress(&mut self.buffer, frame.source).is_ok() { &self.buffer } else { frame.raw }
    }
}

pub struct TrafficLog<W: Write> {
    writer: TlogWriter<W>,
    utc_start_micros: u64,
    links: BTreeMap<LinkId, FramerConfig>,
    peers: BTreeMap<(LinkId, PeerId), TrafficStream>,
    numbering: LogNumbering,
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
            numbering: LogNumbering::new(Encoder::new(WireVersion::V2)),
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
        let stream = self.peers.entry(key).or_insert_with(|| TrafficStream {
            last_seen: now,
            framer: Framer::new(*config),
            losses: SequenceTracker::new(),
        });
        stream.last_seen = now;
        let (writer, numbering, frames) = (&mut self.writer, &mut self.numbering, &mut self.frames);
        let losses = &mut stream.losses;
        let mut written = Ok(());
        stream.framer.push(now, bytes, &mut |found| {
            let (FramerOutput::Frame(frame) | FramerOutput::UnknownFrame(frame)) = found else {
                return;
            };
            if written.is_ok() {
                let lost = losses.record_number(frame.source, frame.sequence);
                written = writer.record(micros, numbering.renumber(&frame, lost));
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
        if !is_ours {
            return Ok(());
        }
        if let VerifiedFrame::Frame(frame) | VerifiedFrame::UnknownFrame(frame) = verify(frame) {
            let micros = self.utc_micros(now, link);
            self.writer.record(micros, self.numbering.renumber(&frame, 0))?;
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
    use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
    use posebridge_recording::tlog::{FrameCheck, TlogRecord};
    use posebridge_telemetry::EncoderTicks;

    use crate::config::Config;

    /// Numbers of the frames of a log, by sender and message.
    fn numbers_in(file: &[u8]) -> Vec<(u32, u8)> {
        let mut reader = posebridge_recording::tlog::TlogReader::new();
        let mut numbers = Vec::new();
        let check = &mut |raw: &[u8]| match verify(raw) {
            VerifiedFrame::Frame(frame) => FrameCheck::Valid((frame.message_id, frame.sequence)),
            VerifiedFrame::UnknownFrame(_) | VerifiedFrame::Invalid => FrameCheck::Invalid,
        };
        let take = &mut |record: TlogRecord<'_, (u32, u8)>| match record.check {
            FrameCheck::Valid(number) | FrameCheck::Unknown(number) => numbers.push(number),
            FrameCheck::Invalid => {}
        };
        reader.push(file, check, take);
        reader.finish(check, take);
        numbers
    }

    #[test]
    fn a_sender_counts_by_one_over_links_and_own_messages_and_losses_stay() {
        let links = Config::default().station_config().unwrap().links;
        let link = links[0].id;
        let source = Address::new(1, 1);
        let mut log = TrafficLog::new(Vec::new(), 0, &links);
        let (mut wire, mut other) = (Encoder::new(WireVersion::V2), Encoder::new(WireVersion::V2));
        let request = Message::ParamRequestList { target: Address::new(1, 197) };
        let own = Message::WheelTicks(WheelTicks {
            stamp: WireStamp::Micros32(0),
            left: EncoderTicks(1),
            right: EncoderTicks(1),
        });
        let mut at = 0;
        let mut record = |encoder: &mut Encoder, message: &Message, log: &mut TrafficLog<Vec<u8>>| {
            let mut frame = Vec::new();
            encoder.encode(source, message, &mut frame);
            at += 1;
            log.received(Timestamp::from_millis(at), link, PeerId(0), &frame)
        };
        record(&mut wire, &request, &mut log).unwrap();
        record(&mut wire, &own, &mut log).unwrap();
        record(&mut wire, &request, &mut log).unwrap();
        // Two are lost.
        wire.encode(source, &request, &mut Vec::new());
        wire.encode(source, &request, &mut Vec::new());
        record(&mut wire, &request, &mut log).unwrap();
        let mut sent = Vec::new();
        other.encode(source, &request, &mut sent);
        log.sent(Timestamp::from_millis(99), link, Priority::Command, &sent).unwrap();
        let (file, _) = log.finish().unwrap();
        assert_eq!(numbers_in(&file), [(21, 0), (42_100, 0), (21, 1), (21, 4), (21, 5)]);
    }

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

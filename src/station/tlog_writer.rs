//! The received and sent frames of a session as a telemetry log: offline by [`TrafficLog`], live beside the recording by [`TlogRecorder`]. It
//! is one file, because its readers support no parts.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::Result;
use posebridge_protocol::dialect::{Encoder, is_signed, is_stock_message};
use posebridge_protocol::framing::{VerifiedFrame, WireVersion, verify};
use posebridge_recording::tlog::{LINK_BITS, TlogWriter};
use posebridge_station::LinkConfig;
use posebridge_telemetry::{Address, HostClock, Input, LinkId, PeerId, Priority, Timestamp};

use super::link_frames::{LinkFrame, LinkFrames};
use super::side_file::{SideFile, SideFileFormat};

/// Bytes that were received or sent.
pub struct Traffic {
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

pub type TlogRecorder = SideFile<TrafficLog<BufWriter<File>>>;

impl TlogRecorder {
    /// `utc_start_micros` is the date at the host clock's zero; links whose bricks do not use MAVLink are not logged.
    pub fn create(path: &Path, utc_start_micros: u64, links: &[LinkConfig], floor_bytes: u64) -> Result<Self> {
        Self::start(path, floor_bytes, |out| Ok(TrafficLog::new(BufWriter::new(out), utc_start_micros, links)))
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
}

impl SideFileFormat for TrafficLog<BufWriter<File>> {
    type Item = Traffic;

    const KIND: &'static str = "telemetry log";
    const THREAD: &'static str = "tlog";
    /// Chunks and frames.
    const QUEUE_CAPACITY: usize = 16_384;

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

    fn finish(self) -> Result<u64> {
        let (_, frames) = Self::finish(self)?;
        Ok(frames)
    }
}

/// Stock messages that pymavlink 2.4.50's dialect `ardupilotmega`, by which its tools read logs, does not have.
#[rustfmt::skip]
const UNKNOWN_TO_PYMAVLINK: [u32; 91] = [
    8, 80, 220, 221, 222, 223, 224, 290, 291, 292, 300, 334, 336, 354, 355, 361, 369, 371, 372, 380, 395, 396, 397,
    400, 401, 410, 411, 412, 413, 414, 415, 420, 421, 435, 436, 437, 440, 441, 510, 511, 512, 513, 514, 515, 8002,
    8003, 8004, 8005, 8006, 8007, 8008, 8009, 8010, 8011, 8012, 8013, 8014, 8015, 8016, 17_000, 17_150, 17_151,
    17_153, 17_154, 17_155, 17_156, 17_157, 17_158, 52_501, 52_502, 52_503, 52_504, 52_505, 52_600, 52_601, 60_000,
    60_010, 60_011, 60_012, 60_013, 60_014, 60_020, 60_040, 60_041, 60_045, 60_046, 60_047, 60_050, 60_051, 60_052,
    60_053,
];

/// Whether a reader with pymavlink's stock dialect counts a frame in its sender's sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Counting {
    Counted,
    Unknown,
}

impl Counting {
    fn of(frame: &LinkFrame<'_>) -> Self {
        let id = frame.frame.message_id;
        let is_counted = frame.is_known && is_stock_message(id) && UNKNOWN_TO_PYMAVLINK.binary_search(&id).is_err();
        if is_counted { Self::Counted } else { Self::Unknown }
    }
}

/// Gives the frames of each sender the numbers that a reader of the whole log expects. On the wire a sender has numbers for each link; in the
/// log its frames of all links and both directions stand one behind the other, and every gap would be a loss.
///
/// Readers count only messages that they know. So any other message gets the number before it once more. What was lost on the way to the
/// station stays a gap.
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
    fn renumber<'f>(&'f mut self, found: &LinkFrame<'f>) -> &'f [u8] {
        let frame = &found.frame;
        let first = SenderNumbering { last: frame.sequence.wrapping_sub(1), lost: 0 };
        let sender = self.senders.entry(frame.source).or_insert(first);
        sender.lost = sender.lost.wrapping_add(found.lost);
        if is_signed(frame.raw) {
            *sender = SenderNumbering { last: frame.sequence, lost: 0 };
            return frame.raw;
        }
        if Counting::of(found) == Counting::Counted {
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
    received: LinkFrames,
    out: FrameLog<W>,
}

/// The log without the streams of the links.
struct FrameLog<W: Write> {
    writer: TlogWriter<W>,
    utc_start_micros: u64,
    numbering: LogNumbering,
    frames: u64,
}

impl<W: Write> FrameLog<W> {
    fn write(&mut self, found: &LinkFrame<'_>) -> std::io::Result<()> {
        let since_start = u64::try_from(found.now.as_micros()).unwrap_or(0);
        let micros = self.utc_start_micros.saturating_add(since_start);
        // The number of the link is in the two lowest bits of the date.
        let micros = (micros & !LINK_BITS) | (u64::from(found.link.0) & LINK_BITS);
        self.writer.record(micros, self.numbering.renumber(found))?;
        self.frames += 1;
        Ok(())
    }
}

impl<W: Write> TrafficLog<W> {
    /// `utc_start_micros` is the date at the host clock's zero; links whose bricks do not use MAVLink are not logged.
    pub fn new(out: W, utc_start_micros: u64, links: &[LinkConfig]) -> Self {
        let numbering = LogNumbering::new(Encoder::new(WireVersion::V2));
        let out = FrameLog { writer: TlogWriter::new(out), utc_start_micros, numbering, frames: 0 };
        Self { received: LinkFrames::new(links), out }
    }

    /// Writes the frames that a chunk of one peer completes.
    pub fn received(
        &mut self,
        now: Timestamp<HostClock>,
        link: LinkId,
        peer: PeerId,
        bytes: &[u8],
    ) -> std::io::Result<()> {
        let mut written = Ok(());
        self.received.push(now, link, peer, bytes, &mut |found| {
            if written.is_ok() {
                written = self.out.write(found);
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
        if priority == Priority::Forwarded || !self.received.contains(link) {
            return Ok(());
        }
        let (frame, is_known) = match verify(frame) {
            VerifiedFrame::Frame(frame) => (frame, true),
            VerifiedFrame::UnknownFrame(frame) => (frame, false),
            VerifiedFrame::Invalid => return Ok(()),
        };
        self.out.write(&LinkFrame { now, link, frame, is_known, lost: 0 })
    }

    pub fn flush(&mut self) -> std::io::Result<()> {
        self.out.writer.flush()
    }

    pub fn finish(self) -> std::io::Result<(W, u64)> {
        let FrameLog { writer, frames, .. } = self.out;
        Ok((writer.finish()?, frames))
    }
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

    #[test]
    fn messages_that_pymavlink_lacks_are_listed_once_and_in_order() {
        assert!(UNKNOWN_TO_PYMAVLINK.is_sorted_by(|a, b| a < b));
        assert!(UNKNOWN_TO_PYMAVLINK.iter().all(|id| is_stock_message(*id)));
    }
}

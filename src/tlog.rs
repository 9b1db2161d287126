//! Telemetry logs where both the file's layout and its frames are known.
//!
//! Reading: [`records`] cuts a file and verifies each frame. Writing: [`TrafficLog`] finds the frames in what links brought and writes
//! them beside those that were sent; live it stands behind [`crate::tasks::tlog_recorder`], offline behind `posebridge export`.

use std::collections::BTreeMap;
use std::io::Write;

use anyhow::Result;
use posebridge_pipeline::{AcceptedVersions, LinkConfig};
use posebridge_protocol::framing::{Scanned, Scanner, ScannerConfig, Verified, verify};
use posebridge_protocol::routing::MOST_PEERS;
use posebridge_recording::tlog::{Judged, LINK_BITS, Reader, Record, Writer};
use posebridge_telemetry::{HostClock, LinkId, PeerId, Priority, Stamp};

use crate::input_file::InputFile;
use crate::progress;

/// Gives every record of a file whose frame is whole or of an unknown message, and then the reader, which has counted.
///
/// # Errors
/// The file cannot be read any further; what came before was given.
pub fn records(mut file: InputFile, mut take: impl FnMut(Record<'_, ()>)) -> Result<Reader> {
    let mut reader = Reader::new();
    let bar = progress::bar(file.size, "bytes")?;
    file.chunks(|chunk| {
        reader.push(chunk, &mut judge, &mut take);
        bar.inc(chunk.len() as u64);
    })?;
    reader.finish(&mut judge, &mut take);
    bar.finish_and_clear();
    file.tell_if_cut();
    Ok(reader)
}

/// Gives the first records of a file for as long as more are wanted.
///
/// # Errors
/// As [`records`].
pub fn first_records(mut file: InputFile, mut wants_more: impl FnMut(Record<'_, ()>) -> bool) -> Result<()> {
    let mut reader = Reader::new();
    let mut is_wanted = true;
    file.chunks_while(|chunk| {
        reader.push(chunk, &mut judge, &mut |record| {
            is_wanted = is_wanted && wants_more(record);
        });
        is_wanted
    })?;
    reader.finish(&mut judge, &mut |record| {
        is_wanted = is_wanted && wants_more(record);
    });
    Ok(())
}

/// What the checksum says of a record's frame.
fn judge(raw: &[u8]) -> Judged<()> {
    match verify(raw) {
        Verified::Frame(_) => Judged::Whole(()),
        Verified::Unknown(_) => Judged::Unknown(()),
        Verified::Not => Judged::Not,
    }
}

/// What one peer of a link has sent, up to the middle of a frame.
struct Heard {
    last: Stamp<HostClock>,
    scanner: Scanner,
}

/// Writes frames with their times.
pub struct TrafficLog<W: Write> {
    writer: Writer<W>,
    utc_start_micros: u64,
    links: BTreeMap<LinkId, ScannerConfig>,
    heard: BTreeMap<(LinkId, PeerId), Heard>,
    frames: u64,
}

impl<W: Write> TrafficLog<W> {
    /// Begins a log. `utc_start_micros` is the date at the host clock's zero; of links whose bricks speak no MAVLink nothing is written.
    pub fn new(out: W, utc_start_micros: u64, links: &[LinkConfig]) -> Self {
        Self {
            writer: Writer::new(out),
            utc_start_micros,
            links: links.iter().filter_map(scanner_config).collect(),
            heard: BTreeMap::new(),
            frames: 0,
        }
    }

    /// Writes the frames that become whole by a chunk of one peer.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn received(
        &mut self,
        now: Stamp<HostClock>,
        (link, peer): (LinkId, PeerId),
        bytes: &[u8],
    ) -> std::io::Result<()> {
        let Some(config) = self.links.get(&link) else {
            return Ok(());
        };
        let micros = self.utc_micros(now, link);
        let key = (link, peer);
        if self.heard.len() >= MOST_PEERS && !self.heard.contains_key(&key) {
            forget_most_silent(&mut self.heard);
        }
        let heard =
            self.heard.entry(key).or_insert_with(|| Heard { last: now, scanner: Scanner::of_every_dialect(*config) });
        heard.last = now;
        let (writer, frames) = (&mut self.writer, &mut self.frames);
        let mut written = Ok(());
        heard.scanner.push(now, bytes, &mut |found| {
            let (Scanned::Frame(frame) | Scanned::Unknown(frame)) = found else {
                return;
            };
            if written.is_ok() {
                written = writer.record(micros, frame.raw);
                *frames += 1;
            }
        });
        written
    }

    /// Writes a frame that was sent; one that was only passed on stands there already, as it came, and what a codec sends is none.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn sent(
        &mut self,
        now: Stamp<HostClock>,
        (link, priority): (LinkId, Priority),
        frame: &[u8],
    ) -> std::io::Result<()> {
        let is_ours = priority != Priority::Forwarded && self.links.contains_key(&link);
        if is_ours && verify(frame) != Verified::Not {
            self.writer.record(self.utc_micros(now, link), frame)?;
            self.frames += 1;
        }
        Ok(())
    }

    /// Hands everything on to the system.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn flush(&mut self) -> std::io::Result<()> {
        self.writer.flush()
    }

    /// Ends the file and says how many frames it holds.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(self) -> std::io::Result<(W, u64)> {
        Ok((self.writer.finish()?, self.frames))
    }

    /// The time of a record: the date, with the number of the link in its two lowest bits.
    fn utc_micros(&self, now: Stamp<HostClock>, link: LinkId) -> u64 {
        let since_start = u64::try_from(now.as_micros()).unwrap_or(0);
        let micros = self.utc_start_micros.saturating_add(since_start);
        (micros & !LINK_BITS) | (u64::from(link.0) & LINK_BITS)
    }
}

/// Makes room: what the most silent peer had begun to send is lost with him, and it is seldom anything.
fn forget_most_silent(heard: &mut BTreeMap<(LinkId, PeerId), Heard>) {
    let silent = heard.iter().min_by_key(|(_, heard)| heard.last);
    let silent = silent.map(|(key, _)| *key);
    if let Some(silent) = silent {
        heard.remove(&silent);
    }
}

/// How a link's bytes are scanned; `None` if they are no MAVLink.
fn scanner_config(link: &LinkConfig) -> Option<(LinkId, ScannerConfig)> {
    link.brick.is_none().then(|| {
        let config = ScannerConfig {
            accept_v1: link.version == AcceptedVersions::V1AndV2,
            transport: link.framing,
            ..ScannerConfig::default()
        };
        (link.id, config)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::WireVersion;
    use posebridge_protocol::message::Message;
    use posebridge_telemetry::Address;

    /// Who calls again and again from another port is another peer each time.
    #[test]
    fn of_many_peers_the_most_silent_are_forgotten_and_no_whole_frame_is_lost() {
        let target = Address::new(1, 197);
        let mut frame = Vec::new();
        let request = Message::ParamRequestList { target };
        Encoder::new(WireVersion::V2).encode(Address::new(7, 1), &request, &mut frame);
        let (begun, rest) = frame.split_at(5);
        let links = Config::default().pipeline().unwrap().links;
        let mut log = TrafficLog::new(Vec::new(), 0, &links);
        let link = links[0].id;
        let peers = 3 * MOST_PEERS as u32;
        for number in 0..peers {
            let now = Stamp::from_millis(i64::from(number));
            log.received(now, (link, PeerId(number)), &frame).unwrap();
            log.received(now, (link, PeerId(number)), begun).unwrap();
            // One who goes on is not forgotten, however long ago he came.
            log.received(now, (link, PeerId(0)), &frame).unwrap();
            assert!(log.heard.len() <= MOST_PEERS);
        }
        let now = Stamp::from_millis(i64::from(peers));
        let last = (link, PeerId(peers - 1));
        log.received(now, last, rest).unwrap();
        let (_, frames) = log.finish().unwrap();
        assert_eq!(frames, u64::from(2 * peers + 1));
    }
}

//! The frames of a session as a telemetry log: found in what links brought, and written beside those that were sent.
//!
//! Live it stands behind [`super::tlog_writer`], offline behind `posebridge export`.

use std::collections::BTreeMap;
use std::io::Write;

use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, VerifiedFrame, verify};
use posebridge_protocol::routing::MAX_PEERS;
use posebridge_recording::tlog::{LINK_BITS, TlogWriter};
use posebridge_station::{AcceptedVersions, LinkConfig};
use posebridge_telemetry::{HostClock, LinkId, PeerId, Priority, Timestamp};

/// What one peer of a link has sent, up to the middle of a frame.
struct TrafficStream {
    last_seen: Timestamp<HostClock>,
    framer: Framer,
}

/// Writes frames with their times.
pub struct TrafficLog<W: Write> {
    writer: TlogWriter<W>,
    utc_start_micros: u64,
    links: BTreeMap<LinkId, FramerConfig>,
    peers: BTreeMap<(LinkId, PeerId), TrafficStream>,
    frames: u64,
}

impl<W: Write> TrafficLog<W> {
    /// Begins a log. `utc_start_micros` is the date at the host clock's zero; of links whose bricks speak no MAVLink nothing is written.
    pub fn new(out: W, utc_start_micros: u64, links: &[LinkConfig]) -> Self {
        Self {
            writer: TlogWriter::new(out),
            utc_start_micros,
            links: links.iter().filter_map(scanner_config).collect(),
            peers: BTreeMap::new(),
            frames: 0,
        }
    }

    /// Writes the frames that become whole by a chunk of one peer.
    ///
    /// # Errors
    /// They cannot be written.
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
        let heard = self
            .peers
            .entry(key)
            .or_insert_with(|| TrafficStream { last_seen: now, framer: Framer::with_all_dialects(*config) });
        heard.last_seen = now;
        let (writer, frames) = (&mut self.writer, &mut self.frames);
        let mut written = Ok(());
        heard.framer.push(now, bytes, &mut |found| {
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

    /// Writes a frame that was sent; one that was only passed on stands there already, as it came, and what a codec sends is none.
    ///
    /// # Errors
    /// It cannot be written.
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
    fn utc_micros(&self, now: Timestamp<HostClock>, link: LinkId) -> u64 {
        let since_start = u64::try_from(now.as_micros()).unwrap_or(0);
        let micros = self.utc_start_micros.saturating_add(since_start);
        (micros & !LINK_BITS) | (u64::from(link.0) & LINK_BITS)
    }
}

/// Makes room: what the most silent peer had begun to send is lost with him, and it is seldom anything.
fn evict_oldest_peer(heard: &mut BTreeMap<(LinkId, PeerId), TrafficStream>) {
    let silent = heard.iter().min_by_key(|(_, heard)| heard.last_seen);
    let silent = silent.map(|(key, _)| *key);
    if let Some(silent) = silent {
        heard.remove(&silent);
    }
}

/// How a link's bytes are scanned; `None` if they are no MAVLink.
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

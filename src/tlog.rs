//! Telemetry logs where both the file's layout and its frames are known.
//!
//! Reading: [`records`] cuts a file and verifies each frame. Writing: [`TrafficLog`] finds the frames in what links brought and writes
//! them beside those that were sent; live it stands behind [`crate::tasks::tlog_recorder`], offline behind `posebridge export`.

use std::collections::BTreeMap;
use std::io::Write;

use anyhow::Result;
use posebridge_pipeline::{AcceptedVersions, LinkConfig};
use posebridge_protocol::framing::{Scanned, Scanner, ScannerConfig, Verified, verify};
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
pub fn first_records(
    mut file: InputFile,
    mut wants_more: impl FnMut(Record<'_, ()>) -> bool,
) -> Result<()> {
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

/// Writes frames with their times.
pub struct TrafficLog<W: Write> {
    writer: Writer<W>,
    utc_start_micros: u64,
    links: BTreeMap<LinkId, ScannerConfig>,
    scanners: BTreeMap<(LinkId, PeerId), Scanner>,
    frames: u64,
}

impl<W: Write> TrafficLog<W> {
    /// Begins a log. `utc_start_micros` is the date at the host clock's zero; of links whose bricks speak no MAVLink nothing is written.
    pub fn new(out: W, utc_start_micros: u64, links: &[LinkConfig]) -> Self {
        Self {
            writer: Writer::new(out),
            utc_start_micros,
            links: links.iter().filter_map(scanner_config).collect(),
            scanners: BTreeMap::new(),
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
        let scanner = self.scanners.entry((link, peer));
        let scanner = scanner.or_insert_with(|| Scanner::of_every_dialect(*config));
        let (writer, frames) = (&mut self.writer, &mut self.frames);
        let mut written = Ok(());
        scanner.push(now, bytes, &mut |found| {
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

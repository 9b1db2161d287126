//! Content of a file: recordings by link, MAVLink links with their frames and others by bytes; telemetry logs and raw captures frame by
//! frame in bounded memory, verified with the checksum seeds of every known dialect; descriptors by run and kind of observation.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, parse_verified};
use posebridge_protocol::statistics::TrafficStatistics;
use posebridge_recording::container::{RecordingEnd, RecordingHeader, RecordingReader};
use posebridge_recording::dataset::ObservationList;
use posebridge_recording::tlog::{ByteOrder, FrameCheck, LINK_BITS, TlogRecord};
use posebridge_telemetry::{
    BrickClock, HostClock, Input, LinkId, LinkState, PeerId, StationInput, TimeDelta, Timestamp,
};
use serde::Serialize;

use crate::config;
use crate::console::progress_bar;
use crate::flags::DataFlags;
use crate::station::input_file::{InputFile, tlog_records};
use crate::station::recorded_session::{ReadProgress, continuation_names, missing_start};
use crate::tools::dataset::DataSet;
use crate::tools::import::message_log::for_each_frame;

#[derive(Debug, Default)]
pub(super) struct FramedFacts {
    /// Unpacked bytes of the file, or of its MAVLink links.
    pub(super) bytes: u64,
    pub(super) census: TrafficStatistics,
    pub(super) unknown_frames: u64,
    /// With the times before them.
    pub(super) unknown_bytes: u64,
    /// In no verified frame; includes the bytes of unknown ones.
    pub(super) bytes_outside: u64,
    /// Zero of the statistics' times, in microseconds since 1970; `None` if the file has no times.
    pub(super) epoch_micros: Option<u64>,
    pub(super) tlog: Option<TlogFacts>,
    pub(super) own: Option<RecordingFacts>,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TlogFacts {
    pub(super) order: ByteOrder,
    /// Number of times with each value of the two lowest bits.
    pub(super) link_bits: [u64; 4],
}

impl TlogFacts {
    /// Link numbers in the times, if they contain any: otherwise the lowest bits are evenly distributed.
    pub(super) fn links(&self) -> Vec<usize> {
        let all: u64 = self.link_bits.iter().sum();
        let used = |share: &u64| *share > 0;
        let is_even = self.link_bits.iter().all(|share| 8 * share > all);
        if all < 64 || is_even {
            return Vec::new();
        }
        let bits = self.link_bits.iter().enumerate();
        bits.filter(|(_, share)| used(share)).map(|(bits, _)| bits).collect()
    }
}

pub(super) enum InspectResult {
    Framed(Box<FramedFacts>),
    Runs(Vec<RunFacts>),
}

impl InspectResult {
    /// Nothing was found behind the file's header.
    pub(super) fn is_empty(&self) -> bool {
        match self {
            Self::Framed(facts) => facts.own.as_ref().map_or_else(
                || facts.census.sources().is_empty() && facts.unknown_frames == 0,
                |recording| recording.inputs == 0,
            ),
            // One without observations is refused.
            Self::Runs(runs) => runs.is_empty(),
        }
    }
}

/// In the JSON object with some values of the header.
#[derive(Debug, Default, Serialize)]
pub(super) struct RecordingFacts {
    #[serde(skip)]
    pub(super) header: RecordingHeader,
    pub(super) inputs: u64,
    /// Observations without bytes, from a foreign recording.
    pub(super) observations: u64,
    pub(super) commands: u64,
    #[serde(skip)]
    pub(super) links: BTreeMap<LinkId, LinkFacts>,
    /// Time of the first input; a later part of a session begins late.
    #[serde(skip)]
    pub(super) first: Option<Timestamp<HostClock>>,
    /// Part number in the session, from 1.
    pub(super) part: u32,
    /// Message about the missing beginning of the session.
    #[serde(rename = "lack")]
    pub(super) missing_start: Option<String>,
    /// File names of the parts that continue it; they are not counted.
    pub(super) continued_by: Vec<String>,
    #[serde(skip)]
    pub(super) last: Option<Timestamp<HostClock>>,
    #[serde(rename = "torn")]
    pub(super) truncation: Option<String>,
    pub(super) damages: Vec<String>,
}

impl RecordingFacts {
    /// From the first input to the last.
    pub(super) fn duration_s(&self) -> f64 {
        self.first.zip(self.last).map_or(0.0, |(first, last)| (last - first).as_secs_f64())
    }
}

#[derive(Debug, Default, Serialize)]
pub(super) struct LinkFacts {
    pub(super) url: String,
    /// `None` for MAVLink.
    pub(super) brick: Option<String>,
    pub(super) chunks: u64,
    pub(super) bytes: u64,
    pub(super) ups: u64,
    pub(super) downs: u64,
}

/// The link id of a file without link numbers.
const LINK: LinkId = LinkId(0);

pub(super) fn inspect_tlog(file: InputFile) -> Result<FramedFacts> {
    let mut framed = FramedFacts { epoch_micros: Some(0), ..FramedFacts::default() };
    let mut facts = TlogFacts::default();
    let reader = tlog_records(file, |record| {
        record_tlog_frame(&mut framed, &mut facts, &record);
    })?;
    let counts = reader.counts();
    framed.bytes = counts.bytes;
    framed.unknown_frames = counts.unknown;
    framed.unknown_bytes = counts.unknown_bytes;
    framed.bytes_outside = counts.skipped_bytes + counts.unknown_bytes;
    facts.order = reader.byte_order().unwrap_or_default();
    framed.tlog = Some(facts);
    Ok(framed)
}

fn record_tlog_frame(framed: &mut FramedFacts, facts: &mut TlogFacts, record: &TlogRecord<'_, ()>) {
    if !matches!(record.check, FrameCheck::Valid(())) {
        return;
    }
    let bits = (record.micros & LINK_BITS) as usize;
    if let Some(count) = facts.link_bits.get_mut(bits) {
        *count += 1;
    }
    if let Some(frame) = parse_verified(record.frame) {
        let at = Timestamp::from_micros(i64::try_from(record.micros).unwrap_or(i64::MAX));
        framed.census.record_logged(bits, &frame, at);
    }
}

pub(super) fn inspect_messages(file: InputFile) -> Result<FramedFacts> {
    let mut framed = FramedFacts { epoch_micros: Some(0), ..FramedFacts::default() };
    for_each_frame(file, |logged| {
        framed.bytes += logged.frame.len() as u64;
        if let Some(frame) = parse_verified(&logged.frame) {
            let at = Timestamp::from_micros(i64::try_from(logged.micros).unwrap_or(i64::MAX));
            framed.census.record(logged.link, &frame, Some(at));
        }
        Ok(())
    })?;
    Ok(framed)
}

pub(super) fn inspect_bytes(mut file: InputFile) -> Result<FramedFacts> {
    let mut framed = FramedFacts::default();
    let mut framer = inspection_framer();
    let bar = progress_bar(file.size, "bytes")?;
    file.chunks(|chunk| {
        framed.bytes += chunk.len() as u64;
        let mut take = |found: FramerOutput<'_>| record_frame(&mut framed, LINK, found, None);
        framer.push(Timestamp::ZERO, chunk, &mut take);
        bar.inc(chunk.len() as u64);
    })?;
    framer.finish(&mut |found| record_frame(&mut framed, LINK, found, None));
    bar.finish_and_clear();
    framed.bytes_outside = framer.counters().garbage_bytes + framed.unknown_bytes;
    Ok(framed)
}

/// A framer for foreign recordings: both versions and every dialect.
fn inspection_framer() -> Framer {
    Framer::new(FramerConfig { accept_v1: true, ..FramerConfig::default() })
}

fn record_frame(framed: &mut FramedFacts, link: LinkId, found: FramerOutput<'_>, at: Option<Timestamp<HostClock>>) {
    match found {
        FramerOutput::Frame(frame) => framed.census.record(link, &frame, at),
        FramerOutput::UnknownFrame(frame) => {
            framed.unknown_frames += 1;
            framed.unknown_bytes += frame.raw.len() as u64;
        }
        FramerOutput::Error(_) => {}
    }
}

/// Size limit of a recording, which is inspected in memory.
const MAX_BYTES: u64 = 4 << 30;

const MAX_DAMAGES: usize = 20;

pub(super) fn inspect_recording(file: InputFile, path: &Path) -> Result<FramedFacts> {
    let name = file.name.clone();
    let bytes = file.read_all(MAX_BYTES)?;
    let mut reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
    let mut framed = FramedFacts { epoch_micros: Some(reader.header().utc_start_micros), ..FramedFacts::default() };
    let mut facts = RecordingFacts {
        part: reader.part_header().part,
        missing_start: missing_start(reader.part_header()),
        continued_by: continuation_names(path, &bytes)?,
        ..facts_of(reader.header())
    };
    let mut scanners: BTreeMap<(LinkId, PeerId), Framer> = BTreeMap::new();
    let progress = ReadProgress::new(&reader)?;
    while let Some(item) = reader.next() {
        match item {
            Ok((now, input)) => record_input(&mut framed, &mut facts, &mut scanners, now, &input),
            Err(error) if facts.damages.len() < MAX_DAMAGES => {
                facts.damages.push(error.to_string());
            }
            Err(_) => {}
        }
        progress.update(&reader);
    }
    drop(progress);
    for ((link, _), mut framer) in scanners {
        framer.finish(&mut |found| record_frame(&mut framed, link, found, facts.last));
        framed.bytes_outside += framer.counters().garbage_bytes;
    }
    framed.bytes_outside += framed.unknown_bytes;
    if let RecordingEnd::Truncated { offset, what } = reader.recording_end() {
        facts.truncation = Some(format!("byte {offset}: {what}"));
    }
    framed.own = Some(facts);
    Ok(framed)
}

fn facts_of(header: &RecordingHeader) -> RecordingFacts {
    // A configuration of a newer program may not be understood; the bytes are counted all the same.
    let config = config::load_text("the recording's own configuration", &header.config_toml, &[]);
    let sections = config.map(|loaded| loaded.config.links).unwrap_or_default();
    let links = header.links.iter().enumerate().map(|(index, url)| {
        let facts = LinkFacts {
            url: url.clone(),
            brick: sections.get(index).and_then(|section| section.brick.clone()),
            ..LinkFacts::default()
        };
        (LinkId(index as u16), facts)
    });
    RecordingFacts { header: header.clone(), links: links.collect(), ..RecordingFacts::default() }
}

fn record_input(
    framed: &mut FramedFacts,
    facts: &mut RecordingFacts,
    scanners: &mut BTreeMap<(LinkId, PeerId), Framer>,
    now: Timestamp<HostClock>,
    input: &Input,
) {
    facts.inputs += 1;
    facts.first.get_or_insert(now);
    facts.last = Some(now);
    match input {
        Input::Bytes { link, peer, bytes } => {
            let of_link = facts.links.entry(*link).or_default();
            of_link.chunks += 1;
            of_link.bytes += bytes.len() as u64;
            if of_link.brick.as_deref().is_none_or(|brick| brick == "mavlink") {
                framed.bytes += bytes.len() as u64;
                let framer = scanners.entry((*link, *peer)).or_insert_with(inspection_framer);
                framer.push(now, bytes, &mut |found| {
                    record_frame(framed, *link, found, Some(now));
                });
            }
        }
        Input::Link { link, state } => {
            let of_link = facts.links.entry(*link).or_default();
            match state {
                LinkState::Up => of_link.ups += 1,
                LinkState::Down => of_link.downs += 1,
            }
        }
        Input::Observation(_) => facts.observations += 1,
        Input::Command(_) | Input::RobotCommand { .. } | Input::OfStation { input: StationInput::Command(_), .. } => {
            facts.commands += 1;
        }
        Input::Report { .. }
        | Input::Port { .. }
        | Input::PeerAddress { .. }
        | Input::Ownership { .. }
        | Input::OutsideFix { .. }
        | Input::Tick
        | Input::OfStation { input: StationInput::Report { .. } | StationInput::Tick, .. } => {}
    }
}

pub(super) struct RunFacts {
    pub(super) name: String,
    pub(super) observations: Vec<(String, Series)>,
    pub(super) truth: usize,
    pub(super) withheld: usize,
    pub(super) bad_rows: Vec<(&'static str, u64)>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Series {
    pub(super) count: u64,
    pub(super) first: Timestamp<BrickClock>,
    pub(super) last: Timestamp<BrickClock>,
    pub(super) longest_gap: TimeDelta,
}

impl Series {
    /// `None` for fewer than two observations.
    pub(super) fn rate_hz(&self) -> Option<f64> {
        let elapsed_s = (self.last - self.first).as_secs_f64();
        (self.count > 1 && elapsed_s > 0.0).then(|| (self.count - 1) as f64 / elapsed_s)
    }
}

pub(super) fn inspect_descriptor(path: &Path, flags: &DataFlags) -> Result<Vec<RunFacts>> {
    let data = DataSet::open(path, flags)?;
    let runs = data.runs.iter().map(|name| {
        let run = data.load(name, flags)?.run;
        let counts = run.bad_rows.counts.iter();
        Ok(RunFacts {
            name: name.clone(),
            observations: series_of(&run.observations),
            truth: run.truth.len(),
            withheld: run.withheld.len(),
            bad_rows: counts.map(|(reason, count)| (reason.name(), *count as u64)).collect(),
        })
    });
    runs.collect()
}

fn series_of(observations: &ObservationList) -> Vec<(String, Series)> {
    let mut series: BTreeMap<String, Series> = BTreeMap::new();
    for timed in observations.iter() {
        let observation = &timed.observation;
        let (kind, sensor) = (observation.measurement.kind(), observation.sensor);
        let name = if sensor.name() == kind { kind.to_owned() } else { format!("{kind} ({} {sensor})", sensor.name()) };
        let stamp = observation.stamp;
        let one =
            series.entry(name).or_insert(Series { count: 0, first: stamp, last: stamp, longest_gap: TimeDelta::ZERO });
        one.count += 1;
        one.longest_gap = one.longest_gap.max(stamp - one.last);
        one.last = one.last.max(stamp);
    }
    series.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_bits_are_links_only_where_they_are_not_spread() {
        let links = |link_bits| TlogFacts { link_bits, ..TlogFacts::default() }.links();
        assert_eq!(links([251, 240, 260, 249]), [0_usize; 0]);
        assert_eq!(links([900, 0, 0, 100]), [0, 3]);
        assert_eq!(links([5, 0, 0, 0]), [0_usize; 0], "too few to tell");
    }
}

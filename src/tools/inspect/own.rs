//! Recordings of ours: the bytes of each MAVLink link are scanned as they were live; of the others only the amount is reported.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_protocol::framing::Framer;
use posebridge_recording::container::{RecordingEnd, RecordingHeader, RecordingReader};
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, PeerId, Timestamp};

use super::facts::{FramedFacts, LinkFacts, RecordingFacts};
use super::framed::{inspection_framer, record_frame};
use crate::config;
use crate::station::input_file::InputFile;
use crate::station::joined_recording::continuation_names;
use crate::station::recording_warnings::missing_start;

/// A recording lies in memory while it is inspected; more than that is not read.
const MAX_BYTES: u64 = 4 << 30;

/// Most damaged places that are listed.
const MAX_DAMAGES: usize = 20;

/// Inspects a recording of ours.
///
/// # Errors
/// It cannot be read or is none.
pub(super) fn inspect(file: InputFile, path: &Path) -> Result<FramedFacts> {
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
    for item in &mut reader {
        match item {
            Ok((now, input)) => record_input(&mut framed, &mut facts, &mut scanners, now, &input),
            Err(error) if facts.damages.len() < MAX_DAMAGES => {
                facts.damages.push(error.to_string());
            }
            Err(_) => {}
        }
    }
    for ((link, _), mut framer) in scanners {
        framer.finish(&mut |found| record_frame(&mut framed, link, found, Some(facts.last)));
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
    RecordingFacts {
        header: header.clone(),
        inputs: 0,
        observations: 0,
        commands: 0,
        links: links.collect(),
        first: None,
        part: 1,
        missing_start: None,
        continued_by: Vec::new(),
        last: Timestamp::ZERO,
        truncation: None,
        damages: Vec::new(),
    }
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
    facts.last = now;
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
        Input::Command(_) | Input::RobotCommand { .. } => facts.commands += 1,
        Input::Report { .. } | Input::Port { .. } | Input::Tick => {}
    }
}

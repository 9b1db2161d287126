//! Recordings of ours: the bytes of each MAVLink link are scanned as they were live; of the others only the amount is told.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_protocol::framing::Scanner;
use posebridge_recording::container::{Ending, Header, Reader};
use posebridge_telemetry::{HostClock, Input, LinkId, LinkState, PeerId, Stamp};

use super::Framed;
use super::framed::{inspecting_scanner, take_scanned};
use crate::config;
use crate::import::parts::names_behind;
use crate::input_file::InputFile;
use crate::own_recording::lack_of;

/// A recording lies in memory while it is inspected; more than that is not read.
const MOST_BYTES: u64 = 4 << 30;

/// What only a recording of ours has.
#[derive(Debug)]
pub(super) struct OwnFacts {
    /// What it says about itself.
    pub(super) header: Header,
    /// How many inputs it holds.
    pub(super) inputs: u64,
    /// Observations that came without bytes, from a foreign recording.
    pub(super) observations: u64,
    /// Commands.
    pub(super) commands: u64,
    /// Links by number.
    pub(super) links: BTreeMap<LinkId, LinkFacts>,
    /// When the first input was given; a later part of a session begins late.
    pub(super) first: Option<Stamp<HostClock>>,
    /// Which part of its session this is; the first is 1.
    pub(super) part: u32,
    /// What it lacks of its session's beginning, in words.
    pub(super) lack: Option<String>,
    /// The names of the parts that continue it; they are not counted.
    pub(super) continued_by: Vec<String>,
    /// When the last input was given.
    pub(super) last: Stamp<HostClock>,
    /// Where and why it ends early.
    pub(super) torn: Option<String>,
    /// What is damaged within it.
    pub(super) damages: Vec<String>,
}

impl OwnFacts {
    /// From its first input to its last, s.
    pub(super) fn duration_s(&self) -> f64 {
        let first = self.first.unwrap_or(self.last);
        (self.last - first).as_secs_f64()
    }
}

/// One link.
#[derive(Debug, Default)]
pub(super) struct LinkFacts {
    /// Its URL.
    pub(super) url: String,
    /// What its brick speaks, if that is no MAVLink.
    pub(super) brick: Option<String>,
    /// Chunks that came.
    pub(super) chunks: u64,
    /// Their bytes.
    pub(super) bytes: u64,
    /// How often it came up.
    pub(super) ups: u64,
    /// How often it went down.
    pub(super) downs: u64,
}

/// So many damaged places are named.
const MOST_DAMAGES: usize = 20;

/// Inspects a recording of ours.
///
/// # Errors
/// It cannot be read or is none.
pub(super) fn inspect(file: InputFile, path: &Path) -> Result<Framed> {
    let name = file.name.clone();
    let bytes = file.whole(MOST_BYTES)?;
    let mut reader = Reader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
    let mut framed = Framed { epoch_micros: Some(reader.header().utc_start_micros), ..Framed::default() };
    let mut facts = OwnFacts {
        part: reader.beginning().part,
        lack: lack_of(reader.beginning()),
        continued_by: names_behind(path, &bytes)?,
        ..facts_of(reader.header())
    };
    let mut scanners: BTreeMap<(LinkId, PeerId), Scanner> = BTreeMap::new();
    for item in &mut reader {
        match item {
            Ok((now, input)) => take(&mut framed, &mut facts, &mut scanners, (now, &input)),
            Err(error) if facts.damages.len() < MOST_DAMAGES => {
                facts.damages.push(error.to_string());
            }
            Err(_) => {}
        }
    }
    for ((link, _), mut scanner) in scanners {
        scanner.finish(&mut |found| take_scanned(&mut framed, link, found, Some(facts.last)));
        framed.bytes_outside += scanner.counters().garbage_bytes;
    }
    framed.bytes_outside += framed.unknown_bytes;
    if let Ending::Torn { offset, what } = reader.ending() {
        facts.torn = Some(format!("byte {offset}: {what}"));
    }
    framed.own = Some(facts);
    Ok(framed)
}

fn facts_of(header: &Header) -> OwnFacts {
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
    OwnFacts {
        header: header.clone(),
        inputs: 0,
        observations: 0,
        commands: 0,
        links: links.collect(),
        first: None,
        part: 1,
        lack: None,
        continued_by: Vec::new(),
        last: Stamp::ZERO,
        torn: None,
        damages: Vec::new(),
    }
}

fn take(
    framed: &mut Framed,
    facts: &mut OwnFacts,
    scanners: &mut BTreeMap<(LinkId, PeerId), Scanner>,
    (now, input): (Stamp<HostClock>, &Input),
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
                let scanner = scanners.entry((*link, *peer)).or_insert_with(inspecting_scanner);
                scanner.push(now, bytes, &mut |found| {
                    take_scanned(framed, *link, found, Some(now));
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
        Input::Command(_) => facts.commands += 1,
        Input::Report { .. } | Input::Port { .. } | Input::Tick => {}
    }
}

//! The metadata record at the start of a recording: session and part.

use std::collections::BTreeMap;

use mcap::records::Metadata;

use super::fields;
use super::walk::RawRecord;
use super::{FORMAT, LAST_UNCHUNKED_FORMAT, PartHeader, ReadError, RecordingHeader};

const METADATA_NAME: &str = "posebridge.recording";

/// Latest start of a session, in the year 2262: nanoseconds of later ones overflow.
pub(super) const LATEST_START_MICROS: u64 = i64::MAX as u64 / 1_000;

/// The log time of the host clock's zero, in nanoseconds: UTC since format 3.
pub(super) const fn zero_nanos(header: &RecordingHeader) -> u64 {
    if header.format > LAST_UNCHUNKED_FORMAT { header.utc_start_micros * 1_000 } else { 0 }
}

pub(super) fn metadata_record(header: &RecordingHeader, beginning: &PartHeader) -> Metadata {
    let links = serde_json::Value::from(header.links.clone()).to_string();
    let mut entries = BTreeMap::from([
        ("config_toml", header.config_toml.clone()),
        ("format", header.format.to_string()),
        ("links", links),
        ("program_version", header.program_version.clone()),
        ("utc_start_micros", header.utc_start_micros.to_string()),
        ("part", beginning.part.to_string()),
        ("inputs_before", beginning.inputs_before.to_string()),
    ]);
    if let Some(name) = &beginning.continues {
        entries.insert("continues", name.clone());
    }
    Metadata {
        name: METADATA_NAME.to_owned(),
        metadata: entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
    }
}

/// Parses the metadata record; `None` for another one.
///
/// # Errors
/// It is damaged, lacks a key or was written by a newer program.
pub(super) fn parse(record: &RawRecord<'_>) -> Result<Option<(RecordingHeader, PartHeader)>, ReadError> {
    let entries = HeaderEntries {
        offset: record.offset as u64,
        values: match fields::metadata(record.body) {
            Some(found) if found.name == METADATA_NAME => found.entries,
            Some(_) => return Ok(None),
            None => return Err(header_error(record.offset as u64, "a damaged metadata record")),
        },
    };
    let format = entries.number("format")?;
    if format > FORMAT {
        return Err(ReadError::Format { found: format });
    }
    let header = RecordingHeader {
        format,
        program_version: entries.text("program_version")?.to_owned(),
        utc_start_micros: entries.number("utc_start_micros")?,
        config_toml: entries.text("config_toml")?.to_owned(),
        links: serde_json::from_str(entries.text("links")?)
            .ok()
            .ok_or_else(|| entries.header_error("a header whose links are not a list"))?,
    };
    if header.utc_start_micros > LATEST_START_MICROS {
        return Err(entries.header_error("a header whose start lies beyond the year 2262"));
    }
    Ok(Some((header, entries.part_header()?)))
}

struct HeaderEntries<'a> {
    offset: u64,
    values: BTreeMap<&'a str, &'a str>,
}

impl<'a> HeaderEntries<'a> {
    fn text(&self, key: &str) -> Result<&'a str, ReadError> {
        let value = self.values.get(key).copied();
        value.ok_or_else(|| self.header_error(&format!("a header without the key `{key}`")))
    }

    fn number<N: std::str::FromStr>(&self, key: &str) -> Result<N, ReadError> {
        let parsed = self.text(key)?.parse().ok();
        parsed.ok_or_else(|| self.header_error(&format!("a header whose `{key}` is not a number")))
    }

    /// Recordings up to format 2 have no parts.
    fn part_header(&self) -> Result<PartHeader, ReadError> {
        if !self.values.contains_key("part") {
            return Ok(PartHeader::default());
        }
        Ok(PartHeader {
            part: self.number("part")?,
            inputs_before: self.number("inputs_before")?,
            continues: self.values.get("continues").map(|name| (*name).to_owned()),
        })
    }

    fn header_error(&self, what: &str) -> ReadError {
        header_error(self.offset, what)
    }
}

fn header_error(offset: u64, what: &str) -> ReadError {
    ReadError::NoHeader { offset, what: what.to_owned() }
}

//! The metadata record at the start of a recording: which session it is of, and which part of it.

use std::collections::BTreeMap;

use mcap::records::Metadata;

use super::fields;
use super::reader::ReadError;
use super::records::RawRecord;
use super::{Beginning, FORMAT, Header, UNCHUNKED};

/// Name of the metadata record.
const NAME: &str = "posebridge.recording";

/// The latest start of a session: of a later one the nanoseconds do not fit. It lies in the year 2262.
pub(super) const LATEST_START_MICROS: u64 = i64::MAX as u64 / 1_000;

/// The time that messages of this recording give to the host clock's zero, in nanoseconds: UTC since format 3.
pub(super) const fn zero_nanos(header: &Header) -> u64 {
    if header.format > UNCHUNKED { header.utc_start_micros * 1_000 } else { 0 }
}

/// The record of a recording that begins like this.
pub(super) fn record(header: &Header, beginning: &Beginning) -> Metadata {
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
        name: NAME.to_owned(),
        metadata: entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
    }
}

/// What a metadata record says, if it is this one.
///
/// # Errors
/// It is damaged, lacks a key or was written by a newer program.
pub(super) fn parse(record: &RawRecord<'_>) -> Result<Option<(Header, Beginning)>, ReadError> {
    let entries = Entries {
        offset: record.offset as u64,
        found: match fields::metadata(record.body) {
            Some(found) if found.name == NAME => found.entries,
            Some(_) => return Ok(None),
            None => return Err(broken(record.offset as u64, "a damaged metadata record")),
        },
    };
    let format = entries.number("format")?;
    if format > FORMAT {
        return Err(ReadError::Format { found: format });
    }
    let header = Header {
        format,
        program_version: entries.text("program_version")?.to_owned(),
        utc_start_micros: entries.number("utc_start_micros")?,
        config_toml: entries.text("config_toml")?.to_owned(),
        links: serde_json::from_str(entries.text("links")?)
            .ok()
            .ok_or_else(|| entries.broken("a header whose links are not a list"))?,
    };
    if header.utc_start_micros > LATEST_START_MICROS {
        return Err(entries.broken("a header whose start lies beyond the year 2262"));
    }
    Ok(Some((header, entries.beginning()?)))
}

/// The entries of the record.
struct Entries<'a> {
    offset: u64,
    found: BTreeMap<&'a str, &'a str>,
}

impl<'a> Entries<'a> {
    fn text(&self, key: &str) -> Result<&'a str, ReadError> {
        let value = self.found.get(key).copied();
        value.ok_or_else(|| self.broken(&format!("a header without the key `{key}`")))
    }

    fn number<N: std::str::FromStr>(&self, key: &str) -> Result<N, ReadError> {
        let parsed = self.text(key)?.parse().ok();
        parsed.ok_or_else(|| self.broken(&format!("a header whose `{key}` is not a number")))
    }

    /// Where it begins; recordings up to format 2 have no parts.
    fn beginning(&self) -> Result<Beginning, ReadError> {
        if !self.found.contains_key("part") {
            return Ok(Beginning::default());
        }
        Ok(Beginning {
            part: self.number("part")?,
            inputs_before: self.number("inputs_before")?,
            continues: self.found.get("continues").map(|name| (*name).to_owned()),
        })
    }

    fn broken(&self, what: &str) -> ReadError {
        broken(self.offset, what)
    }
}

fn broken(offset: u64, what: &str) -> ReadError {
    let what = what.to_owned();
    ReadError::NoHeader { offset, what }
}

//! Messages that `posebridge export --messages` wrote to MCAP become frames again, for a telemetry log and for `inspect`.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use posebridge_protocol::dialect::definition;
use posebridge_protocol::dialect::message_json::read_json;
use posebridge_recording::json_log::{JsonMessage, read_json_log};
use posebridge_recording::tlog::TlogWriter;
use posebridge_telemetry::{Address, LinkId};

use crate::console::print_line;
use crate::station::input_file::InputFile;
use crate::station::recorded_session::MemoryLimit;

/// Writes the frames in the order of the file, at their times; returns their number.
pub(super) fn write_frames(path: &Path, out: File) -> Result<u64> {
    let mut writer = TlogWriter::new(BufWriter::new(out));
    let frames = for_each_frame(InputFile::open(path)?, |logged| Ok(writer.record(logged.micros, &logged.frame)?))?;
    writer.finish()?;
    Ok(frames)
}

/// A message as it was sent.
pub(in crate::tools) struct MessageFrame {
    /// Since 1970.
    pub(in crate::tools) micros: u64,
    pub(in crate::tools) link: LinkId,
    pub(in crate::tools) frame: Vec<u8>,
}

/// Passes the frames in the order of the file; returns their number.
pub(in crate::tools) fn for_each_frame(
    file: InputFile,
    mut take: impl FnMut(&MessageFrame) -> Result<()>,
) -> Result<u64> {
    let name = file.name.clone();
    let bytes = file.read_all(MemoryLimit::default().max_bytes)?;
    let mut frames = 0;
    let read = read_json_log(&bytes, |message| {
        let place = || format!("message {} on `{}`", frames + 1, message.topic);
        let frame = frame_of(&message).with_context(place)?;
        let link = u16::try_from(number(message.metadata, "link").with_context(place)?).with_context(place)?;
        take(&MessageFrame { micros: message.log_nanos / 1_000, link: LinkId(link), frame })?;
        frames += 1;
        anyhow::Ok(())
    });
    let damage = read.with_context(|| format!("`{name}`"))?;
    for what in &damage.listed {
        print_line(&format!("`{name}`: {what}; what is whole is used"));
    }
    let further = damage.count - damage.listed.len() as u64;
    if further > 0 {
        print_line(&format!("`{name}`: {further} further damaged places"));
    }
    Ok(frames)
}

fn frame_of(message: &JsonMessage<'_>) -> Result<Vec<u8>> {
    let id = number(message.metadata, "message_id")?;
    let definition = definition(id).ok_or_else(|| anyhow!("no dialect has a message {id}"))?;
    let part = |key| Ok::<_, anyhow::Error>(u8::try_from(number(message.metadata, key)?)?);
    let source = Address::new(part("system")?, part("component")?);
    Ok(read_json(definition, source, message.json)?)
}

fn number(metadata: &BTreeMap<String, String>, key: &str) -> Result<u32> {
    let text = metadata.get(key).ok_or_else(|| anyhow!("its channel has no `{key}`"))?;
    text.parse().with_context(|| format!("its channel has the {key} `{text}`"))
}

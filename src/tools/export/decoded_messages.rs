//! `posebridge export --messages`: every MAVLink message that a file holds, decoded by its definition. Nothing is estimated.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use posebridge_protocol::dialect::csv_lines::CsvLines;
use posebridge_protocol::dialect::definitions::{MessageDefinition, definitions};
use posebridge_protocol::dialect::fields::FullPayload;
use posebridge_protocol::dialect::message_json::{schema, write_json};
use posebridge_protocol::dialect::{definition_index, message_id_named};
use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerOutput, parse_verified};
use posebridge_recording::container::RecordingReader;
use posebridge_recording::json_log::{JsonChannel, JsonChannelId, JsonLogWriter};
use posebridge_recording::tlog::FrameCheck;
use posebridge_telemetry::{Address, Input, LinkId, Timestamp};

use super::atomic_file::AtomicFile;
use super::files::{OutputFolder, print_written};
use crate::config;
use crate::console::{print_line, print_lines};
use crate::station::input_file::{InputFile, InputKind, tlog_records};
use crate::station::link_frames::{LinkFrame, LinkFrames};
use crate::station::recorded_session::{MemoryLimit, for_each_input, nothing_read, own_bytes};
use crate::tools::import::messages_hint;

/// What is written of the messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MessageFormats {
    pub(super) csv: bool,
    pub(super) mcap: bool,
}

pub(super) fn export_messages(path: &Path, output: OutputFolder<'_>, formats: MessageFormats) -> Result<()> {
    let mut file = InputFile::open(path)?;
    let name = file.name.clone();
    if formats.mcap && file.kind == InputKind::Bytes {
        bail!("--format mcap: `{name}` has no times, which MCAP needs; --format csv leaves them empty");
    }
    let mut tables = formats.csv.then(|| MessageTables::create(output)).transpose()?;
    let mut log = formats.mcap.then(|| MessageLog::create(output)).transpose()?;
    let (mut frames, mut failure) = (0, Ok(()));
    let mut take = |one: &LoggedFrame<'_>| {
        let Some(index) = definition_index(one.frame.message_id) else { return };
        if failure.is_err() {
            return;
        }
        frames += 1;
        failure = tables
            .as_mut()
            .map_or(Ok(()), |tables| tables.record(index, one))
            .and_then(|()| log.as_mut().map_or(Ok(()), |log| log.record(&definitions()[index], one)));
    };
    let unknown = match file.kind {
        InputKind::Tlog => tlog_frames(file, &mut take)?,
        InputKind::Bytes => bytes_frames(&mut file, &mut take)?,
        InputKind::Own => recording_frames(path, file, &mut take)?,
        InputKind::Messages => bail!(messages_hint(path)),
        InputKind::Descriptor => bail!("--messages: `{name}` is a descriptor, there are no frames in its data"),
    };
    failure?;
    if unknown > 0 {
        print_line(&format!("left out: {unknown} frames of messages that no dialect has"));
    }
    if frames == 0 {
        return Err(nothing_read(&name));
    }
    tables.map_or(Ok(()), MessageTables::finish)?;
    log.map_or(Ok(()), MessageLog::finish)
}

struct LoggedFrame<'f> {
    /// Since 1970; `None` in bytes without times.
    micros: Option<u64>,
    link: LinkId,
    frame: FrameRef<'f>,
}

type FrameSink<'s> = dyn FnMut(&LoggedFrame<'_>) + 's;

/// Passes the verified frames at the times of the file; returns how many were of unknown messages.
fn tlog_frames(file: InputFile, take: &mut FrameSink<'_>) -> Result<u64> {
    let reader = tlog_records(file, |record| {
        let frame = (record.check == FrameCheck::Valid(())).then(|| parse_verified(record.frame)).flatten();
        if let Some(frame) = frame {
            take(&LoggedFrame { micros: Some(record.micros), link: LinkId(0), frame });
        }
    })?;
    Ok(reader.counts().unknown)
}

fn bytes_frames(file: &mut InputFile, take: &mut FrameSink<'_>) -> Result<u64> {
    let (mut unknown, link) = (0, LinkId(0));
    let mut framer = Framer::new(FramerConfig { accept_v1: true, ..FramerConfig::default() });
    let mut pass = |found: FramerOutput<'_>| match found {
        FramerOutput::Frame(frame) => take(&LoggedFrame { micros: None, link, frame }),
        FramerOutput::UnknownFrame(_) => unknown += 1,
        FramerOutput::Error(_) => {}
    };
    file.chunks(|chunk| framer.push(Timestamp::ZERO, chunk, &mut pass))?;
    framer.finish(&mut pass);
    file.warn_if_truncated();
    Ok(unknown)
}

/// The received frames of all links that use MAVLink, at their arrival.
fn recording_frames(path: &Path, file: InputFile, take: &mut FrameSink<'_>) -> Result<u64> {
    let name = file.name.clone();
    let (bytes, notes) = own_bytes(path, file, MemoryLimit::default())?;
    print_lines(&notes);
    let mut reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
    let zero_micros = reader.header().utc_start_micros;
    let config = config::load_text("the recording's own configuration", &reader.header().config_toml, &[])?;
    let mut received = LinkFrames::new(&config.config.station_config()?.links);
    let mut unknown = 0;
    let mut pass = |found: &LinkFrame<'_>| {
        if found.is_known {
            let micros = zero_micros.saturating_add(u64::try_from(found.now.as_micros()).unwrap_or(0));
            take(&LoggedFrame { micros: Some(micros), link: found.link, frame: found.frame });
        } else {
            unknown += 1;
        }
    };
    for_each_input(&name, &mut reader, |now, input| {
        if let Input::Bytes { link, peer, bytes } = input {
            received.push(now, *link, *peer, bytes, &mut pass);
        }
        Ok(())
    })?;
    received.finish(&mut pass);
    Ok(unknown)
}

/// One CSV file for each kind of message, in a folder of their own.
struct MessageTables {
    folder: PathBuf,
    /// As [`definitions`].
    tables: Vec<Option<MessageTable>>,
}

struct MessageTable {
    out: File,
    path: PathBuf,
    lines: CsvLines,
    rows: u64,
}

/// Before the fields; no field begins with an underscore.
const FRAME_COLUMNS: [&str; 5] = ["_time [us]", "_link", "_system", "_component", "_sequence"];
/// Of lines that wait until they are written together.
const WAITING_BYTES: usize = 64 * 1024;

impl MessageTables {
    /// Removes the tables that an earlier export left there.
    fn create(output: OutputFolder<'_>) -> Result<Self> {
        let folder = output.folder.join(format!("{}-messages", output.stem()));
        std::fs::create_dir_all(&folder).with_context(|| format!("making the folder `{}`", folder.display()))?;
        for entry in std::fs::read_dir(&folder).with_context(|| format!("reading the folder `{}`", folder.display()))? {
            let path = entry?.path();
            let kind = path.file_stem().and_then(OsStr::to_str).and_then(message_id_named);
            if kind.is_some() && path.extension() == Some(OsStr::new("csv")) {
                std::fs::remove_file(&path).with_context(|| format!("removing `{}`", path.display()))?;
            }
        }
        let tables = definitions().iter().map(|_| None).collect();
        Ok(Self { folder, tables })
    }

    /// `index` is that of the message in [`definitions`].
    fn record(&mut self, index: usize, one: &LoggedFrame<'_>) -> Result<()> {
        let slot = &mut self.tables[index];
        let table = match slot {
            Some(table) => table,
            None => slot.insert(MessageTable::create(&self.folder, &definitions()[index])?),
        };
        table.push(one);
        if table.lines.as_bytes().len() < WAITING_BYTES { Ok(()) } else { table.flush() }
    }

    fn finish(self) -> Result<()> {
        for mut table in self.tables.into_iter().flatten() {
            table.flush()?;
            print_written(&table.path, table.rows, "lines");
        }
        Ok(())
    }
}

impl MessageTable {
    fn create(folder: &Path, definition: &MessageDefinition) -> Result<Self> {
        let path = folder.join(format!("{}.csv", definition.name));
        let out = File::create(&path).with_context(|| format!("creating `{}`", path.display()))?;
        Ok(Self { out, path, lines: CsvLines::new(&FRAME_COLUMNS, definition), rows: 0 })
    }

    fn push(&mut self, one: &LoggedFrame<'_>) {
        let source = one.frame.source;
        self.lines.push(one.micros);
        for number in
            [u64::from(one.link.0), source.system.0.into(), source.component.0.into(), one.frame.sequence.into()]
        {
            self.lines.push(Some(number));
        }
        self.lines.push_payload(FullPayload::new(one.frame.payload));
        self.rows += 1;
    }

    fn flush(&mut self) -> Result<()> {
        let written = self.out.write_all(self.lines.as_bytes());
        self.lines.clear();
        written.with_context(|| format!("writing `{}`", self.path.display()))
    }
}

/// An MCAP file with a channel for each message and sender.
struct MessageLog {
    out: JsonLogWriter<File>,
    file: AtomicFile,
    channels: BTreeMap<(LinkId, Address, u32), JsonChannelId>,
    messages: u64,
}

impl MessageLog {
    fn create(output: OutputFolder<'_>) -> Result<Self> {
        let (out, file) = output.create_new("-messages.mcap")?;
        Ok(Self { out: JsonLogWriter::create(out)?, file, channels: BTreeMap::new(), messages: 0 })
    }

    fn record(&mut self, definition: &MessageDefinition, one: &LoggedFrame<'_>) -> Result<()> {
        let key = (one.link, one.frame.source, definition.id);
        let channel = if let Some(channel) = self.channels.get(&key) {
            *channel
        } else {
            let channel = self.out.add_channel(&channel_of(definition, one))?;
            self.channels.insert(key, channel);
            channel
        };
        let nanos = one.micros.unwrap_or_default().saturating_mul(1_000);
        self.out.write(channel, nanos, one.frame.sequence.into(), &write_json(definition, &one.frame))?;
        self.messages += 1;
        Ok(())
    }

    fn finish(self) -> Result<()> {
        self.out.finish().with_context(|| format!("writing `{}`", self.file.path().display()))?;
        print_written(self.file.path(), self.messages, "messages");
        self.file.finish()
    }
}

fn channel_of(definition: &MessageDefinition, one: &LoggedFrame<'_>) -> JsonChannel {
    let (link, source) = (one.link.0, one.frame.source);
    let (system, component) = (source.system.0, source.component.0);
    let prefix = if link == 0 { String::new() } else { format!("/link{link}") };
    let metadata = [
        ("link", u32::from(link)),
        ("system", system.into()),
        ("component", component.into()),
        ("message_id", definition.id),
    ];
    JsonChannel {
        topic: format!("{prefix}/{system}/{component}/{}", definition.name),
        kind: definition.name.to_owned(),
        schema: schema(definition),
        metadata: metadata.map(|(key, value)| (key.to_owned(), value.to_string())).into(),
    }
}

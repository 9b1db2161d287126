//! A telemetry log or a run of a descriptor, written as a recording of ours or taken as one.

use std::io::{Cursor, Seek, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use posebridge_recording::container::{FORMAT, RecordingHeader, RecordingReader, RecordingWriter};
use posebridge_telemetry::Address;

use super::InputSink;
use super::descriptor::DescriptorSource;
use super::tlog::{TlogSource, timed_frames};
use crate::config::{self, Config, RobotProfile, Setting};
use crate::flags::DataFlags;
use crate::station::input_file::{InputFile, InputKind};
use crate::station::joined_recording::{MemoryLimit, own_bytes};

/// With which station a file without a configuration is read.
#[derive(Clone, Copy, Debug, Default)]
pub struct StationOptions<'a> {
    /// A station's configuration; without it the default one.
    pub config: Option<&'a Path>,
    /// Another robot.
    pub robot: Option<&'a Path>,
    /// Single keys; they go over both.
    pub settings: &'a [Setting],
}

impl StationOptions<'_> {
    fn config(&self) -> Result<Config> {
        let mut config = config::load(self.config, self.settings)?.config;
        if let Some(path) = self.robot {
            config = config.with_robot(RobotProfile::read(path)?);
            config = config::apply_overrides(&config, self.settings)?;
        }
        Ok(config)
    }
}

/// What an import has made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImportSummary {
    /// Inputs written.
    pub inputs: u64,
    /// What was left out or changed, in words for people.
    pub notes: Vec<String>,
}

/// What a session was given, and how its station was configured.
pub struct ImportedSession {
    /// The configuration, and what else the result depends on.
    pub header: RecordingHeader,
    /// What was left out, as far as that is known before the inputs are read; in words.
    pub notes: Vec<String>,
    /// Where the inputs are.
    pub inputs: InputSource,
}

/// Where the inputs of a session are.
pub enum InputSource {
    /// In a recording of ours, in memory.
    Recorded(Vec<u8>),
    /// In a telemetry log, from which they are made one by one.
    Logged(Box<LoggedInputs>),
}

/// The inputs that a telemetry log stands for.
pub struct LoggedInputs(TlogSource);

impl LoggedInputs {
    /// Gives them in the order of their times; the first one always at [`posebridge_telemetry::Timestamp::ZERO`]. Says in words what was left out.
    ///
    /// # Errors
    /// The file cannot be read any further, or as `sink` says.
    pub fn send_to(&self, sink: &mut InputSink<'_>) -> Result<Vec<String>> {
        self.0.inputs(sink)
    }
}

/// Gives the frames of a telemetry log with their times, microseconds since 1970, cleared of damage and of steps of the date, so that they never
/// fall; says in words what was wrong with them.
///
/// # Errors
/// The file cannot be read to its end or holds no frame, or its times make no sense.
pub fn logged_frames(
    path: &Path,
    station: StationOptions<'_>,
    take: &mut dyn FnMut(u64, &[u8]),
) -> Result<Vec<String>> {
    let own = station.config()?.station;
    timed_frames(path, Address::new(own.system, own.component), take)
}

/// Writes a telemetry log or a descriptor's run as a recording of ours.
///
/// # Errors
/// The file cannot be read or makes no sense, or `out` cannot be written.
pub fn import<W: Write + Seek>(
    path: &Path,
    data: &DataFlags,
    station: StationOptions<'_>,
    out: W,
) -> Result<(W, ImportSummary)> {
    match InputFile::open(path)?.kind {
        InputKind::Tlog => {
            let source = TlogSource::open(path, station.config()?)?;
            let header = header_of(&source.config, source.epoch_micros)?;
            write(out, &header, |sink| source.inputs(sink))
        }
        InputKind::Descriptor => {
            let source = DescriptorSource::open(path, data)?;
            let header = header_of(&source.config, 0)?;
            write(out, &header, |sink| source.inputs(sink))
        }
        InputKind::Own => bail!("`{}` is a recording of posebridge already", path.display()),
        InputKind::Bytes => {
            bail!("`{}`: bytes without times cannot be replayed; a telemetry log (*.tlog) has times", path.display())
        }
    }
}

/// The bytes of a recording of ours: those of the file with all parts that continue it, or made from a telemetry log in memory; and what
/// was left out.
///
/// # Errors
/// The file cannot be read, or is neither.
pub fn recording_bytes(path: &Path, station: StationOptions<'_>) -> Result<(Vec<u8>, Vec<String>)> {
    let file = InputFile::open(path)?;
    if file.kind != InputKind::Tlog {
        return own_bytes(path, file, MemoryLimit::default());
    }
    let source = TlogSource::open(path, station.config()?)?;
    let header = header_of(&source.config, source.epoch_micros)?;
    let out = Cursor::new(Vec::new());
    let (out, account) = write(out, &header, |sink| source.inputs(sink))?;
    Ok((out.into_inner(), account.notes))
}

/// A recording of ours with all parts that continue it, or a telemetry log.
///
/// # Errors
/// As [`recording_bytes`].
pub fn session(path: &Path, station: StationOptions<'_>) -> Result<ImportedSession> {
    if InputFile::open(path)?.kind == InputKind::Tlog {
        let source = TlogSource::open(path, station.config()?)?;
        return Ok(ImportedSession {
            header: header_of(&source.config, source.epoch_micros)?,
            notes: Vec::new(),
            inputs: InputSource::Logged(Box::new(LoggedInputs(source))),
        });
    }
    let (bytes, notes) = recording_bytes(path, station)?;
    let reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{}`", path.display()))?;
    Ok(ImportedSession { header: reader.header().clone(), notes, inputs: InputSource::Recorded(bytes) })
}

fn header_of(config: &Config, utc_start_micros: u64) -> Result<RecordingHeader> {
    Ok(RecordingHeader {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros,
        config_toml: toml::to_string(config).context("writing the configuration into the recording")?,
        links: config.links.iter().map(|link| link.url.clone()).collect(),
    })
}

fn write<W: Write + Seek>(
    out: W,
    header: &RecordingHeader,
    inputs: impl FnOnce(&mut InputSink<'_>) -> Result<Vec<String>>,
) -> Result<(W, ImportSummary)> {
    let mut writer = RecordingWriter::create(out, header)?;
    let mut account = ImportSummary::default();
    account.notes = inputs(&mut |now, input| {
        account.inputs += 1;
        Ok(writer.record(now, input)?)
    })?;
    Ok((writer.finish()?, account))
}

//! Foreign files as recordings of ours, so that everything that works on recordings works on them.
//!
//! A telemetry log and a descriptor's run become the inputs that a station would have been given, with a configuration in the header.
//! docs/import.md says what is kept and what is lost.

mod descriptor;
pub(crate) mod parts;
mod timeline;
mod tlog;

use std::io::{Cursor, Seek, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use posebridge_recording::container::{FORMAT, Header, ReadError, Reader, Writer};
use posebridge_telemetry::{Address, HostClock, Input, Stamp};

use crate::cli::DataFlags;
use crate::config::{self, Config, RobotProfile, Setting};
use crate::input_file::{InputFile, Kind};

/// A recording lies in memory while it is worked on: how much of it is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// So many bytes at most, of all parts together.
    pub most_bytes: u64,
    /// What becomes of parts that do not fit.
    pub beyond: Beyond,
}

/// What becomes of the parts of a recording for which there is no room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beyond {
    /// They are an error.
    Refused,
    /// They are left out, and it is said.
    LeftOut,
}

impl Default for Room {
    /// As much as a computer on which somebody waits for a result may have to spare.
    fn default() -> Self {
        Self { most_bytes: 4 << 30, beyond: Beyond::Refused }
    }
}

/// With which station a file without a configuration is read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Station<'a> {
    /// A station's configuration; without it the default one.
    pub config: Option<&'a Path>,
    /// Another robot.
    pub robot: Option<&'a Path>,
    /// Single keys; they go over both.
    pub settings: &'a [Setting],
}

impl Station<'_> {
    fn config(&self) -> Result<Config> {
        let mut config = config::load(self.config, self.settings)?.config;
        if let Some(path) = self.robot {
            config = config.with_robot(RobotProfile::read(path)?);
            config = config::lay_over(&config, self.settings)?;
        }
        Ok(config)
    }
}

/// What an import has made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Account {
    /// Inputs written.
    pub inputs: u64,
    /// What was left out or changed, in words for people.
    pub notes: Vec<String>,
}

/// Takes the inputs of a file as they are found.
pub type Sink<'s> = dyn FnMut(Stamp<HostClock>, &Input) -> Result<()> + 's;

/// What a session was given, and how its station was configured.
pub struct Session {
    /// The configuration, and what else the result depends on.
    pub header: Header,
    /// What was left out, as far as that is known before the inputs are read; in words.
    pub notes: Vec<String>,
    /// Where the inputs are.
    pub inputs: Inputs,
}

/// Where the inputs of a session are.
pub enum Inputs {
    /// In a recording of ours, in memory.
    Recorded(Vec<u8>),
    /// In a telemetry log, from which they are made one by one.
    Logged(Box<LoggedInputs>),
}

/// The inputs that a telemetry log stands for.
pub struct LoggedInputs(tlog::Source);

impl LoggedInputs {
    /// Gives them in the order of their times; the first one always at [`Stamp::ZERO`]. Says in words what was left out.
    ///
    /// # Errors
    /// The file cannot be read any further, or as `sink` says.
    pub fn give(&self, sink: &mut Sink<'_>) -> Result<Vec<String>> {
        self.0.inputs(sink)
    }
}

/// Gives the frames of a telemetry log with their times, microseconds since 1970, cleared of damage and of steps of the date, so that they never
/// fall; says in words what was wrong with them.
///
/// # Errors
/// The file cannot be read to its end or holds no frame, or its times make no sense.
pub fn logged_frames(path: &Path, station: Station<'_>, take: &mut dyn FnMut(u64, &[u8])) -> Result<Vec<String>> {
    let own = station.config()?.station;
    tlog::frames_in_time(path, Address::new(own.system, own.component), take)
}

/// Writes a telemetry log or a descriptor's run as a recording of ours.
///
/// # Errors
/// The file cannot be read or makes no sense, or `out` cannot be written.
pub fn import<W: Write + Seek>(path: &Path, data: &DataFlags, station: Station<'_>, out: W) -> Result<(W, Account)> {
    match InputFile::open(path)?.kind {
        Kind::Tlog => {
            let source = tlog::Source::open(path, station.config()?)?;
            let header = header_of(&source.config, source.epoch_micros)?;
            write(out, &header, |sink| source.inputs(sink))
        }
        Kind::Descriptor => {
            let source = descriptor::Source::open(path, data)?;
            let header = header_of(&source.config, 0)?;
            write(out, &header, |sink| source.inputs(sink))
        }
        Kind::Own => bail!("`{}` is a recording of posebridge already", path.display()),
        Kind::Bytes => {
            bail!("`{}`: bytes without times cannot be replayed; a telemetry log (*.tlog) has times", path.display())
        }
    }
}

/// The bytes of a recording of ours: those of the file with all parts that continue it, or made from a telemetry log in memory; and what
/// was left out.
///
/// # Errors
/// The file cannot be read, or is neither.
pub fn recording_bytes(path: &Path, station: Station<'_>) -> Result<(Vec<u8>, Vec<String>)> {
    let file = InputFile::open(path)?;
    if file.kind != Kind::Tlog {
        return own_bytes(path, file, Room::default());
    }
    let source = tlog::Source::open(path, station.config()?)?;
    let header = header_of(&source.config, source.epoch_micros)?;
    let out = Cursor::new(Vec::new());
    let (out, account) = write(out, &header, |sink| source.inputs(sink))?;
    Ok((out.into_inner(), account.notes))
}

/// The bytes of a recording of ours with the parts that continue it, as far as there is room for them; and what was left out.
///
/// # Errors
/// The file cannot be read, is no recording of ours, or is larger than the room.
pub fn own_recording_bytes(path: &Path, room: Room) -> Result<(Vec<u8>, Vec<String>)> {
    own_bytes(path, InputFile::open(path)?, room)
}

fn own_bytes(path: &Path, mut file: InputFile, room: Room) -> Result<(Vec<u8>, Vec<String>)> {
    let (name, size) = (file.name.clone(), file.size);
    // Looked at before it is read: what is none may be large.
    if let Err(error @ ReadError::NotMcap) = Reader::open(file.beginning()?) {
        return Err(error)
            .with_context(|| format!("recording `{name}` ({size} bytes): `posebridge run` writes recordings"));
    }
    parts::joined(path, file.whole(room.most_bytes)?, room)
}

/// A recording of ours with all parts that continue it, or a telemetry log.
///
/// # Errors
/// As [`recording_bytes`].
pub fn session(path: &Path, station: Station<'_>) -> Result<Session> {
    if InputFile::open(path)?.kind == Kind::Tlog {
        let source = tlog::Source::open(path, station.config()?)?;
        return Ok(Session {
            header: header_of(&source.config, source.epoch_micros)?,
            notes: Vec::new(),
            inputs: Inputs::Logged(Box::new(LoggedInputs(source))),
        });
    }
    let (bytes, notes) = recording_bytes(path, station)?;
    let reader = Reader::open(&bytes).with_context(|| format!("recording `{}`", path.display()))?;
    Ok(Session { header: reader.header().clone(), notes, inputs: Inputs::Recorded(bytes) })
}

fn header_of(config: &Config, utc_start_micros: u64) -> Result<Header> {
    Ok(Header {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros,
        config_toml: toml::to_string(config).context("writing the configuration into the recording")?,
        links: config.links.iter().map(|link| link.url.clone()).collect(),
    })
}

fn write<W: Write + Seek>(
    out: W,
    header: &Header,
    inputs: impl FnOnce(&mut Sink<'_>) -> Result<Vec<String>>,
) -> Result<(W, Account)> {
    let mut writer = Writer::create(out, header)?;
    let mut account = Account::default();
    account.notes = inputs(&mut |now, input| {
        account.inputs += 1;
        Ok(writer.record(now, input)?)
    })?;
    Ok((writer.finish()?, account))
}

//! The files of a recording: one after another, each readable by itself.
//!
//! Knows no thread and no queue, so that tests drive it as they like. It flushes 600 ms after the last flush, and once
//! a second looks whether the file is still there, whether the disk has room, and whether the part is large or old enough.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_recording::container::{Beginning, Gap, Handover, Header, TruthSample, WriteError, Writer};
use posebridge_telemetry::{Calibration, Event, HostClock, Input, Span, Stamp};

use super::watched::Watched;

/// What was recorded reaches the system at least this often, so that a killed program loses less than a second, 400 ms of sparse inputs and a late thread
/// included. Each time a chunk ends, and what the file's index needs of it stays in memory until the part ends: more often would let a long
/// recording's memory grow.
pub const FLUSH_PERIOD: Span = Span::from_millis(600);
/// What is said of everything that comes after a part that could not be ended, or the next one begun.
const HAS_ENDED: &str = "the recording has ended: it could not go on in another file";
/// File and disk are looked at this often.
const LOOK_PERIOD: Span = Span::from_millis(1_000);

/// When a recording goes on in a new file, when it ends, and what stands beside the inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// A part ends when it is so large, in bytes.
    pub part_bytes: Option<u64>,
    /// A part ends when it is so old.
    pub part_span: Option<Span>,
    /// The recording ends when the disk has less room than this, in bytes.
    pub floor_bytes: u64,
    /// Estimates beside the inputs lie at least so far apart.
    pub output_spacing: Span,
}

impl Default for Limits {
    /// Those of the configuration's default.
    fn default() -> Self {
        crate::config::RecordSection::default().limits()
    }
}

/// What a recording holds when it has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kept {
    /// Inputs in it.
    pub inputs: u64,
    /// Inputs that it lacks because the disk was too slow.
    pub lost: u64,
    /// Files.
    pub parts: u32,
}

impl Kept {
    /// Nothing is missing.
    ///
    /// # Errors
    /// Inputs are; the message says how many.
    pub fn whole(self) -> Result<()> {
        ensure!(self.lost == 0, "the disk was too slow for {} inputs; a replay is not exact", self.lost);
        Ok(())
    }
}

/// A recording that is being written.
pub struct Parts {
    first: PathBuf,
    header: Header,
    limits: Limits,
    /// The part that is being written; none once it could not go on in another one.
    part: Option<Part>,
    kept: Kept,
    /// Number of the next input of the session.
    next: u64,
    last: Stamp<HostClock>,
    flushed: Stamp<HostClock>,
    looked: Stamp<HostClock>,
}

/// The file that is open.
struct Part {
    file: Watched,
    writer: Writer<File>,
    begun: Option<Stamp<HostClock>>,
}

impl Part {
    fn create(path: &Path, header: &Header, begins: &Beginning, spacing: Span) -> Result<Self> {
        let (out, file) = Watched::create("recording", path)?;
        let mut writer = Writer::create_part(out, header, begins).with_context(|| file.name())?;
        writer.space_outputs(spacing);
        Ok(Self { file, writer, begun: None })
    }
}

impl Parts {
    /// Creates the first file. `inputs_before` were given to the pipeline before the recording begins.
    ///
    /// # Errors
    /// It cannot be created; one that is there already is never overwritten.
    pub fn create(path: &Path, header: Header, limits: Limits, inputs_before: u64) -> Result<Self> {
        let begins = Beginning { inputs_before, ..Beginning::default() };
        let part = Part::create(path, &header, &begins, limits.output_spacing)?;
        Ok(Self {
            first: path.to_owned(),
            header,
            limits,
            part: Some(part),
            kept: Kept { parts: 1, ..Kept::default() },
            next: inputs_before,
            last: Stamp::ZERO,
            flushed: Stamp::ZERO,
            looked: Stamp::ZERO,
        })
    }

    /// Records the input with this number in the session; those that are missing before it are a gap.
    ///
    /// # Errors
    /// The recording has ended, and why: what was written before stays readable.
    pub fn record(&mut self, now: Stamp<HostClock>, number: u64, input: &Input) -> Result<()> {
        self.note_gap(now, number)?;
        self.look(now)?;
        self.open()?.begun.get_or_insert(now);
        self.write(|writer| writer.record(now, input))?;
        self.kept.inputs += 1;
        self.next = number + 1;
        self.last = now;
        // With this input: where few come, the next one may be the one that is lost.
        if now - self.flushed >= FLUSH_PERIOD {
            self.flushed = now;
            self.flush()?;
        }
        Ok(())
    }

    /// Records what came out of the pipeline.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn show(&mut self, now: Stamp<HostClock>, events: &[Event]) -> Result<()> {
        for event in events {
            self.write(|writer| writer.record_event(now, event))?;
        }
        Ok(())
    }

    /// Records what the filter has learned.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn show_calibration(&mut self, now: Stamp<HostClock>, calibration: &Calibration) -> Result<()> {
        self.write(|writer| writer.record_calibration(now, calibration))
    }

    /// Records a line for people, with its MAVLink severity.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn show_line(&mut self, now: Stamp<HostClock>, severity: u8, text: &str) -> Result<()> {
        self.write(|writer| writer.record_line(now, severity, text))
    }

    /// Records where a simulated robot really was.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn record_truth(&mut self, truth: &[TruthSample]) -> Result<()> {
        let last = self.last;
        self.write(|writer| writer.record_truth(last, truth))
    }

    /// Hands over to the system what waits.
    ///
    /// # Errors
    /// As [`Self::record`].
    pub fn flush(&mut self) -> Result<()> {
        self.write(Writer::flush)
    }

    /// Ends the file; `given` is the number of the session's inputs up to here.
    ///
    /// # Errors
    /// The file could not be written.
    pub fn finish(mut self, given: u64) -> Result<Kept> {
        self.note_gap(self.last, given)?;
        self.end_part()?;
        Ok(self.kept)
    }

    /// The number that the next input of the session has.
    #[must_use]
    pub const fn next(&self) -> u64 {
        self.next
    }

    /// The number of the part that is being written, from 1.
    #[must_use]
    pub const fn part(&self) -> u32 {
        self.kept.parts
    }

    /// The part that is being written.
    fn open(&mut self) -> Result<&mut Part> {
        self.part.as_mut().context(HAS_ENDED)
    }

    /// Writes something into it.
    fn write(&mut self, one: impl FnOnce(&mut Writer<File>) -> Result<(), WriteError>) -> Result<()> {
        let part = self.open()?;
        one(&mut part.writer).with_context(|| part.file.name())
    }

    /// Ends it; gives back its path and what the next part has to know.
    fn end_part(&mut self) -> Result<(PathBuf, Handover)> {
        let ended = self.part.take().context(HAS_ENDED)?;
        let handover = ended.writer.finish_part();
        let handover = handover.with_context(|| ended.file.name())?;
        Ok((ended.file.path().to_owned(), handover))
    }

    fn note_gap(&mut self, now: Stamp<HostClock>, number: u64) -> Result<()> {
        let inputs = number.saturating_sub(self.next);
        if inputs == 0 {
            return Ok(());
        }
        self.kept.lost += inputs;
        self.next = number;
        let gap = Gap { inputs, from: self.last, to: now };
        self.write(|writer| writer.record_gap(&gap))
    }

    /// Looks at the file and its disk when it is time for it.
    fn look(&mut self, now: Stamp<HostClock>) -> Result<()> {
        if now - self.looked < LOOK_PERIOD {
            return Ok(());
        }
        self.looked = now;
        let limits = self.limits;
        let part = self.open()?;
        let bytes = part.file.bytes_there()?;
        part.file.look_at_the_disk(limits.floor_bytes)?;
        let age = part.begun.map_or(Span::ZERO, |begun| now - begun);
        let is_full =
            limits.part_bytes.is_some_and(|most| bytes >= most) || limits.part_span.is_some_and(|most| age >= most);
        if is_full { self.begin_next_part() } else { Ok(()) }
    }

    /// The one before ends first, so that never two of them are in memory: what a file's index needs is the most that a recorder keeps.
    fn begin_next_part(&mut self) -> Result<()> {
        let number = self.kept.parts + 1;
        let (before, handover) = self.end_part()?;
        let begins = Beginning {
            part: number,
            inputs_before: self.next,
            continues: before.file_name().map(|name| name.to_string_lossy().into_owned()),
        };
        let path = part_path(&self.first, number);
        let mut next = Part::create(&path, &self.header, &begins, self.limits.output_spacing)?;
        next.writer.take_over(handover);
        self.part = Some(next);
        self.kept.parts = number;
        Ok(())
    }
}

/// The path of a part: `recording.mcap`, `recording.2.mcap`, `recording.3.mcap` and so on.
#[must_use]
pub fn part_path(first: &Path, number: u32) -> PathBuf {
    match (number, first.extension()) {
        (..=1, _) => first.to_owned(),
        (_, Some(extension)) => {
            let extension = extension.to_string_lossy();
            first.with_extension(format!("{number}.{extension}"))
        }
        (_, None) => first.with_extension(number.to_string()),
    }
}

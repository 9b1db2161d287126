//! A posebridge recording as input: its parts joined in memory, messages about missing or damaged data, and its clock alignments.
//! A following part is identified by its number and by the file name that it continues; other files with such a name are ignored.
//! Damaged or missing data is reported, because the joined recording no longer shows it.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};
use indicatif::ProgressBar;
use posebridge_recording::container::{self, PartHeader, ReadError, RecordingEnd, RecordingReader, RecordingWriter};
use posebridge_telemetry::{BrickClock, Event, HostClock, Input, TimeDelta, Timestamp};

use super::input_file::InputFile;
use super::recording_parts::part_path;
use crate::console::{print_line, progress_bar};

/// Memory limit of a recording, which is processed in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryLimit {
    pub max_bytes: u64,
    pub on_excess: ExcessPolicy,
}

/// What happens to the parts of a recording that exceed the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExcessPolicy {
    Reject,
    /// They are skipped, with a note.
    Skip,
}

impl Default for MemoryLimit {
    /// Typical free memory of an interactive computer.
    fn default() -> Self {
        Self { max_bytes: 4 << 30, on_excess: ExcessPolicy::Reject }
    }
}

/// The bytes of an open posebridge recording with the parts that continue it, as far as the limit allows; and notes on skipped data.
pub fn own_bytes(path: &Path, mut file: InputFile, budget: MemoryLimit) -> Result<(Vec<u8>, Vec<String>)> {
    let (name, size) = (file.name.clone(), file.size);
    // Looked at before it is read: what is none may be large.
    if let Err(error @ ReadError::NotMcap) = RecordingReader::open(file.peek()?) {
        return Err(error)
            .with_context(|| format!("recording `{name}` ({size} bytes): `posebridge run` writes recordings"));
    }
    join_parts(path, file.read_all(budget.max_bytes)?, budget)
}

/// Joins `first`, the content of the file at `path`, with the parts that continue it within the memory limit; returns notes on missing
/// data. Unchanged without further parts. Returns a `first` that is no recording unchanged: opening it reports the error.
fn join_parts(path: &Path, first: Vec<u8>, budget: MemoryLimit) -> Result<(Vec<u8>, Vec<String>)> {
    let mut budget = RemainingMemory::new(budget, first.len() as u64);
    let Ok(reader) = RecordingReader::open(&first) else {
        return Ok((first, Vec::new()));
    };
    let number = reader.part_header().part;
    let Some((next_path, next)) = continuation(path, number, &mut budget)? else {
        return Ok((first, budget.notes()));
    };
    let out = Cursor::new(Vec::with_capacity(first.len() + next.len()));
    let mut writer = RecordingWriter::create_part(out, reader.header(), reader.part_header())?;
    let mut notes = Vec::new();
    let first_number = number;
    let mut part = (number, path.to_owned(), first);
    let mut following = Some((number + 1, next_path, next));
    let mut truth = Vec::new();
    loop {
        let (number, path, bytes) = &part;
        copy(path, bytes, &mut writer, &mut notes)?;
        // That of a simulated run; a run of an earlier format has all of it in its last part.
        truth.extend(container::read_truth(bytes).with_context(|| name_of(path))?);
        let Some(next) = following.take() else {
            writer.record_truth(Timestamp::ZERO, &truth)?;
            let count = number - first_number + 1;
            notes.insert(0, format!("{count} parts were joined"));
            notes.extend(budget.notes());
            break;
        };
        let behind = continuation(&next.1, next.0, &mut budget)?;
        following = behind.map(|(path, bytes)| (next.0 + 1, path, bytes));
        part = next;
    }
    Ok((writer.finish()?.into_inner(), notes))
}

/// File names of the parts that continue the one with content `first` at `path`.
pub(crate) fn continuation_names(path: &Path, first: &[u8]) -> Result<Vec<String>> {
    let mut names = Vec::new();
    let Ok(reader) = RecordingReader::open(first) else {
        return Ok(names);
    };
    let (mut path, mut number) = (path.to_owned(), reader.part_header().part);
    loop {
        // One at a time lies in memory.
        let mut budget = RemainingMemory::new(MemoryLimit::default(), 0);
        let Some((next, _)) = continuation(&path, number, &mut budget)? else {
            return Ok(names);
        };
        names.push(name_of(&next));
        (path, number) = (next, number + 1);
    }
}

struct RemainingMemory {
    limit: MemoryLimit,
    remaining: u64,
    skipped: Option<String>,
}

impl RemainingMemory {
    const fn new(limit: MemoryLimit, taken: u64) -> Self {
        Self { limit, remaining: limit.max_bytes.saturating_sub(taken), skipped: None }
    }

    /// Reserves memory for a part; false if it does not fit and may be skipped, else an error.
    fn reserve(&mut self, path: &Path, size: u64) -> Result<bool> {
        if size <= self.remaining {
            return Ok(true);
        }
        ensure!(
            self.limit.on_excess == ExcessPolicy::Skip,
            "`{}` and the parts before it hold more than {} MiB: begin with a later part",
            path.display(),
            self.limit.max_bytes >> 20
        );
        self.skipped = Some(name_of(path));
        Ok(false)
    }

    fn notes(&self) -> Vec<String> {
        let notes = self.skipped.iter().map(|name| {
            format!(
                "`{name}` and what follows it are left out: with them there are more than {} MiB; begin there for the rest",
                self.limit.max_bytes >> 20
            )
        });
        notes.collect()
    }
}

/// The part after part `number` at `path`; reserves memory for it.
fn continuation(path: &Path, number: u32, budget: &mut RemainingMemory) -> Result<Option<(PathBuf, Vec<u8>)>> {
    let next = part_path(&first_path(path, number), number + 1);
    if !next.is_file() {
        return Ok(None);
    }
    let name = next.display();
    let size = std::fs::metadata(&next).with_context(|| format!("looking at `{name}`"))?.len();
    if !budget.reserve(&next, size)? {
        return Ok(None);
    }
    let bytes = InputFile::open(&next)?.read_all(budget.remaining)?;
    budget.remaining = budget.remaining.saturating_sub(bytes.len() as u64);
    let continues = RecordingReader::open(&bytes).ok().is_some_and(|reader| {
        let beginning = reader.part_header();
        let before = path.file_name().unwrap_or_default().to_string_lossy();
        beginning.part == number + 1 && beginning.continues.as_deref() == Some(&*before)
    });
    Ok(continues.then_some((next, bytes)))
}

/// The path of the first part, given that of part `number`.
fn first_path(path: &Path, number: u32) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let of_part = format!(".{number}");
    match (number, name.rsplit_once('.')) {
        (2.., Some((stem, extension))) if stem.ends_with(&of_part) => {
            let stem = stem.strip_suffix(&of_part).unwrap_or(stem);
            path.with_file_name(format!("{stem}.{extension}"))
        }
        _ => path.to_owned(),
    }
}

fn copy(
    path: &Path,
    bytes: &[u8],
    writer: &mut RecordingWriter<Cursor<Vec<u8>>>,
    notes: &mut Vec<String>,
) -> Result<()> {
    let name = name_of(path);
    let mut reader = RecordingReader::open(bytes).with_context(|| name.clone())?;
    for item in &mut reader {
        match item {
            Ok((now, input)) => writer.record(now, &input)?,
            Err(error) => notes.push(format!("{name}: {error}; the replay is not that of the live run any more")),
        }
    }
    if let RecordingEnd::Truncated { offset, what } = reader.recording_end() {
        notes.push(format!("{name}: cut off at byte {offset} ({what})"));
    }
    Ok(())
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

const MAX_NOTES: usize = 50;

/// Warnings about a recording: the first ones as text, the others as a count.
#[derive(Debug, Default)]
pub struct RecordingWarnings {
    lines: Vec<String>,
    omitted: u64,
}

impl RecordingWarnings {
    pub fn from_notes(found: &[String]) -> Self {
        let mut notes = Self::default();
        found.iter().cloned().for_each(|note| notes.add(note));
        notes
    }

    pub fn add(&mut self, note: String) {
        if self.lines.len() < MAX_NOTES {
            self.lines.push(note);
        } else {
            self.omitted += 1;
        }
    }

    pub fn add_missing_start(&mut self, beginning: &PartHeader) {
        if let Some(lack) = missing_start(beginning) {
            self.add(format!("{lack}; the replay is not that of the live run"));
        }
    }

    /// Reports unreadable data; the intact data after it is still replayed.
    pub fn add_damage(&mut self, error: &ReadError) {
        self.add(format!("{error}; the replay is not that of the live run any more"));
    }

    pub fn add_ending(&mut self, ending: &RecordingEnd) {
        if let RecordingEnd::Truncated { offset, what } = ending {
            self.add(format!("cut off at byte {offset} ({what}); everything before was replayed"));
        }
    }

    pub fn into_lines(mut self) -> Vec<String> {
        if self.omitted > 0 {
            self.lines.push(format!("{} more places are damaged", self.omitted));
        }
        self.lines
    }
}

/// Describes the missing beginning of the session; `None` if the recording begins with it.
pub fn missing_start(beginning: &PartHeader) -> Option<String> {
    let before = beginning.inputs_before;
    let holder = match &beginning.continues {
        Some(name) => format!("they are in `{name}` and what that continues"),
        None => "nobody recorded them".to_owned(),
    };
    (before > 0).then(|| format!("it lacks the first {before} inputs of its session ({holder})"))
}

/// Passes every input of a recording. Damage and truncation are printed; the intact inputs are used.
pub fn for_each_input(
    name: &str,
    reader: &mut RecordingReader<'_>,
    mut take: impl FnMut(Timestamp<HostClock>, &Input) -> Result<()>,
) -> Result<()> {
    let progress = ReadProgress::new(reader)?;
    let mut is_empty = true;
    while let Some(item) = reader.next() {
        match item {
            Ok((now, input)) => {
                is_empty = false;
                take(now, &input)?;
            }
            Err(error) => progress.print(&format!("{name}: {error}; what is whole is used")),
        }
        progress.update(reader);
    }
    drop(progress);
    if let RecordingEnd::Truncated { offset, what } = reader.recording_end() {
        print_line(&format!("{name}: cut off at byte {offset} ({what}); everything before is used"));
    }
    if is_empty { Err(nothing_read(name)) } else { Ok(()) }
}

/// The error of a file in which nothing could be read: no empty result may pass for one.
pub fn nothing_read(name: &str) -> anyhow::Error {
    anyhow!(
        "`{name}` holds nothing that can be read; if no robot was heard while it was recorded, look for the robot with `posebridge doctor`"
    )
}

/// A progress bar over the bytes of a recording; it vanishes when dropped.
pub struct ReadProgress(ProgressBar);

impl ReadProgress {
    /// Bytes between two updates.
    const STEP: u64 = 256 * 1024;
    /// Smaller recordings are read in less than two seconds.
    const MIN_SIZE: u64 = 8 << 20;

    pub fn new(reader: &RecordingReader<'_>) -> Result<Self> {
        let is_long = reader.size() >= Self::MIN_SIZE;
        Ok(Self(if is_long { progress_bar(reader.size(), "bytes")? } else { ProgressBar::hidden() }))
    }

    fn print(&self, line: &str) {
        self.0.suspend(|| print_line(line));
    }

    pub fn update(&self, reader: &RecordingReader<'_>) {
        if reader.offset() >= self.0.position() + Self::STEP {
            self.0.set_position(reader.offset());
        }
    }
}

impl Drop for ReadProgress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

/// One instant by both clocks, and the rate between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockAlignment {
    pub host: Timestamp<HostClock>,
    pub brick: Timestamp<BrickClock>,
    /// Rate of the brick's clock relative to the host's, minus one.
    pub skew_ppm: f64,
}

impl ClockAlignment {
    pub const fn from_event(event: &Event) -> Option<Self> {
        if let Event::BrickClockAligned { host, brick, skew_ppm, .. } = *event {
            return Some(Self { host, brick, skew_ppm });
        }
        None
    }

    pub fn brick_at(&self, host: Timestamp<HostClock>) -> Timestamp<BrickClock> {
        let since_s = (host - self.host).as_secs_f64();
        self.brick + TimeDelta::from_secs_f64(since_s * self.rate())
    }

    pub fn host_at(&self, brick: Timestamp<BrickClock>) -> Timestamp<HostClock> {
        let since_s = (brick - self.brick).as_secs_f64();
        self.host + TimeDelta::from_secs_f64(since_s / self.rate())
    }

    fn rate(&self) -> f64 {
        1.0 + 1e-6 * self.skew_ppm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_recording::container::{RecordingHeader, TruthSample};
    use posebridge_telemetry::{Address, Input, LinkId, Pose, RobotId};

    use crate::config::RecordingLimits;
    use crate::station::recording_parts::RecordingParts;

    /// Seven seconds of ticks, four a second, in parts of two seconds, with a robot's truth beside each tick.
    fn record(folder: &Path) -> PathBuf {
        let path = folder.join("recording.mcap");
        let limits =
            RecordingLimits { part_duration: Some(TimeDelta::from_millis(2_000)), ..RecordingLimits::default() };
        let header = RecordingHeader { format: container::FORMAT, ..RecordingHeader::default() };
        let mut parts = RecordingParts::create(&path, header, limits, 0).unwrap();
        for number in 0..28 {
            let now = Timestamp::from_millis(250 * i64::from(number));
            parts.record(now, u64::from(number as u32), &Input::Tick).unwrap();
            parts.record_outputs(|writer, last| writer.record_truth(last, &[truth(number)])).unwrap();
        }
        parts.finish(28).unwrap();
        path
    }

    fn truth(number: i32) -> TruthSample {
        let robot = RobotId { link: LinkId(0), address: Address::new(1 + number as u8 % 2, 1) };
        let time = Timestamp::from_millis(250 * i64::from(number));
        TruthSample { robot: Some(robot), time, pose: Pose::default(), odometry: None }
    }

    fn instants(bytes: &[u8]) -> Vec<i64> {
        let reader = RecordingReader::open(bytes).unwrap();
        let instant = |item: Result<(Timestamp<_>, Input), _>| item.unwrap().0.as_nanos() / 1_000_000;
        reader.map(instant).collect()
    }

    #[test]
    fn parts_that_continue_each_other_are_one_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = record(folder.path());
        assert!(folder.path().join("recording.3.mcap").exists());
        let first = std::fs::read(&path).unwrap();
        let (whole, notes) = join_parts(&path, first, MemoryLimit::default()).unwrap();
        let expected: Vec<i64> = (0..28).map(|number| 250 * number).collect();
        assert_eq!(instants(&whole), expected);
        assert_eq!(notes, ["4 parts were joined"]);
        let expected: Vec<TruthSample> = (0..28).map(truth).collect();
        assert_eq!(container::read_truth(&whole).unwrap(), expected);
    }

    #[test]
    fn a_later_part_is_joined_with_what_follows_and_still_lacks_its_beginning() {
        let folder = tempfile::tempdir().unwrap();
        record(folder.path());
        let second = folder.path().join("recording.2.mcap");
        let bytes = std::fs::read(&second).unwrap();
        let begins_ms = instants(&bytes)[0];
        let names = continuation_names(&second, &bytes).unwrap();
        assert_eq!(names, ["recording.3.mcap", "recording.4.mcap"]);
        let (rest, notes) = join_parts(&second, bytes, MemoryLimit::default()).unwrap();
        assert_eq!(notes, ["3 parts were joined"]);
        let found = instants(&rest);
        assert_eq!((found[0], found[found.len() - 1]), (begins_ms, 6_750));
        let reader = RecordingReader::open(&rest).unwrap();
        assert!(reader.part_header().inputs_before > 0);
        assert_eq!(reader.part_header().part, 2);
    }

    #[test]
    fn parts_that_are_too_much_together_are_refused_before_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = record(folder.path());
        let first = std::fs::read(&path).unwrap();
        let second = std::fs::metadata(folder.path().join("recording.2.mcap")).unwrap();
        let budget = |beyond| MemoryLimit { max_bytes: first.len() as u64 + second.len(), on_excess: beyond };
        let refused = join_parts(&path, first.clone(), budget(ExcessPolicy::Reject));
        let refused = refused.unwrap_err().to_string();
        assert!(refused.contains("recording.3.mcap"), "{refused}");
        assert!(refused.contains("begin with a later part"), "{refused}");
        // Or what fits is taken.
        let (begun, notes) = join_parts(&path, first.clone(), budget(ExcessPolicy::Skip)).unwrap();
        let (all, _) = join_parts(&path, first.clone(), MemoryLimit::default()).unwrap();
        let (begun, all) = (instants(&begun), instants(&all));
        assert!(all.starts_with(&begun) && begun.len() < all.len(), "{begun:?}");
        assert_eq!(notes[0], "2 parts were joined");
        assert!(notes[1].starts_with("`recording.3.mcap` and what follows it are left out"), "{notes:?}");
    }

    #[test]
    fn a_stranger_under_the_name_of_a_part_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = record(folder.path());
        let bytes = std::fs::read(&path).unwrap();
        std::fs::copy(&path, folder.path().join("recording.2.mcap")).unwrap();
        let (same, notes) = join_parts(&path, bytes.clone(), MemoryLimit::default()).unwrap();
        assert_eq!((same, notes), (bytes, Vec::new()));
    }

    #[test]
    fn an_instant_goes_to_the_other_clock_and_back() {
        let aligned = ClockAlignment {
            host: Timestamp::from_millis(5_000),
            brick: Timestamp::from_millis(1_000),
            skew_ppm: 1_000.0,
        };
        let host = Timestamp::from_millis(15_000);
        let brick = aligned.brick_at(host);
        assert_eq!(brick, Timestamp::from_millis(11_010));
        let there_and_back = aligned.host_at(brick) - host;
        assert!(there_and_back.as_secs_f64().abs() < 1e-8);
    }
}

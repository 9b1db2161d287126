//! A recording in several files as one: the parts that continue each other, joined in memory.
//!
//! A part is known to follow by its number and by the name of the file that it says it continues; what else lies in the folder under such
//! a name is left alone. What was damaged or missing is said, because the joined recording no longer shows it.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_recording::container::{self, Ending, Reader, Writer};

use super::{Beyond, Room};
use crate::input_file::InputFile;
use crate::tasks::parts::part_path;

/// The recording in `first`, the content of the file at `path`, with the parts that continue it and for which there is room; and what they
/// lack, in words. As it is if nothing continues it.
///
/// # Errors
/// A part that continues it cannot be read. A `first` that is no recording comes back as it is: whoever opens it says so.
pub(super) fn joined(path: &Path, first: Vec<u8>, room: Room) -> Result<(Vec<u8>, Vec<String>)> {
    let mut room = RoomLeft::new(room, first.len() as u64);
    let Ok(reader) = Reader::open(&first) else {
        return Ok((first, Vec::new()));
    };
    let number = reader.beginning().part;
    let Some((next_path, next)) = continuation((path, number), &mut room)? else {
        return Ok((first, room.notes()));
    };
    let out = Cursor::new(Vec::with_capacity(first.len() + next.len()));
    let mut writer = Writer::create_part(out, reader.header(), reader.beginning())?;
    let mut notes = Vec::new();
    let first_number = number;
    let mut part = (number, path.to_owned(), first);
    let mut following = Some((number + 1, next_path, next));
    let mut truth = Vec::new();
    loop {
        let (number, path, bytes) = &part;
        copy(path, bytes, &mut writer, &mut notes)?;
        // That of a simulated run; a run of an earlier format has all of it in its last part.
        truth.extend(container::truth(bytes).with_context(|| name_of(path))?);
        let Some(next) = following.take() else {
            writer.record_truth(posebridge_telemetry::Stamp::ZERO, &truth)?;
            let count = number - first_number + 1;
            notes.insert(0, format!("{count} parts were joined"));
            notes.extend(room.notes());
            break;
        };
        let behind = continuation((&next.1, next.0), &mut room)?;
        following = behind.map(|(path, bytes)| (next.0 + 1, path, bytes));
        part = next;
    }
    Ok((writer.finish()?.into_inner(), notes))
}

/// The names of the parts that continue the one whose content is `first`, in the file at `path`.
///
/// # Errors
/// As [`joined`].
pub(crate) fn names_behind(path: &Path, first: &[u8]) -> Result<Vec<String>> {
    let mut names = Vec::new();
    let Ok(reader) = Reader::open(first) else {
        return Ok(names);
    };
    let (mut path, mut number) = (path.to_owned(), reader.beginning().part);
    loop {
        // One at a time lies in memory.
        let mut room = RoomLeft::new(Room::default(), 0);
        let Some((next, _)) = continuation((&path, number), &mut room)? else {
            return Ok(names);
        };
        names.push(name_of(&next));
        (path, number) = (next, number + 1);
    }
}

/// What is left of the room, and what found none.
struct RoomLeft {
    room: Room,
    left: u64,
    left_out: Option<String>,
}

impl RoomLeft {
    const fn new(room: Room, taken: u64) -> Self {
        Self { room, left: room.most_bytes.saturating_sub(taken), left_out: None }
    }

    /// Whether a part of this size still fits; one that has to is an error.
    fn has(&mut self, path: &Path, size: u64) -> Result<bool> {
        if size <= self.left {
            return Ok(true);
        }
        ensure!(
            self.room.beyond == Beyond::LeftOut,
            "`{}` and the parts before it hold more than {} MiB: begin with a later part",
            path.display(),
            self.room.most_bytes >> 20
        );
        self.left_out = Some(name_of(path));
        Ok(false)
    }

    fn notes(&self) -> Vec<String> {
        let notes = self.left_out.iter().map(|name| {
            format!(
                "`{name}` and what follows it are left out: with them there are more than {} MiB; begin there for the rest",
                self.room.most_bytes >> 20
            )
        });
        notes.collect()
    }
}

/// The part behind part `number`, which is the file at `path`; takes its bytes from the room.
fn continuation((path, number): (&Path, u32), room: &mut RoomLeft) -> Result<Option<(PathBuf, Vec<u8>)>> {
    let next = part_path(&first_path(path, number), number + 1);
    if !next.is_file() {
        return Ok(None);
    }
    let name = next.display();
    let size = std::fs::metadata(&next).with_context(|| format!("looking at `{name}`"))?.len();
    if !room.has(&next, size)? {
        return Ok(None);
    }
    let bytes = InputFile::open(&next)?.whole(room.left)?;
    room.left = room.left.saturating_sub(bytes.len() as u64);
    let continues = Reader::open(&bytes).ok().is_some_and(|reader| {
        let beginning = reader.beginning();
        let before = path.file_name().unwrap_or_default().to_string_lossy();
        beginning.part == number + 1 && beginning.continues.as_deref() == Some(&*before)
    });
    Ok(continues.then_some((next, bytes)))
}

/// The path of the first part, from that of part `number`.
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

fn copy(path: &Path, bytes: &[u8], writer: &mut Writer<Cursor<Vec<u8>>>, notes: &mut Vec<String>) -> Result<()> {
    let name = name_of(path);
    let mut reader = Reader::open(bytes).with_context(|| name.clone())?;
    for item in &mut reader {
        match item {
            Ok((now, input)) => writer.record(now, &input)?,
            Err(error) => notes.push(format!("{name}: {error}; the replay is not that of the live run any more")),
        }
    }
    if let Ending::Torn { offset, what } = reader.ending() {
        notes.push(format!("{name}: cut off at byte {offset} ({what})"));
    }
    Ok(())
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::parts::{Limits, Parts};
    use posebridge_recording::container::Header;
    use posebridge_telemetry::{Input, Span, Stamp};

    /// Seven seconds of ticks, four a second, in parts of two seconds.
    fn record(folder: &Path) -> PathBuf {
        let path = folder.join("recording.mcap");
        let limits = Limits { part_span: Some(Span::from_millis(2_000)), ..Limits::default() };
        let header = Header { format: container::FORMAT, ..Header::default() };
        let mut parts = Parts::create(&path, header, limits, 0).unwrap();
        for number in 0..28 {
            let now = Stamp::from_millis(250 * i64::from(number));
            parts.record(now, u64::from(number as u32), &Input::Tick).unwrap();
        }
        parts.finish(28).unwrap();
        path
    }

    fn instants(bytes: &[u8]) -> Vec<i64> {
        let reader = Reader::open(bytes).unwrap();
        let instant = |item: Result<(Stamp<_>, Input), _>| item.unwrap().0.as_nanos() / 1_000_000;
        reader.map(instant).collect()
    }

    #[test]
    fn parts_that_continue_each_other_are_one_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = record(folder.path());
        assert!(folder.path().join("recording.3.mcap").exists());
        let first = std::fs::read(&path).unwrap();
        let (whole, notes) = joined(&path, first, Room::default()).unwrap();
        let expected: Vec<i64> = (0..28).map(|number| 250 * number).collect();
        assert_eq!(instants(&whole), expected);
        assert_eq!(notes, ["4 parts were joined"]);
    }

    #[test]
    fn a_later_part_is_joined_with_what_follows_and_still_lacks_its_beginning() {
        let folder = tempfile::tempdir().unwrap();
        record(folder.path());
        let second = folder.path().join("recording.2.mcap");
        let bytes = std::fs::read(&second).unwrap();
        let begins_ms = instants(&bytes)[0];
        let names = names_behind(&second, &bytes).unwrap();
        assert_eq!(names, ["recording.3.mcap", "recording.4.mcap"]);
        let (rest, notes) = joined(&second, bytes, Room::default()).unwrap();
        assert_eq!(notes, ["3 parts were joined"]);
        let found = instants(&rest);
        assert_eq!((found[0], found[found.len() - 1]), (begins_ms, 6_750));
        let reader = Reader::open(&rest).unwrap();
        assert!(reader.beginning().inputs_before > 0);
        assert_eq!(reader.beginning().part, 2);
    }

    #[test]
    fn parts_that_are_too_much_together_are_refused_before_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = record(folder.path());
        let first = std::fs::read(&path).unwrap();
        let second = std::fs::metadata(folder.path().join("recording.2.mcap")).unwrap();
        let room = |beyond| Room { most_bytes: first.len() as u64 + second.len(), beyond };
        let refused = joined(&path, first.clone(), room(Beyond::Refused));
        let refused = refused.unwrap_err().to_string();
        assert!(refused.contains("recording.3.mcap"), "{refused}");
        assert!(refused.contains("begin with a later part"), "{refused}");
        // Or what fits is taken.
        let (begun, notes) = joined(&path, first.clone(), room(Beyond::LeftOut)).unwrap();
        let (all, _) = joined(&path, first.clone(), Room::default()).unwrap();
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
        let (same, notes) = joined(&path, bytes.clone(), Room::default()).unwrap();
        assert_eq!((same, notes), (bytes, Vec::new()));
    }
}

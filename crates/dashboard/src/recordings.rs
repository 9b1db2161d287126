//! The recordings of this run: list and download.
//!
//! A name from outside never becomes a path: it is looked up among the names in the folder.

use std::fs::DirEntry;
use std::path::PathBuf;
use std::time::UNIX_EPOCH;

use posebridge_recording::ros2::BAG_SUFFIX;

use crate::model::{RecordingNow, RecordingRow};

/// With a new file every five minutes this is a week.
const MAX_LISTED: usize = 2_100;
const FILE_SUFFIX: &str = ".mcap";

#[derive(Clone, Debug)]
pub(crate) struct RecordingFolder {
    folder: PathBuf,
}

impl RecordingFolder {
    pub(crate) const fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Sorted by start, the latest ones if there are too many. `current` is being written. A missing folder has none.
    pub(crate) fn list(&self, current: Option<&str>) -> Vec<RecordingRow> {
        let mut rows: Vec<RecordingRow> = self.rows(current).collect();
        rows.sort_unstable_by(|one, other| sort_key(&one.name).cmp(&sort_key(&other.name)));
        let surplus = rows.len().saturating_sub(MAX_LISTED);
        rows.drain(..surplus);
        rows
    }

    fn rows(&self, current: Option<&str>) -> impl Iterator<Item = RecordingRow> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten();
        entries.filter_map(move |entry| row_of(&entry.ok()?, current))
    }

    pub(crate) fn path(&self, name: &str) -> Option<PathBuf> {
        let row = self.rows(None).find(|row| row.name == name)?;
        Some(self.folder.join(&row.name))
    }

    pub(crate) fn current(&self, name: &str) -> RecordingNow {
        let bytes = std::fs::metadata(self.folder.join(name)).map_or(0, |found| found.len());
        RecordingNow { name: name.to_owned(), bytes }
    }
}

/// The sort key of a name: `recording.mcap`, its parts `recording.2.mcap` to `recording.10.mcap`, then
/// `recording-2.mcap` and its parts.
fn sort_key(name: &str) -> (&str, u64, u64, &str) {
    let base = name.strip_suffix(FILE_SUFFIX).unwrap_or(name);
    let (base, part) = split_number(base, '.');
    let (stem, number) = split_number(base, '-');
    (stem, number, part, name)
}

/// Splits a number off the end; the first file has none.
fn split_number(text: &str, separator: char) -> (&str, u64) {
    let split = text.rsplit_once(separator);
    let numbered = split.and_then(|(head, number)| Some((head, number.parse().ok()?)));
    numbered.unwrap_or((text, 1))
}

fn row_of(entry: &DirEntry, current: Option<&str>) -> Option<RecordingRow> {
    let name = entry.file_name().into_string().ok()?;
    // A symbolic link could lead anywhere.
    let is_file = entry.file_type().is_ok_and(|kind| kind.is_file());
    // A ROS 2 bag beside a recording is not one of ours.
    if !is_file || !name.ends_with(FILE_SUFFIX) || name.ends_with(BAG_SUFFIX) {
        return None;
    }
    let found = entry.metadata().ok()?;
    let begun = found.created().or_else(|_| found.modified()).ok();
    let since_1970 = begun.and_then(|begun| begun.duration_since(UNIX_EPOCH).ok());
    Some(RecordingRow {
        is_current: current == Some(name.as_str()),
        bytes: found.len(),
        begun: since_1970.map(|duration| duration.as_secs()),
        name,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_stand_in_the_order_in_which_they_were_begun() {
        let folder = tempfile::tempdir().unwrap();
        let names = [
            "other.mcap",
            "recording.mcap",
            "recording.2.mcap",
            "recording.10.mcap",
            "recording-2.mcap",
            "recording-2.3.mcap",
            "recording-10.mcap",
        ];
        for name in names.iter().rev() {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let rows = RecordingFolder::new(folder.path().to_owned()).list(None);
        let listed: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(listed, names);
    }

    #[test]
    fn of_too_many_the_latest_are_listed_and_all_can_be_had() {
        let folder = tempfile::tempdir().unwrap();
        for part in 1..=MAX_LISTED + 3 {
            let name = format!("recording.{part}.mcap");
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let recordings = RecordingFolder::new(folder.path().to_owned());
        let rows = recordings.list(None);
        assert_eq!((rows.len(), rows[0].name.as_str()), (MAX_LISTED, "recording.4.mcap"));
        assert!(recordings.path("recording.1.mcap").is_some());
    }

    #[test]
    fn only_recordings_of_the_folder_can_be_named() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("run");
        std::fs::create_dir(&inner).unwrap();
        std::fs::write(folder.path().join("outside.mcap"), "secret").unwrap();
        std::fs::write(inner.join("recording.mcap"), "12345").unwrap();
        std::fs::write(inner.join("recording-ros2.mcap"), "").unwrap();
        std::fs::write(inner.join("parameters.toml"), "").unwrap();
        std::os::unix::fs::symlink("../outside.mcap", inner.join("link.mcap")).unwrap();
        std::fs::create_dir(inner.join("folder.mcap")).unwrap();
        let recordings = RecordingFolder::new(inner.clone());
        let rows = recordings.list(Some("recording.mcap"));
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].bytes, rows[0].is_current), (5, true));
        assert!(rows[0].begun.is_some_and(|begun| begun > 1_600_000_000));
        assert_eq!(recordings.path("recording.mcap"), Some(inner.join("recording.mcap")));
        for name in ["../outside.mcap", "link.mcap", "/etc/passwd", "..", "", "parameters.toml"] {
            assert_eq!(recordings.path(name), None, "{name}");
        }
    }
}

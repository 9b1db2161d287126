//! The recordings of this run: what there is, and whole files of it.
//!
//! A name from outside is never made into a path: it is looked for among the names of the folder.

use std::fs::DirEntry;
use std::path::PathBuf;
use std::time::UNIX_EPOCH;

use crate::model::{RecordingNow, RecordingRow};

/// So many are listed; a run that goes on in a new file every quarter of an hour has ten days in them.
const MOST_LISTED: usize = 1_000;
/// How their names end.
const ENDING: &str = ".mcap";

/// The folder of this run's recordings.
#[derive(Clone, Debug)]
pub(crate) struct Recordings {
    folder: PathBuf,
}

impl Recordings {
    pub(crate) const fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// All recordings, sorted by name; `current` is being written. A folder that is gone has none.
    pub(crate) fn list(&self, current: Option<&str>) -> Vec<RecordingRow> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten();
        let rows = entries.filter_map(|entry| row_of(&entry.ok()?, current));
        let mut rows: Vec<RecordingRow> = rows.take(MOST_LISTED).collect();
        rows.sort_unstable_by(|one, other| one.name.cmp(&other.name));
        rows
    }

    /// The file of this name, if it is one of the list.
    pub(crate) fn path(&self, name: &str) -> Option<PathBuf> {
        let listed = self.list(None);
        let row = listed.iter().find(|row| row.name == name)?;
        Some(self.folder.join(&row.name))
    }

    /// How large the file is that is being written.
    pub(crate) fn now(&self, name: &str) -> RecordingNow {
        let bytes = std::fs::metadata(self.folder.join(name)).map_or(0, |found| found.len());
        RecordingNow {
            name: name.to_owned(),
            bytes,
        }
    }
}

fn row_of(entry: &DirEntry, current: Option<&str>) -> Option<RecordingRow> {
    let name = entry.file_name().into_string().ok()?;
    // A link could lead anywhere.
    let is_file = entry.file_type().is_ok_and(|kind| kind.is_file());
    if !is_file || !name.ends_with(ENDING) {
        return None;
    }
    let found = entry.metadata().ok()?;
    let begun = found.created().or_else(|_| found.modified()).ok();
    let since_1970 = begun.and_then(|begun| begun.duration_since(UNIX_EPOCH).ok());
    Some(RecordingRow {
        is_current: current == Some(name.as_str()),
        bytes: found.len(),
        begun: since_1970.map(|span| span.as_secs()),
        name,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_recordings_of_the_folder_can_be_named() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("run");
        std::fs::create_dir(&inner).unwrap();
        std::fs::write(folder.path().join("outside.mcap"), "secret").unwrap();
        std::fs::write(inner.join("recording.mcap"), "12345").unwrap();
        std::fs::write(inner.join("parameters.toml"), "").unwrap();
        std::os::unix::fs::symlink("../outside.mcap", inner.join("link.mcap")).unwrap();
        std::fs::create_dir(inner.join("folder.mcap")).unwrap();
        let recordings = Recordings::new(inner.clone());
        let rows = recordings.list(Some("recording.mcap"));
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].bytes, rows[0].is_current), (5, true));
        assert!(rows[0].begun.is_some_and(|begun| begun > 1_600_000_000));
        assert_eq!(
            recordings.path("recording.mcap"),
            Some(inner.join("recording.mcap"))
        );
        for name in [
            "../outside.mcap",
            "link.mcap",
            "/etc/passwd",
            "..",
            "",
            "parameters.toml",
        ] {
            assert_eq!(recordings.path(name), None, "{name}");
        }
    }
}

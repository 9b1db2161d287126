//! The files of an export: each has its name only when it is whole.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use super::args::ExportArgs;
use crate::console::print_line;

/// A file that is being written beside the place where it belongs; dropped before [`AtomicFile::finish`] it leaves nothing behind.
pub(super) struct AtomicFile {
    path: PathBuf,
    temporary: PathBuf,
    is_complete: bool,
}

impl AtomicFile {
    /// Begins one; what is at `path` already is not touched. What a killed export left beside it is written over.
    ///
    /// # Errors
    /// There is something at `path`, or the file cannot be created.
    pub(super) fn create(path: PathBuf) -> Result<(File, Self)> {
        ensure!(
            !path.exists(),
            "creating `{}`: the file is there already; move it or choose another folder with --out",
            path.display()
        );
        let mut name = path.clone().into_os_string();
        name.push(".part");
        let beside = PathBuf::from(name);
        let file = File::create(&beside).with_context(|| format!("creating `{}`", beside.display()))?;
        let fresh = Self { path, temporary: beside, is_complete: false };
        Ok((file, fresh))
    }

    /// Where it belongs.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Gives it its name.
    ///
    /// # Errors
    /// The system does not.
    pub(super) fn finish(mut self) -> Result<()> {
        std::fs::rename(&self.temporary, &self.path).with_context(|| format!("naming `{}`", self.path.display()))?;
        self.is_complete = true;
        Ok(())
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if !self.is_complete {
            // The caller that drops it reports why there is no file.
            drop(std::fs::remove_file(&self.temporary));
        }
    }
}

/// Begins the file of this extension in the folder, with the recording's own name; what is there already is not touched.
pub(super) fn create_new(args: &ExportArgs, extension: &str) -> Result<(File, AtomicFile)> {
    let name = format!("{}.{extension}", stem(&args.recording));
    AtomicFile::create(args.out.join(name))
}

/// The name of a file without folder and extensions.
fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    let without = Path::new(name).file_stem().unwrap_or_default();
    without.to_string_lossy().into_owned()
}

/// Says what was written.
pub(super) fn print_written(path: &Path, count: u64, what: &str) {
    print_line(&format!("wrote `{}`: {count} {what}", path.display()));
}

pub(super) fn print_notes(notes: &[String]) {
    for note in notes {
        print_line(note);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_named_after_its_recording() {
        assert_eq!(stem(Path::new("a/drive.2.tlog.gz")), "drive.2");
        assert_eq!(stem(Path::new("recording.mcap")), "recording");
    }
}

//! A file that is there when it is complete, and not before.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

/// A temporary file beside its target; dropping it before [`AtomicFile::finish`] removes it.
pub(super) struct AtomicFile {
    path: PathBuf,
    temporary: PathBuf,
    is_complete: bool,
}

impl AtomicFile {
    /// Never overwrites `path`, but a temporary file that a killed export left.
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

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

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

//! A file that is there when it is complete, and not before. So is the folder that is made for it.

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
        let beside = with_suffix(&path, ".part");
        Self::create_beside(path, beside)
    }

    /// The file `name` in a folder of its own, which must not exist.
    pub(super) fn create_in_folder(folder: &Path, name: &str) -> Result<(File, Self)> {
        ensure!(
            !folder.exists(),
            "creating `{}`: the folder is there already; move it or choose another one with --out",
            folder.display()
        );
        Self::create_beside(folder.join(name), with_suffix(folder, ".part"))
    }

    fn create_beside(path: PathBuf, beside: PathBuf) -> Result<(File, Self)> {
        let file = File::create(&beside).with_context(|| format!("creating `{}`", beside.display()))?;
        let fresh = Self { path, temporary: beside, is_complete: false };
        Ok((file, fresh))
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn finish(mut self) -> Result<()> {
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder).with_context(|| format!("making the folder `{}`", folder.display()))?;
        }
        std::fs::rename(&self.temporary, &self.path).with_context(|| format!("naming `{}`", self.path.display()))?;
        self.is_complete = true;
        Ok(())
    }
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.to_owned().into_os_string();
    name.push(suffix);
    PathBuf::from(name)
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if !self.is_complete {
            // The caller that drops it reports why there is no file.
            drop(std::fs::remove_file(&self.temporary));
        }
    }
}

//! A file that has its name only when it is whole.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

/// A file that is being written beside the place where it belongs; dropped before [`Fresh::finish`] it leaves nothing behind.
pub(super) struct Fresh {
    path: PathBuf,
    beside: PathBuf,
    is_whole: bool,
}

impl Fresh {
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
        let fresh = Self { path, beside, is_whole: false };
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
        std::fs::rename(&self.beside, &self.path).with_context(|| format!("naming `{}`", self.path.display()))?;
        self.is_whole = true;
        Ok(())
    }
}

impl Drop for Fresh {
    fn drop(&mut self) {
        if !self.is_whole {
            // Why there is no file is told by whoever drops it.
            drop(std::fs::remove_file(&self.beside));
        }
    }
}

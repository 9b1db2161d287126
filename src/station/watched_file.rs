//! A file that grows while the program runs: whether it is still there, and whether its disk has room.

use std::fs::File;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use nix::sys::statvfs::statvfs;

/// A file that was made and is being written.
#[derive(Debug)]
pub struct WatchedFile {
    /// What people call it.
    description: &'static str,
    path: PathBuf,
    /// Device and number by which the system knows it.
    identity: (u64, u64),
}

impl WatchedFile {
    /// Creates the file; `what` it is stands in every error.
    ///
    /// # Errors
    /// It cannot be created; one that is there already is never overwritten.
    pub fn create(what: &'static str, path: &Path) -> Result<(File, Self)> {
        let name = path.display();
        let file = File::create_new(path).with_context(|| format!("creating the {what} `{name}`"))?;
        let identity = file.metadata().map(|found| (found.dev(), found.ino()));
        let identity = identity.with_context(|| format!("looking at `{name}`"))?;
        let path = path.to_owned();
        Ok((file, Self { description: what, path, identity }))
    }

    /// Where it was made.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The message of an error.
    pub fn name(&self) -> String {
        format!("{} `{}`", self.description, self.path.display())
    }

    /// How large it is.
    ///
    /// # Errors
    /// It was deleted or moved: what is written goes nowhere.
    pub fn file_size(&self) -> Result<u64> {
        let found = std::fs::metadata(&self.path).ok();
        match found.filter(|found| (found.dev(), found.ino()) == self.identity) {
            Some(found) => Ok(found.len()),
            None => bail!("{}: the file or its folder has been deleted or moved", self.name()),
        }
    }

    /// Looks whether the disk has more room than this.
    ///
    /// # Errors
    /// It has not.
    pub fn check_free_space(&self, floor_bytes: u64) -> Result<()> {
        // A file system that cannot be asked may well have room.
        let Ok(disk) = statvfs(&self.path) else {
            return Ok(());
        };
        let free_bytes = disk.blocks_available().saturating_mul(disk.fragment_size());
        if free_bytes >= floor_bytes {
            return Ok(());
        }
        bail!(
            "{}: the disk has {} MB left, less than `record.min_free_mb` = {}; what was written is whole",
            self.name(),
            free_bytes / 1_000_000,
            floor_bytes / 1_000_000
        )
    }
}

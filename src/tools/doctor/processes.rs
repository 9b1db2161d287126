//! The running processes and what they hold open, from `/proc`.

use std::fs;
use std::path::{Path, PathBuf};

use super::surroundings::{SystemRoots, names_in, value_in};

/// A running process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Process {
    /// Its number.
    pub(super) pid: u32,
    /// Its name, cut to 15 characters by the kernel: proc(5), `/proc/pid/comm`.
    pub(super) name: String,
    folder: PathBuf,
}

impl Process {
    /// The files that it holds open; `None` if that is hidden from us, as it is for processes of other people.
    pub(super) fn open_files(&self) -> Option<Vec<PathBuf>> {
        let descriptors = fs::read_dir(self.folder.join("fd")).ok()?;
        let targets = descriptors.flatten().filter_map(|descriptor| fs::read_link(descriptor.path()).ok());
        Some(targets.collect())
    }
}

/// All processes, by number.
pub(super) fn processes(roots: &SystemRoots) -> Vec<Process> {
    let mut found: Vec<_> = names_in(&roots.proc)
        .into_iter()
        .filter_map(|name| Some((name.parse().ok()?, roots.proc.join(name))))
        .filter_map(|(pid, folder)| process(pid, &folder))
        .collect();
    found.sort_by_key(|process| process.pid);
    found
}

/// A process that ends while we look is none.
fn process(pid: u32, folder: &Path) -> Option<Process> {
    Some(Process { pid, name: value_in(&folder.join("comm"))?, folder: folder.to_owned() })
}

/// The process whose name is one of these.
pub(super) fn running(roots: &SystemRoots, names: &[&str]) -> Option<Process> {
    processes(roots).into_iter().find(|process| names.contains(&process.name.as_str()))
}

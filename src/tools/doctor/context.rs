//! Input and output of the checks: Linux system folders, user permissions, running processes, results.

use std::fs;
use std::path::{Path, PathBuf};

use nix::unistd::{AccessFlags, Gid, Uid, User, access};
use serde::{Serialize, Serializer};

/// The configuration, links and system to check.
#[derive(Clone, Debug)]
pub struct DiagnosticContext {
    /// The root folder of the computer: `/`, in tests that of a simulated computer.
    pub root: PathBuf,
    pub user: UserPermissions,
    /// `None` checks the embedded default and opens no link.
    pub config: Option<PathBuf>,
    /// The configuration of the robot to set up.
    pub robot: Option<PathBuf>,
    /// Links to listen on, as given; with a robot its links.
    pub links: Vec<String>,
    /// Listening time for each link and each speed.
    pub listen_for_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    Skipped,
    Ok,
    Warning,
    /// It will not work.
    Problem,
}

impl Status {
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Skipped => "skipped",
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Problem => "problem",
        }
    }
}

/// The result of a check for one item, in the JSON object of `doctor --json` too.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CheckResult {
    pub status: Status,
    #[serde(rename = "what")]
    pub message: String,
    /// What to do; empty if nothing, in JSON null.
    #[serde(serialize_with = "null_if_empty")]
    pub advice: String,
}

fn null_if_empty<S: Serializer>(text: &str, serializer: S) -> Result<S::Ok, S::Error> {
    Some(text).filter(|text| !text.is_empty()).serialize(serializer)
}

impl CheckResult {
    pub fn ok(what: impl Into<String>) -> Self {
        Self::new(Status::Ok, what, "")
    }

    pub fn skipped(what: impl Into<String>) -> Self {
        Self::new(Status::Skipped, what, "")
    }

    /// A possible cause of problems, with a remedy.
    pub fn warning(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Warning, what, advice)
    }

    /// A certain cause of problems, with a remedy.
    pub fn problem(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Problem, what, advice)
    }

    fn new(status: Status, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { status, message: what.into(), advice: advice.into() }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    pub name: &'static str,
    #[serde(flatten)]
    pub result: CheckResult,
}

/// Permissions of the user of this process.
#[derive(Clone, Debug)]
pub struct UserPermissions {
    /// Group ids of this session.
    pub groups: Vec<u32>,
    /// Whether a device may be opened for reading and writing.
    pub can_open: fn(&Path) -> bool,
    pub group: fn(u32) -> UserGroup,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UserGroup {
    /// Its name, or its number if it has none.
    pub name: String,
    /// Whether the user is listed as a member. Effective from the next login.
    pub lists_user: bool,
}

impl UserPermissions {
    pub fn current() -> Self {
        let groups = nix::unistd::getgroups().unwrap_or_default();
        Self {
            groups: groups.into_iter().map(Gid::as_raw).collect(),
            can_open: |path| access(path, AccessFlags::R_OK | AccessFlags::W_OK).is_ok(),
            group: host_group,
        }
    }
}

fn host_group(number: u32) -> UserGroup {
    let Ok(Some(group)) = nix::unistd::Group::from_gid(Gid::from_raw(number)) else {
        return UserGroup { name: number.to_string(), lists_user: false };
    };
    let person = User::from_uid(Uid::current()).ok().flatten();
    UserGroup { lists_user: person.is_some_and(|person| group.mem.contains(&person.name)), name: group.name }
}

/// Names in a folder, sorted; empty if it cannot be read.
pub(super) fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}

/// Content of a file without its line end.
pub(super) fn value_in(path: &Path) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    Some(text.trim().to_owned())
}

/// File name of a symbolic link's target.
pub(super) fn link_name(path: &Path) -> Option<String> {
    let target = fs::read_link(path).ok()?;
    Some(target.file_name()?.to_string_lossy().into_owned())
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Process {
    pub(super) pid: u32,
    /// Cut to 15 characters by the kernel: proc(5), `/proc/pid/comm`.
    pub(super) name: String,
    folder: PathBuf,
}

impl Process {
    /// Files that it holds open; `None` if hidden, as for processes of other users.
    pub(super) fn open_files(&self) -> Option<Vec<PathBuf>> {
        let descriptors = fs::read_dir(self.folder.join("fd")).ok()?;
        let targets = descriptors.flatten().filter_map(|descriptor| fs::read_link(descriptor.path()).ok());
        Some(targets.collect())
    }
}

pub(super) fn processes(root: &Path) -> Vec<Process> {
    let proc = root.join("proc");
    let mut found: Vec<_> = names_in(&proc)
        .into_iter()
        .filter_map(|name| {
            let folder = proc.join(&name);
            // `None` if the process has ended.
            Some(Process { pid: name.parse().ok()?, name: value_in(&folder.join("comm"))?, folder })
        })
        .collect();
    found.sort_by_key(|process| process.pid);
    found
}

pub(super) fn running(root: &Path, names: &[&str]) -> Option<Process> {
    processes(root).into_iter().find(|process| names.contains(&process.name.as_str()))
}

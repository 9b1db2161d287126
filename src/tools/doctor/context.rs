//! What a check looks at and what it says: the folders through which Linux shows itself, who asks, the running processes, and a result.

use std::fs;
use std::path::{Path, PathBuf};

use nix::unistd::{AccessFlags, Gid, Uid, User, access};
use serde::Serialize;

/// What is to be looked at.
#[derive(Clone, Debug)]
pub struct DiagnosticContext {
    pub roots: SystemRoots,
    pub user: UserPermissions,
    /// The configuration file; without it the embedded default is checked, and no link is opened.
    pub config: Option<PathBuf>,
    /// The links to listen on, as they were given.
    pub links: Vec<String>,
    /// How long to listen on each, and at each speed, in seconds.
    pub listen_for_s: f64,
}

/// How a check came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    Skipped,
    Ok,
    Warning,
    /// It will not work like this.
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

/// What one check says about one thing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckResult {
    pub status: Status,
    pub message: String,
    /// What to do; empty where nothing needs to be done.
    pub advice: String,
}

impl CheckResult {
    pub fn ok(what: impl Into<String>) -> Self {
        Self::new(Status::Ok, what, "")
    }

    /// There was nothing to look at.
    pub fn skipped(what: impl Into<String>) -> Self {
        Self::new(Status::Skipped, what, "")
    }

    /// Something that may be a reason for trouble, with its cure.
    pub fn warning(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Warning, what, advice)
    }

    /// Something that does not work like this, with its cure.
    pub fn problem(what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(Status::Problem, what, advice)
    }

    fn new(status: Status, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { status, message: what.into(), advice: advice.into() }
    }
}

/// One verdict with the name of its check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    pub name: &'static str,
    pub result: CheckResult,
}

/// The folders through which Linux shows itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SystemRoots {
    /// `/sys`: devices and drivers.
    pub sys: PathBuf,
    /// `/dev`: device nodes.
    pub dev: PathBuf,
    /// `/proc`: processes and limits.
    pub proc: PathBuf,
    /// `/run`: what services and udev have left.
    pub run: PathBuf,
    /// `/var/lib`: what services remember, such as paired devices.
    pub var_lib: PathBuf,
}

impl SystemRoots {
    /// Those of the computer that this program runs on.
    pub fn host() -> Self {
        Self::under(Path::new("/"))
    }

    /// Those of a computer whose root folder is `root`.
    pub fn under(root: &Path) -> Self {
        Self {
            sys: root.join("sys"),
            dev: root.join("dev"),
            proc: root.join("proc"),
            run: root.join("run"),
            var_lib: root.join("var/lib"),
        }
    }
}

/// The person who runs the program, as far as permissions go.
#[derive(Clone, Debug)]
pub struct UserPermissions {
    /// Numbers of the groups that this session has.
    pub groups: Vec<u32>,
    /// Whether a device may be opened for reading and writing.
    pub can_open: fn(&Path) -> bool,
    pub group: fn(u32) -> UserGroup,
}

/// A group of the system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UserGroup {
    /// Its name, or its number where it has none.
    pub name: String,
    /// Whether the system lists the person as a member. It takes effect with the next login.
    pub lists_user: bool,
}

impl UserPermissions {
    /// The one who has started this program.
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

/// The names in a folder, sorted; none if it cannot be read.
pub(super) fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}

/// What stands in a file of one value, without its line end.
pub(super) fn value_in(path: &Path) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    Some(text.trim().to_owned())
}

/// The last part of where a link leads.
pub(super) fn link_name(path: &Path) -> Option<String> {
    let target = fs::read_link(path).ok()?;
    Some(target.file_name()?.to_string_lossy().into_owned())
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Process {
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

//! Where the checks read the system from, and who asks.

use std::fs;
use std::path::{Path, PathBuf};

use nix::unistd::{AccessFlags, Gid, Uid, User, access};

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
    /// What the group with this number is.
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

//! The signing files: the key, readable only by its owner, and one state file per link id with the last timestamps, with a lock against
//! other stations: two that sign with one key and one link id would reject each other's frames. The lock is a separate file, because
//! the state file is replaced. Anyone with write access to the state can reset the timestamps, and so does a replacement that is lost
//! in a power failure: so others must not have write access, and each write is synced with its directory.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::unistd::Uid;
use posebridge_protocol::signing::{Key, ShutdownKind, SigningState};
use serde::{Deserialize, Serialize};

use crate::config::MemoryRecord;

pub(super) const OWNER_ONLY: u32 = 0o600;
const ANYBODY_ELSE: u32 = 0o077;
/// Larger than a key file, small enough to read whatever the path refers to.
const LONGEST: u64 = 1_024;

/// Rejects a file that other users can read or change. No error shows its content.
pub fn read_key(path: &Path) -> Result<Key> {
    let name = path.display();
    let file = File::open(path)
        .with_context(|| format!("reading the key `{name}` (`posebridge key new {name}` makes one)"))?;
    let metadata = file.metadata().with_context(|| format!("reading the key `{name}`"))?;
    if !metadata.is_file() {
        bail!("`{name}` is no file and holds no key");
    }
    let mode = metadata.permissions().mode() & 0o777;
    if mode & ANYBODY_ELSE != 0 {
        bail!(
            "others than its owner have access to the key `{name}` (mode {mode:04o}): run `chmod 600 {name}`; if somebody may \
             have read it, make a new one"
        );
    }
    let mut text = String::new();
    file.take(LONGEST)
        .read_to_string(&mut text)
        // The system's own error about bytes that are no text would not help.
        .map_err(|_no_text| anyhow!("`{name}` holds no key: it is no text"))?;
    text.parse().with_context(|| format!("`{name}` holds no key"))
}

/// Creates a key from random bytes of the operating system and writes it to a new file. Never overwrites a file.
pub fn create_key(path: &Path) -> Result<Key> {
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes).map_err(|error| anyhow!("the operating system gives no random bytes: {error}"))?;
    let key = Key::from_bytes(bytes);
    write_key(path, &key)?;
    Ok(key)
}

/// Writes a key to a new file, for its owner alone. Never overwrites a file.
pub fn write_key(path: &Path, key: &Key) -> Result<()> {
    let name = path.display();
    let mut file = OpenOptions::new().write(true).create_new(true).mode(OWNER_ONLY).open(path).map_err(|error| {
        if error.kind() == ErrorKind::AlreadyExists {
            return anyhow!("`{name}` is there already, and a key is never overwritten");
        }
        anyhow::Error::from(error).context(format!("creating the key `{name}`"))
    })?;
    writeln!(file, "{}", key.reveal_hex())
        .and_then(|()| file.sync_all())
        .with_context(|| format!("writing the key `{name}`"))
}

const VERSION: u32 = 1;

/// Write permission of group and others. The file contains no secret.
const OTHERS_WRITE: u32 = 0o022;

#[derive(Debug)]
pub(super) struct StateFile {
    path: PathBuf,
    _lock: Flock<File>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct State {
    version: u32,
    /// The session that wrote it has ended and used no later timestamp.
    closed: bool,
    memory: MemoryRecord,
}

impl StateFile {
    pub(super) fn lock(key_file: &Path, link_id: u8) -> Result<Self> {
        let lock_path = path_beside(key_file, link_id, "lock");
        let name = lock_path.display();
        let lock = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .mode(OWNER_ONLY)
            .open(&lock_path)
            .with_context(|| format!("creating `{name}` beside the key"))?;
        let lock = Flock::lock(lock, FlockArg::LockExclusiveNonblock).map_err(|(_, error)| {
            if error == Errno::EWOULDBLOCK {
                anyhow!(
                    "another station on this computer signs with link id {link_id} of the key `{}`: give this one another \
                     `signing.link_id`",
                    key_file.display()
                )
            } else {
                anyhow!("locking `{name}`: {error}")
            }
        })?;
        Ok(Self { path: path_beside(key_file, link_id, "state"), _lock: lock })
    }

    /// The state of the last session with this key. An invalid state is an error: without it old frames would be accepted.
    pub(super) fn read(&self, key: &Key) -> Result<Option<(SigningState, ShutdownKind)>> {
        let name = self.path.display();
        let mut file = match File::open(&self.path) {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error).with_context(|| format!("reading `{name}`")),
        };
        self.check_permissions(&file)?;
        let mut text = String::new();
        file.read_to_string(&mut text).with_context(|| format!("reading `{name}`"))?;
        let cure = || {
            format!(
                "`{name}` does not hold the stamps that signing goes on from; make a new key for both ends of the link, or delete the file and \
                 accept that frames of the last session can be sent again"
            )
        };
        let state: State = toml::from_str(&text).with_context(cure)?;
        if state.version != VERSION {
            bail!("{} (version {})", cure(), state.version);
        }
        if state.memory.key_name != key.name() {
            // Another key stood in that file: no stamp of it means anything.
            return Ok(None);
        }
        let ending = if state.closed { ShutdownKind::Clean } else { ShutdownKind::Interrupted };
        Ok(Some((state.memory.memory(), ending)))
    }

    fn check_permissions(&self, file: &File) -> Result<()> {
        let name = self.path.display();
        let metadata = file.metadata().with_context(|| format!("reading `{name}`"))?;
        let owner = Uid::from_raw(metadata.uid());
        if metadata.mode() & OTHERS_WRITE != 0 || !(owner.is_root() || owner == Uid::effective()) {
            bail!(
                "others than you can change `{name}` (mode {:04o}, owner {owner}) and wind the stamps of signatures back: run \
                 `chmod 600 {name}`; if somebody may have done so, make a new key for both ends of the link",
                metadata.mode() & 0o7777
            );
        }
        Ok(())
    }

    /// Replaces the state atomically; a reader, and a restart after a crash, finds the old state or the new one.
    pub(super) fn write(&self, memory: &MemoryRecord, ending: ShutdownKind) -> Result<()> {
        let name = self.path.display();
        let state = State { version: VERSION, closed: ending == ShutdownKind::Clean, memory: memory.clone() };
        let text = toml::to_string(&state).with_context(|| format!("writing `{name}`"))?;
        replace(&self.path, &text, File::sync_all).with_context(|| format!("writing `{name}`"))
    }
}

/// Replaces a file atomically; `sync` flushes a file or a directory to the disk.
fn replace(path: &Path, text: &str, mut sync: impl FnMut(&File) -> std::io::Result<()>) -> std::io::Result<()> {
    let mut new = path.as_os_str().to_owned();
    new.push(".new");
    let new = PathBuf::from(new);
    // A file that a crash or another user has left there is not written into.
    match std::fs::remove_file(&new) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        Ok(()) | Err(_) => {}
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(OWNER_ONLY).open(&new)?;
    file.write_all(text.as_bytes())?;
    // Else a power failure could leave the new name with nothing behind it.
    sync(&file)?;
    std::fs::rename(new, path)?;
    // Else it could bring the state before back, which may say that a session has ended orderly.
    sync(&File::open(directory_of(path))?)
}

fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        Some(_) | None => Path::new("."),
    }
}

fn path_beside(key_file: &Path, link_id: u8, ending: &str) -> PathBuf {
    let mut path = key_file.as_os_str().to_owned();
    path.push(format!(".link{link_id}.{ending}"));
    PathBuf::from(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;

    use posebridge_protocol::signing::SigningTime;

    #[test]
    fn a_new_key_can_be_read_by_its_owner_alone_and_is_never_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        let key = create_key(&path).unwrap();
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(read_key(&path).unwrap(), key);
        let error = create_key(&path).unwrap_err().to_string();
        assert!(error.contains("never overwritten"), "{error}");
        assert_eq!(read_key(&path).unwrap(), key);
        assert_ne!(create_key(&folder.path().join("b.key")).unwrap(), key);
    }

    #[test]
    fn a_key_that_others_can_reach_is_refused_with_the_cure() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        create_key(&path).unwrap();
        for mode in [0o640, 0o604, 0o620, 0o601] {
            std::fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            let error = read_key(&path).unwrap_err().to_string();
            assert!(error.contains("chmod 600"), "{mode:o}: {error}");
        }
        std::fs::set_permissions(&path, Permissions::from_mode(0o400)).unwrap();
        assert!(read_key(&path).is_ok());
    }

    #[test]
    fn what_is_no_key_is_refused_without_showing_it() {
        let folder = tempfile::tempdir().unwrap();
        let secret = "5a".repeat(31);
        for text in [secret.as_bytes(), b"", b"\xff\xfe"] {
            let path = folder.path().join("a.key");
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
            let error = format!("{:#}", read_key(&path).unwrap_err());
            assert!(error.contains("holds no key"), "{error}");
            assert!(!error.contains("5a"), "{error}");
        }
        assert!(read_key(folder.path()).is_err());
        let missing = format!("{:#}", read_key(&folder.path().join("no")).unwrap_err());
        assert!(missing.contains("posebridge key new"), "{missing}");
    }

    fn memory() -> SigningState {
        SigningState { last_sent: SigningTime::from_units(77), ..SigningState::default() }
    }

    #[test]
    fn what_was_written_is_read_and_only_under_its_key_and_link_id() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        let (key, other) = (Key::from_bytes([1; 32]), Key::from_bytes([2; 32]));
        let state = StateFile::lock(&path, 3).unwrap();
        assert_eq!(state.read(&key).unwrap(), None);
        for ending in [ShutdownKind::Interrupted, ShutdownKind::Clean] {
            let record = MemoryRecord::of(&key, &memory());
            state.write(&record, ending).unwrap();
            assert_eq!(state.read(&key).unwrap(), Some((memory(), ending)));
        }
        assert_eq!(state.read(&other).unwrap(), None);
        let next = StateFile::lock(&path, 4).unwrap();
        assert_eq!(next.read(&key).unwrap(), None);
    }

    #[test]
    fn a_second_station_with_the_same_link_id_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        let first = StateFile::lock(&path, 3).unwrap();
        let error = StateFile::lock(&path, 3).unwrap_err().to_string();
        assert!(error.contains("another station"), "{error}");
        drop(first);
        assert!(StateFile::lock(&path, 3).is_ok());
    }

    #[test]
    fn the_contents_are_on_the_disk_before_the_name_is_and_the_name_before_anything_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key.link0.state");
        std::fs::write(&path, "before").unwrap();
        let mut synced = Vec::new();
        replace(&path, "after", |file| {
            let found = std::fs::read_to_string(&path).unwrap();
            synced.push((file.metadata().unwrap().is_dir(), found));
            Ok(())
        })
        .unwrap();
        let expected = [(false, "before".to_owned()), (true, "after".to_owned())];
        assert_eq!(synced, expected);
        let refused = replace(&path, "later", |file| {
            let is_dir = file.metadata().unwrap().is_dir();
            if is_dir { Err(ErrorKind::StorageFull.into()) } else { Ok(()) }
        });
        assert!(refused.is_err(), "a name that may get lost is no success");
        assert_eq!(directory_of(Path::new("a.key")), Path::new("."));
    }

    #[test]
    fn what_lies_where_the_new_state_is_written_is_neither_followed_nor_kept() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFile::lock(&folder.path().join("a.key"), 0).unwrap();
        let precious = folder.path().join("precious");
        std::fs::write(&precious, "precious").unwrap();
        let new = folder.path().join("a.key.link0.state.new");
        std::os::unix::fs::symlink(&precious, &new).unwrap();
        let key = Key::from_bytes([1; 32]);
        let record = MemoryRecord::of(&key, &memory());
        state.write(&record, ShutdownKind::Interrupted).unwrap();
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
        std::fs::write(&new, "left over").unwrap();
        std::fs::set_permissions(&new, Permissions::from_mode(0o666)).unwrap();
        state.write(&record, ShutdownKind::Interrupted).unwrap();
        let mode = std::fs::symlink_metadata(&state.path).unwrap().mode();
        assert_eq!(mode & 0o7777, 0o600);
    }

    #[test]
    fn a_state_that_others_can_change_is_refused_with_the_cure() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFile::lock(&folder.path().join("a.key"), 0).unwrap();
        let key = Key::from_bytes([1; 32]);
        let record = MemoryRecord::of(&key, &memory());
        state.write(&record, ShutdownKind::Clean).unwrap();
        for mode in [0o620, 0o602] {
            std::fs::set_permissions(&state.path, Permissions::from_mode(mode)).unwrap();
            let error = state.read(&key).unwrap_err().to_string();
            assert!(error.contains("chmod 600"), "{mode:o}: {error}");
        }
        std::fs::set_permissions(&state.path, Permissions::from_mode(0o644)).unwrap();
        assert!(state.read(&key).unwrap().is_some());
    }

    #[test]
    fn a_damaged_state_is_not_taken_for_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.key");
        let state = StateFile::lock(&path, 0).unwrap();
        let key = Key::from_bytes([1; 32]);
        std::fs::write(&state.path, "version = 1\n").unwrap();
        let error = format!("{:#}", state.read(&key).unwrap_err());
        assert!(error.contains("delete the file"), "{error}");
    }
}

//! Key files: 64 hexadecimal digits in a file that only its owner can read.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use posebridge_protocol::signing::Key;

/// Read and write for the owner, nothing for others.
pub(super) const OWNER_ONLY: u32 = 0o600;
/// Whatever group and others may do.
const ANYBODY_ELSE: u32 = 0o077;
/// More than a key file has, and little enough to read whatever the path leads to.
const LONGEST: u64 = 1_024;

/// Reads a key.
///
/// # Errors
/// There is no such file, other users can read or change it, or it holds no key. The message shows nothing of it.
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

/// Makes a key from random bytes of the operating system and writes it to a new file.
///
/// # Errors
/// The file is there already, which is never overwritten, or cannot be written.
pub fn create_key(path: &Path) -> Result<Key> {
    let name = path.display();
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes).map_err(|error| anyhow!("the operating system gives no random bytes: {error}"))?;
    let key = Key::from_bytes(bytes);
    let mut file = OpenOptions::new().write(true).create_new(true).mode(OWNER_ONLY).open(path).map_err(|error| {
        if error.kind() == ErrorKind::AlreadyExists {
            return anyhow!("`{name}` is there already, and a key is never overwritten");
        }
        anyhow::Error::from(error).context(format!("creating the key `{name}`"))
    })?;
    writeln!(file, "{}", key.reveal_hex())
        .and_then(|()| file.sync_all())
        .with_context(|| format!("writing the key `{name}`"))?;
    Ok(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;

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
}

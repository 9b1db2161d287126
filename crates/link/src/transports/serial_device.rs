//! Which device a serial link means: patterns, and udev's names that outlive a replug.
//!
//! A device that is pulled while a program has it open comes back under another number (ttyUSB0 as ttyUSB1). udev also
//! links it under a name made of vendor, model and serial number in `/dev/serial/by-id`, which comes back with it. So a
//! link that names such a device by its number remembers that name and is opened by it from then on. A path with `*` or
//! `?` is a pattern for any of several devices and is matched anew for each attempt. It opens nothing.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::{Component, Path, PathBuf};

/// Beginnings of the device names that the kernel numbers in the order of plugging in: USB adapters and USB devices.
const NUMBERED: &[&str] = &["ttyUSB", "ttyACM"];

/// Most devices that one pattern may match: more than a computer has; guards against `/*/*/*`.
const MAX_MATCHES: usize = 256;

/// The link in `by_id` that leads to `path`, if `path` is the plain name of a device that is numbered by the order of
/// plugging in; the first in sorted order if there are several.
pub(super) fn stable_name(path: &Path, by_id: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    if !NUMBERED.iter().any(|kind| name.starts_with(kind)) {
        return None;
    }
    let device = path.canonicalize().ok()?;
    let mut links: Vec<_> = fs::read_dir(by_id)
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|link| link.canonicalize().is_ok_and(|target| target == device))
        .collect();
    links.sort_unstable();
    links.into_iter().next()
}

/// True if `path` is to be read as a pattern: it holds a wildcard, and nothing stands there under this very name.
pub(super) fn is_pattern(path: &Path) -> bool {
    has_wildcard(path.as_os_str()) && path.symlink_metadata().is_err()
}

/// Everything that a pattern matches, sorted. `*` stands for any characters within one component of the path, `?` for
/// one; neither matches a leading dot.
pub(super) fn matches(pattern: &Path) -> Vec<PathBuf> {
    let mut found = vec![PathBuf::new()];
    for component in pattern.components() {
        let Component::Normal(name) = component else {
            for path in &mut found {
                path.push(component);
            }
            continue;
        };
        found = if has_wildcard(name) {
            found
                .iter()
                .flat_map(|directory| entries(directory, name))
                .take(MAX_MATCHES)
                .collect()
        } else {
            found.iter().map(|path| path.join(name)).collect()
        };
    }
    found.retain(|path| path.exists());
    found.sort_unstable();
    found
}

fn has_wildcard(text: &OsStr) -> bool {
    text.as_bytes().iter().any(|byte| b"*?".contains(byte))
}

/// The entries of a directory whose names match, sorted.
fn entries(directory: &Path, pattern: &OsStr) -> Vec<PathBuf> {
    let listed = if directory.as_os_str().is_empty() {
        Path::new(".")
    } else {
        directory
    };
    let Ok(listing) = fs::read_dir(listed) else {
        return Vec::new();
    };
    let mut names: Vec<_> = listing
        .filter_map(|entry| Some(entry.ok()?.file_name()))
        .filter(|name| name_matches(pattern.as_bytes(), name.as_bytes()))
        .collect();
    names.sort_unstable();
    names.iter().map(|name| directory.join(name)).collect()
}

/// Matches by walking along both and going back to the last `*` when stuck: no worse than the product of the lengths.
fn name_matches(pattern: &[u8], name: &[u8]) -> bool {
    if name.first() == Some(&b'.') && pattern.first() != Some(&b'.') {
        return false;
    }
    let (mut at, mut done) = (0, 0);
    let mut retry: Option<(usize, usize)> = None;
    while let Some(byte) = name.get(done) {
        match pattern.get(at) {
            Some(b'*') => {
                retry = Some((at + 1, done));
                at += 1;
            }
            Some(wanted) if *wanted == b'?' || wanted == byte => {
                at += 1;
                done += 1;
            }
            _ => {
                let Some((after_star, taken)) = retry else {
                    return false;
                };
                retry = Some((after_star, taken + 1));
                at = after_star;
                done = taken + 1;
            }
        }
    }
    pattern
        .get(at..)
        .unwrap_or_default()
        .iter()
        .all(|byte| *byte == b'*')
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn stars_and_question_marks_match_as_in_a_shell() {
        for (pattern, name, expected) in [
            ("ttyUSB*", "ttyUSB0", true),
            ("ttyUSB*", "ttyUSB", true),
            ("ttyUSB?", "ttyUSB", false),
            ("ttyUSB?", "ttyUSB12", false),
            ("*-if0?", "usb-FTDI-if00", true),
            ("*FTDI*port0", "usb-FTDI_FT232R-if00-port0", true),
            ("*FTDI*port0", "usb-FTDI_FT232R-if00-port1", false),
            ("a*b*c", "abbbc", true),
            ("a*b*c", "abbb", false),
            ("*", ".hidden", false),
            (".h*", ".hidden", true),
            ("", "", true),
            ("***", "x", true),
        ] {
            let matched = name_matches(pattern.as_bytes(), name.as_bytes());
            assert_eq!(matched, expected, "{pattern} {name}");
        }
    }

    #[test]
    fn a_pattern_of_many_stars_does_not_take_for_ever() {
        let pattern = b"*a".repeat(40);
        assert!(!name_matches(&pattern, &[b'b'; 39]));
        let mut name = vec![b'a'; 4_000];
        name.push(b'b');
        assert!(!name_matches(&pattern, &name));
    }

    #[test]
    fn matches_come_sorted_from_every_directory_that_matches() {
        let root = tempfile::tempdir().expect("a temporary directory");
        for path in ["b/tty2", "a/tty9", "a/tty1", "a/other", "c/tty1"] {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a parent")).expect("own directory");
            fs::write(path, "").expect("own directory");
        }
        let found = matches(&root.path().join("[ab?]/tty*"));
        assert_eq!(
            found,
            Vec::<PathBuf>::new(),
            "brackets are plain characters"
        );
        let found = matches(&root.path().join("?/tty*"));
        let expected = ["a/tty1", "a/tty9", "b/tty2", "c/tty1"].map(|path| root.path().join(path));
        assert_eq!(found, expected);
        assert!(matches(&root.path().join("?/nothing*")).is_empty());
    }

    #[test]
    fn a_name_that_exists_is_no_pattern() {
        let root = tempfile::tempdir().expect("a temporary directory");
        let path = root.path().join("what?");
        assert!(is_pattern(&path));
        fs::write(&path, "").expect("own directory");
        assert!(!is_pattern(&path));
        assert!(!is_pattern(Path::new("/dev/ttyUSB0")));
    }

    #[test]
    fn only_numbered_devices_have_a_better_name() {
        let root = tempfile::tempdir().expect("a temporary directory");
        let (device, by_id) = (root.path().join("ttyACM3"), root.path().join("by-id"));
        fs::write(&device, "").expect("own directory");
        assert_eq!(stable_name(&device, &by_id), None);
        fs::create_dir(&by_id).expect("own directory");
        symlink("/dev/null", by_id.join("usb-0_other")).expect("a free name");
        assert_eq!(stable_name(&device, &by_id), None);
        symlink("../ttyACM3", by_id.join("usb-b-if01")).expect("a free name");
        symlink("../ttyACM3", by_id.join("usb-a-if00")).expect("a free name");
        assert_eq!(stable_name(&device, &by_id), Some(by_id.join("usb-a-if00")));
        assert_eq!(stable_name(&by_id.join("usb-b-if01"), &by_id), None);
        let uart = root.path().join("ttyS0");
        fs::write(&uart, "").expect("own directory");
        symlink(&uart, by_id.join("usb-c-if00")).expect("a free name");
        assert_eq!(stable_name(&uart, &by_id), None);
    }
}

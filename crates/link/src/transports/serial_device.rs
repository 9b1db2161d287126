//! The device of a serial link: patterns, and udev's names that survive a replug.
//!
//! A device that is unplugged while a program has it open comes back with another number (ttyUSB0 as ttyUSB1). udev
//! also links it under two names that do not change: one in `/dev/serial/by-id` from vendor, model and serial number,
//! and one in `/dev/serial/by-path` from the USB socket. So a link that names such a device by its number remembers one
//! of these names and is opened by it from then on.
//!
//! Many adapters have no serial number (CH340), or all the same one (CP2102 leave the factory with 0001). Two of those
//! share one name in `by-id`, and udev lets it lead to the other one when the first is unplugged. So the name by serial
//! number is used only if it is unique among the adapters that are plugged in, otherwise the name by socket.
//!
//! A path with `*` or `?` is a pattern for any of several devices and is matched again at each attempt. Nothing is
//! opened here.
//!
//! # Sources
//! systemd, rules.d/60-serial.rules: how udev makes both names.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::{Component, Path, PathBuf};

use crate::transports::open_request::DeviceDirectories;

/// Prefixes of the device names that the kernel numbers in the order of plugging in: USB adapters and USB devices.
const NUMBERED_PREFIXES: &[&str] = &["ttyUSB", "ttyACM"];

/// Most devices that one pattern may match: more than a computer has; guards against `/*/*/*`.
const MAX_MATCHES: usize = 256;

/// A name that identifies the device at `path` after a replug, if `path` is a device name that is numbered in the order of
/// plugging in.
pub(super) fn stable_name(path: &Path, directories: &DeviceDirectories) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    if !NUMBERED_PREFIXES.iter().any(|kind| name.starts_with(kind)) {
        return None;
    }
    let device = path.canonicalize().ok()?;
    let by_id = UsbAdapter::has_unique_serial(name, &directories.tty_class)
        .then(|| find_symlink_to(&device, &directories.serial_by_id))
        .flatten();
    by_id.or_else(|| find_symlink_to(&device, &directories.serial_by_path))
}

/// The link in `directory` that leads to `device`; the first in sorted order if there are several.
fn find_symlink_to(device: &Path, directory: &Path) -> Option<PathBuf> {
    let links = fs::read_dir(directory).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    links.filter(|link| link.canonicalize().is_ok_and(|target| target == device)).min()
}

/// A USB device behind a serial port, from sysfs.
struct UsbAdapter {
    /// Its directory, which names the socket.
    sysfs_path: PathBuf,
    vendor: String,
    product: String,
    serial: String,
}

impl UsbAdapter {
    /// The device behind the port `name`, if it is on USB and has a serial number.
    fn from_sysfs(name: &OsStr, tty_class: &Path) -> Option<Self> {
        let interface = tty_class.join(name).join("device").canonicalize().ok()?;
        let device = interface.ancestors().find(|device| device.join("idVendor").exists())?;
        let attribute = |file: &str| {
            let text = fs::read_to_string(device.join(file)).ok()?;
            Some(text.trim().to_owned()).filter(|text| !text.is_empty())
        };
        Some(Self {
            vendor: attribute("idVendor")?,
            product: attribute("idProduct")?,
            serial: attribute("serial")?,
            sysfs_path: device.to_owned(),
        })
    }

    /// True if the adapter behind the port `name` has a serial number, and no other one that is plugged in has the same.
    fn has_unique_serial(name: &str, tty_class: &Path) -> bool {
        let Some(own) = Self::from_sysfs(OsStr::new(name), tty_class) else {
            return false;
        };
        let is_twin = |other: &Self| {
            (&other.vendor, &other.product, &other.serial) == (&own.vendor, &own.product, &own.serial)
                && other.sysfs_path != own.sysfs_path
        };
        fs::read_dir(tty_class).is_ok_and(|ports| {
            let names = ports.filter_map(|entry| Some(entry.ok()?.file_name()));
            !names.filter_map(|name| Self::from_sysfs(&name, tty_class)).any(|other| is_twin(&other))
        })
    }
}

/// True if `path` is a pattern: it has a wildcard, and no file has this literal name.
pub(super) fn is_pattern(path: &Path) -> bool {
    has_wildcard(path.as_os_str()) && path.symlink_metadata().is_err()
}

/// All matches of a pattern, sorted. `*` matches any characters within one component of the path, `?` one; neither matches a
/// leading dot.
pub(super) fn expand_pattern(pattern: &Path) -> Vec<PathBuf> {
    let mut found = vec![PathBuf::new()];
    for component in pattern.components() {
        let Component::Normal(name) = component else {
            for path in &mut found {
                path.push(component);
            }
            continue;
        };
        found = if has_wildcard(name) {
            found.iter().flat_map(|directory| matching_entries(directory, name)).take(MAX_MATCHES).collect()
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
fn matching_entries(directory: &Path, pattern: &OsStr) -> Vec<PathBuf> {
    let listed = if directory.as_os_str().is_empty() { Path::new(".") } else { directory };
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

/// Matches with backtracking to the last `*`; the time is at most proportional to the product of the lengths.
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
            Some(expected) if *expected == b'?' || expected == byte => {
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
    pattern.get(at..).unwrap_or_default().iter().all(|byte| *byte == b'*')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::udev;
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
        let found = expand_pattern(&root.path().join("[ab?]/tty*"));
        assert_eq!(found, Vec::<PathBuf>::new(), "brackets are plain characters");
        let found = expand_pattern(&root.path().join("?/tty*"));
        let expected = ["a/tty1", "a/tty9", "b/tty2", "c/tty1"].map(|path| root.path().join(path));
        assert_eq!(found, expected);
        assert!(expand_pattern(&root.path().join("?/nothing*")).is_empty());
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

    /// A computer in a folder, with the ports that are plugged in.
    struct Computer {
        root: tempfile::TempDir,
        directories: DeviceDirectories,
    }

    impl Computer {
        fn new() -> Self {
            let root = tempfile::tempdir().expect("a temporary directory");
            let directories = udev::directories(root.path());
            Self { root, directories }
        }

        fn port(&self, name: &str) -> PathBuf {
            self.root.path().join(name)
        }

        fn plug(&self, name: &str, socket: &str, serial: Option<&str>) {
            fs::write(self.port(name), "").expect("own directory");
            let id = format!("usb-CP2102_{}", serial.unwrap_or("bridge").trim());
            udev::plug_in(self.root.path(), name, udev::PluggedAdapter { socket, id: &id, serial });
        }

        fn stable(&self, name: &str) -> Option<PathBuf> {
            let stable = stable_name(&self.port(name), &self.directories)?;
            let relative = stable.strip_prefix(self.root.path());
            Some(relative.expect("in the folder").to_owned())
        }
    }

    #[test]
    fn only_a_serial_number_of_its_own_names_an_adapter_and_else_its_socket_does() {
        let computer = Computer::new();
        computer.plug("ttyUSB0", "socket-1", Some("A7\n"));
        let by_serial = PathBuf::from("by-id/usb-CP2102_A7");
        assert_eq!(computer.stable("ttyUSB0"), Some(by_serial.clone()));
        computer.plug("ttyUSB1", "socket-2", Some("0001\n"));
        assert_eq!(computer.stable("ttyUSB1"), Some("by-id/usb-CP2102_0001".into()));
        // Another one with the same number takes the name over.
        computer.plug("ttyUSB2", "socket-3", Some("0001\n"));
        for (name, socket) in [("ttyUSB1", "socket-2"), ("ttyUSB2", "socket-3")] {
            let by_socket = PathBuf::from("by-path").join(socket);
            assert_eq!(computer.stable(name), Some(by_socket));
        }
        for serial in [None, Some("\n")] {
            computer.plug("ttyUSB3", "socket-4", serial);
            let by_socket = PathBuf::from("by-path/socket-4");
            assert_eq!(computer.stable("ttyUSB3"), Some(by_socket));
        }
        assert_eq!(computer.stable("ttyUSB0"), Some(by_serial));
    }

    #[test]
    fn two_ports_of_one_adapter_are_no_twins() {
        let computer = Computer::new();
        computer.plug("ttyUSB0", "socket-1", Some("A7"));
        computer.plug("ttyUSB1", "socket-1", Some("A7"));
        assert!(UsbAdapter::has_unique_serial("ttyUSB0", &computer.directories.tty_class));
    }

    #[test]
    fn only_numbered_devices_have_a_better_name() {
        let computer = Computer::new();
        let by_id = &computer.directories.serial_by_id;
        fs::write(computer.port("ttyACM3"), "").expect("own directory");
        assert_eq!(computer.stable("ttyACM3"), None, "no directory at all");
        computer.plug("ttyACM3", "socket-1", Some("A7"));
        symlink("/dev/null", by_id.join("usb-0_other")).expect("a free name");
        symlink("../ttyACM3", by_id.join("usb-A-if00")).expect("a free name");
        assert_eq!(computer.stable("ttyACM3"), Some("by-id/usb-A-if00".into()));
        assert_eq!(computer.stable("by-id/usb-A-if00"), None);
        computer.plug("ttyS0", "socket-2", Some("A8"));
        assert_eq!(computer.stable("ttyS0"), None);
    }
}

//! Which serial ports there are, by which driver, and what is plugged in.

use std::fs;
use std::path::{Path, PathBuf};

use super::check_result::{CheckResult, DiagnosticContext};
use super::surroundings::{SystemRoots, link_name, names_in, value_in};

/// How the names of ports begin that a robot may be behind: USB adapters, USB boards, bound Bluetooth links, and the
/// pins of a single-board computer. The kernel's documentation, admin-guide/devices.txt, lists them.
const PREFIXES: &[&str] = &["ttyUSB", "ttyACM", "rfcomm", "ttyAMA"];

/// A serial port, as the system describes it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SerialPort {
    /// Its name, such as ttyUSB0.
    pub name: String,
    /// The device node.
    pub device: PathBuf,
    /// The name that stays when the number changes.
    pub by_id: Option<PathBuf>,
    /// The kernel's driver.
    pub driver: Option<String>,
    /// What is plugged in, for USB.
    pub usb: Option<UsbIds>,
    /// The folders of the device and of all devices that it is a part of, from the inside out.
    pub sys_folders: Vec<PathBuf>,
}

/// The numbers by which a USB device is known, four hexadecimal digits each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsbIds {
    /// Of the vendor.
    pub vendor: String,
    /// Of the product.
    pub product: String,
    /// Its name for people; empty where it has none.
    pub name: String,
}

/// Lists the ports; a computer without one gets a warning, because a robot may as well come by network.
pub fn check(examination: &DiagnosticContext) -> Vec<CheckResult> {
    let ports = serial_ports(&examination.roots);
    if ports.is_empty() {
        return vec![CheckResult::warning(
            "no serial port is there",
            "if the robot is on a cable: plug it in; a cable that only charges shows nothing. \
             For Bluetooth: bind the paired brick with `sudo rfcomm bind 0 <address> 1`",
        )];
    }
    ports.iter().map(|port| CheckResult::ok(describe(port))).collect()
}

fn describe(port: &SerialPort) -> String {
    let driver = port.driver.as_ref().map(|driver| format!("driver {driver}"));
    let usb = port.usb.as_ref().map(|usb| {
        let description = format!("USB {}:{} {}", usb.vendor, usb.product, usb.name);
        description.trim_end().to_owned()
    });
    let by_id = port.by_id.as_ref().map(|id| format!("also {}", id.display()));
    let parts = [Some(port.device.display().to_string()), driver, usb, by_id];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// The ports of the computer, by name.
pub fn serial_ports(roots: &SystemRoots) -> Vec<SerialPort> {
    let names = names_in(&roots.dev);
    let is_port = |name: &&String| PREFIXES.iter().any(|prefix| name.starts_with(prefix));
    names.iter().filter(is_port).map(|name| port(roots, name)).collect()
}

fn port(roots: &SystemRoots, name: &str) -> SerialPort {
    let device_link = roots.sys.join("class/tty").join(name).join("device");
    let sys_folders = fs::canonicalize(&device_link).map(|folder| folders_up(&folder, &roots.sys)).unwrap_or_default();
    let tty = roots.sys.join("class/tty").join(name);
    SerialPort {
        name: name.to_owned(),
        device: roots.dev.join(name),
        by_id: by_id(roots, name),
        driver: link_name(&device_link.join("driver")),
        usb: sys_folders.iter().find_map(|folder| usb_ids(folder)),
        sys_folders: std::iter::once(tty).chain(sys_folders).collect(),
    }
}

/// The folder and those above it, as far as they lie in `root`.
fn folders_up(folder: &Path, root: &Path) -> Vec<PathBuf> {
    let root = fs::canonicalize(root).unwrap_or_else(|_missing| root.to_owned());
    folder.ancestors().take_while(|above| above.starts_with(&root) && **above != root).map(Path::to_owned).collect()
}

fn usb_ids(folder: &Path) -> Option<UsbIds> {
    Some(UsbIds {
        vendor: value_in(&folder.join("idVendor"))?,
        product: value_in(&folder.join("idProduct"))?,
        name: value_in(&folder.join("product")).unwrap_or_default(),
    })
}

fn by_id(roots: &SystemRoots, name: &str) -> Option<PathBuf> {
    let folder = roots.dev.join("serial/by-id");
    names_in(&folder).into_iter().map(|id| folder.join(id)).find(|link| link_name(link).as_deref() == Some(name))
}

//! Checks of serial ports: ports and connected devices, user permissions, programs that hold them, and access by ModemManager, which
//! opens USB boards (`ttyACM*`) when they appear unless a udev tag forbids it. Source: ModemManager's reference manual, "Common udev
//! tags" (ID_MM_DEVICE_IGNORE, ID_MM_PORT_IGNORE); systemd, sd-device (in `/run/udev/data` the files `c<major>:<minor>` with a line
//! `E:KEY=VALUE` per property).

use std::collections::BTreeSet;
use std::fs::{self, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use posebridge_link::LinkUrl;

use super::context::{
    CheckResult, DiagnosticContext, Process, UserPermissions, link_name, names_in, processes, running, value_in,
};

/// Name prefixes of ports for robots: USB adapters, USB boards, bound Bluetooth links, and the pins of a single-board computer. Source:
/// the kernel's admin-guide/devices.txt.
const PREFIXES: &[&str] = &["ttyUSB", "ttyACM", "rfcomm", "ttyAMA"];

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SerialPort {
    /// Such as ttyUSB0.
    pub name: String,
    pub device: PathBuf,
    /// The stable name, independent of the number.
    pub by_id: Option<PathBuf>,
    pub driver: Option<String>,
    pub usb: Option<UsbIds>,
    /// Sysfs folders of the device and of its parents, innermost first.
    pub sys_folders: Vec<PathBuf>,
}

/// Vendor and product id of a USB device, four hexadecimal digits each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsbIds {
    pub vendor: String,
    pub product: String,
    /// Product name; empty if it has none.
    pub name: String,
}

/// Lists the ports; without any it is only a warning, because a robot may use the network.
pub fn check_ports(context: &DiagnosticContext) -> Vec<CheckResult> {
    let ports = serial_ports(&context.root);
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

/// Sorted by name.
pub fn serial_ports(root: &Path) -> Vec<SerialPort> {
    let names = names_in(&root.join("dev"));
    let is_port = |name: &&String| PREFIXES.iter().any(|prefix| name.starts_with(prefix));
    names.iter().filter(is_port).map(|name| port(root, name)).collect()
}

fn port(root: &Path, name: &str) -> SerialPort {
    let tty = root.join("sys/class/tty").join(name);
    let device_link = tty.join("device");
    let sys = root.join("sys");
    let sys_folders = fs::canonicalize(&device_link).map(|folder| folders_up(&folder, &sys)).unwrap_or_default();
    SerialPort {
        name: name.to_owned(),
        device: root.join("dev").join(name),
        by_id: by_id(root, name),
        driver: link_name(&device_link.join("driver")),
        usb: sys_folders.iter().find_map(|folder| usb_ids(folder)),
        sys_folders: std::iter::once(tty).chain(sys_folders).collect(),
    }
}

/// The folder and its parents within `root`.
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

fn by_id(root: &Path, name: &str) -> Option<PathBuf> {
    let folder = root.join("dev/serial/by-id");
    names_in(&folder).into_iter().map(|id| folder.join(id)).find(|link| link_name(link).as_deref() == Some(name))
}

const GROUP_READ_WRITE: u32 = 0o060;

/// Checks every port; a port that the user may not open is a problem.
pub fn check_permissions(context: &DiagnosticContext) -> Vec<CheckResult> {
    let ports = serial_ports(&context.root);
    if ports.is_empty() {
        return vec![CheckResult::skipped("no serial port is there")];
    }
    let person = &context.user;
    ports.iter().map(|port| port_permission(port, person)).collect()
}

fn port_permission(port: &SerialPort, person: &UserPermissions) -> CheckResult {
    let device = port.device.display();
    if (person.can_open)(&port.device) {
        return CheckResult::ok(format!("{device} may be read and written"));
    }
    match port.device.metadata() {
        Ok(metadata) => {
            CheckResult::problem(format!("{device} may not be opened"), permission_advice(&metadata, person))
        }
        Err(error) => {
            CheckResult::problem(format!("{device} leads nowhere: {error}"), "unplug the device and plug it in again")
        }
    }
}

fn permission_advice(metadata: &Metadata, person: &UserPermissions) -> String {
    let number = metadata.gid();
    let group = (person.group)(number);
    let name = &group.name;
    if metadata.mode() & GROUP_READ_WRITE != GROUP_READ_WRITE {
        return format!(
            "its mode {:04o} lets no group use it: a udev rule has to open it, such as \
             SUBSYSTEM==\"tty\", MODE=\"0660\", GROUP=\"{name}\"",
            metadata.mode() & 0o7777
        );
    }
    if person.groups.contains(&number) {
        return format!("you are in its group {name}: a container or a security module forbids it");
    }
    if group.lists_user {
        return format!("you are in its group {name} from your next login on: log out and in again");
    }
    format!("it belongs to group {name}: run `sudo usermod -aG {name} $USER`, then log out and in again")
}

/// Checks for processes that hold a port, or a device of the given links.
pub fn check_holders(context: &DiagnosticContext) -> Vec<CheckResult> {
    let devices = devices(context);
    if devices.is_empty() {
        return vec![CheckResult::skipped("no serial port is there")];
    }
    let (mut verdicts, hidden) = holders(&context.root, &devices);
    if verdicts.is_empty() {
        verdicts.push(none_found(devices.len(), hidden));
    }
    verdicts
}

/// The devices with links resolved, as in `/proc`.
fn devices(context: &DiagnosticContext) -> BTreeSet<PathBuf> {
    let ports = serial_ports(&context.root);
    let of_ports = ports.into_iter().map(|port| port.device);
    let of_links = context
        .links
        .iter()
        .filter_map(|link| LinkUrl::parse(link).ok())
        .filter(|url| url.transport().scheme() == "serial")
        .map(|url| url.path().to_owned());
    of_ports
        .chain(of_links)
        .filter_map(|device| fs::canonicalize(device).ok())
        // The process that creates a pseudo-terminal holds its other side as well, and plays the robot.
        .filter(|device| !device.starts_with("/dev/pts"))
        .collect()
}

fn none_found(devices: usize, hidden: usize) -> CheckResult {
    let ports = if devices == 1 { "port" } else { "ports" };
    let message = format!("no program that can be looked into holds the {devices} {ports}");
    if hidden == 0 {
        CheckResult::ok(message)
    } else {
        CheckResult::ok(format!("{message}; {hidden} programs of other people cannot be looked into (sudo sees them)"))
    }
}

/// A warning for each process that holds a device, and the number of processes that cannot be inspected.
fn holders(root: &Path, devices: &BTreeSet<PathBuf>) -> (Vec<CheckResult>, usize) {
    let mut found = Vec::new();
    let mut hidden = 0;
    for process in processes(root) {
        let Some(files) = process.open_files() else {
            hidden += 1;
            continue;
        };
        let held: BTreeSet<&Path> = files.iter().filter_map(|file| devices.get(file)).map(PathBuf::as_path).collect();
        let Process { name, pid, .. } = &process;
        found.extend(held.into_iter().map(|device| {
            CheckResult::warning(
                format!("{} is held by {name}, process {pid}", device.display()),
                format!("close the port there, or end it with `kill {pid}`"),
            )
        }));
    }
    (found, hidden)
}

const PROBED: &str = "ttyACM";
const IGNORE_TAGS: [&str; 2] = ["E:ID_MM_DEVICE_IGNORE=1", "E:ID_MM_PORT_IGNORE=1"];

/// Checks whether it runs, and which ports it may probe.
pub fn check_modem_manager(context: &DiagnosticContext) -> Vec<CheckResult> {
    let root = &context.root;
    if running(root, &["ModemManager"]).is_none() {
        return vec![CheckResult::ok("ModemManager does not run")];
    }
    let probed: Vec<_> = serial_ports(root)
        .into_iter()
        .filter(|port| port.name.starts_with(PROBED) && !is_ignored(port, root))
        .collect();
    if probed.is_empty() {
        return vec![CheckResult::ok("ModemManager runs, but has no port here that it would probe")];
    }
    probed.iter().map(modem_manager_result).collect()
}

fn modem_manager_result(port: &SerialPort) -> CheckResult {
    let rule = match &port.usb {
        Some(usb) => format!(
            "`echo 'ATTRS{{idVendor}}==\"{}\", ATTRS{{idProduct}}==\"{}\", ENV{{ID_MM_DEVICE_IGNORE}}=\"1\"' \
             | sudo tee /etc/udev/rules.d/70-robot.rules`, `sudo udevadm control --reload`",
            usb.vendor, usb.product
        ),
        None => "write a udev rule that sets ENV{ID_MM_DEVICE_IGNORE}=\"1\" for it".to_owned(),
    };
    CheckResult::warning(
        format!(
            "ModemManager probes {} whenever it is plugged in, and holds it for some seconds",
            port.device.display()
        ),
        format!("{rule}, then plug it in again"),
    )
}

/// Whether udev has tagged the port or a parent device.
fn is_ignored(port: &SerialPort, root: &Path) -> bool {
    port.sys_folders
        .iter()
        .filter_map(|folder| value_in(&folder.join("dev")))
        .filter_map(|number| fs::read_to_string(root.join("run/udev/data").join(format!("c{number}"))).ok())
        .any(|properties| properties.lines().any(|line| IGNORE_TAGS.contains(&line)))
}

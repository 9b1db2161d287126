//! Which program holds a port: two programs on one port each get a part of the bytes.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use posebridge_link::LinkUrl;

use super::check_result::{CheckResult, DiagnosticContext};
use super::ports::serial_ports;
use super::processes::processes;
use super::surroundings::SystemRoots;

/// Looks for holders of every port, and of the devices of the given links.
pub fn check(examination: &DiagnosticContext) -> Vec<CheckResult> {
    let devices = devices(examination);
    if devices.is_empty() {
        return vec![CheckResult::skipped("no serial port is there")];
    }
    let (holders, hidden) = holders(&examination.roots, &devices);
    let mut verdicts: Vec<_> = holders.iter().map(DeviceHolder::to_result).collect();
    if verdicts.is_empty() {
        verdicts.push(none_found(devices.len(), hidden));
    }
    verdicts
}

/// The devices, links followed: that is how they stand in `/proc`.
fn devices(examination: &DiagnosticContext) -> BTreeSet<PathBuf> {
    let ports = serial_ports(&examination.roots);
    let of_ports = ports.into_iter().map(|port| port.device);
    let of_links = examination
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

/// A program that has a port open.
struct DeviceHolder {
    device: PathBuf,
    name: String,
    pid: u32,
}

impl DeviceHolder {
    fn to_result(&self) -> CheckResult {
        let Self { device, name, pid } = self;
        CheckResult::warning(
            format!("{} is held by {name}, process {pid}", device.display()),
            format!("close the port there, or end it with `kill {pid}`"),
        )
    }
}

/// Who holds which device, and how many processes cannot be looked into.
fn holders(roots: &SystemRoots, devices: &BTreeSet<PathBuf>) -> (Vec<DeviceHolder>, usize) {
    let mut found = Vec::new();
    let mut hidden = 0;
    for process in processes(roots) {
        let Some(files) = process.open_files() else {
            hidden += 1;
            continue;
        };
        let held: BTreeSet<&Path> = files.iter().filter_map(|file| devices.get(file)).map(PathBuf::as_path).collect();
        found.extend(held.into_iter().map(|device| DeviceHolder {
            device: device.to_owned(),
            name: process.name.clone(),
            pid: process.pid,
        }));
    }
    (found, hidden)
}

//! Which program holds a port: two programs on one port each get a part of the bytes.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use posebridge_link::LinkUrl;

use super::ports::serial_ports;
use super::processes::processes;
use super::{Examination, Roots, Verdict};

/// Looks for holders of every port, and of the devices of the given links.
#[must_use]
pub fn check(examination: &Examination) -> Vec<Verdict> {
    let devices = devices(examination);
    if devices.is_empty() {
        return vec![Verdict::skipped("no serial port is there")];
    }
    let (holders, hidden) = holders(&examination.roots, &devices);
    let mut verdicts: Vec<_> = holders.iter().map(Holder::verdict).collect();
    if verdicts.is_empty() {
        verdicts.push(none_found(devices.len(), hidden));
    }
    verdicts
}

/// The devices, links followed: that is how they stand in `/proc`.
fn devices(examination: &Examination) -> BTreeSet<PathBuf> {
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
        // Whoever makes a pseudo-terminal holds its other side as well, and is the robot.
        .filter(|device| !device.starts_with("/dev/pts"))
        .collect()
}

fn none_found(devices: usize, hidden: usize) -> Verdict {
    let ports = if devices == 1 { "port" } else { "ports" };
    let said = format!("no program that can be looked into holds the {devices} {ports}");
    if hidden == 0 {
        Verdict::ok(said)
    } else {
        Verdict::ok(format!("{said}; {hidden} programs of other people cannot be looked into (sudo sees them)"))
    }
}

/// A program that has a port open.
struct Holder {
    device: PathBuf,
    name: String,
    pid: u32,
}

impl Holder {
    fn verdict(&self) -> Verdict {
        let Self { device, name, pid } = self;
        Verdict::warning(
            format!("{} is held by {name}, process {pid}", device.display()),
            format!("close the port there, or end it with `kill {pid}`"),
        )
    }
}

/// Who holds which device, and how many processes cannot be looked into.
fn holders(roots: &Roots, devices: &BTreeSet<PathBuf>) -> (Vec<Holder>, usize) {
    let mut found = Vec::new();
    let mut hidden = 0;
    for process in processes(roots) {
        let Some(files) = process.open_files() else {
            hidden += 1;
            continue;
        };
        let held: BTreeSet<&Path> = files.iter().filter_map(|file| devices.get(file)).map(PathBuf::as_path).collect();
        found.extend(held.into_iter().map(|device| Holder {
            device: device.to_owned(),
            name: process.name.clone(),
            pid: process.pid,
        }));
    }
    (found, hidden)
}

//! Whether ModemManager takes a newly plugged board for a modem and writes to it for some seconds.
//!
//! It opens USB boards (`ttyACM*`) when they appear and sends AT commands, unless udev says that it must not. udev's properties
//! are in `/run/udev/data`, by the numbers of the device.
//!
//! Source: ModemManager's reference manual, "Common udev tags" (ID_MM_DEVICE_IGNORE, ID_MM_PORT_IGNORE); systemd,
//! sd-device (the files `c<major>:<minor>` with a line `E:KEY=VALUE` per property).

use std::fs;
use std::path::Path;

use super::check_result::{CheckResult, DiagnosticContext};
use super::ports::{SerialPort, serial_ports};
use super::processes::running;
use super::surroundings::{SystemRoots, value_in};

/// Ports that it probes by themselves.
const PROBED: &str = "ttyACM";
/// The tags that keep it away.
const IGNORE_TAGS: [&str; 2] = ["E:ID_MM_DEVICE_IGNORE=1", "E:ID_MM_PORT_IGNORE=1"];

/// Looks whether it runs, and which ports it may probe.
pub fn check(examination: &DiagnosticContext) -> Vec<CheckResult> {
    let roots = &examination.roots;
    if running(roots, &["ModemManager"]).is_none() {
        return vec![CheckResult::ok("ModemManager does not run")];
    }
    let probed: Vec<_> = serial_ports(roots)
        .into_iter()
        .filter(|port| port.name.starts_with(PROBED) && !is_ignored(port, roots))
        .collect();
    if probed.is_empty() {
        return vec![CheckResult::ok("ModemManager runs, but has no port here that it would probe")];
    }
    probed.iter().map(check_port).collect()
}

fn check_port(port: &SerialPort) -> CheckResult {
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

/// Whether udev has tagged the port, or the device that it is a part of.
fn is_ignored(port: &SerialPort, roots: &SystemRoots) -> bool {
    port.sys_folders
        .iter()
        .filter_map(|folder| value_in(&folder.join("dev")))
        .any(|number| is_tagged(&roots.run, &number))
}

fn is_tagged(run: &Path, number: &str) -> bool {
    let properties = fs::read_to_string(run.join("udev/data").join(format!("c{number}")));
    properties.is_ok_and(|text| text.lines().any(|line| IGNORE_TAGS.contains(&line)))
}

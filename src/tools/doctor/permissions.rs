//! Whether the person may use the ports, and which group would help.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;

use super::check_result::{CheckResult, DiagnosticContext};
use super::ports::{SerialPort, serial_ports};
use super::surroundings::UserPermissions;

/// Reading and writing for the group, in a file's mode.
const GROUP_READ_WRITE: u32 = 0o060;

/// Looks at every port; a port that is closed to the person is a problem.
pub fn check(examination: &DiagnosticContext) -> Vec<CheckResult> {
    let ports = serial_ports(&examination.roots);
    if ports.is_empty() {
        return vec![CheckResult::skipped("no serial port is there")];
    }
    let person = &examination.user;
    ports.iter().map(|port| check_port(port, person)).collect()
}

fn check_port(port: &SerialPort, person: &UserPermissions) -> CheckResult {
    let device = port.device.display();
    if (person.can_open)(&port.device) {
        return CheckResult::ok(format!("{device} may be read and written"));
    }
    match port.device.metadata() {
        Ok(metadata) => CheckResult::problem(format!("{device} may not be opened"), advice(&metadata, person)),
        Err(error) => {
            CheckResult::problem(format!("{device} leads nowhere: {error}"), "unplug the device and plug it in again")
        }
    }
}

fn advice(metadata: &Metadata, person: &UserPermissions) -> String {
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

//! Whether the person may use the ports, and which group would help.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;

use super::ports::{SerialPort, serial_ports};
use super::{Examination, Person, Verdict};

/// Reading and writing for the group, in a file's mode.
const GROUP_READ_WRITE: u32 = 0o060;

/// Looks at every port; a port that is closed to the person is a problem.
#[must_use]
pub fn check(examination: &Examination) -> Vec<Verdict> {
    let ports = serial_ports(&examination.roots);
    if ports.is_empty() {
        return vec![Verdict::skipped("no serial port is there")];
    }
    let person = &examination.person;
    ports.iter().map(|port| judge(port, person)).collect()
}

fn judge(port: &SerialPort, person: &Person) -> Verdict {
    let device = port.device.display();
    if (person.may_open)(&port.device) {
        return Verdict::ok(format!("{device} may be read and written"));
    }
    match port.device.metadata() {
        Ok(metadata) => Verdict::problem(format!("{device} may not be opened"), advice(&metadata, person)),
        Err(error) => {
            Verdict::problem(format!("{device} leads nowhere: {error}"), "unplug the device and plug it in again")
        }
    }
}

fn advice(metadata: &Metadata, person: &Person) -> String {
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
    if group.lists_person {
        return format!("you are in its group {name} from your next login on: log out and in again");
    }
    format!("it belongs to group {name}: run `sudo usermod -aG {name} $USER`, then log out and in again")
}

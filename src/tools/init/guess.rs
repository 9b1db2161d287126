//! Where a robot may be: the ports of this computer against how the robot is usually reached.

use std::path::Path;

use crate::config::{LinkSection, TemplateLink};
use crate::tools::doctor::SystemRoots;
use crate::tools::doctor::ports::{SerialPort, serial_ports};

/// How a URL of a serial port begins.
const SERIAL: &str = "serial://";
/// A board on a USB cable is one or the other, by its chip.
const USB_PREFIXES: [&str; 2] = ["ttyACM", "ttyUSB"];
/// Most further ports that are listed.
const MAX_LISTED: usize = 8;

/// The robot's usual link, with a port that is there in the place of its own.
pub(super) fn guess(usual: &LinkSection, roots: &SystemRoots) -> TemplateLink {
    let as_usual = |origin: &str, notes| TemplateLink {
        url: usual.url.clone(),
        is_listening: usual.listen,
        origin: origin.to_owned(),
        notes,
    };
    let Some(device) = serial_device(&usual.url) else {
        return as_usual("how this robot is usually reached", Vec::new());
    };
    let ports = serial_ports(roots);
    let (fitting, others): (Vec<_>, Vec<_>) = ports.iter().partition(|port| is_alike(&port.name, &device));
    let Some((first, further)) = fitting.split_first() else {
        let notes = describe_ports(&others, "no such port is there now; there is");
        return as_usual("a guess, no such port is there: `posebridge doctor` shows which are", notes);
    };
    let path = first.by_id.as_ref().unwrap_or(&first.device).display();
    let further: Vec<&SerialPort> = further.iter().chain(&others).copied().collect();
    TemplateLink {
        url: format!("{SERIAL}{path}{}", options_of(&usual.url)),
        is_listening: false,
        origin: format!("a guess: {} is there", describe_port(first)),
        notes: describe_ports(&further, "also there:"),
    }
}

/// The name of the device that a serial URL opens.
fn serial_device(url: &str) -> Option<String> {
    let path = url.strip_prefix(SERIAL)?;
    let path = path.split('?').next().unwrap_or(path);
    Some(Path::new(path).file_name()?.to_string_lossy().into_owned())
}

fn options_of(url: &str) -> &str {
    url.find('?').and_then(|at| url.get(at..)).unwrap_or("")
}

/// Whether a port is of the kind that is usual.
fn is_alike(name: &str, usual: &str) -> bool {
    let kind = |name: &str| {
        let stem = name.trim_end_matches(|character: char| character.is_ascii_digit());
        let is_usb = USB_PREFIXES.contains(&stem);
        if is_usb { USB_PREFIXES[0] } else { stem }.to_owned()
    };
    kind(name) == kind(usual)
}

fn describe_ports(ports: &[&SerialPort], what: &str) -> Vec<String> {
    let lines = ports.iter().take(MAX_LISTED).map(|port| format!("{what} {}", describe_port(port)));
    lines.collect()
}

/// Its device and what is plugged in; names of foreign devices are one line.
fn describe_port(port: &SerialPort) -> String {
    let device = port.device.display();
    let name = port.usb.as_ref().map(|usb| usb.name.as_str());
    match name.filter(|name| !name.is_empty()) {
        Some(name) => {
            let name: String =
                name.chars().map(|character| if character.is_control() { ' ' } else { character }).collect();
            format!("{device} ({name})")
        }
        None => device.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn usual(url: &str) -> LinkSection {
        LinkSection::new(url)
    }

    /// A computer with these device nodes.
    fn computer(names: &[&str]) -> (tempfile::TempDir, SystemRoots) {
        let folder = tempfile::tempdir().unwrap();
        let roots = SystemRoots::under(folder.path());
        fs::create_dir_all(&roots.dev).unwrap();
        for name in names {
            fs::write(roots.dev.join(name), "").unwrap();
        }
        (folder, roots)
    }

    #[test]
    fn a_port_of_the_usual_kind_takes_its_place_and_keeps_the_options() {
        let (_folder, roots) = computer(&["rfcomm0", "tty0", "ttyUSB3", "ttyUSB7"]);
        let found = guess(&usual("serial:///dev/ttyACM0?baud=57600"), &roots);
        let device = roots.dev.join("ttyUSB3");
        let expected = format!("serial://{}?baud=57600", device.display());
        assert_eq!(found.url, expected);
        assert_eq!(found.origin, format!("a guess: {} is there", device.display()));
        let dev = roots.dev.display();
        let notes = [format!("also there: {dev}/ttyUSB7"), format!("also there: {dev}/rfcomm0")];
        assert_eq!(found.notes, notes);
    }

    #[test]
    fn a_name_that_stays_is_taken_before_a_number() {
        let (_folder, roots) = computer(&["ttyACM0"]);
        let by_id = roots.dev.join("serial/by-id");
        fs::create_dir_all(&by_id).unwrap();
        std::os::unix::fs::symlink("../../ttyACM0", by_id.join("usb-board")).unwrap();
        let found = guess(&usual("serial:///dev/ttyACM0"), &roots);
        assert_eq!(found.url, format!("serial://{}", by_id.join("usb-board").display()));
    }

    #[test]
    fn without_a_fitting_port_the_usual_link_stands_and_the_others_are_named() {
        let (_folder, roots) = computer(&["ttyACM0"]);
        let found = guess(&usual("serial:///dev/rfcomm0"), &roots);
        assert_eq!(found.url, "serial:///dev/rfcomm0");
        assert!(found.origin.starts_with("a guess, no such port"), "{}", found.origin);
        assert_eq!(found.notes.len(), 1, "{:?}", found.notes);
    }

    #[test]
    fn a_link_that_is_no_port_stays_as_it_is() {
        let (_folder, roots) = computer(&["ttyACM0"]);
        let listening = LinkSection { listen: true, ..usual("tcp://127.0.0.1:5760") };
        let found = guess(&listening, &roots);
        assert_eq!((found.url.as_str(), found.is_listening), ("tcp://127.0.0.1:5760", true));
    }
}

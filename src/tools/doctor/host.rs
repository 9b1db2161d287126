//! Checks of the computer besides its serial ports: Bluetooth, time synchronisation, and the receive buffer of UDP links.
//! Sources: the kernel's Documentation/ABI/stable/sysfs-class-rfkill (type, soft, hard); BlueZ keeps paired devices in
//! `/var/lib/bluetooth/<adapter>/<device>/info`, which only root may read on most systems; systemd-timesyncd(8) (the file
//! `synchronized`); chronyd(8) (its command socket); socket(7), SO_RCVBUF: limited by net.core.rmem_max.

use std::path::Path;

use posebridge_link::UDP_RECEIVE_BUFFER_BYTES as RECOMMENDED_BYTES;

use super::context::{CheckResult, DiagnosticContext, names_in, running, value_in};

/// Checks adapters, rfkill switches and pairings; skipped without a radio.
pub(super) fn check_bluetooth(context: &DiagnosticContext) -> Vec<CheckResult> {
    let root = &context.root;
    let mut verdicts = check_blocked_radios(root);
    let adapters = adapters(root);
    if adapters.is_empty() {
        if verdicts.is_empty() {
            verdicts.push(CheckResult::skipped("no Bluetooth adapter is there"));
        }
        return verdicts;
    }
    if verdicts.is_empty() {
        verdicts.push(CheckResult::ok(format!("adapter {} is not blocked", adapters.join(", "))));
    }
    if running(root, &["bluetoothd"]).is_none() {
        verdicts.push(CheckResult::warning(
            "the Bluetooth service does not run, so nothing can be paired",
            "run `sudo systemctl start bluetooth`",
        ));
    }
    verdicts.push(check_paired(root));
    verdicts
}

/// Excludes open connections, which are listed beside them as `hci0:11`.
fn adapters(root: &Path) -> Vec<String> {
    let mut names = names_in(&root.join("sys/class/bluetooth"));
    names.retain(|name| name.starts_with("hci") && !name.contains(':'));
    names
}

fn check_blocked_radios(root: &Path) -> Vec<CheckResult> {
    let folder = root.join("sys/class/rfkill");
    names_in(&folder)
        .into_iter()
        .map(|name| folder.join(name))
        .filter(|radio| value_in(&radio.join("type")).as_deref() == Some("bluetooth"))
        .filter_map(|radio| check_radio(&radio))
        .collect()
}

fn check_radio(radio: &Path) -> Option<CheckResult> {
    let name = value_in(&radio.join("name")).unwrap_or_default();
    let is_set = |switch: &str| value_in(&radio.join(switch)).as_deref() == Some("1");
    if is_set("hard") {
        return Some(CheckResult::problem(
            format!("Bluetooth radio {name} is switched off by a switch or by the firmware"),
            "use the switch or key of the computer, or its firmware settings",
        ));
    }
    is_set("soft")
        .then(|| CheckResult::problem(format!("Bluetooth radio {name} is blocked"), "run `rfkill unblock bluetooth`"))
}

fn check_paired(root: &Path) -> CheckResult {
    let folder = root.join("var/lib/bluetooth");
    if std::fs::read_dir(&folder).is_err() {
        return CheckResult::skipped(
            "paired devices cannot be read without root: `bluetoothctl devices Paired` lists them",
        );
    }
    let devices: Vec<_> = names_in(&folder)
        .into_iter()
        .map(|adapter| folder.join(adapter))
        .flat_map(|adapter| paired_devices(&adapter))
        .collect();
    if devices.is_empty() {
        return CheckResult::warning(
            "no device is paired",
            "for a brick on Bluetooth: pair it with `bluetoothctl` (the PIN of an NXT is 1234)",
        );
    }
    CheckResult::ok(format!("paired: {}", devices.join(", ")))
}

fn paired_devices(adapter: &Path) -> Vec<String> {
    names_in(adapter)
        .into_iter()
        .filter_map(|address| {
            let info = std::fs::read_to_string(adapter.join(&address).join("info")).ok()?;
            let is_paired = info.contains("[LinkKey]") || info.contains("[LongTermKey]");
            let name = info.lines().find_map(|line| line.strip_prefix("Name="));
            is_paired.then(|| format!("{} {address}", name.unwrap_or("unnamed")))
        })
        .collect()
}

/// Time services, by process name, cut to 15 characters.
const SERVICES: &[&str] = &["systemd-timesyn", "chronyd", "ntpd", "ntpsec", "openntpd"];

/// Checks for a service, and whether it reports success.
pub(super) fn check_time_sync(context: &DiagnosticContext) -> Vec<CheckResult> {
    let (root, run) = (&context.root, context.root.join("run"));
    let service = running(root, SERVICES);
    let verdict = if run.join("systemd/timesync/synchronized").exists() {
        CheckResult::ok("the date is synchronised by systemd-timesyncd")
    } else if run.join("chrony/chronyd.sock").exists() {
        CheckResult::ok("chronyd runs; `chronyc tracking` says how well it does")
    } else {
        match service {
            Some(service) if service.name == "systemd-timesyn" => CheckResult::warning(
                "systemd-timesyncd runs, but has not reached a time server yet",
                "connect the computer to a network, or ignore this if its date is right",
            ),
            Some(service) => CheckResult::ok(format!("{} runs", service.name)),
            None => CheckResult::warning(
                "no service keeps the date of this computer right",
                "run `sudo timedatectl set-ntp true`; without it, recordings of two computers cannot be put side by side by their dates",
            ),
        }
    };
    vec![verdict]
}

pub(super) fn check_receive_buffer(context: &DiagnosticContext) -> Vec<CheckResult> {
    let path = context.root.join("proc/sys/net/core/rmem_max");
    let granted = value_in(&path).and_then(|text| text.parse::<usize>().ok());
    vec![match granted {
        None => CheckResult::skipped(format!("{} cannot be read", path.display())),
        Some(bytes) if bytes >= RECOMMENDED_BYTES => {
            CheckResult::ok(format!("UDP links get the receive buffer that they ask for ({RECOMMENDED_BYTES} bytes)"))
        }
        Some(bytes) => CheckResult::warning(
            format!("UDP links get a receive buffer of {bytes} of {RECOMMENDED_BYTES} bytes: enough for a few robots"),
            format!("for many robots run `sudo sysctl net.core.rmem_max={RECOMMENDED_BYTES}`"),
        ),
    }]
}

//! Whether a service keeps the computer's date right.
//!
//! The station measures with a clock that no service moves; the date stands in names and headers of recordings, by which
//! recordings of two computers are put side by side.
//!
//! Source: systemd-timesyncd(8) (the file `synchronized`); chronyd(8) (its command socket).

use super::check_result::{CheckResult, DiagnosticContext};
use super::processes::running;

/// Services that set the date, by the names of their processes, cut to 15 characters.
const SERVICES: &[&str] = &["systemd-timesyn", "chronyd", "ntpd", "ntpsec", "openntpd"];

/// Looks for a service, and for whether it has succeeded where it says so.
pub fn check(examination: &DiagnosticContext) -> Vec<CheckResult> {
    let roots = &examination.roots;
    let run = &roots.run;
    let service = running(roots, SERVICES);
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

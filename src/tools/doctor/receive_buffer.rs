//! Whether the system grants UDP links the receive buffer that they ask for.
//!
//! Source: socket(7), SO_RCVBUF: a larger wish is cut to net.core.rmem_max.

use posebridge_link::UDP_RECEIVE_BUFFER_BYTES as WANTED_BYTES;

use super::check_result::{CheckResult, DiagnosticContext};
use super::surroundings::value_in;

/// Compares the limit with the wish.
pub fn check(examination: &DiagnosticContext) -> Vec<CheckResult> {
    let path = examination.roots.proc.join("sys/net/core/rmem_max");
    let granted = value_in(&path).and_then(|text| text.parse::<usize>().ok());
    vec![match granted {
        None => CheckResult::skipped(format!("{} cannot be read", path.display())),
        Some(bytes) if bytes >= WANTED_BYTES => {
            CheckResult::ok(format!("UDP links get the receive buffer that they ask for ({WANTED_BYTES} bytes)"))
        }
        Some(bytes) => CheckResult::warning(
            format!("UDP links get a receive buffer of {bytes} of {WANTED_BYTES} bytes: enough for a few robots"),
            format!("for many robots run `sudo sysctl net.core.rmem_max={WANTED_BYTES}`"),
        ),
    }]
}

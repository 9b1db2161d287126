//! Any JSON as a command of the dashboard.
//!
//! An accepted command matches the row that it names, with every number in its range; a rejection gives its reason in
//! one short line without control characters, because the line is shown on pages and terminals.

use posebridge_dashboard::command::{COMMANDS, parse};
use posebridge_telemetry::Command;

/// Longer than the longest refusal, which lists all commands.
const LONGEST_REFUSAL: usize = 1_000;

/// Input: the text.
pub(crate) fn check(data: &[u8]) {
    match parse(data) {
        Ok(parsed) => {
            let name = parsed.name;
            assert!(COMMANDS.iter().any(|row| row.name == name), "{name}");
            if let Command::Simulator(simulated) = parsed.command {
                assert_eq!(simulated.name(), name);
                assert_eq!(simulated.validate(), Ok(()));
            }
            assert_eq!(parse(data), Ok(parsed), "the same text twice");
        }
        Err(error) => {
            let why = error.to_string();
            assert!(!why.is_empty() && why.len() < LONGEST_REFUSAL, "{why}");
            assert!(!why.contains(char::is_control), "{why:?}");
        }
    }
}

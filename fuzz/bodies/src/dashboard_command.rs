//! The JSON of a command of the dashboard, as any page or program may send it.
//!
//! What is taken is of the row that it names, with every number in its range; what is refused says why in one short line without
//! control characters, because the line goes to pages and terminals.

use posebridge_dashboard::command::{COMMANDS, read};
use posebridge_telemetry::Command;

/// Longer than the longest refusal, which lists all commands.
const LONGEST_REFUSAL: usize = 1_000;

/// Input: the text.
pub(crate) fn check(data: &[u8]) {
    match read(data) {
        Ok((name, command)) => {
            assert!(COMMANDS.iter().any(|row| row.name == name), "{name}");
            if let Command::Simulator(simulated) = command {
                assert_eq!(simulated.name(), name);
                assert_eq!(simulated.check(), Ok(()));
            }
            assert_eq!(read(data), Ok((name, command)), "the same text twice");
        }
        Err(error) => {
            let why = error.to_string();
            assert!(!why.is_empty() && why.len() < LONGEST_REFUSAL, "{why}");
            assert!(!why.contains(char::is_control), "{why:?}");
        }
    }
}

//! The command line: errors, manual, completions, first configuration, doctor, and the files of contrib/.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

#[path = "../../crates/dashboard/tests/support/http.rs"]
mod http;
#[path = "../support/mod.rs"]
mod support;

#[cfg(feature = "camera")]
mod camera;
mod commands;
mod contrib;
mod doctor;
mod error_texts;
mod init;
mod manual;

//! Attacks on a station, and what a robot that steers by it loses: nothing. SECURITY.md has the table of them.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

#[path = "../support/mod.rs"]
mod support;

mod robot;
mod stuck_outputs;
mod texts;

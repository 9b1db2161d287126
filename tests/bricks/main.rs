//! Bricks against the station: their protocols, links and filters, the SDK in C and Python, and commands to the simulator.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, print figures, and pick the events that they are about"
)]

#[path = "../support/mod.rs"]
mod support;

mod filters;
mod laps;
mod protocols;
mod sdk;
mod simulator_commands;

//! Links over real pseudo-terminals and the loopback, with a paused clock.

#![expect(clippy::expect_used, reason = "helpers outside of test functions")]
#![expect(clippy::wildcard_enum_match_arm, reason = "a test that sees any other event fails and prints it")]

mod adapters;
mod bluetooth;
mod conformance;
mod crowd;
mod ev3;
mod file;
mod flood;
mod network;
mod serial;
mod slow;
mod support;
mod terminal_names;
mod traffic;
mod udev;
mod url;

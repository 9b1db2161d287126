//! The protocol crate from outside, in virtual time: frames, messages, sessions, routing, signatures and the codecs of bricks.
#![expect(clippy::expect_used, clippy::panic, reason = "helpers outside #[test] stop where the test is broken")]
#![expect(clippy::wildcard_enum_match_arm, reason = "each test looks for one kind of message among all")]
#![expect(clippy::print_stdout, reason = "figures are for whoever runs the tests with --nocapture")]

#[path = "../support/mod.rs"]
mod support;

mod bricks;
mod camera_corners;
mod camera_json;
mod captures;
mod commands;
mod detect;
mod ev3;
mod framer;
mod golden;
mod nxt;
mod properties;
mod recorded_robot;
mod resync;
mod routing;
mod session;
mod signing;
mod text_columns;
mod text_line;
mod vehicle_services;

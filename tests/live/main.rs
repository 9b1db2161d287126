//! Live runs of the real program, mostly in real time: what users see while a robot drives, and what a run survives.
#![expect(
    clippy::expect_used,
    clippy::unwrap_used,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and pick the messages that they are about"
)]

#[path = "../../crates/dashboard/tests/support/http.rs"]
mod http;
#[path = "../support/mod.rs"]
mod support;

mod camera_fixes;
mod dashboard;
mod plotjuggler;
mod rendered_camera;
mod runs;
mod terminal_picture;
mod terminal_view;

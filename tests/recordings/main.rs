//! Recordings: written, taken in from elsewhere, replayed, exported and reported on.
#![expect(
    clippy::expect_used,
    clippy::unwrap_used,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and pick the inputs that they are about"
)]

#[path = "../support/mod.rs"]
mod support;

mod export;
mod failures;
mod files;
mod inspect;
mod log_times;
mod page_history;
mod parts;
mod real_recordings;
mod replay_smooth;
mod replugged_recording;
mod report;
mod trajectory;

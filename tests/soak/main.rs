//! Long runs over the worst links, in virtual and in real time.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and a long run shows how it goes"
)]

#[path = "../support/mod.rs"]
mod support;

mod frame_account;
mod real_time;
mod virtual_time;

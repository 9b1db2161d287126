//! The fleet from outside: a network of stations in virtual time, hostile inputs, keys and estimates.
#![expect(
    clippy::expect_used,
    clippy::indexing_slicing,
    reason = "helpers outside #[test] stop where the test itself is wrong"
)]

mod chaos;
mod estimate;
mod hostile;
mod keys;
mod network;
mod ros2_keys;
mod rules;
mod scenarios;
mod sessions;
mod simulation;
mod stations;
mod steps;

//! What is connected, counted or configured wrongly on a robot is named, and nothing is named on a robot without a fault.
#![expect(
    clippy::unwrap_used,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and change one kind of observation"
)]

mod csv_recordings;
mod drives;
mod laboratory;
mod simulated_brick;

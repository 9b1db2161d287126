//! Links of the real program: relays, players, signing, ground stations.
#![expect(
    clippy::expect_used,
    clippy::unwrap_used,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and pick the messages that they are about"
)]

#[path = "../support/mod.rs"]
mod support;

mod ground_station;
mod play_over_tcp;
mod relay;
mod signed_link;

//! A station between a brick, a camera and ground stations: who gets what, once.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]
#![expect(dead_code, reason = "the helpers are shared with tests of a single link, which need others of them")]

#[path = "../support/brick.rs"]
mod brick;
#[path = "../support/events.rs"]
mod events;
mod filters;
#[path = "../support/network.rs"]
mod network;
mod redundant;
mod ring;
mod routing_setup;
#[path = "../support/station.rs"]
mod station;

//! The engine through its public interface, in virtual time: bytes, ticks and commands in, events and frames out.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::wildcard_enum_match_arm,
    reason = "helpers stop at the first surprise and pick the events that they are about; the figures are to be read"
)]

mod autopilots;
mod brick_clocks;
mod brick_links;
mod camera_fixes;
mod clock_alignment;
mod clocks;
mod commands;
mod compared_filters;
mod driving;
mod engine;
mod ground_station;
mod identity;
mod links;
mod loops;
mod many_peers;
mod missions;
mod redundant_links;
mod routing;
mod several_robots;
mod signing;
mod strangers;
mod support;
mod takeover;
mod thermometers;
mod vehicle_requests;
mod vehicle_status;
mod wall_range;

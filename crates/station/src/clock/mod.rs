//! From one clock to another: the only place where stamps of different clocks meet.
//!
//! [`unwrap`] turns the counters of a brick or camera into instants that neither wrap nor fall, by whichever ways they come; [`bounds`] finds how two clocks
//! run against each other from the instants of messages; [`conversion`] follows what was found without ever running backwards;
//! [`align`] puts the three together for one remote participant.
//! Nothing here reads a clock: all instants come in as arguments.

pub mod align;
pub mod bounds;
pub mod conversion;
mod hull;
mod last_stamp;
mod maximize;
mod stamp_tracks;
pub mod unwrap;

pub use posebridge_protocol::routing::Endpoint;

/// No clock of a brick may be further off than this share of its rate. Crystals reach 50 ppm and ceramic resonators of cheap boards
/// 5000; an RC oscillator is as good only where its user has calibrated it (ATmega328P datasheet, accuracy of the internal oscillator).
pub const MAX_SKEW: f64 = 0.01;

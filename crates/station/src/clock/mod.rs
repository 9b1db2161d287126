//! Clock alignment: the only place where stamps of different clocks are compared.
//!
//! [`unwrap`] turns the counters of a brick or camera, from all its endpoints, into instants that neither wrap nor
//! fall; [`bounds`] fits the offset between two clocks to the instants of messages; [`conversion`] follows these fits
//! without ever running backwards; [`align`] combines the three for one remote participant.

pub mod align;
pub mod bounds;
pub mod conversion;
mod hull;
mod last_stamp;
mod maximize;
pub mod unwrap;

pub use posebridge_protocol::routing::Endpoint;

/// Largest rate error of a brick's clock. Crystals reach 50 ppm and ceramic resonators of cheap boards 5000; an RC
/// oscillator is as good only where its user has calibrated it (ATmega328P datasheet, accuracy of the internal
/// oscillator).
pub const MAX_SKEW: f64 = 0.01;

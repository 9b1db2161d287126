//! Zenoh sessions: what stations of a fleet say to each other, on the network.
//!
//! A [`FleetSession`] is one thread that owns the session. It takes [`FleetCommand`]s and gives [`FleetEvent`]s through bounded channels,
//! so that nothing on the network makes a station wait. What the messages mean is in `posebridge-fleet`.

mod connection;
mod fleet_session;
mod publishers;
mod subscriptions;

pub use connection::{Connection, ConnectionError, Scouting};
pub use fleet_session::{CommandReply, FleetCommand, FleetEvent, FleetSession, Publication, SessionCounts};

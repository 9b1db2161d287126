//! Zenoh sessions: what stations of a fleet say to each other, and a node of ROS 2.
//!
//! A [`FleetSession`] is one thread that owns the session. It takes [`FleetCommand`]s and gives [`FleetEvent`]s through bounded channels,
//! so that nothing on the network makes a station wait. What the messages mean is in `posebridge-fleet`.

mod connection;
mod fleet_session;
mod io;
mod publishers;
mod ros2_node;
mod session_state;
mod subscriptions;

pub use connection::{Connection, ConnectionError, Scouting};
pub use fleet_session::FleetSession;
pub use io::{AnswerReceiver, CommandReply, FleetCommand, FleetEvent, Publication, SessionCounts};
pub use ros2_node::{Ros2Error, Ros2Node};

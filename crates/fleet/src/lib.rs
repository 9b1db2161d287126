//! A fleet: several stations that may hear the same robots, and which of them owns which robot.
//!
//! The owner of a robot fuses its observations and sends it estimates; no other station does. [`Ownership`] is the protocol, as
//! one deterministic value per station; a shell connects it with the network ([`FleetKeys`]) and with the engine. It reads no clock
//! and opens nothing.
//!
//! # The protocol
//!
//! - A station announces a claim with a liveliness token of robot, [`Epoch`] and station ([`OwnershipToken`]). Of several claims for one robot the
//!   highest holds. An owner that learns of a higher one stops at once, and withdraws its token a little later, so that everybody has
//!   heard of the new owner before the old token vanishes.
//! - A station that hears a robot is its stand-by unless it owns it. It asks the owner. An owner that hears the robot, too, says so, and the
//!   stand-by asks again later. One that does not hands over: it stops, and answers with the state of its filter; the asker claims the next
//!   epoch. One that does not answer in time is replaced, with the last state that it published.
//! - Where nobody owns the robot, the station asks everybody for the last state and epoch, unless it knows them, and claims.
//! - When the owner's token vanishes, every stand-by claims at once; ties are settled by the order of tokens.
//! - Owners publish the state each second and at the moment when they stop hearing the robot, on which stand-by stations ask at once.
//! - A station that was frozen, which it sees by a jump of its clock, sends nothing until the shell has confirmed that it knows all tokens.
//! - A station that is cut off serves what it hears. After the rejoin the order of tokens decides.
//! - An owner that does not hear its robot for long releases it.
//!
//! Estimates carry the epoch, and whoever receives them drops those of earlier owners ([`EpochFence`]).
//!
//! # What the shell has to do
//!
//! - Give inputs of the network before those of robots, where both wait.
//! - Ask [`Ownership::permit`] just before each estimate is sent, on a clock that goes on while the computer sleeps.
//! - Answer [`Output::ConfirmFleet`] and report each loss of the last session with [`Input::FleetDisconnected`], each return of the first one
//!   with [`Input::FleetConfirmed`] after the tokens.
//! - At a hand-over ([`AnswerContent::HandOver`]) append the robot's state as it is before the [`Output::Stop`] that follows.

mod claims;
mod clock_note;
mod config;
mod epoch;
mod estimate;
mod event;
mod fleet_status;
mod fleet_table;
mod io;
mod keys;
mod messages;
mod names;
mod ownership;
mod queries;
mod reception;
mod robot_entry;
mod robot_table;
mod ros2_keys;
mod station_clock;

pub use clock_note::{ClockNote, IdentityNote, NoteError};
pub use config::OwnershipConfig;
pub use epoch::{Epoch, EpochFence, FenceDecision, OwnershipToken};
pub use estimate::{EstimateError, FleetEstimate};
pub use event::{ClaimReason, OwnershipEvent, StopReason};
pub use fleet_table::{FleetRobot, FleetStation, FleetTable};
pub use io::{
    AnswerContent, Input, Output, QueryId, QueryTarget, Reception, RefusalCounts, StartState, StateAnswer,
    StateSnapshot,
};
pub use keys::{FleetKey, FleetKeys, KeyError};
pub use messages::{
    FleetMessage, MessageError, SavedState, SharedFix, StateNotice, StateQuestion, StateReply, StationReport,
    decode_message, encode_message,
};
pub use names::{CameraName, FleetName, LinkName, NameError, RobotName, StationId, StationName};
pub use ownership::{Ownership, RobotRole};
pub use ros2_keys::{EndpointKind, RosAttachment, RosEndpoint, RosName, RosNameError, RosNode, RosQos, RosType};
pub use station_clock::{ClockExchange, ClockOffset, StationClock};

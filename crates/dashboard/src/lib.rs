//! The page of the station: what fusion does, shown while it does it.
//!
//! Gets what the shard tells through a bounded channel that drops and counts ([`Feed`]), turns it into messages for browsers and
//! programs with views that are pure functions of events ([`views`]), and serves them over HTTP and WebSocket on a thread with a
//! runtime of its own ([`Dashboard`]). Readers in this process, such as the terminal view, get the same messages as values
//! ([`Taps`]), also when nobody listens for browsers. What people ask for goes back through a second bounded channel, as
//! [`Command`](posebridge_telemetry::Command)s, and so into the recording. Nothing here is waited for by whoever steers a robot.
//!
//! JSON for browsers is known here and nowhere else. The shapes stand in [`model`], in `schema/v1.json` and in docs/dashboard.md;
//! units are SI, angles radians, space the arena, times seconds of the session by the host's clock.

mod assets;
mod bound;
pub mod command;
mod commander;
mod counts;
mod feed;
pub mod gather;
mod hub;
mod latency;
mod limits;
mod metrics;
pub mod model;
mod negotiation;
mod reach;
mod recordings;
pub mod room;
mod schema;
mod server;
mod state;
mod taps;
mod thread;
mod token;
pub mod views;

pub use bound::{Bound, Listen};
pub use commander::Commander;
pub use feed::{Batch, Feed, Standing, TruthSample};
pub use gather::{Gatherer, Keep};
pub use schema::schema;
pub use taps::{Found, FrameTap, Taps};
pub use thread::{Dashboard, Facts, Sources, StartError, TokenPolicy};
pub use token::Token;

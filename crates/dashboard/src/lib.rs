//! The dashboard: the live page of the station.
//!
//! Receives events from the station loop through a bounded channel that drops and counts ([`EventFeed`]), converts them to messages
//! with views that are pure functions of events ([`views`]), and serves those over HTTP and WebSocket on its own thread and runtime
//! ([`Dashboard`]). Readers in this process, such as the terminal view, get the same messages as values ([`FrameTaps`]), also without a
//! server. Commands return through a second bounded channel, as [`Command`](posebridge_telemetry::Command)s, and so into the recording.
//! The station loop never waits for the dashboard.
//!
//! All JSON for browsers is defined here. Its structure is in [`model`], in `schema/v1.json` and in docs/dashboard.md;
//! units are SI, angles radians, coordinates those of the arena, times seconds of the session by the host's clock.

mod api;
mod assets;
mod cameras;
pub mod command;
mod counters;
mod feed;
mod fleet;
mod hub;
mod limits;
mod metrics;
pub mod model;
mod operator_tokens;
mod recordings;
mod schema;
mod server;
mod taps;
mod thread;
mod token;
mod token_file;
pub mod views;

pub use api::{DashboardInputs, DashboardStartError, DeadReckoning, DeadReckoningBuilder, StationInfo, TokenPolicy};
pub use cameras::{CameraPicture, CameraSource};
pub use feed::{EventBatch, EventFeed, RobotStatus, SimulatedTruth, StationStatus};
pub use fleet::{FleetReply, FleetRobotCommand, FleetSource};
pub use hub::SessionViews;
pub use operator_tokens::{OperatorTokenError, OperatorTokens};
pub use schema::schema;
pub use taps::{CommandSubmitter, FrameTap, FrameTaps, TapPoll};
pub use thread::{BoundListener, Dashboard, ListenAddress};
pub use token::AccessToken;
pub use token_file::{LineProblem, TokenFileError};
pub use views::RetentionPolicy;

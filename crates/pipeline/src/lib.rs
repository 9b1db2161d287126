//! The engine: decode, align clocks, estimate, publish, as one deterministic value.
//!
//! [`Pipeline`] takes what links, people and recordings give it and gives back events and bytes to send. It reads no
//! clock, opens nothing and knows no runtime; live runs, replays, simulations and tests drive the very same object.
//!
//! ```text
//! bytes > framing > messages > readings > clock > estimator > publisher > events, bytes
//! ```

pub mod clock;
pub mod config;
mod engine;
mod interpret;
mod link_state;
mod peers;
mod publish;
mod publisher;
mod records;
mod robot_voice;
mod thermometers;

pub use config::{
    AcceptedVersions, BrickLink, DescriptionPolicy, FixRequestConfig, LinkConfig, OUTPUTS, OutputInstant, OutputKind,
    OutputStream, PipelineConfig, ThermometerConfig, Voices,
};
pub use engine::{BuildError, Pipeline};

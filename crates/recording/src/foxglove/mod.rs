//! What came out of the pipeline, as messages that viewers and notebooks read without set-up.
//!
//! Protocol buffers of Foxglove's own schemas for what every viewer draws (odometry, pose, path, transform, ellipse, fixes,
//! log); JSON with a schema for what only we have (innovations, health of links, clocks, calibration, temperature,
//! commands, gaps, truth). [`Outputs`] turns events into messages; [`crate::container::Writer`] puts them beside the inputs
//! of a recording. Nothing of it is read back by a replay: the same events come out of the inputs again.
//!
//! # Model
//! ```text
//! instant of an estimate    t_host = host0 + (t_brick - brick0) / (1 + skew)      by the last alignment of the brick's clock
//! time in a message         UTC = start of the session + t_host
//! quaternion of a heading   z = sin(heading / 2), w = cos(heading / 2)
//! ellipse                   2.448 standard deviations: 95 % of a normal distribution in the plane, sqrt(-2 ln 0.05)
//! ```

mod channels;
mod convert;
mod outputs;
mod records;
mod wire;

pub use channels::{CHANNELS, Channel};
pub(crate) use outputs::Message;
pub use outputs::Outputs;
pub(crate) use outputs::{calibration, command, gap};

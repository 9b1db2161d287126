//! The station's outputs as messages that viewers and notebooks read without configuration.
//!
//! Protocol buffers of Foxglove's schemas for what every viewer draws (odometry, pose, path, transform, ellipse, fixes, log); JSON with
//! a schema for the rest (innovations, health of links, clocks, calibration, temperature, commands, gaps, truth). [`OutputEncoder`]
//! converts events to messages; [`crate::container::RecordingWriter`] stores them beside the inputs of a recording. A replay does not
//! read them: it computes the same events from the inputs. Robots after the first have separate topics and a separate frame.
//!
//! # Model
//! ```text
//! instant of an estimate    t_host = host0 + (t_brick - brick0) / (1 + skew)      by the last alignment of the brick's clock
//! time in a message         UTC = start of the session + t_host
//! quaternion of a heading   z = sin(heading / 2), w = cos(heading / 2)
//! ellipse                   2.448 standard deviations: 95 % of a normal distribution in the plane, sqrt(-2 ln 0.05)
//! ```

mod channels;
mod outputs;
mod records;
mod robot_outputs;
mod wire;

pub use channels::{CHANNELS, Channel};
pub(crate) use channels::{ChannelKey, EncodedMessage};
pub use outputs::OutputEncoder;
pub(crate) use outputs::{command_message, gap_message};

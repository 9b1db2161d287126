//! What a person or another program asks of the pipeline.

use crate::spaces::{Arena, Pose};

/// A request to the pipeline; part of its recorded inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Put the robot there, with the given standard deviations; counted as a reset.
    SetPose {
        /// Where the robot is.
        pose: Pose<Arena>,
        /// One standard deviation of x and of y, in metres.
        position_sigma_m: f64,
        /// One standard deviation of the heading, in radians.
        heading_sigma_rad: f64,
    },
}

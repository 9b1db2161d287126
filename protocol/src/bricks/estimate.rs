//! The estimate as a mailbox of a LEGO brick gets it.
//!
//! # Layout
//! ```text
//! 0 u32 brick time, ms    4 f32 x, m    8 f32 y, m    12 f32 heading, rad    16 f32 sigma, m
//! 20 u8 flags    21 u8 reset counter    22 u16 sequence    little-endian
//! ```

use crate::message::{PlanarPose, PoseFlags};

/// `sigma_m` is the larger of the standard deviations of x and y.
pub(super) fn estimate_bytes(tick_ms: u32, pose: &PlanarPose, sigma_m: f64, sequence: u16) -> [u8; 24] {
    let floats = [pose.pose.x.0, pose.pose.y.0, pose.pose.heading.rad(), sigma_m];
    let parts = tick_ms
        .to_le_bytes()
        .into_iter()
        .chain(floats.into_iter().flat_map(|value| (value as f32).to_le_bytes()))
        .chain([validity_bits(pose.flags), pose.reset_counter])
        .chain(sequence.to_le_bytes());
    let mut bytes = [0; 24];
    for (byte, part) in bytes.iter_mut().zip(parts) {
        *byte = part;
    }
    bytes
}

/// Bit 0: the position is valid; bit 1: the heading is.
pub(super) const fn validity_bits(flags: PoseFlags) -> u8 {
    flags.position_valid as u8 | (flags.heading_valid as u8) << 1
}

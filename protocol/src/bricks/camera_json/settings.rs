//! The settings of a link to cameras.

use posebridge_telemetry::TimeDelta;

use crate::framing::TransportKind;

/// Settings for cameras that send JSON.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraJsonSettings {
    /// Whether a chunk is a datagram, whose end ends its last line.
    pub framing: TransportKind,
    /// How long before its arrival a fix without a time was exposed.
    pub delay: TimeDelta,
    /// It may be so much more or less.
    pub delay_spread: TimeDelta,
    /// Fixes of less quality are left out; 0 to 100 per cent; a camera that has failed sends 0.
    pub min_quality: f64,
}

impl Default for CameraJsonSettings {
    /// A camera program at 30 images per second takes one to three of them for an image.
    fn default() -> Self {
        Self {
            framing: TransportKind::Stream,
            delay: TimeDelta::from_millis(60),
            delay_spread: TimeDelta::from_millis(40),
            min_quality: 1.0,
        }
    }
}

//! What a link to cameras must be told.

use posebridge_telemetry::Span;

use crate::framing::Framing;

/// How cameras that speak JSON are heard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixSettings {
    /// Whether a chunk is a datagram, whose end ends its last line.
    pub framing: Framing,
    /// How long before its arrival a fix without a time was exposed.
    pub delay: Span,
    /// It may be so much more or less.
    pub delay_spread: Span,
    /// Fixes of less quality are left out; 0 to 100 per cent, 0 is what a camera says that has failed.
    pub least_quality: f64,
}

impl Default for FixSettings {
    /// A camera program at 30 images per second takes one to three of them for an image.
    fn default() -> Self {
        Self {
            framing: Framing::Stream,
            delay: Span::from_millis(60),
            delay_spread: Span::from_millis(40),
            least_quality: 1.0,
        }
    }
}

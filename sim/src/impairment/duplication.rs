//! Impairments of datagrams only: duplication and reordering.
//!
//! # Model
//! ```text
//! held back: with probability p the arrival is U(from, to) later, and those behind do not wait
//! repeated:  with probability q a copy arrives right behind it
//! ```

use posebridge_telemetry::TimeDelta;

use super::draws::{millis, uniform};
use super::settings::{DirectionProfile, Reorder};
use crate::random::RandomStream;

/// Draws what happens to each datagram.
#[derive(Clone, Debug)]
pub(super) struct Duplication {
    reorder: Option<Reorder>,
    duplicate: f64,
    reordering: RandomStream,
    duplicating: RandomStream,
}

impl Duplication {
    pub(super) fn new(profile: &DirectionProfile, reordering: RandomStream, duplicating: RandomStream) -> Self {
        Self { reorder: profile.reorder, duplicate: profile.duplicate, reordering, duplicating }
    }

    /// How long the next datagram is held back, if it is.
    pub(super) fn held_back(&mut self) -> Option<TimeDelta> {
        let reorder = self.reorder?;
        let happens = self.reordering.bernoulli(reorder.probability);
        let (from, to) = (millis(reorder.from_ms), millis(reorder.to_ms));
        let wait = uniform(&mut self.reordering, from, to);
        happens.then_some(wait)
    }

    /// Whether the next datagram arrives twice.
    pub(super) fn is_duplicated(&mut self) -> bool {
        self.duplicating.bernoulli(self.duplicate)
    }
}

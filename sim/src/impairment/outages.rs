//! Outages: both directions go away together and come back.
//!
//! # Model
//! ```text
//! up for Exp(mean_up), down for U(down_from, down_to)
//! ```

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::draws::{exponential, uniform};
use super::settings::Disconnects;
use crate::random::Stream;

/// Whether bytes can flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Presence {
    Up,
    Down,
}

/// When the link goes away and comes back.
#[derive(Clone, Debug)]
pub(super) struct Outages {
    settings: Disconnects,
    stream: Stream,
    presence: Presence,
    changes_at: Stamp<HostClock>,
}

impl Outages {
    /// A link that is up at `now`.
    pub(super) fn new(settings: Disconnects, stream: Stream, now: Stamp<HostClock>) -> Self {
        let mut outages = Self { settings, stream, presence: Presence::Up, changes_at: now };
        outages.changes_at = now + outages.stay();
        outages
    }

    /// When the link next goes away or comes back.
    pub(super) const fn changes_at(&self) -> Stamp<HostClock> {
        self.changes_at
    }

    /// Lets the next change happen and returns what it is then.
    pub(super) fn change(&mut self) -> Presence {
        self.presence = match self.presence {
            Presence::Up => Presence::Down,
            Presence::Down => Presence::Up,
        };
        self.changes_at = self.changes_at + self.stay();
        self.presence
    }

    fn stay(&mut self) -> Span {
        let settings = self.settings;
        let stay = match self.presence {
            Presence::Up => exponential(&mut self.stream, Span::from_secs_f64(settings.mean_up_s)),
            Presence::Down => uniform(
                &mut self.stream,
                Span::from_secs_f64(settings.down_from_s),
                Span::from_secs_f64(settings.down_to_s),
            ),
        };
        stay.max(Span::from_nanos(1))
    }
}

//! Outages: both directions go away together and come back.
//!
//! # Model
//! ```text
//! up for Exp(mean_up), down for U(down_from, down_to)
//! ```

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::draws::{exponential, uniform};
use super::settings::Disconnects;
use crate::random::RandomStream;

/// Whether bytes can flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OutageState {
    Up,
    Down,
}

/// When the link goes away and comes back.
#[derive(Clone, Debug)]
pub(super) struct Outages {
    settings: Disconnects,
    stream: RandomStream,
    state: OutageState,
    changes_at: Timestamp<HostClock>,
}

impl Outages {
    /// A link that is up at `now`.
    pub(super) fn new(settings: Disconnects, stream: RandomStream, now: Timestamp<HostClock>) -> Self {
        let mut outages = Self { settings, stream, state: OutageState::Up, changes_at: now };
        outages.changes_at = now + outages.draw_duration();
        outages
    }

    /// When the link next goes away or comes back.
    pub(super) const fn changes_at(&self) -> Timestamp<HostClock> {
        self.changes_at
    }

    /// Lets the next change happen and returns what it is then.
    pub(super) fn toggle(&mut self) -> OutageState {
        self.state = match self.state {
            OutageState::Up => OutageState::Down,
            OutageState::Down => OutageState::Up,
        };
        self.changes_at = self.changes_at + self.draw_duration();
        self.state
    }

    fn draw_duration(&mut self) -> TimeDelta {
        let settings = self.settings;
        let stay = match self.state {
            OutageState::Up => exponential(&mut self.stream, TimeDelta::from_secs_f64(settings.mean_up_s)),
            OutageState::Down => uniform(
                &mut self.stream,
                TimeDelta::from_secs_f64(settings.down_from_s),
                TimeDelta::from_secs_f64(settings.down_to_s),
            ),
        };
        stay.max(TimeDelta::from_nanos(1))
    }
}

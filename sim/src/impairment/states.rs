//! States of a link that pass in time: good and bad (loss in bursts), up and down (outages of both directions).
//!
//! # Model
//! ```text
//! burst loss   good -> bad after Exp(mean_good), bad -> good after Exp(mean_bad), lost with probability loss_good or loss_bad
//!              share of loss = (mean_good loss_good + mean_bad loss_bad) / (mean_good + mean_bad)
//! outages      up for Exp(mean_up), down for U(down_from, down_to)
//! ```
//! The states pass in time, not with each packet, so that the length of a burst does not depend on how much is sent.
//!
//! # Sources
//! Gilbert, Capacity of a Burst-Noise Channel, Bell System Technical Journal 39 (1960); Elliott, Estimates of Error Rates for Codes
//! on Burst-Noise Channels, the same 42 (1963). In continuous time as a two-state Markov process.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::profile::{BurstLoss, Disconnects};
use super::unit_draws::{exponential, uniform};
use crate::random::RandomStream;

#[derive(Clone, Debug)]
pub(super) struct GilbertElliott {
    settings: BurstLoss,
    is_bad: bool,
    /// When the state changes; `None` before the first look.
    changes_at: Option<Timestamp<HostClock>>,
    states: RandomStream,
}

impl GilbertElliott {
    /// A link in a state drawn from the long-run shares of both.
    pub(super) fn new(settings: BurstLoss, mut states: RandomStream) -> Self {
        let share_bad = settings.mean_bad_s / (settings.mean_good_s + settings.mean_bad_s);
        Self { is_bad: states.bernoulli(share_bad), settings, changes_at: None, states }
    }

    /// Whether what leaves at `at` is lost, given a uniform draw on [0, 1). The instants must not fall.
    pub(super) fn is_lost(&mut self, at: Timestamp<HostClock>, draw: f64) -> bool {
        self.advance_to(at);
        let loss = if self.is_bad { self.settings.loss_bad } else { self.settings.loss_good };
        draw < loss
    }

    /// Lets time pass. The first look starts the first state, so it must come with the first unit, whatever becomes of it.
    pub(super) fn advance_to(&mut self, at: Timestamp<HostClock>) {
        // A memoryless state may be looked at first at any instant.
        let mut changes_at = match self.changes_at {
            Some(changes_at) => changes_at,
            None => at + self.draw_dwell_time(),
        };
        while changes_at <= at {
            self.is_bad = !self.is_bad;
            changes_at = changes_at + self.draw_dwell_time();
        }
        self.changes_at = Some(changes_at);
    }

    fn draw_dwell_time(&mut self) -> TimeDelta {
        let mean_s = if self.is_bad { self.settings.mean_bad_s } else { self.settings.mean_good_s };
        exponential(&mut self.states, TimeDelta::from_secs_f64(mean_s)).max(TimeDelta::from_nanos(1))
    }
}

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

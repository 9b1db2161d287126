//! Two-state processes of a link: good and bad (loss in bursts), up and down (outages of both directions).
//!
//! # Model
//! ```text
//! burst loss   good -> bad after Exp(mean_good), bad -> good after Exp(mean_bad), lost with probability loss_good or loss_bad
//!              share of loss = (mean_good loss_good + mean_bad loss_bad) / (mean_good + mean_bad)
//! outages      up for Exp(mean_up), down for U(down_from, down_to)
//! ```
//! The states change with time, not with each packet, so that the length of a burst does not depend on the traffic.
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
    /// `None` before the first unit.
    changes_at: Option<Timestamp<HostClock>>,
    states: RandomStream,
}

impl GilbertElliott {
    /// Draws the first state from the stationary distribution.
    pub(super) fn new(settings: BurstLoss, mut states: RandomStream) -> Self {
        let share_bad = settings.mean_bad_s / (settings.mean_good_s + settings.mean_bad_s);
        Self { is_bad: states.bernoulli(share_bad), settings, changes_at: None, states }
    }

    /// Whether a unit that departs at `at` is lost, given a uniform draw on [0, 1). The instants must not decrease.
    pub(super) fn is_lost(&mut self, at: Timestamp<HostClock>, draw: f64) -> bool {
        self.advance_to(at);
        let loss = if self.is_bad { self.settings.loss_bad } else { self.settings.loss_good };
        draw < loss
    }

    /// Advances the state. The first call starts the first state, so it must come with the first unit, whatever its outcome.
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OutageState {
    Up,
    Down,
}

#[derive(Clone, Debug)]
pub(super) struct Outages {
    settings: Disconnects,
    stream: RandomStream,
    state: OutageState,
    changes_at: Timestamp<HostClock>,
}

impl Outages {
    /// The link is up at `now`.
    pub(super) fn new(settings: Disconnects, stream: RandomStream, now: Timestamp<HostClock>) -> Self {
        let mut outages = Self { settings, stream, state: OutageState::Up, changes_at: now };
        outages.changes_at = now + outages.draw_duration();
        outages
    }

    pub(super) const fn changes_at(&self) -> Timestamp<HostClock> {
        self.changes_at
    }

    /// Advances to the next change and returns the new state.
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

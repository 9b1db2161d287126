//! Loss in bursts: a link that is good for a while and bad for a while.
//!
//! # Model
//! ```text
//! good -> bad after Exp(mean_good), bad -> good after Exp(mean_bad), lost with probability loss_good or loss_bad
//! share of loss = (mean_good loss_good + mean_bad loss_bad) / (mean_good + mean_bad)
//! ```
//! The states pass in time, not with each packet, so that the length of a burst does not depend on how much is sent.
//!
//! # Sources
//! Gilbert, Capacity of a Burst-Noise Channel, Bell System Technical Journal 39 (1960); Elliott, Estimates of Error Rates for Codes
//! on Burst-Noise Channels, the same 42 (1963). In continuous time as a two-state Markov process.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::draws::exponential;
use super::settings::BurstLoss;
use crate::random::RandomStream;

/// The two states.
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

    /// Whether what leaves at `at` is lost, with its luck on [0, 1). The instants must not fall.
    pub(super) fn is_lost(&mut self, at: Timestamp<HostClock>, luck: f64) -> bool {
        self.advance_to(at);
        let loss = if self.is_bad { self.settings.loss_bad } else { self.settings.loss_good };
        luck < loss
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

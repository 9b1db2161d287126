//! The trails of a recording: the same views over a whole session instead of its last minute.

use posebridge_telemetry::{Event, HostClock, Stamp};

use crate::feed::{Standing, TruthSample};
use crate::limits::REPLAY_POINTS;
use crate::model::{Frame, seconds_of};
pub use crate::views::Keep;
use crate::views::{Setting, Told, VIEWS, View};

/// Gathers what a session shows.
pub struct Gatherer {
    views: Vec<Box<dyn View>>,
    last: Stamp<HostClock>,
}

impl Gatherer {
    /// For a session with these links, by their URLs.
    #[must_use]
    pub fn new(links: Vec<String>) -> Self {
        let setting = Setting { links, keep: Keep::Whole { most: REPLAY_POINTS } };
        Self { views: VIEWS.iter().map(|entry| (entry.build)(&setting)).collect(), last: Stamp::ZERO }
    }

    /// Takes what happened.
    pub fn take(&mut self, now: Stamp<HostClock>, event: &Event) {
        self.last = self.last.max(now);
        self.tell(now, Told::Event(event));
    }

    /// Takes what stood at its end.
    pub fn take_standing(&mut self, standing: &Standing) {
        self.tell(self.last, Told::Standing(standing));
    }

    /// Takes where the simulated robot was.
    pub fn take_truth(&mut self, sample: &TruthSample) {
        self.tell(sample.now, Told::Truth(sample));
    }

    /// Everything that was gathered.
    #[must_use]
    pub fn history(&self) -> Frame {
        let mut history = Frame { now_s: seconds_of(self.last), ..Frame::default() };
        for view in &self.views {
            view.add_history(&mut history);
        }
        history
    }

    fn tell(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        for view in &mut self.views {
            view.take(now, told);
        }
    }
}

//! The trails of a recording: the same views over a whole session instead of its last minute.

use posebridge_telemetry::{Event, HostClock, Timestamp};

use crate::feed::{SimulatedTruth, StationStatus};
use crate::limits::MAX_REPLAY_POINTS;
use crate::model::{Frame, seconds_of};
pub use crate::views::RetentionPolicy;
use crate::views::{VIEWS, View, ViewConfig, ViewInput};

/// The views of a whole session.
pub struct SessionViews {
    views: Vec<Box<dyn View>>,
    last: Timestamp<HostClock>,
}

impl SessionViews {
    pub fn new(links: Vec<String>) -> Self {
        let setting = ViewConfig { links, retention: RetentionPolicy::WholeSession { max_points: MAX_REPLAY_POINTS } };
        Self { views: VIEWS.iter().map(|entry| (entry.build)(&setting)).collect(), last: Timestamp::ZERO }
    }

    pub fn push_event(&mut self, now: Timestamp<HostClock>, event: &Event) {
        self.last = self.last.max(now);
        self.dispatch(now, ViewInput::Event(event));
    }

    pub fn push_status(&mut self, status: &StationStatus) {
        self.dispatch(self.last, ViewInput::Status(status));
    }

    pub fn push_truth(&mut self, sample: &SimulatedTruth) {
        self.dispatch(sample.now, ViewInput::Truth(sample));
    }

    pub fn history(&self) -> Frame {
        let mut history = Frame { now_s: seconds_of(self.last), ..Frame::default() };
        for view in &self.views {
            view.add_history(&mut history);
        }
        history
    }

    fn dispatch(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        for view in &mut self.views {
            view.observe(now, input);
        }
    }
}

//! How the simulated brick was set last: by what it steers, and how bad its link is.

use posebridge_telemetry::{HostClock, Stamp};

use super::{Pace, Setting, Told, View};
use crate::model::{Frame, SimulatorNow};

/// The settings; `None` without a simulated brick.
pub(super) struct Simulator {
    now: Option<SimulatorNow>,
    has_news: bool,
}

impl Simulator {
    pub(super) const fn new(_setting: &Setting) -> Self {
        Self { now: None, has_news: false }
    }
}

impl View for Simulator {
    fn take(&mut self, _now: Stamp<HostClock>, told: Told<'_>) {
        if let Told::Standing(standing) = told
            && standing.simulator != self.now
        {
            self.now.clone_from(&standing.simulator);
            self.has_news = true;
        }
    }

    fn add_news(&mut self, frame: &mut Frame, pace: Pace) {
        // Once a second as well: a reader that was slow may have missed the change.
        if std::mem::take(&mut self.has_news) || pace == Pace::Second {
            self.add_history(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        history.simulator.clone_from(&self.now);
    }
}

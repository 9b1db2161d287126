//! Which sources are left out.

use posebridge_telemetry::{HostClock, Stamp};

use super::{Pace, Setting, Told, View};
use crate::model::Frame;

/// Their numbers; `None` as long as nobody has said.
pub(super) struct Switches {
    off: Option<Vec<u8>>,
    has_news: bool,
}

impl Switches {
    pub(super) const fn new(_setting: &Setting) -> Self {
        Self { off: None, has_news: false }
    }
}

impl View for Switches {
    fn take(&mut self, _now: Stamp<HostClock>, told: Told<'_>) {
        if let Told::Standing(standing) = told
            && self.off.as_ref() != Some(&standing.switched_off)
        {
            self.off = Some(standing.switched_off.clone());
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
        history.switched_off.clone_from(&self.off);
    }
}

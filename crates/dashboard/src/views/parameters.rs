//! The tunables as they stand.

use posebridge_telemetry::{HostClock, Stamp};

use super::{Pace, Setting, Told, View};
use crate::model::{Frame, ParameterValue};

/// Their values.
pub(super) struct Parameters {
    values: Vec<ParameterValue>,
    has_news: bool,
}

impl Parameters {
    pub(super) const fn new(_setting: &Setting) -> Self {
        Self { values: Vec::new(), has_news: false }
    }
}

impl View for Parameters {
    fn take(&mut self, _now: Stamp<HostClock>, told: Told<'_>) {
        if let Told::Standing(standing) = told
            && standing.parameters != self.values
        {
            self.values.clone_from(&standing.parameters);
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
        if !self.values.is_empty() {
            history.parameters = Some(self.values.clone());
        }
    }
}

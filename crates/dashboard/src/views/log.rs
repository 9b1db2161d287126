//! The event log: texts of robots, ground stations and the station, and events of robots and links.

use posebridge_telemetry::severity::NOTICE;
use posebridge_telemetry::{Event, HostClock, RepeatFilter, TimeDelta, Timestamp};

use super::retained_series::{PointPriority, RetainedSeries};
use super::view::{FrameContent, RetentionPolicy, View, ViewConfig, ViewInput};
use crate::model::{Frame, LogLine, seconds_of};

/// More than a page shows.
const MAX_LINES: usize = 300;
/// MAVLink's longest text in parts is far shorter.
const MAX_LINE_BYTES: usize = 1_000;

/// Largest age of a line: there are far fewer lines than points, and the start of a session is the most informative.
const REPEAT_WINDOW: TimeDelta = TimeDelta::from_millis(24 * 3_600_000);

pub(super) struct Log {
    config: ViewConfig,
    lines: RetainedSeries<LogLine>,
    repeats: RepeatFilter,
    severity: u8,
}

impl Log {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        let keep = match setting.retention {
            RetentionPolicy::SlidingWindow { .. } => {
                RetentionPolicy::SlidingWindow { duration: REPEAT_WINDOW, max_points: MAX_LINES }
            }
            whole @ RetentionPolicy::WholeSession { .. } => whole,
        };
        Self {
            config: setting.clone(),
            lines: RetainedSeries::new(keep),
            repeats: RepeatFilter::default(),
            severity: NOTICE,
        }
    }

    /// In a whole session the texts of robots and ground stations are thinned first; live, the last lines are kept
    /// unchanged.
    const fn priority_of(&self, severity: u8) -> PointPriority {
        match self.config.retention {
            RetentionPolicy::WholeSession { .. } if severity > NOTICE => PointPriority::Normal,
            RetentionPolicy::WholeSession { .. } | RetentionPolicy::SlidingWindow { .. } => PointPriority::Keep,
        }
    }

    fn push(&mut self, now: Timestamp<HostClock>, severity: u8, text: String) {
        let t_s = seconds_of(now);
        let line = LogLine { t_s, severity, text };
        self.lines.push(now, line, self.priority_of(severity));
    }

    /// The line of an event. The station's own lines are at least notices.
    fn line_of(&self, event: &Event) -> Option<(u8, String)> {
        let (severity, text) = event.describe()?;
        if let Event::Text { .. } = event {
            return Some((severity, cut(text)));
        }
        let url = if let Event::Link { link, .. } = event { self.config.links.get(usize::from(link.0)) } else { None };
        Some((severity.min(NOTICE), url.map(|url| format!("{text} ({url})")).unwrap_or(text)))
    }
}

fn cut(mut text: String) -> String {
    let mut end = text.len().min(MAX_LINE_BYTES);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text.truncate(end);
    text
}

impl View for Log {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        if let Some(repeated) = self.repeats.flush_due(now) {
            self.push(now, self.severity, repeated);
        }
        let ViewInput::Event(event) = input else {
            return;
        };
        let Some((severity, text)) = self.line_of(event) else {
            return;
        };
        let shown = self.repeats.push(now, &text);
        if let Some(repeated) = shown.repeat_summary {
            self.push(now, self.severity, repeated);
        }
        if shown.is_shown {
            self.push(now, severity, text);
            self.severity = severity;
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        frame.log = self.lines.take_pending();
    }

    fn add_history(&self, history: &mut Frame) {
        history.log = self.lines.retained();
    }

    fn dropped(&self) -> u64 {
        self.lines.dropped()
    }
}

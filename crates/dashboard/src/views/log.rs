//! The event log: what robots, ground stations and the station itself say, and what happened to robots and links.

use posebridge_telemetry::{Address, Event, HostClock, LinkState, Repeats, Span, Stamp};

use super::trail::{Trail, Weight};
use super::{Keep, Pace, Setting, Told, View, robot_name};
use crate::model::{Frame, LogLine, seconds_of};

/// So many lines are kept; more than a page shows.
const MOST_LINES: usize = 300;
/// So long a line is at most, in bytes; MAVLink's longest text in parts is far shorter.
const LONGEST_LINE: usize = 1_000;

/// So old a line is at most: there are far fewer lines than points, and the beginning of a session tells most.
const LONGEST: Span = Span::from_millis(24 * 3_600_000);

const WARNING: u8 = 4;
const NOTICE: u8 = 5;

/// The lines.
pub(super) struct Log {
    setting: Setting,
    trail: Trail<LogLine>,
    repeats: Repeats,
    /// The severity of the last line.
    severity: u8,
}

impl Log {
    pub(super) fn new(setting: &Setting) -> Self {
        let keep = match setting.keep {
            Keep::Latest { .. } => Keep::Latest { span: LONGEST, most: MOST_LINES },
            whole @ Keep::Whole { .. } => whole,
        };
        Self { setting: setting.clone(), trail: Trail::new(keep), repeats: Repeats::default(), severity: NOTICE }
    }

    /// Over a whole session what robots and ground stations chatter goes first; the last lines are kept as they came.
    const fn weight_of(&self, severity: u8) -> Weight {
        match self.setting.keep {
            Keep::Whole { .. } if severity > NOTICE => Weight::Usual,
            Keep::Whole { .. } | Keep::Latest { .. } => Weight::Rare,
        }
    }

    fn push(&mut self, now: Stamp<HostClock>, severity: u8, text: String) {
        let t_s = seconds_of(now);
        let line = LogLine { t_s, severity, text };
        self.trail.push(now, line, self.weight_of(severity));
    }

    fn line_of(&self, event: &Event) -> Option<(u8, String)> {
        Some(match event {
            Event::RobotSeen { robot } => (NOTICE, format!("heard {}", robot_name(*robot))),
            Event::RobotLost { robot, silence } => {
                let silent_s = silence.as_secs_f64();
                let robot = robot_name(*robot);
                (WARNING, format!("lost {robot}, silent for {silent_s:.1} s"))
            }
            Event::BrickRestarted { robot } => {
                let robot = robot_name(*robot);
                (WARNING, format!("{robot} was restarted: clock and counters re-based"))
            }
            Event::Link { link, state } => {
                let name = self.setting.link_name(*link);
                match state {
                    LinkState::Up => (NOTICE, format!("link {name} is up")),
                    LinkState::Down => (WARNING, format!("link {name} is down")),
                }
            }
            Event::Text { source, severity, text } => (*severity, said(*source, text)),
            Event::Observed { .. }
            | Event::Fused { .. }
            | Event::Estimated { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Health { .. }
            | Event::Defect { .. } => return None,
        })
    }
}

fn said(source: Address, text: &str) -> String {
    let mut end = text.len().min(LONGEST_LINE);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    format!("{source}: {}", &text[..end])
}

impl View for Log {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        if let Some(repeated) = self.repeats.due(now) {
            self.push(now, self.severity, repeated);
        }
        let Told::Event(event) = told else {
            return;
        };
        let Some((severity, text)) = self.line_of(event) else {
            return;
        };
        let shown = self.repeats.take(now, &text);
        if let Some(repeated) = shown.before {
            self.push(now, self.severity, repeated);
        }
        if shown.is_shown {
            self.push(now, severity, text);
            self.severity = severity;
        }
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        frame.log = self.trail.take_news();
    }

    fn add_history(&self, history: &mut Frame) {
        history.log = self.trail.kept();
    }

    fn dropped(&self) -> u64 {
        self.trail.dropped()
    }
}

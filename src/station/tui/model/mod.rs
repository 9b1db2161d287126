//! All that the terminal view knows: made of the same messages as the page, and of what a person has chosen.
//!
//! A value without clock and terminal. Everything in it is bounded: trails by [`RecentPoints`], robots, sensors and lines by the constants
//! here.

mod recent;
mod robot;

use std::collections::{BTreeSet, VecDeque};

use posebridge_dashboard::model::{
    ClockRow, ErrorsRow, Frame, LinkRow, LogLine, RecordingNow, SimulatorFacts, TruthPoint,
};
use posebridge_telemetry::severity::NOTICE;

pub use recent::RecentPoints;
pub use robot::{Robot, SourceModel};

/// Most robots that are shown; a class has fewer.
const MAX_ROBOTS: usize = 64;
/// Most lines that are kept, as on the page.
const MAX_LINES: usize = 300;
/// What was done is shown for so long, to be read in passing.
const NOTICE_DURATION_S: f64 = 5.0;

/// What is known, and what is chosen.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// The simulated brick, if the station has one of its own.
    pub simulator: Option<SimulatorFacts>,
    /// The session's time, in seconds.
    pub now_s: f64,
    /// Every robot that was heard.
    pub robots: Vec<Robot>,
    /// Where the only simulated robot really was.
    truth: RecentPoints<TruthPoint>,
    /// How far odometry and estimate of the first simulated robot are from the truth.
    errors: Option<ErrorsRow>,
    /// All links.
    pub links: Vec<LinkRow>,
    /// The alignment of the robot's clock.
    pub clock: Option<ClockRow>,
    /// The recording that is being written.
    pub recording: Option<RecordingNow>,
    /// Lines for people, oldest first.
    pub log: VecDeque<LogLine>,
    /// Messages that this view has missed because the terminal was slow.
    pub missed: u64,
    /// What is chosen.
    pub selection: Selection,
}

/// What a person has chosen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Which of [`Model::visible_robots`] robots.
    pub robot: usize,
    /// Which panel has the whole screen; `None` for all of them together.
    pub panel: Option<usize>,
    /// Whether the keys are explained.
    pub has_help: bool,
    /// The robots whose simulated cameras were covered from here.
    pub covered_cameras: BTreeSet<String>,
    /// What was done last, and when.
    pub notice: Option<(f64, &'static str)>,
}

impl Model {
    /// Before anything has happened.
    pub fn new(simulator: Option<SimulatorFacts>) -> Self {
        Self { simulator, ..Self::default() }
    }

    /// Takes a message.
    pub fn on_frame(&mut self, frame: &Frame) {
        self.now_s = self.now_s.max(frame.now_s);
        for part in &frame.robots {
            if let Some(robot) = self.robot(&part.id) {
                robot.on_frame(part);
            }
        }
        for point in &frame.truth {
            let truth = match &point.robot {
                None => Some(&mut self.truth),
                Some(id) => self.robot(id).map(|robot| &mut robot.truth),
            };
            if let Some(truth) = truth {
                truth.push(point.t_s, point.clone());
            }
        }
        if let Some(errors) = &frame.errors {
            self.errors = Some(errors.clone());
        }
        if let Some(links) = &frame.links {
            self.links.clone_from(links);
        }
        if let Some(clock) = &frame.clock {
            self.clock = Some(clock.clone());
        }
        if let Some(recording) = &frame.recording {
            self.recording.clone_from(recording);
        }
        for line in &frame.log {
            self.add_line(line.clone());
        }
    }

    /// Takes a line that the program says.
    pub fn push_message(&mut self, line: &str) {
        let t_s = self.now_s;
        for text in line.lines() {
            self.add_line(LogLine { t_s, severity: NOTICE, text: text.to_owned() });
        }
    }

    /// Notes what was done.
    pub const fn set_notice(&mut self, what: &'static str) {
        self.selection.notice = Some((self.now_s, what));
    }

    /// What was done last, as long as it is new.
    pub fn notice(&self) -> Option<&'static str> {
        let (noted_s, what) = self.selection.notice?;
        (self.now_s - noted_s <= NOTICE_DURATION_S).then_some(what)
    }

    /// The robots to choose from: those with an estimate. A camera is heard as well but has none. Without any, all.
    pub fn visible_robots(&self) -> Vec<&Robot> {
        let estimated: Vec<&Robot> = self.robots.iter().filter(|robot| !robot.estimates.is_empty()).collect();
        if estimated.is_empty() { self.robots.iter().collect() } else { estimated }
    }

    /// The chosen robot.
    pub fn selected_robot(&self) -> Option<&Robot> {
        let shown = self.visible_robots();
        let last = shown.len().checked_sub(1)?;
        shown.get(self.selection.robot.min(last)).copied()
    }

    /// Where the chosen robot really was, if it is simulated.
    pub fn selected_truth(&self) -> Option<&RecentPoints<TruthPoint>> {
        let own = self.selected_robot().map(|robot| &robot.truth).filter(|truth| !truth.is_empty());
        own.or_else(|| (self.visible_robots().len() <= 1).then_some(&self.truth))
    }

    /// How far odometry and estimate of the chosen robot are from its truth.
    pub fn selected_errors(&self) -> Option<&ErrorsRow> {
        let own = self.selected_robot().and_then(|robot| robot.errors.as_ref());
        own.or_else(|| self.errors.as_ref().filter(|_| self.visible_robots().len() <= 1))
    }

    fn robot(&mut self, id: &str) -> Option<&mut Robot> {
        let known = self.robots.iter().position(|robot| robot.id == id);
        let index = match known {
            Some(index) => index,
            None if self.robots.len() >= MAX_ROBOTS => return None,
            None => {
                self.robots.push(Robot::new(id));
                self.robots.len() - 1
            }
        };
        self.robots.get_mut(index)
    }

    fn add_line(&mut self, line: LogLine) {
        if self.log.len() >= MAX_LINES {
            self.log.pop_front();
        }
        self.log.push_back(line);
    }
}

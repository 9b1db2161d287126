//! State of the terminal view: built from the messages of the page and the user's selection.
//!
//! It has no clock and no terminal. Everything in it is bounded: trails by [`RecentPoints`], robots, sensors and lines by the constants
//! here.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use posebridge_dashboard::model::{
    CalibrationRow, ClockRow, ComparedPoint, ComparisonRow, ErrorsRow, EstimatePoint, FixPoint, FleetState, Frame,
    FusionPoint, LinkRow, LogLine, QuantityPoint, RecordingNow, RobotFrame, SetupRow, SimulatorFacts, TruthPoint, Word,
};
use posebridge_telemetry::severity::NOTICE;

/// A class has fewer.
const MAX_ROBOTS: usize = 64;
/// As on the page.
const MAX_FILTERS: usize = 16;
/// As on the page.
const MAX_LINES: usize = 300;
const NOTICE_DURATION_S: f64 = 5.0;
/// As on the page.
const FLEET_PERIOD_S: f64 = 1.0;

#[derive(Clone, Debug, Default)]
pub struct Model {
    /// `None` without an embedded simulated brick.
    pub simulator: Option<SimulatorFacts>,
    pub now_s: f64,
    pub robots: Vec<Robot>,
    /// Of the only simulated robot.
    truth: RecentPoints<TruthPoint>,
    errors: Option<ErrorsRow>,
    pub links: Vec<LinkRow>,
    setup: Vec<SetupRow>,
    pub clock: Option<ClockRow>,
    pub recording: Option<RecordingNow>,
    /// The fleet and when it was looked at; `None` for a station that is in none.
    fleet: Option<(f64, FleetState)>,
    /// Oldest first.
    pub log: VecDeque<LogLine>,
    /// Messages missed because the terminal was slow.
    pub missed: u64,
    pub selection: Selection,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// Index into [`Model::visible_robots`].
    pub robot: usize,
    /// The panel shown on the whole screen; `None` for all.
    pub panel: Option<usize>,
    pub has_help: bool,
    /// Robots whose simulated cameras were covered from this view.
    pub covered_cameras: BTreeSet<String>,
    pub notice: Option<(f64, &'static str)>,
    /// What was typed of a pose so far; `None` while none is typed.
    pub typed_pose: Option<String>,
}

impl Model {
    pub fn new(simulator: Option<SimulatorFacts>) -> Self {
        Self { simulator, ..Self::default() }
    }

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
        if let Some(setup) = &frame.setup {
            self.setup.clone_from(setup);
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

    /// Whether what is known of the fleet is old.
    pub fn is_fleet_due(&self) -> bool {
        self.fleet.as_ref().is_none_or(|(looked_s, _)| self.now_s - looked_s >= FLEET_PERIOD_S)
    }

    pub fn set_fleet(&mut self, fleet: FleetState) {
        self.fleet = Some((self.now_s, fleet));
    }

    pub fn fleet(&self) -> Option<&FleetState> {
        self.fleet.as_ref().map(|(_, fleet)| fleet)
    }

    pub fn push_message(&mut self, line: &str) {
        let t_s = self.now_s;
        for text in line.lines() {
            self.add_line(LogLine { t_s, severity: NOTICE, text: text.to_owned() });
        }
    }

    pub const fn set_notice(&mut self, what: &'static str) {
        self.selection.notice = Some((self.now_s, what));
    }

    pub fn notice(&self) -> Option<&'static str> {
        let (noted_s, what) = self.selection.notice?;
        (self.now_s - noted_s <= NOTICE_DURATION_S).then_some(what)
    }

    /// Robots for selection: those with an estimate, which excludes cameras. All, if none has one.
    pub fn visible_robots(&self) -> Vec<&Robot> {
        let is_estimated = |robot: &&Robot| !robot.estimates.is_empty() || robot.quantity.is_some();
        let estimated: Vec<&Robot> = self.robots.iter().filter(is_estimated).collect();
        if estimated.is_empty() { self.robots.iter().collect() } else { estimated }
    }

    pub fn selected_robot(&self) -> Option<&Robot> {
        let shown = self.visible_robots();
        let last = shown.len().checked_sub(1)?;
        shown.get(self.selection.robot.min(last)).copied()
    }

    /// The steps of the selected robot, or of the one that has not been heard yet; none once they are complete, and with a simulator.
    pub fn setup_rows(&self) -> Vec<&SetupRow> {
        let robot = self.selected_robot().map_or("", |robot| robot.id.as_str());
        let rows_of = |id: &str| -> Vec<&SetupRow> { self.setup.iter().filter(|row| row.robot == id).collect() };
        let own = rows_of(robot);
        let rows = if own.is_empty() { rows_of("") } else { own };
        let is_complete = rows.iter().all(|row| matches!(row.state.as_str(), "ok" | "optional"));
        if is_complete || self.simulator.is_some() { Vec::new() } else { rows }
    }

    pub fn selected_truth(&self) -> Option<&RecentPoints<TruthPoint>> {
        let own = self.selected_robot().map(|robot| &robot.truth).filter(|truth| !truth.is_empty());
        own.or_else(|| (self.visible_robots().len() <= 1).then_some(&self.truth))
    }

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

/// Bounds the sensors of a robot, which has a handful.
const MAX_SOURCES: usize = 32;

#[derive(Clone, Debug, Default)]
pub struct Robot {
    pub id: String,
    pub name: Option<String>,
    pub estimates: RecentPoints<EstimatePoint>,
    /// The last estimate of a filter of one quantity.
    pub quantity: Option<QuantityPoint>,
    /// What became of its last reading.
    pub reading_verdict: Word,
    pub fixes: RecentPoints<FixPoint>,
    /// Empty unless it is one of several simulated robots.
    pub truth: RecentPoints<TruthPoint>,
    pub errors: Option<ErrorsRow>,
    /// Positions of the filters that run beside the one that sends, by filter.
    pub compared: BTreeMap<String, RecentPoints<ComparedPoint>>,
    /// All filters, the one that sends first; empty while none are compared.
    pub comparison: Vec<ComparisonRow>,
    pub sources: BTreeMap<Word, SourceModel>,
    pub calibration: Vec<CalibrationRow>,
}

#[derive(Clone, Debug, Default)]
pub struct SourceModel {
    pub count: u64,
    pub gated: u64,
    /// Mean NIS per degree of freedom of the latest; `None` where nothing was predicted.
    pub nis: Option<f64>,
    /// What the latest say of the filter.
    pub consistency: Word,
    pub last_verdict: Word,
}

impl Robot {
    pub(super) fn new(id: &str) -> Self {
        Self { id: id.to_owned(), ..Self::default() }
    }

    /// The name, else the id.
    pub fn label(&self) -> &str {
        self.name.as_deref().unwrap_or(&self.id)
    }

    pub(super) fn on_frame(&mut self, part: &RobotFrame) {
        if part.name.is_some() {
            self.name.clone_from(&part.name);
        }
        if part.errors.is_some() {
            self.errors.clone_from(&part.errors);
        }
        for estimate in &part.estimates {
            self.estimates.push(estimate.t_s, estimate.clone());
        }
        for point in part.quantities.iter().filter(|point| point.name.is_empty()) {
            if !point.verdict.is_empty() {
                self.reading_verdict.clone_from(&point.verdict);
            }
            self.quantity = Some(point.clone());
        }
        for fix in &part.fixes {
            self.fixes.push(fix.t_s, fix.clone());
        }
        for point in &part.compared {
            if self.compared.contains_key(&point.filter) || self.compared.len() < MAX_FILTERS {
                self.compared.entry(point.filter.clone()).or_default().push(point.t_s, point.clone());
            }
        }
        if !part.comparison.is_empty() {
            self.comparison.clone_from(&part.comparison);
        }
        for record in &part.fusion {
            self.on_fusion(record);
        }
        for tally in part.tallies.iter().filter(|tally| tally.nis.get().is_some()) {
            if let Some(source) = self.sources.get_mut(&tally.sensor) {
                source.nis = tally.nis.get();
                source.consistency.clone_from(&tally.consistency);
            }
        }
        if let Some(calibration) = &part.calibration {
            // A history has one row a second for each; the last one counts.
            for row in calibration {
                match self.calibration.iter_mut().find(|kept| kept.name == row.name) {
                    Some(kept) => kept.clone_from(row),
                    None => self.calibration.push(row.clone()),
                }
            }
        }
    }

    fn on_fusion(&mut self, record: &FusionPoint) {
        let is_known = self.sources.contains_key(&record.sensor);
        if !is_known && self.sources.len() >= MAX_SOURCES {
            return;
        }
        let source = self.sources.entry(record.sensor.clone()).or_default();
        source.count += 1;
        source.last_verdict.clone_from(&record.verdict);
        source.gated += u64::from(record.verdict == "gated");
    }
}

/// Duration of trails, as on the page.
const WINDOW_S: f64 = 60.0;
/// 80 s at the 50 Hz of a station.
const MAX_POINTS: usize = 4_096;

/// The latest points, oldest first.
#[derive(Clone, Debug)]
pub struct RecentPoints<T> {
    points: VecDeque<(f64, T)>,
}

impl<T> Default for RecentPoints<T> {
    fn default() -> Self {
        Self { points: VecDeque::new() }
    }
}

impl<T> RecentPoints<T> {
    /// `t_s` is session time.
    pub fn push(&mut self, t_s: f64, point: T) {
        self.points.push_back((t_s, point));
        while self.points.len() > MAX_POINTS
            || self.points.front().is_some_and(|(oldest_s, _)| t_s - oldest_s > WINDOW_S)
        {
            self.points.pop_front();
        }
    }

    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        self.points.iter().map(|(_, point)| point)
    }

    pub fn last(&self) -> Option<&T> {
        self.points.back().map(|(_, point)| point)
    }

    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_as_old_as_a_minute_and_not_more_than_agreed() {
        let mut recent = RecentPoints::default();
        for second in 0..100 {
            recent.push(f64::from(second), second);
        }
        assert_eq!(recent.iter().copied().collect::<Vec<_>>(), (39..100).collect::<Vec<_>>());
        for _ in 0..10_000 {
            recent.push(100.0, 7);
        }
        assert_eq!(recent.iter().count(), MAX_POINTS);
        assert_eq!(recent.last(), Some(&7));
    }
}

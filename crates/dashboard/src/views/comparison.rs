//! The filters that run beside the one that sends: their paths, their errors and their NIS.

use std::collections::VecDeque;

use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Event, FusionOutcome, FusionRecord, HostClock, Point2, RobotId, Timestamp,
};

use super::retained_series::{BoundedMap, MAX_ROBOTS, PointPriority, RetainedSeriesMap, SeriesView};
use super::truth_samples::{SampleOrder, TruthSamples};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::feed::SimulatedTruth;
use crate::model::{ComparedPoint, ComparisonRow, Frame, seconds_of};

/// Divisor of the history for the path of one filter: all together should remain a small message.
const PATH_SHARE: usize = 4;
/// Filters of one robot; there are ten of a pose.
const MAX_FILTERS: usize = 16;
/// Estimates that wait for the truth after their instant, which comes within 50 ms; of all filters.
const MAX_WAITING: usize = 32 * MAX_FILTERS;

/// Positions of the compared filters, for the map.
pub(super) fn compared_paths(config: &ViewConfig) -> SeriesView<(), &'static str, ComparedPoint> {
    SeriesView {
        state: (),
        points: RetainedSeriesMap::new(
            config.retention.map_points(|points| points / PATH_SHARE),
            MAX_FILTERS * MAX_ROBOTS,
        ),
        observe: |(), now, event| {
            let Event::EstimateCompared { robot, filter, estimate } = event else {
                return None;
            };
            let point = ComparedPoint {
                t_s: seconds_of(now),
                filter: (*filter).to_owned(),
                x_m: estimate.pose.x.0.into(),
                y_m: estimate.pose.y.0.into(),
                is_relative: estimate.is_relative(),
            };
            Some(((*robot, *filter), point, PointPriority::Normal))
        },
        write: |frame, points| frame.compared.extend(points),
    }
}

/// The filters of each robot side by side, since the comparison began.
#[derive(Default)]
pub(super) struct Comparison {
    robots: BoundedMap<RobotId, RobotComparison>,
    /// Samples of a single simulated brick name no robot: they are of the first one.
    first: Option<RobotId>,
    is_on: bool,
}

struct RobotComparison {
    /// The first is the one that sends.
    filters: Vec<FilterComparison>,
    truth: TruthSamples,
    /// Estimates of instants after the last sample of the truth, oldest first.
    waiting: VecDeque<WaitingEstimate>,
}

struct FilterComparison {
    /// Empty for the one that sends.
    name: &'static str,
    last: Option<Estimate>,
    error_m: f64,
    squares_m2: f64,
    compared_with_truth: u64,
    nis_sum: f64,
    degrees_of_freedom: u64,
    used: u64,
    gated: u64,
}

struct WaitingEstimate {
    filter: usize,
    time: Timestamp<BrickClock>,
    position: Point2<Arena>,
}

const SENDING: &str = "";

impl RobotComparison {
    fn new() -> Self {
        Self { filters: vec![FilterComparison::new(SENDING)], truth: TruthSamples::new(), waiting: VecDeque::new() }
    }

    fn filter(&mut self, name: &'static str) -> Option<usize> {
        let known = self.filters.iter().position(|filter| filter.name == name);
        if known.is_none() && self.filters.len() < MAX_FILTERS {
            self.filters.push(FilterComparison::new(name));
            return Some(self.filters.len() - 1);
        }
        known
    }

    fn push_estimate(&mut self, name: &'static str, estimate: &Estimate) {
        let Some(filter) = self.filter(name).filter(|_| estimate.validity.position) else {
            return;
        };
        self.filters[filter].last = Some(*estimate);
        let waiting = WaitingEstimate { filter, time: estimate.stamp, position: estimate.pose.origin() };
        if self.truth.latest().is_some_and(|latest| waiting.time <= latest) {
            self.compare(&waiting);
        } else {
            if self.waiting.len() >= MAX_WAITING {
                self.waiting.pop_front();
            }
            self.waiting.push_back(waiting);
        }
    }

    fn push_record(&mut self, name: &'static str, record: &FusionRecord) {
        if let Some(filter) = self.filter(name) {
            self.filters[filter].push_record(record);
        }
    }

    fn push_truth(&mut self, sample: &SimulatedTruth) {
        match self.truth.push(sample) {
            SampleOrder::Repeated => return,
            SampleOrder::Restarted => self.waiting.clear(),
            SampleOrder::Later => {}
        }
        while self.waiting.front().is_some_and(|estimate| estimate.time <= sample.time) {
            if let Some(estimate) = self.waiting.pop_front() {
                self.compare(&estimate);
            }
        }
    }

    fn compare(&mut self, estimate: &WaitingEstimate) {
        let Some((truth, _)) = self.truth.at(estimate.time) else {
            return;
        };
        let error_m = estimate.position.distance(truth).0;
        let filter = &mut self.filters[estimate.filter];
        filter.error_m = error_m;
        filter.squares_m2 += error_m.powi(2);
        filter.compared_with_truth += 1;
    }

    fn rows(&self) -> Vec<ComparisonRow> {
        // The one that sends is always there.
        if self.filters.len() < 2 {
            return Vec::new();
        }
        let sent = self.filters.first().and_then(|filter| filter.last);
        self.filters.iter().map(|filter| filter.row(sent.as_ref())).collect()
    }
}

impl FilterComparison {
    const fn new(name: &'static str) -> Self {
        Self {
            name,
            last: None,
            error_m: f64::NAN,
            squares_m2: 0.0,
            compared_with_truth: 0,
            nis_sum: 0.0,
            degrees_of_freedom: 0,
            used: 0,
            gated: 0,
        }
    }

    fn push_record(&mut self, record: &FusionRecord) {
        self.gated += u64::from(record.outcome == FusionOutcome::Gated);
        self.used += u64::from(matches!(record.outcome, FusionOutcome::Accepted | FusionOutcome::Slip));
        if record.degrees_of_freedom > 0 && record.nis.is_finite() {
            self.nis_sum += record.nis;
            self.degrees_of_freedom += u64::from(record.degrees_of_freedom);
        }
    }

    fn row(&self, sent: Option<&Estimate>) -> ComparisonRow {
        let ratio = |sum: f64, count: u64| if count == 0 { f64::NAN } else { sum / count as f64 };
        let apart_m =
            self.last.zip(sent).map_or(f64::NAN, |(own, sent)| own.pose.origin().distance(sent.pose.origin()).0);
        ComparisonRow {
            filter: self.name.to_owned(),
            error_m: self.error_m.into(),
            error_rms_m: ratio(self.squares_m2, self.compared_with_truth).sqrt().into(),
            apart_m: apart_m.into(),
            major_m: self
                .last
                .and_then(|last| last.ellipse_95())
                .map_or(f64::NAN, |ellipse| ellipse.semi_major_m)
                .into(),
            nis: ratio(self.nis_sum, self.degrees_of_freedom).into(),
            used: self.used,
            gated: self.gated,
        }
    }
}

impl Comparison {
    fn robot(&mut self, robot: RobotId) -> Option<&mut RobotComparison> {
        self.robots.get_or_insert(robot, RobotComparison::new)
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    fn on_event(&mut self, event: &Event) {
        match event {
            Event::EstimateCompared { robot, filter, estimate } => {
                if let Some(robot) = self.robot(*robot) {
                    robot.push_estimate(filter, estimate);
                }
            }
            Event::ObservationCompared { robot, filter, record } => {
                if let Some(robot) = self.robot(*robot) {
                    robot.push_record(filter, record);
                }
            }
            Event::EstimateUpdated { robot, estimate } => {
                self.first.get_or_insert(*robot);
                // Counted while there is something to compare it with, so that all have the same share of the drive.
                if let Some(robot) = self.robots.entries.get_mut(robot) {
                    robot.push_estimate(SENDING, estimate);
                }
            }
            Event::ObservationFused { robot, record } => {
                if let Some(robot) = self.robots.entries.get_mut(robot) {
                    robot.push_record(SENDING, record);
                }
            }
            _ => {}
        }
    }

    fn add_rows(&self, frame: &mut Frame) {
        for (robot, comparison) in &self.robots.entries {
            let rows = comparison.rows();
            if !rows.is_empty() {
                frame.robot(&robot_name(*robot)).comparison = rows;
            }
        }
    }
}

impl View for Comparison {
    fn observe(&mut self, _now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(event) => self.on_event(event),
            ViewInput::Truth(sample) => {
                let robot = sample.robot.or(self.first);
                if let Some(robot) = robot.and_then(|robot| self.robots.entries.get_mut(&robot)) {
                    robot.push_truth(sample);
                }
            }
            ViewInput::Status(status) => {
                // A new comparison begins with empty sums.
                if status.is_comparing != self.is_on {
                    self.is_on = status.is_comparing;
                    if !self.is_on {
                        self.robots.entries.clear();
                    }
                }
            }
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        if content == FrameContent::DeltaAndSummary {
            self.add_rows(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        self.add_rows(history);
    }

    fn dropped(&self) -> u64 {
        self.robots.ignored
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Meters, Pose};

    use super::super::tests::{at, estimate, estimated_event, history, robot, truth, updates, view};
    use super::*;
    use crate::feed::StationStatus;

    fn compared(filter: &'static str, x_m: f64) -> Event {
        let estimate = estimate();
        let pose = Pose::new(Meters(x_m), estimate.pose.y, estimate.pose.heading);
        Event::EstimateCompared { robot: robot(), filter, estimate: Estimate { pose, ..estimate } }
    }

    fn record(filter: &'static str, outcome: FusionOutcome, nis: f64) -> Event {
        let Event::ObservationFused { robot, record } = super::super::tests::fused_event(outcome, 2) else {
            unreachable!("it is one");
        };
        Event::ObservationCompared { robot, filter, record: FusionRecord { nis, ..record } }
    }

    #[test]
    fn each_filter_has_its_errors_to_the_truth_and_to_the_one_that_sends() {
        let mut view = view("comparison");
        let events = [
            compared("odometry", 1.6),
            estimated_event(&estimate()),
            record("odometry", FusionOutcome::Gated, 9.0),
            record("odometry", FusionOutcome::Accepted, 3.0),
        ];
        view.observe(at(960), ViewInput::Truth(&truth(None, 4_960, 1.46)));
        for event in &events {
            view.observe(at(1_000), ViewInput::Event(event));
        }
        // The robot was at 1.5 m, 3 cm beside the estimates, as the next two samples tell.
        for sample in [truth(None, 4_960, 1.46), truth(None, 5_040, 1.54)] {
            view.observe(at(1_040), ViewInput::Truth(&sample));
        }
        view.observe(at(1_050), ViewInput::Event(&compared("odometry", 1.5)));
        let rows = updates(&mut *view, FrameContent::DeltaAndSummary).robots[0].comparison.clone();
        let names: Vec<&str> = rows.iter().map(|row| row.filter.as_str()).collect();
        assert_eq!(names, ["", "odometry"]);
        let near = |number: crate::model::Number, expected: f64| {
            let value = number.get().unwrap();
            assert!((value - expected).abs() < 1e-6, "{value} {expected}");
        };
        near(rows[0].error_m, 0.03);
        near(rows[1].error_m, 0.03);
        let far_m2 = 0.1_f64.powi(2) + 0.03_f64.powi(2);
        near(rows[1].error_rms_m, f64::midpoint(far_m2, 0.03_f64.powi(2)).sqrt());
        near(rows[1].apart_m, 0.0);
        near(rows[1].nis, 3.0);
        assert_eq!((rows[1].used, rows[1].gated), (1, 1));
        assert_eq!(rows[0].nis.get(), None, "it has observed nothing");
    }

    #[test]
    fn without_a_comparison_there_are_no_rows_and_a_new_one_begins_with_nothing() {
        let mut view = view("comparison");
        view.observe(at(0), ViewInput::Event(&estimated_event(&estimate())));
        assert!(history(&*view).robots.is_empty());
        let comparing = |is_comparing| StationStatus { is_comparing, ..StationStatus::default() };
        view.observe(at(0), ViewInput::Event(&compared("ekf5", 1.0)));
        view.observe(at(10), ViewInput::Status(&comparing(true)));
        assert_eq!(history(&*view).robots[0].comparison.len(), 2);
        view.observe(at(20), ViewInput::Status(&comparing(false)));
        assert!(history(&*view).robots.is_empty());
    }

    #[test]
    fn paths_are_kept_apart_by_filter() {
        let mut view = view("compared paths");
        for (millis, event) in
            [(0, compared("ekf5", 1.0)), (0, compared("odometry", 2.0)), (300, compared("ekf5", 1.5))]
        {
            view.observe(at(millis), ViewInput::Event(&event));
        }
        let points = &history(&*view).robots[0].compared;
        let of = |name: &str| -> Vec<_> {
            points.iter().filter(|point| point.filter == name).filter_map(|point| point.x_m.get()).collect()
        };
        assert_eq!((of("ekf5"), of("odometry")), (vec![1.0, 1.5], vec![2.0]));
    }
}

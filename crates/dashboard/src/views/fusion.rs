//! The outcome of each observation: innovations and NIS of each source.
//!
//! Records with a NIS and those without are thinned separately: of the wheels one in four has one, and thinning both
//! together by halves would leave none of those.

use posebridge_telemetry::{Event, FusionRecord, HostClock, SensorId, Timestamp};

use super::fixes::priority_of;
use super::retained_series::RetentionPolicy;
use super::retained_series::{MAX_ROBOTS, RetainedSeriesMap};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::{Frame, FusionPoint, Number, seconds_of};

/// The share of the history for one source: a robot has about four, and all together should remain a small message.
const POINT_SHARE: usize = 3;
/// Sources are separate, so that a slow one is not displaced; each with a NIS and without.
const MAX_SOURCES: usize = 2 * 4 * MAX_ROBOTS;

pub(super) struct Fusion {
    series: RetainedSeriesMap<(SensorId, &'static str, bool), FusionPoint>,
}

impl Fusion {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        let keep = match setting.retention {
            RetentionPolicy::SlidingWindow { duration: span, max_points: most } => {
                RetentionPolicy::SlidingWindow { duration: span, max_points: most / POINT_SHARE }
            }
            RetentionPolicy::WholeSession { max_points: most } => {
                RetentionPolicy::WholeSession { max_points: most / POINT_SHARE }
            }
        };
        Self { series: RetainedSeriesMap::new(keep, MAX_SOURCES) }
    }
}

impl View for Fusion {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        let ViewInput::Event(Event::ObservationFused { robot, record }) = input else {
            return;
        };
        let has_nis = record.degrees_of_freedom > 0;
        let source = (record.sensor, record.kind, has_nis);
        let priority = priority_of(record.outcome);
        self.series.push(now, (*robot, source), point_of(now, record), priority);
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        for (robot, points) in self.series.take_pending() {
            frame.robot(&robot_name(robot)).fusion.extend(points);
        }
        sort_points(frame);
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.series.retained() {
            history.robot(&robot_name(robot)).fusion.extend(points);
        }
        sort_points(history);
    }

    fn dropped(&self) -> u64 {
        self.series.dropped()
    }
}

/// Sorts the records of all series by time.
fn sort_points(frame: &mut Frame) {
    for robot in &mut frame.robots {
        robot.fusion.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    }
}

fn point_of(now: Timestamp<HostClock>, record: &FusionRecord) -> FusionPoint {
    let used = usize::from(record.degrees_of_freedom).min(record.innovation.len());
    let innovation = record.innovation.iter().take(used);
    let variances = (0..used).map(|index| record.innovation_covariance[index][index]);
    let nis = if used == 0 { f64::NAN } else { record.nis };
    FusionPoint {
        t_s: seconds_of(now),
        sensor: record.sensor.name().to_owned(),
        kind: record.kind.to_owned(),
        verdict: record.outcome.reason().to_owned(),
        lag_s: record.lag.as_secs_f64().into(),
        nis: nis.into(),
        dof: record.degrees_of_freedom,
        innovation: innovation.map(|value| Number::from(*value)).collect(),
        sigma: variances.map(|value| Number::from(value.sqrt())).collect(),
    }
}

//! What became of each observation: innovations and NIS of each source.
//!
//! Records with a NIS and those without are thinned apart: of wheels one in four has one, and thinning both together by halves would
//! leave none of those.

use posebridge_telemetry::{Event, FusionRecord, HostClock, SensorId, Stamp};

use super::fixes::weight_of;
use super::trail::{MOST_ROBOTS, Trails};
use super::{Keep, Pace, Setting, Told, View, robot_name};
use crate::model::{Frame, FusionPoint, Number, seconds_of};

/// The share of the history that one source has: a robot has about four, and all together should stay a small message.
const SHARE: usize = 3;
/// Sources are kept apart, so that one that speaks seldom is not crowded out; each with a NIS and without.
const MOST_SOURCES: usize = 2 * 4 * MOST_ROBOTS;

/// The records of each source.
pub(super) struct Fusion {
    trails: Trails<(SensorId, &'static str, bool), FusionPoint>,
}

impl Fusion {
    pub(super) fn new(setting: &Setting) -> Self {
        let keep = match setting.keep {
            Keep::Latest { span, most } => Keep::Latest { span, most: most / SHARE },
            Keep::Whole { most } => Keep::Whole { most: most / SHARE },
        };
        Self { trails: Trails::new(keep, MOST_SOURCES) }
    }
}

impl View for Fusion {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        let Told::Event(Event::Fused { robot, record }) = told else {
            return;
        };
        let has_nis = record.degrees_of_freedom > 0;
        let source = (record.sensor, record.kind, has_nis);
        let point = (point_of(now, record), weight_of(record.verdict));
        self.trails.push(now, (*robot, source), point);
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        for (robot, points) in self.trails.take_news() {
            frame.robot(&robot_name(robot)).fusion.extend(points);
        }
        sort(frame);
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.trails.kept() {
            history.robot(&robot_name(robot)).fusion.extend(points);
        }
        sort(history);
    }

    fn dropped(&self) -> u64 {
        self.trails.dropped()
    }
}

/// Puts the records of all trails into the order in which they came.
fn sort(frame: &mut Frame) {
    for robot in &mut frame.robots {
        robot.fusion.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    }
}

fn point_of(now: Stamp<HostClock>, record: &FusionRecord) -> FusionPoint {
    let used = usize::from(record.degrees_of_freedom).min(record.innovation.len());
    let innovation = record.innovation.iter().take(used);
    let variances = (0..used).map(|index| record.innovation_covariance[index][index]);
    let nis = if used == 0 { f64::NAN } else { record.nis };
    FusionPoint {
        t_s: seconds_of(now),
        sensor: record.sensor.name().to_owned(),
        kind: record.kind.to_owned(),
        verdict: record.verdict.reason().to_owned(),
        lag_s: record.lag.as_secs_f64().into(),
        nis: nis.into(),
        dof: record.degrees_of_freedom,
        innovation: innovation.map(|value| Number::from(*value)).collect(),
        sigma: variances.map(|value| Number::from(value.sqrt())).collect(),
    }
}

//! Camera fixes with what became of them: the map's marks.
//!
//! Where a fix was stands in the observation, what became of it in the record that follows.

use std::collections::VecDeque;

use posebridge_telemetry::{Event, Fix, Heading, HostClock, Observed, RobotId, SensorId, Stamp, Verdict};

use super::trail::{MOST_ROBOTS, Trails, Weight};
use super::{Pace, Setting, Told, View, robot_name};
use crate::model::{FixPoint, Frame, seconds_of};

/// So many fixes wait for their records; the record follows at once, but a late fix may revise others first.
const MOST_OPEN: usize = 16;

/// The fixes of each robot.
pub(super) struct Fixes {
    trails: Trails<(), FixPoint>,
    open: VecDeque<(RobotId, SensorId, Fix)>,
}

impl Fixes {
    pub(super) fn new(setting: &Setting) -> Self {
        Self { trails: Trails::new(setting.keep, MOST_ROBOTS), open: VecDeque::new() }
    }

    /// The oldest fix of this sensor whose record has not come.
    fn close(&mut self, robot: RobotId, sensor: SensorId) -> Option<Fix> {
        let is_it = |open: &(RobotId, SensorId, Fix)| (open.0, open.1) == (robot, sensor);
        let index = self.open.iter().position(is_it)?;
        self.open.remove(index).map(|(_, _, fix)| fix)
    }
}

impl View for Fixes {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        match told {
            Told::Event(Event::Observed { robot, observation, .. }) => {
                if let Observed::Fix(fix) = observation.observed {
                    if self.open.len() >= MOST_OPEN {
                        self.open.pop_front();
                    }
                    self.open.push_back((*robot, observation.sensor, fix));
                }
            }
            Told::Event(Event::Fused { robot, record }) if record.kind == "fix" => {
                let Some(fix) = self.close(*robot, record.sensor) else {
                    return;
                };
                let heading_rad = fix.heading.map_or(f64::NAN, Heading::rad);
                let point = FixPoint {
                    t_s: seconds_of(now),
                    x_m: fix.position.x.0.into(),
                    y_m: fix.position.y.0.into(),
                    heading_rad: heading_rad.into(),
                    sensor: record.sensor.name().to_owned(),
                    verdict: record.verdict.reason().to_owned(),
                    lag_s: record.lag.as_secs_f64().into(),
                };
                let weight = weight_of(record.verdict);
                self.trails.push(now, (*robot, ()), (point, weight));
            }
            Told::Event(_) | Told::Truth(_) | Told::Standing(_) => {}
        }
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        for (robot, points) in self.trails.take_news() {
            frame.robot(&robot_name(robot)).fixes = points;
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.trails.kept() {
            history.robot(&robot_name(robot)).fixes = points;
        }
    }

    fn dropped(&self) -> u64 {
        self.trails.dropped()
    }
}

/// What was used as foreseen is one of many; everything else is what people look for.
pub(super) fn weight_of(verdict: Verdict) -> Weight {
    if matches!(verdict, Verdict::Accepted | Verdict::Unused) { Weight::Usual } else { Weight::Rare }
}

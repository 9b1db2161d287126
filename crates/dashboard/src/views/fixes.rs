//! Camera fixes with their outcome: the map's marks.
//!
//! The position of a fix is in the observation, its outcome in the record that follows.

use std::collections::VecDeque;

use posebridge_telemetry::{
    Event, Fix, FusionOutcome, Heading, HostClock, ObservationKind, RobotId, SensorId, Timestamp,
};

use super::retained_series::{MAX_ROBOTS, PointPriority, RetainedSeriesMap};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::{FixPoint, Frame, seconds_of};

/// Most fixes that wait for their records; the record follows at once, but a late fix may revise others first.
const MAX_PENDING_FIXES: usize = 16;

pub(super) struct Fixes {
    series: RetainedSeriesMap<(), FixPoint>,
    pending: VecDeque<(RobotId, SensorId, Fix)>,
}

impl Fixes {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        Self { series: RetainedSeriesMap::new(setting.retention, MAX_ROBOTS), pending: VecDeque::new() }
    }

    /// The oldest fix of this sensor without a record.
    fn take_pending(&mut self, robot: RobotId, sensor: SensorId) -> Option<Fix> {
        let is_it = |open: &(RobotId, SensorId, Fix)| (open.0, open.1) == (robot, sensor);
        let index = self.pending.iter().position(is_it)?;
        self.pending.remove(index).map(|(_, _, fix)| fix)
    }
}

impl View for Fixes {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(Event::ObservationAligned { robot, observation, .. }) => {
                if let ObservationKind::Fix(fix) = observation.measurement {
                    if self.pending.len() >= MAX_PENDING_FIXES {
                        self.pending.pop_front();
                    }
                    self.pending.push_back((*robot, observation.sensor, fix));
                }
            }
            ViewInput::Event(Event::ObservationFused { robot, record }) if record.kind == "fix" => {
                let Some(fix) = self.take_pending(*robot, record.sensor) else {
                    return;
                };
                let heading_rad = fix.heading.map_or(f64::NAN, Heading::rad);
                let point = FixPoint {
                    t_s: seconds_of(now),
                    x_m: fix.position.x.0.into(),
                    y_m: fix.position.y.0.into(),
                    heading_rad: heading_rad.into(),
                    sensor: record.sensor.name().to_owned(),
                    verdict: record.outcome.reason().to_owned(),
                    lag_s: record.lag.as_secs_f64().into(),
                };
                let priority = priority_of(record.outcome);
                self.series.push(now, (*robot, ()), point, priority);
            }
            ViewInput::Event(_) | ViewInput::Truth(_) | ViewInput::Status(_) => {}
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        for (robot, points) in self.series.take_pending() {
            frame.robot(&robot_name(robot)).fixes = points;
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.series.retained() {
            history.robot(&robot_name(robot)).fixes = points;
        }
    }

    fn dropped(&self) -> u64 {
        self.series.dropped()
    }
}

/// Accepted and unused fixes are normal; people search for all others.
pub(super) fn priority_of(verdict: FusionOutcome) -> PointPriority {
    if matches!(verdict, FusionOutcome::Accepted | FusionOutcome::Unused) {
        PointPriority::Normal
    } else {
        PointPriority::Keep
    }
}

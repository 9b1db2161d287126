//! The list of robots with names and loss of contact, and their estimates. Every message with data of a robot has its id.

use posebridge_telemetry::{Ellipse, Estimate, Event, HostClock, RobotId, TimeDelta, Timestamp};

use super::retained_series::{BoundedMap, MAX_ROBOTS, PointPriority, RetainedSeriesMap, SeriesView};
use super::view::{View, ViewConfig, ViewInput, robot_name};
use crate::model::{EstimatePoint, Frame, Number, seconds_of};

/// In characters; shown beside the robot on a map.
const MAX_NAME_CHARS: usize = 60;

/// In the order of their first estimates.
#[derive(Default)]
pub(super) struct Robots {
    known: Vec<KnownRobot>,
    /// Names can arrive before the first estimate.
    names: BoundedMap<RobotId, String>,
    ignored: u64,
    has_changed: bool,
}

struct KnownRobot {
    robot: RobotId,
    /// Time of loss; `None` while messages arrive.
    lost: Option<Timestamp<HostClock>>,
}

impl Robots {
    fn on_estimate(&mut self, robot: RobotId) {
        if let Some(known) = self.known.iter_mut().find(|known| known.robot == robot) {
            known.lost = None;
            return;
        }
        if self.known.len() >= MAX_ROBOTS {
            self.ignored += 1;
            return;
        }
        self.known.push(KnownRobot { robot, lost: None });
        self.has_changed = true;
    }

    fn on_name(&mut self, robot: RobotId, name: &str) {
        if let Some(known) = self.names.get_or_insert(robot, String::new) {
            *known = name.chars().take(MAX_NAME_CHARS).collect();
            self.has_changed = true;
        }
    }

    fn on_loss(&mut self, now: Timestamp<HostClock>, robot: RobotId) {
        if let Some(known) = self.known.iter_mut().find(|known| known.robot == robot) {
            known.lost = Some(now);
            self.has_changed = true;
        }
    }
}

impl View for Robots {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            // Not every sender is a robot: cameras and ground stations send too.
            ViewInput::Event(Event::EstimateUpdated { robot, .. } | Event::QuantityUpdated { robot, .. }) => {
                self.on_estimate(*robot);
            }
            ViewInput::Event(Event::RobotNamed { robot, name }) => self.on_name(*robot, name),
            ViewInput::Event(Event::RobotLost { robot, .. }) => self.on_loss(now, *robot),
            ViewInput::Event(_) | ViewInput::Truth(_) | ViewInput::Status(_) => {}
        }
    }

    fn take_change(&mut self) -> bool {
        std::mem::take(&mut self.has_changed)
    }

    fn add_history(&self, history: &mut Frame) {
        for known in &self.known {
            let part = history.robot(&robot_name(known.robot));
            part.name = self.names.entries.get(&known.robot).cloned();
            part.lost_t_s = known.lost.map(seconds_of);
        }
    }

    fn dropped(&self) -> u64 {
        self.ignored + self.names.ignored
    }
}

/// Estimates with their ellipses, for the map.
pub(super) fn estimates(config: &ViewConfig) -> SeriesView<(), (), EstimatePoint> {
    SeriesView {
        state: (),
        points: RetainedSeriesMap::new(config.retention, MAX_ROBOTS),
        observe: |(), now, event| {
            let Event::EstimateUpdated { robot, estimate } = event else {
                return None;
            };
            Some(((*robot, ()), estimate_point(now, estimate), PointPriority::Normal))
        },
        write: |frame, points| frame.estimates = points,
    }
}

pub(super) fn estimate_point(now: Timestamp<HostClock>, estimate: &Estimate) -> EstimatePoint {
    let ellipse = estimate.ellipse_95();
    let of_ellipse = |read: fn(&Ellipse) -> f64| Number::from(ellipse.as_ref().map_or(f64::NAN, read));
    EstimatePoint {
        t_s: seconds_of(now),
        robot_s: estimate.stamp.as_secs_f64(),
        x_m: estimate.pose.x.0.into(),
        y_m: estimate.pose.y.0.into(),
        heading_rad: estimate.pose.heading.rad().into(),
        major_m: of_ellipse(|ellipse| ellipse.semi_major_m),
        minor_m: of_ellipse(|ellipse| ellipse.semi_minor_m),
        axis_rad: of_ellipse(|ellipse| ellipse.direction_rad),
        heading_sigma_rad: estimate.heading_sigma_rad().into(),
        forward_m_per_s: estimate.forward_speed.0.into(),
        turn_rad_per_s: estimate.turn_rate.0.into(),
        reset_counter: estimate.reset_counter,
        is_dead_reckoning: estimate.is_dead_reckoning,
        is_relative: estimate.is_relative(),
        is_heading_known: estimate.is_relative() || estimate.validity.heading,
        fix_age_s: estimate.fix_age.map_or(f64::NAN, TimeDelta::as_secs_f64).into(),
    }
}

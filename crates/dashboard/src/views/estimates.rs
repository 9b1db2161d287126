//! Estimates with their ellipse: the map's line and the robot on it.

use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{Ellipse, Estimate, Event, HostClock, Timestamp};

use super::retained_series::{MAX_ROBOTS, PointPriority, RetainedSeriesMap};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::model::{EstimatePoint, Frame, Number, seconds_of};

/// An ellipse of this many standard deviations holds 95 % of a normal distribution of two dimensions: sqrt(-2 ln
/// 0.05).
const ELLIPSE_SIGMAS: f64 = 2.447_746_830_680_816;

pub(super) struct Estimates {
    series: RetainedSeriesMap<(), EstimatePoint>,
}

impl Estimates {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        Self { series: RetainedSeriesMap::new(setting.retention, MAX_ROBOTS) }
    }
}

impl View for Estimates {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        let ViewInput::Event(Event::EstimateUpdated { robot, estimate }) = input else {
            return;
        };
        if estimate.validity.position && estimate.validity.heading {
            let point = point_of(now, estimate);
            self.series.push(now, (*robot, ()), point, PointPriority::Normal);
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        for (robot, points) in self.series.take_pending() {
            frame.robot(&robot_name(robot)).estimates = points;
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.series.retained() {
            history.robot(&robot_name(robot)).estimates = points;
        }
    }

    fn dropped(&self) -> u64 {
        self.series.dropped()
    }
}

/// An estimate as a point of the page.
pub(crate) fn point_of(now: Timestamp<HostClock>, estimate: &Estimate) -> EstimatePoint {
    let covariance = &estimate.covariance;
    let ellipse = Ellipse::from_covariance(
        covariance[row::X][row::X],
        covariance[row::X][row::Y],
        covariance[row::Y][row::Y],
        ELLIPSE_SIGMAS,
    );
    let of_ellipse = |read: fn(&Ellipse) -> f64| Number::from(ellipse.as_ref().map_or(f64::NAN, read));
    EstimatePoint {
        t_s: seconds_of(now),
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
        fix_age_s: estimate.fix_age.map_or(f64::NAN, posebridge_telemetry::TimeDelta::as_secs_f64).into(),
    }
}

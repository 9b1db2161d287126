//! Estimates with their ellipse: the map's line and the robot on it.

use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{Ellipse, Estimate, Event, HostClock, Stamp};

use super::trail::{MOST_ROBOTS, Trails, Weight};
use super::{Pace, Setting, Told, View, robot_name};
use crate::model::{EstimatePoint, Frame, Number, seconds_of};

/// An ellipse of so many standard deviations holds 95 % of a normal distribution of two dimensions: sqrt(-2 ln 0.05).
const ELLIPSE_SIGMAS: f64 = 2.447_746_830_680_816;

/// The estimates of each robot.
pub(super) struct Estimates {
    trails: Trails<(), EstimatePoint>,
}

impl Estimates {
    pub(super) fn new(setting: &Setting) -> Self {
        Self { trails: Trails::new(setting.keep, MOST_ROBOTS) }
    }
}

impl View for Estimates {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        let Told::Event(Event::Estimated { robot, estimate }) = told else {
            return;
        };
        if estimate.validity.position && estimate.validity.heading {
            let point = point_of(now, estimate);
            self.trails.push(now, (*robot, ()), (point, Weight::Usual));
        }
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        for (robot, points) in self.trails.take_news() {
            frame.robot(&robot_name(robot)).estimates = points;
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.trails.kept() {
            history.robot(&robot_name(robot)).estimates = points;
        }
    }

    fn dropped(&self) -> u64 {
        self.trails.dropped()
    }
}

/// An estimate as it is shown.
pub(crate) fn point_of(now: Stamp<HostClock>, estimate: &Estimate) -> EstimatePoint {
    let covariance = &estimate.covariance;
    let ellipse = Ellipse::of_covariance(
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
        fix_age_s: estimate.fix_age.map_or(f64::NAN, posebridge_telemetry::Span::as_secs_f64).into(),
    }
}

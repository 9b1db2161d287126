//! Where the wheels alone say a robot is. A simulated brick sends its own odometry with the truth; for the others it is computed here.

use posebridge_telemetry::{
    Arena, DriveGeometry, Estimate, Event, HostClock, Observation, Odom, Pose, RobotId, Timestamp, Transform2,
};

use super::retained_series::{BoundedMap, MAX_ROBOTS, PointPriority, RetainedSeriesMap};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::api::{DeadReckoning, DeadReckoningBuilder};
use crate::model::{Frame, OdometryPoint, seconds_of};

pub(super) struct Odometry {
    builder: Option<DeadReckoningBuilder>,
    robots: BoundedMap<RobotId, RobotOdometry>,
    points: RetainedSeriesMap<(), OdometryPoint>,
}

struct RobotOdometry {
    geometry: DriveGeometry,
    reckoning: Box<dyn DeadReckoning>,
    last: Option<Pose<Odom>>,
    anchor: Option<Anchor>,
}

/// The place of the odometry's frame: where the estimate was when it was first one of this kind.
struct Anchor {
    place: Transform2<Arena, Odom>,
    is_relative: bool,
}

impl Odometry {
    pub(super) fn new(config: &ViewConfig) -> Self {
        Self {
            builder: config.dead_reckoning.clone(),
            robots: BoundedMap::default(),
            points: RetainedSeriesMap::new(config.retention, MAX_ROBOTS),
        }
    }

    /// Begins with a robot whose geometry is new: a brick may describe itself later than it sends.
    fn on_geometry(&mut self, robot: RobotId, geometry: DriveGeometry) {
        let Some(builder) = &self.builder else { return };
        let new = || RobotOdometry { geometry, reckoning: builder.build(geometry), last: None, anchor: None };
        if let Some(known) = self.robots.get_or_insert(robot, new)
            && known.geometry != geometry
        {
            *known = new();
        }
    }

    fn on_observation(&mut self, robot: RobotId, observation: &Observation) {
        if let Some(known) = self.robots.entries.get_mut(&robot) {
            known.last = known.reckoning.observe(observation).or(known.last);
        }
    }

    fn on_estimate(&mut self, now: Timestamp<HostClock>, robot: RobotId, estimate: &Estimate) {
        let pose = self.robots.entries.get_mut(&robot).and_then(|known| known.place(estimate));
        if let Some(pose) = pose {
            let point = OdometryPoint {
                t_s: seconds_of(now),
                x_m: pose.x.0.into(),
                y_m: pose.y.0.into(),
                heading_rad: pose.heading.rad().into(),
                is_relative: estimate.is_relative(),
            };
            self.points.push(now, (robot, ()), point, PointPriority::Normal);
        }
    }
}

impl RobotOdometry {
    fn place(&mut self, estimate: &Estimate) -> Option<Pose<Arena>> {
        let last = self.last?;
        let is_relative = estimate.is_relative();
        if self.anchor.as_ref().is_none_or(|anchor| anchor.is_relative != is_relative) {
            self.anchor = Some(Anchor { place: estimate.pose * last.inverse(), is_relative });
        }
        self.anchor.as_ref().map(|anchor| anchor.place * last)
    }
}

impl View for Odometry {
    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Event(Event::ObservationAligned { robot, observation, .. }) => {
                self.on_observation(*robot, observation);
            }
            ViewInput::Event(Event::BrickRestarted { robot }) => {
                if let Some(known) = self.robots.entries.get_mut(robot) {
                    known.reckoning.restart_clock();
                }
            }
            ViewInput::Event(Event::EstimateUpdated { robot, estimate }) => self.on_estimate(now, *robot, estimate),
            ViewInput::Status(status) => {
                for robot in &status.robots {
                    if let Some(geometry) = robot.geometry {
                        self.on_geometry(robot.robot, geometry);
                    }
                }
            }
            _ => {}
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        for (robot, points) in self.points.take_pending() {
            frame.robot(&robot_name(robot)).odometry = points;
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.points.retained() {
            history.robot(&robot_name(robot)).odometry = points;
        }
    }

    fn dropped(&self) -> u64 {
        self.points.dropped()
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Address, BrickClock, Heading, Meters, ObservationKind, Radians, SensorId, TimeDelta};

    use super::*;
    use crate::feed::{RobotStatus, StationStatus};
    use crate::model::Number;
    use crate::views::RetentionPolicy;
    use crate::views::tests::{at, estimate, history, robot};

    /// Goes ahead by the left wheel's angle in metres.
    struct Ahead;

    impl DeadReckoning for Ahead {
        fn observe(&mut self, observation: &Observation) -> Option<Pose<Odom>> {
            let ObservationKind::WheelAngles { left, .. } = observation.measurement else { return None };
            Some(Pose::new(Meters(left.0), Meters(0.0), Heading::from_rad(0.0)))
        }

        fn restart_clock(&mut self) {}
    }

    fn geometry() -> DriveGeometry {
        let [radius, width] = [0.03, 0.12].map(Meters);
        DriveGeometry { left_wheel_radius: radius, right_wheel_radius: radius, track_width: width, tick: Radians(0.01) }
    }

    fn wheels(angle_rad: f64) -> Event {
        let measurement = ObservationKind::WheelAngles { left: Radians(angle_rad), right: Radians(angle_rad) };
        let stamp = Timestamp::<BrickClock>::ZERO;
        let observation = Observation { sensor: SensorId::WHEELS, stamp, stamp_sigma: TimeDelta::ZERO, measurement };
        Event::ObservationAligned { robot: robot(), source: Address::new(1, 1), arrival: Timestamp::ZERO, observation }
    }

    #[test]
    fn odometry_begins_where_the_estimate_is_and_again_where_the_robot_is_found_in_the_arena() {
        let mut view = Odometry::new(&ViewConfig {
            links: Vec::new(),
            retention: RetentionPolicy::WholeSession { max_points: 100 },
            dead_reckoning: Some(DeadReckoningBuilder::new(|_| Box::new(Ahead))),
        });
        let robots = vec![RobotStatus { robot: robot(), geometry: Some(geometry()), ..RobotStatus::default() }];
        let status = StationStatus { robots, ..StationStatus::default() };
        view.observe(at(0), ViewInput::Status(&status));
        let mut relative = estimate();
        relative.validity.position = false;
        relative.pose = Pose::new(Meters(0.0), Meters(0.0), Heading::from_rad(0.0));
        let found = Estimate {
            pose: Pose::new(Meters(2.0), Meters(3.0), Heading::from_rad(std::f64::consts::FRAC_PI_2)),
            ..estimate()
        };
        for (millis, angle_rad, estimate) in
            [(10, 1.0, &relative), (20, 1.5, &relative), (30, 2.0, &found), (40, 2.5, &found)]
        {
            view.observe(at(millis), ViewInput::Event(&wheels(angle_rad)));
            let event = Event::EstimateUpdated { robot: robot(), estimate: *estimate };
            view.observe(at(millis), ViewInput::Event(&event));
        }
        let points = history(&view).robots[0].odometry.clone();
        let rounded = |value: &Number| (value.get().unwrap() * 1e6).round() / 1e6;
        let shown: Vec<_> =
            points.iter().map(|point| (rounded(&point.x_m), rounded(&point.y_m), point.is_relative)).collect();
        assert_eq!(shown, [(0.0, 0.0, true), (0.5, 0.0, true), (2.0, 3.0, false), (2.0, 3.5, false)]);
    }
}

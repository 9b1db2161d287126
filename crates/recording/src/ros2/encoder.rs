//! Converts events to messages of ROS 2.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::severity::{ERROR, WARNING};
use posebridge_telemetry::{
    BrickClock, Estimate, Event, HostClock, LinkCounter, LinkHealth, LinkId, LinkState, Observation, ObservationKind,
    RobotId, Timestamp, Transform2,
};

use super::definitions::{self, MessageType};
use super::frames::OdometryFrame;
use super::messages::{
    DiagnosticLevel, DiagnosticStatus, Header, Imu, Odometry, PoseWithCovarianceStamped, RosTime, SpatialPose,
    TransformStamped, encode_diagnostics, encode_transforms,
};
use super::names::{id_name, ros_name, unique_name};
use crate::clock_alignment::ClockAlignmentPoint;
use crate::planar::{POSE_ROWS, VELOCITY_ROWS, quaternion_about_z, spatial_covariance};
use crate::robot_names::RobotNames;

/// The arena.
const MAP: &str = "map";
const TF_TOPIC: &str = "/tf";
const DIAGNOSTICS_TOPIC: &str = "/diagnostics";

/// Variance of what a robot on a plane does not measure: z, roll, pitch and their rates, and the speed to the side. Neither zero, which
/// robot_localization takes for certain knowledge, nor so large that a 6 x 6 inverse loses the digits of the rest: 1000 m, 1000 rad.
const UNMEASURED: f64 = 1e6;

/// Begins a covariance of `sensor_msgs/Imu` whose quantity is not measured.
const NOT_MEASURED: [f64; 9] = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// A message of a topic.
#[derive(Debug)]
pub struct RosMessage {
    /// With its namespace.
    pub topic: String,
    pub message_type: MessageType,
    /// In CDR, with its header.
    pub data: Vec<u8>,
}

/// Converts events, in order.
#[derive(Debug)]
pub struct RosEncoder {
    /// UTC of the host clock's zero.
    zero_nanos: u64,
    names: RobotNames,
    first: Option<RobotId>,
    robots: BTreeMap<RobotId, RosRobot>,
    links_down: BTreeSet<LinkId>,
}

#[derive(Debug)]
struct RosRobot {
    /// Empty for the first robot, if it has no name.
    name: String,
    odom_frame: String,
    body_frame: String,
    alignment: Option<ClockAlignmentPoint>,
    odometry: OdometryFrame,
    last_transform: Option<Timestamp<HostClock>>,
}

impl RosEncoder {
    /// `zero_nanos` is UTC of the host clock's zero.
    pub fn new(zero_nanos: u64) -> Self {
        Self {
            zero_nanos,
            names: RobotNames::default(),
            first: None,
            robots: BTreeMap::new(),
            links_down: BTreeSet::new(),
        }
    }

    /// The robots that have topics, each with the part of the name before the last; empty for a lone one without a name.
    pub fn namespaces(&self) -> impl Iterator<Item = (RobotId, &str)> {
        self.robots.iter().map(|(robot, known)| (*robot, known.name.as_str()))
    }

    /// `now` is the arrival of the event.
    pub fn encode(&mut self, now: Timestamp<HostClock>, event: &Event) -> Vec<RosMessage> {
        self.names.observe(event);
        match event {
            Event::EstimateUpdated { robot, estimate } => self.estimate_messages(*robot, now, estimate),
            Event::ObservationAligned { robot, observation, .. } => {
                self.imu_message(*robot, now, observation).into_iter().collect()
            }
            Event::BrickClockAligned { robot, skew_ppm, brick, host, .. } => {
                let point = ClockAlignmentPoint { host: *host, brick: *brick, skew_ppm: *skew_ppm };
                self.robot(*robot).alignment = Some(point);
                Vec::new()
            }
            Event::Health { link, health, .. } => vec![self.health_message(now, *link, health)],
            Event::Link { link, state } => {
                match state {
                    LinkState::Up => self.links_down.remove(link),
                    LinkState::Down => self.links_down.insert(*link),
                };
                self.described(now, event, &format!("link {link}"))
            }
            Event::RobotDetected { robot }
            | Event::RobotNamed { robot, .. }
            | Event::RobotLost { robot, .. }
            | Event::BrickRestarted { robot } => {
                let subject = format!("robot {}", self.names.label(*robot));
                self.described(now, event, &subject)
            }
            Event::Text { source, .. } => self.described(now, event, &format!("texts of {source}")),
            // A recording has them; there is no standard message for them.
            Event::ObservationFused { .. }
            | Event::ObservationCompared { .. }
            | Event::EstimateCompared { .. }
            | Event::QuantityUpdated { .. }
            | Event::Temperature { .. }
            | Event::CameraClockAligned { .. }
            | Event::ReceiveError { .. } => Vec::new(),
        }
    }

    /// Adds an unknown robot; a name that comes later does not change its topics. Observations without a sender are of the first one.
    fn robot(&mut self, robot: RobotId) -> &mut RosRobot {
        let robot = match self.first {
            Some(first) if robot == RobotId::default() => first,
            Some(first) if first == RobotId::default() => {
                let known = self.robots.remove(&first);
                self.robots.extend(known.map(|known| (robot, known)));
                self.first = Some(robot);
                robot
            }
            Some(_) => robot,
            None => *self.first.insert(robot),
        };
        if !self.robots.contains_key(&robot) {
            let is_taken = |name: &str| self.robots.values().any(|other| other.name == name);
            let name = match self.names.get(robot).and_then(ros_name) {
                Some(name) => unique_name(&name, is_taken),
                None if self.robots.is_empty() => String::new(),
                None => unique_name(&id_name(robot), is_taken),
            };
            self.robots.insert(robot, RosRobot::new(name));
        }
        self.robots.entry(robot).or_insert_with(|| RosRobot::new(String::new()))
    }

    fn estimate_messages(&mut self, robot: RobotId, now: Timestamp<HostClock>, estimate: &Estimate) -> Vec<RosMessage> {
        let zero_nanos = self.zero_nanos;
        let robot = self.robot(robot);
        // Without a heading there is no pose in the arena.
        if !(estimate.is_relative() || estimate.validity.heading) {
            return Vec::new();
        }
        robot.odometry.advance(estimate);
        let at = robot.host_time(estimate.stamp).unwrap_or(now);
        let stamp = stamp(zero_nanos, at);
        let frame_id = if estimate.is_relative() { robot.odom_frame.as_str() } else { MAP };
        let header = Header { stamp, frame_id };
        let pose = spatial_pose(estimate.pose);
        let covariance = spatial_covariance(estimate, &POSE_ROWS, UNMEASURED);
        let odometry = Odometry {
            header,
            child_frame_id: &robot.body_frame,
            pose,
            pose_covariance: covariance,
            linear: [estimate.forward_speed.0, 0.0, 0.0],
            angular: [0.0, 0.0, estimate.turn_rate.0],
            twist_covariance: spatial_covariance(estimate, &VELOCITY_ROWS, UNMEASURED),
        };
        let mut messages = vec![robot.message("odom", definitions::ODOMETRY, odometry.encode())];
        if !estimate.is_relative() {
            let data = PoseWithCovarianceStamped { header, pose, covariance }.encode();
            messages.push(robot.message("pose", definitions::POSE_WITH_COVARIANCE_STAMPED, data));
        }
        // A second transform for an instant, or an older one, is refused by tf2 with a warning for each.
        if robot.last_transform.is_none_or(|last| at > last) {
            robot.last_transform = Some(at);
            messages.push(robot.transform_message(stamp, estimate));
        }
        messages
    }

    /// The turn rate of a gyro; it measures neither orientation nor acceleration in space.
    fn imu_message(
        &mut self,
        robot: RobotId,
        now: Timestamp<HostClock>,
        observation: &Observation,
    ) -> Option<RosMessage> {
        let ObservationKind::TurnRate(turn) = observation.measurement else {
            return None;
        };
        let zero_nanos = self.zero_nanos;
        let robot = self.robot(robot);
        let at = robot.host_time(observation.stamp).unwrap_or(now);
        let imu = Imu {
            header: Header { stamp: stamp(zero_nanos, at), frame_id: &robot.body_frame },
            orientation: [0.0, 0.0, 0.0, 1.0],
            orientation_covariance: NOT_MEASURED,
            angular_velocity: [0.0, 0.0, turn.0],
            // Zeros: not known. The noise of the gyro is a matter of the filter, and an observation does not say it.
            angular_velocity_covariance: [0.0; 9],
            linear_acceleration: [0.0; 3],
            linear_acceleration_covariance: NOT_MEASURED,
        };
        Some(robot.message("imu", definitions::IMU, imu.encode()))
    }

    fn health_message(&self, now: Timestamp<HostClock>, link: LinkId, health: &LinkHealth) -> RosMessage {
        let counters = LinkCounter::ALL.iter().map(|counter| (counter.key, (counter.read)(health).to_string()));
        let round_trip = health.round_trip.map(|time| ("round_trip_s", time.as_secs_f64().to_string()));
        let (level, message) = if self.links_down.contains(&link) {
            (DiagnosticLevel::Error, "down")
        } else {
            (DiagnosticLevel::Ok, "up")
        };
        let values = counters.chain(round_trip).collect();
        self.diagnostics_message(now, level, &format!("link {link}"), message.to_owned(), values)
    }

    /// An event in words.
    fn described(&self, now: Timestamp<HostClock>, event: &Event, subject: &str) -> Vec<RosMessage> {
        let Some((severity, text)) = event.describe() else {
            return Vec::new();
        };
        let level = if matches!(event, Event::RobotLost { .. }) {
            DiagnosticLevel::Stale
        } else if severity <= ERROR {
            DiagnosticLevel::Error
        } else if severity == WARNING {
            DiagnosticLevel::Warn
        } else {
            DiagnosticLevel::Ok
        };
        vec![self.diagnostics_message(now, level, subject, text, Vec::new())]
    }

    fn diagnostics_message(
        &self,
        now: Timestamp<HostClock>,
        level: DiagnosticLevel,
        subject: &str,
        message: String,
        values: Vec<(&'static str, String)>,
    ) -> RosMessage {
        let status = DiagnosticStatus { level, name: format!("posebridge: {subject}"), message, values };
        let header = Header { stamp: stamp(self.zero_nanos, now), frame_id: "" };
        let data = encode_diagnostics(&header, &[status]);
        RosMessage { topic: DIAGNOSTICS_TOPIC.to_owned(), message_type: definitions::DIAGNOSTIC_ARRAY, data }
    }
}

impl RosRobot {
    fn new(name: String) -> Self {
        let frame = |frame: &str| if name.is_empty() { frame.to_owned() } else { format!("{name}/{frame}") };
        Self {
            odom_frame: frame("odom"),
            body_frame: frame("base_link"),
            name,
            alignment: None,
            odometry: OdometryFrame::default(),
            last_transform: None,
        }
    }

    /// `None` before the first alignment.
    fn host_time(&self, brick: Timestamp<BrickClock>) -> Option<Timestamp<HostClock>> {
        Some(self.alignment?.host_time(brick))
    }

    fn message(&self, topic: &str, message_type: MessageType, data: Vec<u8>) -> RosMessage {
        let topic = if self.name.is_empty() { format!("/{topic}") } else { format!("/{}/{topic}", self.name) };
        RosMessage { topic, message_type, data }
    }

    fn transform_message(&self, stamp: RosTime, estimate: &Estimate) -> RosMessage {
        let odom_from_body = TransformStamped {
            header: Header { stamp, frame_id: &self.odom_frame },
            child_frame_id: &self.body_frame,
            transform: spatial_pose(self.odometry.odom_from_body()),
        };
        let data = if estimate.is_relative() {
            encode_transforms(&[odom_from_body])
        } else {
            let map_from_odom = TransformStamped {
                header: Header { stamp, frame_id: MAP },
                child_frame_id: &self.odom_frame,
                transform: spatial_pose(self.odometry.arena_from_odom(estimate.pose)),
            };
            encode_transforms(&[map_from_odom, odom_from_body])
        };
        RosMessage { topic: TF_TOPIC.to_owned(), message_type: definitions::TF_MESSAGE, data }
    }
}

fn spatial_pose<Target, Source>(pose: Transform2<Target, Source>) -> SpatialPose {
    SpatialPose { position: [pose.x.0, pose.y.0, 0.0], orientation: quaternion_about_z(pose.heading.rad()) }
}

/// `zero_nanos` is UTC of the host clock's zero.
fn stamp(zero_nanos: u64, at: Timestamp<HostClock>) -> RosTime {
    RosTime::from_unix_nanos(i128::from(zero_nanos) + i128::from(at.as_nanos()))
}

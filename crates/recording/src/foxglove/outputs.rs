//! Converts events to messages.

use posebridge_telemetry::severity::WARNING;
use posebridge_telemetry::{
    Arena, Calibration, Command, Estimate, Event, FusionOutcome, FusionRecord, HostClock, Observation, ObservationKind,
    Pose, RobotId, TimeDelta, Timestamp,
};
use serde::Serialize;

use super::channels::{self, Channel, EncodedMessage};
use super::records::{
    CalibrationRecord, ClockRecord, CommandRecord, EstimateRecord, FusedRecord, GapRecord, HealthRecord,
    RobotTruthRecord, TemperatureRecord, TruthRecord, finite,
};
use super::robot_outputs::{ClockAlignmentPoint, RobotOutputsTable};
use super::wire::{self, ARENA, ellipse_of, log_level, odometry_of, pose_of};
use crate::container::{RecordingGap, TruthSample};

/// Low, because each message contains the whole path.
const PATH_PERIOD: TimeDelta = TimeDelta::from_millis(2_000);

/// Converts events to messages, in order.
#[derive(Debug)]
pub struct OutputEncoder {
    utc: UtcClock,
    /// Minimum interval between estimates of a robot, and between fusions of one sensor and kind.
    spacing: TimeDelta,
    robots: RobotOutputsTable,
}

#[derive(Clone, Copy, Debug)]
struct UtcClock {
    /// UTC of the host clock's zero.
    zero_nanos: u64,
}

impl OutputEncoder {
    /// `zero_nanos` is UTC at the host clock's zero. `spacing` is the minimum interval between estimates of a robot, and between
    /// accepted fusions of one sensor and kind; records of rejected observations are all kept.
    pub fn new(zero_nanos: u64, spacing: TimeDelta) -> Self {
        Self { utc: UtcClock { zero_nanos }, spacing, robots: RobotOutputsTable::default() }
    }

    /// Sets the minimum interval between estimates.
    pub(crate) const fn set_spacing(&mut self, spacing: TimeDelta) {
        self.spacing = spacing;
    }

    /// Messages dropped because too many robots need topics.
    pub(crate) const fn skipped(&self) -> u64 {
        self.robots.skipped()
    }

    /// `now` is the arrival of the event.
    pub(crate) fn encode_event(&mut self, now: Timestamp<HostClock>, event: &Event) -> Vec<EncodedMessage> {
        self.robots.observe_name(event);
        let mut messages = self.messages_of(now, event);
        let warning = self.robots.take_overflow_warning();
        messages.extend(warning.map(|text| self.log_message(now, WARNING, "recording", &text)));
        messages
    }

    fn messages_of(&mut self, now: Timestamp<HostClock>, event: &Event) -> Vec<EncodedMessage> {
        match event {
            Event::EstimateUpdated { robot, estimate } => self.estimate_messages(*robot, now, estimate),
            Event::ObservationFused { robot, record } => self.fusion_messages(*robot, now, record),
            Event::ObservationAligned { robot, observation, .. } => self.fix_messages(*robot, now, observation),
            Event::BrickClockAligned { .. } => self.brick_clock_messages(event),
            Event::CameraClockAligned { camera, offset, uncertainty, stamp, host } => {
                let record = ClockRecord {
                    clock: "camera",
                    system: camera.system.0,
                    component: camera.component.0,
                    host_nanos: host.as_nanos(),
                    other_nanos: stamp.as_nanos(),
                    offset_s: offset.as_secs_f64(),
                    skew_ppm: None,
                    uncertainty_s: uncertainty.as_secs_f64(),
                    round_trip_s: None,
                };
                vec![json_message(channels::CLOCK, &record)]
            }
            Event::Temperature { brick, channel, stamp, shown, verdict, settled, .. } => {
                let record = TemperatureRecord {
                    system: brick.address.system.0,
                    component: brick.address.component.0,
                    channel: channel.to_string(),
                    brick_nanos: stamp.as_nanos(),
                    shown_c: finite(shown.0),
                    verdict: verdict.reason(),
                    settled_c: settled.and_then(|settled| finite(settled.value)),
                    settled_sigma_c: settled.and_then(|settled| finite(settled.sigma)),
                };
                let mut messages = vec![json_message(channels::TEMPERATURE, &record)];
                // A thermometer may be that of a brick that is no robot.
                if let Some(outputs) = self.robots.find_other(*brick) {
                    outputs.assign(&mut messages);
                }
                messages
            }
            Event::Health { link, health, sources } => {
                vec![json_message(channels::LINK_HEALTH, &HealthRecord::new(*link, health, sources))]
            }
            Event::RobotDetected { .. }
            | Event::RobotNamed { .. }
            | Event::RobotLost { .. }
            | Event::BrickRestarted { .. }
            | Event::Link { .. }
            | Event::Text { .. } => self.log_message_of(now, event).into_iter().collect(),
            Event::ReceiveError { .. } => Vec::new(),
        }
    }

    /// A log line with its MAVLink severity: 0 emergency to 7 debug.
    pub(crate) fn log_message(
        &self,
        now: Timestamp<HostClock>,
        severity: u8,
        name: &str,
        text: &str,
    ) -> EncodedMessage {
        let log = wire::Log {
            timestamp: Some(self.utc.timestamp(now)),
            level: log_level(severity),
            message: text.to_owned(),
            name: name.to_owned(),
        };
        protobuf_message(channels::LOG, &log)
    }

    /// Estimated constants of a robot; `None` is the first robot.
    pub(crate) fn calibration_messages(
        &mut self,
        robot: Option<RobotId>,
        calibration: &Calibration,
    ) -> Vec<EncodedMessage> {
        let Some(outputs) = self.robots.get_or_add(robot) else {
            return Vec::new();
        };
        let mut messages = vec![json_message(channels::CALIBRATION, &CalibrationRecord(*calibration))];
        outputs.assign(&mut messages);
        messages
    }

    /// The truth sample, and its host time by the last alignment of that robot's clock.
    pub(crate) fn truth_messages(
        &mut self,
        end: Timestamp<HostClock>,
        sample: &TruthSample,
    ) -> (Timestamp<HostClock>, Vec<EncodedMessage>) {
        let mut messages = Vec::new();
        let mut at = end;
        if let Some(outputs) = self.robots.get_or_add(sample.robot) {
            at = outputs.host_time(sample.time).unwrap_or(end).max(Timestamp::ZERO);
            let pose = wire::PoseInFrame {
                timestamp: Some(self.utc.timestamp(at)),
                frame_id: ARENA.to_owned(),
                pose: Some(pose_of(&sample.pose)),
            };
            messages.push(protobuf_message(channels::TRUE_POSE, &pose));
            outputs.assign(&mut messages);
        }
        // It is read back: that of a robot without topics is kept as well.
        messages.push(match sample.robot {
            None => json_message(channels::TRUTH, &TruthRecord::from(sample)),
            Some(robot) => json_message(channels::ROBOT_TRUTH, &RobotTruthRecord::new(robot, sample)),
        });
        (at, messages)
    }

    fn estimate_messages(
        &mut self,
        robot: RobotId,
        now: Timestamp<HostClock>,
        estimate: &Estimate,
    ) -> Vec<EncodedMessage> {
        let Some(outputs) = self.robots.get_or_add(Some(robot)) else {
            return Vec::new();
        };
        if !is_due(&mut outputs.last_estimate, now, self.spacing) {
            return Vec::new();
        }
        let mut messages = vec![json_message(channels::ESTIMATE, &EstimateRecord::from(estimate))];
        if !(estimate.validity.position && estimate.validity.heading) {
            outputs.assign(&mut messages);
            return messages;
        }
        let timestamp = Some(self.utc.timestamp(outputs.host_time(estimate.stamp).unwrap_or(now)));
        let pose = pose_of(&estimate.pose);
        let odometry = odometry_of(estimate, &outputs.body_frame, timestamp);
        messages.push(protobuf_message(channels::ODOMETRY, &odometry));
        let in_arena = wire::PoseInFrame { timestamp, frame_id: ARENA.to_owned(), pose: Some(pose) };
        messages.push(protobuf_message(channels::POSE, &in_arena));
        let transform = wire::FrameTransform {
            timestamp,
            parent_frame_id: ARENA.to_owned(),
            child_frame_id: outputs.body_frame.clone(),
            translation: pose.position,
            rotation: pose.orientation,
        };
        messages.push(protobuf_message(channels::TRANSFORM, &transform));
        let ellipse = ellipse_of(estimate, timestamp);
        messages.extend(ellipse.map(|scene| protobuf_message(channels::ELLIPSE, &scene)));
        outputs.path.push(pose);
        if is_due(&mut outputs.path.last_written, now, PATH_PERIOD) {
            let path = wire::PosesInFrame { timestamp, frame_id: ARENA.to_owned(), poses: outputs.path.poses.clone() };
            messages.push(protobuf_message(channels::PATH, &path));
        }
        outputs.assign(&mut messages);
        messages
    }

    fn fusion_messages(
        &mut self,
        robot: RobotId,
        now: Timestamp<HostClock>,
        record: &FusionRecord,
    ) -> Vec<EncodedMessage> {
        let Some(outputs) = self.robots.get_or_add(Some(robot)) else {
            return Vec::new();
        };
        let last = outputs.last_fusions.entry((record.sensor, record.kind));
        let is_due = is_due(last.or_default(), now, self.spacing);
        let mut messages = Vec::new();
        if is_due || !matches!(record.outcome, FusionOutcome::Accepted | FusionOutcome::Unused) {
            messages.push(json_message(channels::FUSION, &FusedRecord::from(record)));
            outputs.assign(&mut messages);
        }
        if record.outcome == FusionOutcome::PoseReset {
            let text = format!("{} was moved to a {}", outputs.estimate_name(), record.kind);
            messages.push(self.log_message(now, WARNING, "estimator", &text));
        }
        messages
    }

    fn fix_messages(
        &mut self,
        robot: RobotId,
        now: Timestamp<HostClock>,
        observation: &Observation,
    ) -> Vec<EncodedMessage> {
        let ObservationKind::Fix(fix) = observation.measurement else {
            return Vec::new();
        };
        let Some(outputs) = self.robots.get_or_add(Some(robot)) else {
            return Vec::new();
        };
        let heading = fix.heading.unwrap_or_default();
        let pose = Pose::<Arena>::new(fix.position.x, fix.position.y, heading);
        let at = outputs.host_time(observation.stamp).unwrap_or(now);
        let pose = wire::PoseInFrame {
            timestamp: Some(self.utc.timestamp(at)),
            frame_id: ARENA.to_owned(),
            pose: Some(pose_of(&pose)),
        };
        let mut messages = vec![protobuf_message(channels::FIX, &pose)];
        outputs.assign(&mut messages);
        messages
    }

    fn brick_clock_messages(&mut self, event: &Event) -> Vec<EncodedMessage> {
        let Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host } = *event else {
            return Vec::new();
        };
        let Some(outputs) = self.robots.get_or_add(Some(robot)) else {
            return Vec::new();
        };
        outputs.alignment = Some(ClockAlignmentPoint { host, brick, skew_ppm });
        let record = ClockRecord {
            clock: "brick",
            system: robot.address.system.0,
            component: robot.address.component.0,
            host_nanos: host.as_nanos(),
            other_nanos: brick.as_nanos(),
            offset_s: offset.as_secs_f64(),
            skew_ppm: finite(skew_ppm),
            uncertainty_s: uncertainty.as_secs_f64(),
            round_trip_s: round_trip.map(TimeDelta::as_secs_f64),
        };
        let mut messages = vec![json_message(channels::CLOCK, &record)];
        outputs.assign(&mut messages);
        messages
    }

    /// An event as a log line. A text message has its sender as the name.
    fn log_message_of(&self, now: Timestamp<HostClock>, event: &Event) -> Option<EncodedMessage> {
        if let Event::Text { source, severity, text } = event {
            return Some(self.log_message(now, *severity, &source.to_string(), text));
        }
        let (severity, text) = event.describe()?;
        let name = if matches!(event, Event::Link { .. }) { "link" } else { "session" };
        Some(self.log_message(now, severity, name, &text))
    }
}

impl UtcClock {
    fn timestamp(self, at: Timestamp<HostClock>) -> wire::Timestamp {
        let nanos = i128::from(self.zero_nanos) + i128::from(at.as_nanos());
        wire::Timestamp {
            seconds: nanos.div_euclid(1_000_000_000) as i64,
            nanos: nanos.rem_euclid(1_000_000_000) as i32,
        }
    }
}

/// A command from a user or program; `robot` is its target, if it names one.
pub(crate) fn command_message(command: &Command, robot: Option<RobotId>) -> EncodedMessage {
    json_message(channels::COMMAND, &CommandRecord::new(command, robot))
}

pub(crate) fn gap_message(gap: &RecordingGap) -> EncodedMessage {
    json_message(channels::GAP, &GapRecord::from(gap))
}

/// True at the first call and then once per `spacing`.
fn is_due(last: &mut Option<Timestamp<HostClock>>, now: Timestamp<HostClock>, spacing: TimeDelta) -> bool {
    let is_due = last.is_none_or(|last| now - last >= spacing);
    if is_due {
        *last = Some(now);
    }
    is_due
}

fn protobuf_message(channel: Channel, message: &impl prost::Message) -> EncodedMessage {
    EncodedMessage { channel, robot: None, data: message.encode_to_vec() }
}

/// Records of numbers, texts and lists always serialise.
fn json_message(channel: Channel, record: &impl Serialize) -> EncodedMessage {
    EncodedMessage { channel, robot: None, data: serde_json::to_vec(record).unwrap_or_default() }
}

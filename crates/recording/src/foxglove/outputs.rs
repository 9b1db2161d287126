//! Converts events to messages.

use posebridge_telemetry::severity::WARNING;
use posebridge_telemetry::{
    Calibration, Command, Estimate, Event, FusionOutcome, FusionRecord, HostClock, Observation, ObservationKind, Pose,
    RobotId, ScalarEstimate, TimeDelta, Timestamp,
};

use super::channels::{self, Channel, EncodedMessage};
use super::records::{self, ClockAlignment, CommandRequest, LinkReport, Record, TemperatureReading};
use super::robot_outputs::RobotOutputsTable;
use super::wire;
use crate::clock_alignment::ClockAlignmentPoint;
use crate::container::{RecordingGap, TruthSample};

/// Low, because each message contains the whole path.
const PATH_PERIOD: TimeDelta = TimeDelta::from_millis(2_000);

/// Converts events to messages, in order.
#[derive(Debug)]
pub struct OutputEncoder {
    /// UTC of the host clock's zero.
    zero_nanos: u64,
    /// Minimum interval between estimates of a robot, and between fusions of one sensor and kind.
    spacing: TimeDelta,
    robots: RobotOutputsTable,
}

impl OutputEncoder {
    /// `zero_nanos` is UTC at the host clock's zero. `spacing` is the minimum interval between estimates of a robot, and between
    /// accepted fusions of one sensor and kind; records of rejected observations are all kept.
    pub fn new(zero_nanos: u64, spacing: TimeDelta) -> Self {
        Self { zero_nanos, spacing, robots: RobotOutputsTable::default() }
    }

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
            Event::ObservationCompared { robot, filter, record } => self.compared_fusion(*robot, now, filter, record),
            Event::EstimateCompared { robot, filter, estimate } => {
                self.compared_estimate(*robot, now, filter, estimate)
            }
            Event::ObservationAligned { robot, observation, .. } => self.fix_messages(*robot, now, observation),
            Event::BrickClockAligned { .. } => self.brick_clock_messages(event),
            Event::CameraClockAligned { camera, offset, uncertainty, stamp, host } => {
                let alignment = ClockAlignment {
                    clock: "camera",
                    owner: *camera,
                    host_nanos: host.as_nanos(),
                    other_nanos: stamp.as_nanos(),
                    offset: *offset,
                    skew_ppm: None,
                    uncertainty: *uncertainty,
                    round_trip: None,
                };
                vec![json_message(channels::CLOCK, &records::CLOCK, &alignment)]
            }
            Event::Temperature { brick, channel, stamp, shown, verdict, settled, .. } => {
                let reading = TemperatureReading {
                    brick: brick.address,
                    channel: *channel,
                    stamp: *stamp,
                    shown: *shown,
                    verdict: *verdict,
                    settled: *settled,
                };
                let mut messages = vec![json_message(channels::TEMPERATURE, &records::TEMPERATURE, &reading)];
                // A thermometer may be that of a brick that is no robot.
                if let Some(outputs) = self.robots.find_other(*brick) {
                    outputs.assign(&mut messages);
                }
                messages
            }
            Event::Health { link, health, sources } => {
                let report = LinkReport { link: *link, health: *health, sources: sources.clone() };
                vec![json_message(channels::LINK_HEALTH, &records::LINK_HEALTH, &report)]
            }
            // The values are in the recording's inputs: a replay gives them again, and `export` writes them as a table.
            Event::QuantityUpdated { robot, estimate } => self.quantity_messages(*robot, estimate),
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
        protobuf_message(channels::LOG, wire::log(severity, name, text, &utc_timestamp(self.zero_nanos, now)))
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
        let mut messages = vec![json_message(channels::CALIBRATION, &records::CALIBRATION, calibration)];
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
            let pose = wire::pose_in_frame(sample.pose, wire::ARENA, &utc_timestamp(self.zero_nanos, at));
            messages.push(protobuf_message(channels::TRUE_POSE, pose));
            outputs.assign(&mut messages);
        }
        // It is read back: that of a robot without topics is kept as well.
        messages.push(match sample.robot {
            None => json_message(channels::TRUTH, &records::TRUTH, sample),
            Some(_) => json_message(channels::ROBOT_TRUTH, &records::ROBOT_TRUTH, sample),
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
        let mut messages = vec![json_message(channels::ESTIMATE, &records::ESTIMATE, estimate)];
        if !(estimate.is_relative() || estimate.validity.heading) {
            outputs.assign(&mut messages);
            return messages;
        }
        let timestamp = utc_timestamp(self.zero_nanos, outputs.host_time(estimate.stamp).unwrap_or(now));
        let frame = if estimate.is_relative() { outputs.start_frame.as_str() } else { wire::ARENA };
        let odometry = wire::odometry(estimate, frame, &outputs.body_frame, &timestamp);
        let transform = wire::transform(estimate.pose, frame, &outputs.body_frame, &timestamp);
        let ellipse = wire::ellipse(estimate, frame, &timestamp);
        messages.push(protobuf_message(channels::ODOMETRY, odometry));
        messages.push(protobuf_message(channels::POSE, wire::pose_in_frame(estimate.pose, frame, &timestamp)));
        messages.push(protobuf_message(channels::TRANSFORM, transform));
        messages.extend(ellipse.map(|scene| protobuf_message(channels::ELLIPSE, scene)));
        outputs.path.push(estimate);
        if is_due(&mut outputs.path.last_written, now, PATH_PERIOD) {
            messages
                .push(protobuf_message(channels::PATH, wire::poses_in_frame(&outputs.path.poses, frame, &timestamp)));
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
            messages.push(json_message(channels::FUSION, &records::FUSION, record));
            outputs.assign(&mut messages);
        }
        if record.outcome == FusionOutcome::PoseReset {
            let text = format!("{} was moved to a {}", outputs.estimate_name(), record.kind);
            messages.push(self.log_message(now, WARNING, "estimator", &text));
        }
        messages
    }

    fn compared_estimate(
        &mut self,
        robot: RobotId,
        now: Timestamp<HostClock>,
        filter: &'static str,
        estimate: &Estimate,
    ) -> Vec<EncodedMessage> {
        let spacing = self.spacing;
        let Some(outputs) = self.robots.get_or_add(Some(robot)) else {
            return Vec::new();
        };
        if !is_due(outputs.last_compared_estimates.entry(filter).or_default(), now, spacing) {
            return Vec::new();
        }
        let message = json_message(channels::COMPARED_ESTIMATE, &records::ESTIMATE, estimate);
        let mut messages = vec![EncodedMessage { filter: Some(filter), ..message }];
        outputs.assign(&mut messages);
        messages
    }

    /// Of observations that were compared with a prediction.
    fn compared_fusion(
        &mut self,
        robot: RobotId,
        now: Timestamp<HostClock>,
        filter: &'static str,
        record: &FusionRecord,
    ) -> Vec<EncodedMessage> {
        let spacing = self.spacing;
        let Some(outputs) = self.robots.get_or_add(Some(robot)).filter(|_| record.degrees_of_freedom > 0) else {
            return Vec::new();
        };
        let last = outputs.last_compared_fusions.entry((filter, record.sensor, record.kind));
        if !is_due(last.or_default(), now, spacing) {
            return Vec::new();
        }
        let message = json_message(channels::COMPARED_FUSION, &records::FUSION, record);
        let mut messages = vec![EncodedMessage { filter: Some(filter), ..message }];
        outputs.assign(&mut messages);
        messages
    }

    fn quantity_messages(&mut self, robot: RobotId, estimate: &ScalarEstimate) -> Vec<EncodedMessage> {
        let Some(outputs) = self.robots.get_or_add(Some(robot)) else {
            return Vec::new();
        };
        let mut messages = vec![json_message(channels::QUANTITY, &records::QUANTITY, estimate)];
        outputs.assign(&mut messages);
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
        let pose = Pose::new(fix.position.x, fix.position.y, fix.heading.unwrap_or_default());
        let at = outputs.host_time(observation.stamp).unwrap_or(now);
        let fix = wire::pose_in_frame(pose, wire::ARENA, &utc_timestamp(self.zero_nanos, at));
        let mut messages = vec![protobuf_message(channels::FIX, fix)];
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
        let alignment = ClockAlignment {
            clock: "brick",
            owner: robot.address,
            host_nanos: host.as_nanos(),
            other_nanos: brick.as_nanos(),
            offset,
            skew_ppm: Some(skew_ppm),
            uncertainty,
            round_trip,
        };
        let mut messages = vec![json_message(channels::CLOCK, &records::CLOCK, &alignment)];
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

/// `zero_nanos` is UTC of the host clock's zero.
fn utc_timestamp(zero_nanos: u64, at: Timestamp<HostClock>) -> wire::Message {
    wire::timestamp(i128::from(zero_nanos) + i128::from(at.as_nanos()))
}

/// A command from a user or program; `robot` is its target, if it names one.
pub(crate) fn command_message(command: &Command, robot: Option<RobotId>) -> EncodedMessage {
    json_message(channels::COMMAND, &records::COMMAND, &CommandRequest { robot, command: *command })
}

pub(crate) fn gap_message(gap: &RecordingGap) -> EncodedMessage {
    json_message(channels::GAP, &records::GAP, gap)
}

/// True at the first call and then once per `spacing`.
fn is_due(last: &mut Option<Timestamp<HostClock>>, now: Timestamp<HostClock>, spacing: TimeDelta) -> bool {
    let is_due = last.is_none_or(|last| now - last >= spacing);
    if is_due {
        *last = Some(now);
    }
    is_due
}

fn protobuf_message(channel: Channel, message: wire::Message) -> EncodedMessage {
    EncodedMessage { channel, robot: None, filter: None, data: message.into_bytes() }
}

fn json_message<T>(channel: Channel, record: &Record<T>, of: &T) -> EncodedMessage {
    EncodedMessage { channel, robot: None, filter: None, data: record.message(of) }
}

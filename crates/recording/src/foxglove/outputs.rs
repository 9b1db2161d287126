//! From events to messages.

use std::collections::BTreeMap;

use posebridge_telemetry::{
    Arena, BrickClock, Calibration, Command, Estimate, Event, FusionOutcome, FusionRecord, HostClock, LinkState,
    Observation, ObservationKind, Pose, RobotId, SensorId, TimeDelta, Timestamp,
};
use serde::Serialize;

use super::channels::{self, Channel};
use super::convert::{ARENA, BODY, ellipse_of, log_level, odometry_of, pose_of};
use super::records::{
    CalibrationRecord, ClockRecord, CommandRecord, EstimateRecord, FusedRecord, GapRecord, HealthRecord,
    TemperatureRecord, TruthRecord, finite,
};
use super::robot_truth::RobotTruthRecord;
use super::wire;
use crate::container::{RecordingGap, TruthSample};

/// The path is written this often: it is whole each time.
const PATH_PERIOD: TimeDelta = TimeDelta::from_millis(2_000);
/// The path has at most so many poses; from then on every second one stays.
const PATH_POSES: usize = 256;

/// One message for a channel beside the inputs.
#[derive(Debug)]
pub(crate) struct EncodedMessage {
    pub(crate) channel: Channel,
    pub(crate) data: Vec<u8>,
}

/// Turns events into messages, in the order in which they happened.
#[derive(Debug)]
pub struct OutputEncoder {
    /// UTC of the host clock's zero, ns.
    zero_nanos: u64,
    /// Estimates, and fusions of one sensor and kind, lie at least so far apart.
    spacing: TimeDelta,
    alignment: Option<ClockAlignmentPoint>,
    last_estimate: Option<Timestamp<HostClock>>,
    last_fusions: BTreeMap<(SensorId, &'static str), Option<Timestamp<HostClock>>>,
    path: PathHistory,
}

/// An instant by both clocks.
#[derive(Clone, Copy, Debug)]
struct ClockAlignmentPoint {
    host: Timestamp<HostClock>,
    brick: Timestamp<BrickClock>,
    skew_ppm: f64,
}

/// Where the robot has been.
#[derive(Debug, Default)]
struct PathHistory {
    poses: Vec<wire::Pose>,
    stride: usize,
    pose_count: usize,
    last_written: Option<Timestamp<HostClock>>,
}

impl OutputEncoder {
    /// For a session whose host clock was zero at this UTC, in nanoseconds. Estimates, and fusions of one sensor and kind that were
    /// accepted, are thinned to this spacing; whatever was not accepted stays.
    #[must_use]
    pub fn new(zero_nanos: u64, spacing: TimeDelta) -> Self {
        Self {
            zero_nanos,
            spacing,
            alignment: None,
            last_estimate: None,
            last_fusions: BTreeMap::new(),
            path: PathHistory::default(),
        }
    }

    /// Sets how far apart estimates lie at least.
    pub(crate) const fn set_spacing(&mut self, spacing: TimeDelta) {
        self.spacing = spacing;
    }

    /// The messages of an event that came at `now`.
    pub(crate) fn encode_event(&mut self, now: Timestamp<HostClock>, event: &Event) -> Vec<EncodedMessage> {
        match event {
            Event::EstimateUpdated { estimate, .. } => self.estimate_messages(now, estimate),
            Event::ObservationFused { record, .. } => self.fusion_messages(now, record),
            Event::ObservationAligned { observation, .. } => self.fix_message(now, observation).into_iter().collect(),
            Event::BrickClockAligned { .. } => self.brick_clock_message(event).into_iter().collect(),
            Event::CameraClockAligned { .. } => camera_clock_message(event).into_iter().collect(),
            Event::Temperature { .. } => temperature_message(event).into_iter().collect(),
            Event::Health { link, health, sources } => {
                json_message(channels::LINK_HEALTH, &HealthRecord::new(*link, health, sources)).into_iter().collect()
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

    /// A line for people, with its MAVLink severity: 0 emergency to 7 debug.
    pub(crate) fn log_message(
        &self,
        now: Timestamp<HostClock>,
        severity: u8,
        name: &str,
        text: &str,
    ) -> EncodedMessage {
        let log = wire::Log {
            timestamp: Some(self.time(now)),
            level: log_level(severity),
            message: text.to_owned(),
            name: name.to_owned(),
        };
        protobuf_message(channels::LOG, &log)
    }

    /// The truth of one instant, and by the last alignment of the brick's clock when that was.
    pub(crate) fn truth_messages(
        &self,
        end: Timestamp<HostClock>,
        sample: &TruthSample,
    ) -> (Timestamp<HostClock>, Vec<EncodedMessage>) {
        let at = self.host_time(sample.time).unwrap_or(end).max(Timestamp::ZERO);
        let pose = wire::PoseInFrame {
            timestamp: Some(self.time(at)),
            frame_id: ARENA.to_owned(),
            pose: Some(pose_of(&sample.pose)),
        };
        let mut messages = vec![protobuf_message(channels::TRUE_POSE, &pose)];
        messages.extend(match sample.robot {
            None => json_message(channels::TRUTH, &TruthRecord::from(sample)),
            Some(robot) => json_message(channels::ROBOT_TRUTH, &RobotTruthRecord::new(robot, sample)),
        });
        (at, messages)
    }

    fn estimate_messages(&mut self, now: Timestamp<HostClock>, estimate: &Estimate) -> Vec<EncodedMessage> {
        if !is_due(&mut self.last_estimate, now, self.spacing) {
            return Vec::new();
        }
        let mut messages: Vec<EncodedMessage> =
            json_message(channels::ESTIMATE, &EstimateRecord::from(estimate)).into_iter().collect();
        if !(estimate.validity.position && estimate.validity.heading) {
            return messages;
        }
        let timestamp = Some(self.time(self.host_time(estimate.stamp).unwrap_or(now)));
        let pose = pose_of(&estimate.pose);
        messages.push(protobuf_message(channels::ODOMETRY, &odometry_of(estimate, timestamp)));
        let frame_id = ARENA.to_owned();
        let in_arena = wire::PoseInFrame { timestamp, frame_id, pose: Some(pose) };
        messages.push(protobuf_message(channels::POSE, &in_arena));
        let transform = wire::FrameTransform {
            timestamp,
            parent_frame_id: ARENA.to_owned(),
            child_frame_id: BODY.to_owned(),
            translation: pose.position,
            rotation: pose.orientation,
        };
        messages.push(protobuf_message(channels::TRANSFORM, &transform));
        let ellipse = ellipse_of(estimate, timestamp);
        messages.extend(ellipse.map(|scene| protobuf_message(channels::ELLIPSE, &scene)));
        self.path.push(pose);
        if is_due(&mut self.path.last_written, now, PATH_PERIOD) {
            let path = wire::PosesInFrame { timestamp, frame_id: ARENA.to_owned(), poses: self.path.poses.clone() };
            messages.push(protobuf_message(channels::PATH, &path));
        }
        messages
    }

    fn fusion_messages(&mut self, now: Timestamp<HostClock>, record: &FusionRecord) -> Vec<EncodedMessage> {
        let last = self.last_fusions.entry((record.sensor, record.kind));
        let is_due = is_due(last.or_default(), now, self.spacing);
        let mut messages = Vec::new();
        if is_due || !matches!(record.outcome, FusionOutcome::Accepted | FusionOutcome::Unused) {
            messages.extend(json_message(channels::FUSION, &FusedRecord::from(record)));
        }
        if record.outcome == FusionOutcome::PoseReset {
            let text = format!("the estimate was moved to a {}", record.kind);
            messages.push(self.log_message(now, 4, "estimator", &text));
        }
        messages
    }

    fn fix_message(&self, now: Timestamp<HostClock>, observation: &Observation) -> Option<EncodedMessage> {
        let ObservationKind::Fix(fix) = observation.measurement else {
            return None;
        };
        let heading = fix.heading.unwrap_or_default();
        let pose = Pose::<Arena>::new(fix.position.x, fix.position.y, heading);
        let at = self.host_time(observation.stamp).unwrap_or(now);
        let pose = wire::PoseInFrame {
            timestamp: Some(self.time(at)),
            frame_id: ARENA.to_owned(),
            pose: Some(pose_of(&pose)),
        };
        Some(protobuf_message(channels::FIX, &pose))
    }

    fn brick_clock_message(&mut self, event: &Event) -> Option<EncodedMessage> {
        let Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host } = *event else {
            return None;
        };
        self.alignment = Some(ClockAlignmentPoint { host, brick, skew_ppm });
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
        json_message(channels::CLOCK, &record)
    }

    /// What a person would want to read of an event.
    fn log_message_of(&self, now: Timestamp<HostClock>, event: &Event) -> Option<EncodedMessage> {
        let (severity, name, text) = match event {
            Event::RobotDetected { robot } => (6, "session", format!("robot {robot} was heard")),
            Event::RobotNamed { robot, name } => (6, "session", format!("robot {robot} is {name}")),
            Event::RobotLost { robot, silence } => {
                let silence_s = silence.as_secs_f64();
                let text = format!("robot {robot} has been silent for {silence_s:.1} s");
                (4, "session", text)
            }
            Event::BrickRestarted { robot } => (4, "session", format!("robot {robot} restarted")),
            Event::Link { link, state } => match state {
                LinkState::Up => (6, "link", format!("link {link} is up")),
                LinkState::Down => (4, "link", format!("link {link} is down")),
            },
            Event::Text { source, severity, text } => {
                return Some(self.log_message(now, *severity, &source.to_string(), text));
            }
            Event::ObservationAligned { .. }
            | Event::ObservationFused { .. }
            | Event::EstimateUpdated { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Health { .. }
            | Event::ReceiveError { .. } => return None,
        };
        Some(self.log_message(now, severity, name, &text))
    }

    /// When the host's clock showed what the brick's does; `None` before the first alignment.
    fn host_time(&self, brick: Timestamp<BrickClock>) -> Option<Timestamp<HostClock>> {
        let ClockAlignmentPoint { host, brick: zero, skew_ppm } = self.alignment?;
        let since_s = (brick - zero).as_secs_f64() / (1.0 + 1e-6 * skew_ppm);
        Some(host + TimeDelta::from_secs_f64(since_s))
    }

    /// UTC.
    fn time(&self, at: Timestamp<HostClock>) -> wire::Timestamp {
        let nanos = i128::from(self.zero_nanos) + i128::from(at.as_nanos());
        wire::Timestamp {
            seconds: nanos.div_euclid(1_000_000_000) as i64,
            nanos: nanos.rem_euclid(1_000_000_000) as i32,
        }
    }
}

impl PathHistory {
    fn push(&mut self, pose: wire::Pose) {
        self.stride = self.stride.max(1);
        if self.pose_count.is_multiple_of(self.stride) {
            self.poses.push(pose);
        }
        self.pose_count += 1;
        if self.poses.len() >= PATH_POSES {
            let mut is_kept = false;
            self.poses.retain(|_| {
                is_kept = !is_kept;
                is_kept
            });
            self.stride *= 2;
        }
    }
}

/// A request of a person or a program as a message; `robot` is the one that it is for, if it names one.
pub(crate) fn command_message(command: &Command, robot: Option<RobotId>) -> Option<EncodedMessage> {
    json_message(channels::COMMAND, &CommandRecord::new(command, robot))
}

/// What the filter has learned as a message.
pub(crate) fn calibration_message(calibration: &Calibration) -> Option<EncodedMessage> {
    json_message(channels::CALIBRATION, &CalibrationRecord::from(calibration))
}

/// Inputs that are missing as a message.
pub(crate) fn gap_message(gap: &RecordingGap) -> Option<EncodedMessage> {
    json_message(channels::GAP, &GapRecord::from(gap))
}

/// Whether something is due again; the first time it is.
fn is_due(last: &mut Option<Timestamp<HostClock>>, now: Timestamp<HostClock>, spacing: TimeDelta) -> bool {
    let is_due = last.is_none_or(|last| now - last >= spacing);
    if is_due {
        *last = Some(now);
    }
    is_due
}

fn camera_clock_message(event: &Event) -> Option<EncodedMessage> {
    let Event::CameraClockAligned { camera, offset, uncertainty, stamp, host } = event else {
        return None;
    };
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
    json_message(channels::CLOCK, &record)
}

fn temperature_message(event: &Event) -> Option<EncodedMessage> {
    let Event::Temperature { brick, channel, stamp, shown, verdict, settled, .. } = event else {
        return None;
    };
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
    json_message(channels::TEMPERATURE, &record)
}

fn protobuf_message(channel: Channel, message: &impl prost::Message) -> EncodedMessage {
    let data = message.encode_to_vec();
    EncodedMessage { channel, data }
}

/// A record as JSON. It has numbers, texts and lists alone, so that there is always one.
fn json_message(channel: Channel, record: &impl Serialize) -> Option<EncodedMessage> {
    let data = serde_json::to_vec(record).ok()?;
    Some(EncodedMessage { channel, data })
}

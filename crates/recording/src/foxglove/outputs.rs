//! From events to messages.

use std::collections::BTreeMap;

use posebridge_telemetry::{
    Arena, BrickClock, Calibration, Command, Estimate, Event, FusionRecord, HostClock, LinkState, Observation,
    Observed, Pose, SensorId, Span, Stamp, Verdict,
};
use serde::Serialize;

use super::channels::{self, Channel};
use super::convert::{ARENA, BODY, ellipse_of, level, odometry_of, pose_of};
use super::records::{
    CalibrationRecord, ClockRecord, CommandRecord, EstimateRecord, FusedRecord, GapRecord, HealthRecord,
    TemperatureRecord, TruthRecord, finite,
};
use super::wire;
use crate::container::{Gap, TruthSample};

/// The path is written this often: it is whole each time.
const PATH_PERIOD: Span = Span::from_millis(2_000);
/// The path has at most so many poses; from then on every second one stays.
const PATH_POSES: usize = 256;

/// One message for a channel beside the inputs.
#[derive(Debug)]
pub(crate) struct Message {
    pub(crate) channel: Channel,
    pub(crate) data: Vec<u8>,
}

/// Turns events into messages, in the order in which they happened.
#[derive(Debug)]
pub struct Outputs {
    /// UTC of the host clock's zero, ns.
    zero_nanos: u64,
    /// Estimates, and fusions of one sensor and kind, lie at least so far apart.
    spacing: Span,
    alignment: Option<Alignment>,
    estimated: Option<Stamp<HostClock>>,
    fused: BTreeMap<(SensorId, &'static str), Option<Stamp<HostClock>>>,
    path: Path,
}

/// An instant by both clocks.
#[derive(Clone, Copy, Debug)]
struct Alignment {
    host: Stamp<HostClock>,
    brick: Stamp<BrickClock>,
    skew_ppm: f64,
}

/// Where the robot has been.
#[derive(Debug, Default)]
struct Path {
    poses: Vec<wire::Pose>,
    stride: usize,
    seen: usize,
    written: Option<Stamp<HostClock>>,
}

impl Outputs {
    /// For a session whose host clock was zero at this UTC, in nanoseconds. Estimates, and fusions of one sensor and kind that were
    /// accepted, are thinned to this spacing; whatever was not accepted stays.
    #[must_use]
    pub fn new(zero_nanos: u64, spacing: Span) -> Self {
        Self { zero_nanos, spacing, alignment: None, estimated: None, fused: BTreeMap::new(), path: Path::default() }
    }

    /// Sets how far apart estimates lie at least.
    pub(crate) const fn set_spacing(&mut self, spacing: Span) {
        self.spacing = spacing;
    }

    /// The messages of an event that came at `now`.
    pub(crate) fn take(&mut self, now: Stamp<HostClock>, event: &Event) -> Vec<Message> {
        match event {
            Event::Estimated { estimate, .. } => self.estimate(now, estimate),
            Event::Fused { record, .. } => self.fusion(now, record),
            Event::Observed { observation, .. } => self.fix(now, observation).into_iter().collect(),
            Event::BrickClockAligned { .. } => self.brick_clock(event).into_iter().collect(),
            Event::CameraClockAligned { .. } => camera_clock(event).into_iter().collect(),
            Event::Temperature { .. } => temperature(event).into_iter().collect(),
            Event::Health { link, health, sources } => {
                json(channels::LINK_HEALTH, &HealthRecord::of(*link, health, sources)).into_iter().collect()
            }
            Event::RobotSeen { .. }
            | Event::RobotLost { .. }
            | Event::BrickRestarted { .. }
            | Event::Link { .. }
            | Event::Text { .. } => self.line_of(now, event).into_iter().collect(),
            Event::Defect { .. } => Vec::new(),
        }
    }

    /// A line for people, with its MAVLink severity: 0 emergency to 7 debug.
    pub(crate) fn line(&self, now: Stamp<HostClock>, severity: u8, (name, text): (&str, &str)) -> Message {
        let log = wire::Log {
            timestamp: Some(self.time(now)),
            level: level(severity),
            message: text.to_owned(),
            name: name.to_owned(),
        };
        protobuf(channels::LOG, &log)
    }

    /// The truth of one instant, and by the last alignment of the brick's clock when that was.
    pub(crate) fn truth(&self, end: Stamp<HostClock>, sample: &TruthSample) -> (Stamp<HostClock>, Vec<Message>) {
        let at = self.host_time(sample.stamp).unwrap_or(end).max(Stamp::ZERO);
        let pose = wire::PoseInFrame {
            timestamp: Some(self.time(at)),
            frame_id: ARENA.to_owned(),
            pose: Some(pose_of(&sample.pose)),
        };
        let mut messages = vec![protobuf(channels::TRUE_POSE, &pose)];
        messages.extend(json(channels::TRUTH, &TruthRecord::from(sample)));
        (at, messages)
    }

    fn estimate(&mut self, now: Stamp<HostClock>, estimate: &Estimate) -> Vec<Message> {
        if !is_due(&mut self.estimated, now, self.spacing) {
            return Vec::new();
        }
        let mut messages: Vec<Message> =
            json(channels::ESTIMATE, &EstimateRecord::from(estimate)).into_iter().collect();
        if !(estimate.validity.position && estimate.validity.heading) {
            return messages;
        }
        let timestamp = Some(self.time(self.host_time(estimate.stamp).unwrap_or(now)));
        let pose = pose_of(&estimate.pose);
        messages.push(protobuf(channels::ODOMETRY, &odometry_of(estimate, timestamp)));
        let frame_id = ARENA.to_owned();
        let in_arena = wire::PoseInFrame { timestamp, frame_id, pose: Some(pose) };
        messages.push(protobuf(channels::POSE, &in_arena));
        let transform = wire::FrameTransform {
            timestamp,
            parent_frame_id: ARENA.to_owned(),
            child_frame_id: BODY.to_owned(),
            translation: pose.position,
            rotation: pose.orientation,
        };
        messages.push(protobuf(channels::TRANSFORM, &transform));
        let ellipse = ellipse_of(estimate, timestamp);
        messages.extend(ellipse.map(|scene| protobuf(channels::ELLIPSE, &scene)));
        self.path.push(pose);
        if is_due(&mut self.path.written, now, PATH_PERIOD) {
            let path = wire::PosesInFrame { timestamp, frame_id: ARENA.to_owned(), poses: self.path.poses.clone() };
            messages.push(protobuf(channels::PATH, &path));
        }
        messages
    }

    fn fusion(&mut self, now: Stamp<HostClock>, record: &FusionRecord) -> Vec<Message> {
        let last = self.fused.entry((record.sensor, record.kind));
        let is_due = is_due(last.or_default(), now, self.spacing);
        let mut messages = Vec::new();
        if is_due || !matches!(record.verdict, Verdict::Accepted | Verdict::Unused) {
            messages.extend(json(channels::FUSION, &FusedRecord::from(record)));
        }
        if record.verdict == Verdict::ResetTo {
            let text = format!("the estimate was moved to a {}", record.kind);
            messages.push(self.line(now, 4, ("estimator", &text)));
        }
        messages
    }

    fn fix(&self, now: Stamp<HostClock>, observation: &Observation) -> Option<Message> {
        let Observed::Fix(fix) = observation.observed else {
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
        Some(protobuf(channels::FIX, &pose))
    }

    fn brick_clock(&mut self, event: &Event) -> Option<Message> {
        let Event::BrickClockAligned { robot, offset, skew_ppm, uncertainty, round_trip, brick, host } = *event else {
            return None;
        };
        self.alignment = Some(Alignment { host, brick, skew_ppm });
        let record = ClockRecord {
            clock: "brick",
            system: robot.address.system.0,
            component: robot.address.component.0,
            host_nanos: host.as_nanos(),
            other_nanos: brick.as_nanos(),
            offset_s: offset.as_secs_f64(),
            skew_ppm: finite(skew_ppm),
            uncertainty_s: uncertainty.as_secs_f64(),
            round_trip_s: round_trip.map(Span::as_secs_f64),
        };
        json(channels::CLOCK, &record)
    }

    /// What a person would want to read of an event.
    fn line_of(&self, now: Stamp<HostClock>, event: &Event) -> Option<Message> {
        let (severity, name, text) = match event {
            Event::RobotSeen { robot } => (6, "session", format!("robot {robot} was heard")),
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
                return Some(self.line(now, *severity, (&source.to_string(), text)));
            }
            Event::Observed { .. }
            | Event::Fused { .. }
            | Event::Estimated { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Health { .. }
            | Event::Defect { .. } => return None,
        };
        Some(self.line(now, severity, (name, &text)))
    }

    /// When the host's clock showed what the brick's does; `None` before the first alignment.
    fn host_time(&self, brick: Stamp<BrickClock>) -> Option<Stamp<HostClock>> {
        let Alignment { host, brick: zero, skew_ppm } = self.alignment?;
        let since_s = (brick - zero).as_secs_f64() / (1.0 + 1e-6 * skew_ppm);
        Some(host + Span::from_secs_f64(since_s))
    }

    /// UTC.
    fn time(&self, at: Stamp<HostClock>) -> wire::Timestamp {
        let nanos = i128::from(self.zero_nanos) + i128::from(at.as_nanos());
        wire::Timestamp {
            seconds: nanos.div_euclid(1_000_000_000) as i64,
            nanos: nanos.rem_euclid(1_000_000_000) as i32,
        }
    }
}

impl Path {
    fn push(&mut self, pose: wire::Pose) {
        self.stride = self.stride.max(1);
        if self.seen.is_multiple_of(self.stride) {
            self.poses.push(pose);
        }
        self.seen += 1;
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

/// A request of a person or a program as a message.
pub(crate) fn command(command: &Command) -> Option<Message> {
    json(channels::COMMAND, &CommandRecord::from(command))
}

/// What the filter has learned as a message.
pub(crate) fn calibration(calibration: &Calibration) -> Option<Message> {
    json(channels::CALIBRATION, &CalibrationRecord::from(calibration))
}

/// Inputs that are missing as a message.
pub(crate) fn gap(gap: &Gap) -> Option<Message> {
    json(channels::GAP, &GapRecord::from(gap))
}

/// Whether something is due again; the first time it is.
fn is_due(last: &mut Option<Stamp<HostClock>>, now: Stamp<HostClock>, spacing: Span) -> bool {
    let is_due = last.is_none_or(|last| now - last >= spacing);
    if is_due {
        *last = Some(now);
    }
    is_due
}

fn camera_clock(event: &Event) -> Option<Message> {
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
    json(channels::CLOCK, &record)
}

fn temperature(event: &Event) -> Option<Message> {
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
    json(channels::TEMPERATURE, &record)
}

fn protobuf(channel: Channel, message: &impl prost::Message) -> Message {
    let data = message.encode_to_vec();
    Message { channel, data }
}

/// A record as JSON. It has numbers, texts and lists alone, so that there is always one.
fn json(channel: Channel, record: &impl Serialize) -> Option<Message> {
    let data = serde_json::to_vec(record).ok()?;
    Some(Message { channel, data })
}

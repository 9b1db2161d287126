//! The NXT as a brick protocol: sends due requests, passes replies to `replies.rs`, and reports losses and silence.

use std::collections::{BTreeMap, VecDeque};

use posebridge_telemetry::severity::{INFO, NOTICE, WARNING};
use posebridge_telemetry::{Address, HostClock, ReceiveError, SourceHealth, TimeDelta, Timestamp};

use super::digital::DigitalSensor;
use super::estimate::{EstimateMailbox, PUSHED_INTERVAL};
use super::framer::{TelegramFramer, TelegramPart};
use super::gyro::AnalogGyro;
use super::motors::{MotorReadings, PendingAccelerations, TickClock, WheelTotals};
use super::poll_schedule::{PollSchedule, PortState, ReadSize, RequestFailure, ScheduleChange};
use super::requests::{NxtRequest, ReplyMatch, RequestTracker};
use super::settings::{NxtSensor, NxtSettings, WheelSource};
use super::telegram::{NxtReply, framed, keep_alive};
use crate::bricks::codec::{
    BrickCodec, CodecEvent, CodecEventSink, CodecSettings, DEFAULT_BRICK_ADDRESS, HeartbeatSource,
};
use crate::bricks::mavlink;
use crate::framing::{FramerConfig, FramerCounters, START_BYTE_V2, TransportKind};
use crate::message::{Heartbeat, Message, PlanarPose, WireStamp};

/// The brick switches itself off after ten minutes without certain commands; each of these restarts that time.
const KEEP_ALIVE_PERIOD: TimeDelta = TimeDelta::from_millis(60_000);

/// Number of consecutive sync requests without a reply, with or without frames, that means that a pushing program has
/// taken over the link: leJOS answers none of LEGO's commands, and would receive ours as its own input.
const MAX_UNANSWERED_BARRIERS: u8 = 4;

#[derive(Debug)]
pub(super) struct NxtCodec {
    pub(super) settings: NxtSettings,
    pub(super) brick: Address,
    framer: TelegramFramer,
    requests: RequestTracker,
    pub(super) schedule: PollSchedule,
    outbox: VecDeque<Vec<u8>>,
    is_started: bool,
    /// The next request, delayed while an equal one is outstanding.
    held_request: Option<NxtRequest>,
    /// Consecutive barriers without a reply.
    lost_barriers: u8,
    next_keep_alive: Timestamp<HostClock>,
    presence: BrickLiveness,
    heartbeat: HeartbeatSource,
    pub(super) clock: TickClock,
    /// Replies since the last host timestamp that replaced the brick's.
    pub(super) replies_since_host_tick: u8,
    pub(super) motors: MotorReadings,
    pub(super) totals: WheelTotals,
    pub(super) gyro: Option<(u8, AnalogGyro)>,
    pub(super) devices: [Option<DigitalSensor>; 4],
    pub(super) accelerations: PendingAccelerations,
    pub(super) mailbox: EstimateMailbox,
    /// Without those whose cause no longer exists: then the same text is emitted again.
    pub(super) last_texts: BTreeMap<StatusTopic, String>,
    /// Decodes the frames that a program on the brick sends.
    frames: Option<Box<dyn BrickCodec>>,
    damage_counters: FramerCounters,
}

/// Polls the brick; needs no program on it.
pub(in crate::bricks) fn open(settings: &CodecSettings) -> Box<dyn BrickCodec> {
    Box::new(NxtCodec::new(&settings.nxt, None))
}

/// A program on the brick pushes MAVLink frames; only the clock is polled.
pub(in crate::bricks) fn open_push(settings: &CodecSettings) -> Box<dyn BrickCodec> {
    let frames = mavlink::open(&CodecSettings {
        framer: FramerConfig {
            // A frame in each telegram: there is nothing to look for.
            transport: TransportKind::Datagram,
            ..settings.framer
        },
        ..settings.clone()
    });
    Box::new(NxtCodec::new(&settings.nxt, Some(frames)))
}

impl NxtCodec {
    fn new(settings: &NxtSettings, frames: Option<Box<dyn BrickCodec>>) -> Self {
        let source = if frames.is_some() { WheelSource::Pushed } else { WheelSource::Polled };
        let interval = settings.estimate_interval.unwrap_or(match source {
            WheelSource::Polled => TimeDelta::ZERO,
            WheelSource::Pushed => PUSHED_INTERVAL,
        });
        let gyro = (0..4).zip(settings.sensors).find_map(|(port, sensor)| {
            let gyro = AnalogGyro::new(settings.gyro_rest_counts, settings.gyro_sign);
            (sensor == NxtSensor::HtGyro).then_some((port, gyro))
        });
        Self {
            brick: DEFAULT_BRICK_ADDRESS,
            framer: TelegramFramer::new(source),
            requests: RequestTracker::new(settings.answer_timeout),
            schedule: PollSchedule::new(settings, source, Timestamp::ZERO),
            outbox: VecDeque::new(),
            is_started: false,
            held_request: None,
            lost_barriers: 0,
            next_keep_alive: Timestamp::ZERO,
            presence: BrickLiveness::default(),
            heartbeat: HeartbeatSource::new(Heartbeat::ROVER),
            clock: TickClock::default(),
            replies_since_host_tick: 0,
            motors: MotorReadings::default(),
            totals: WheelTotals::default(),
            gyro,
            devices: settings.sensors.map(DigitalSensor::new),
            accelerations: PendingAccelerations::default(),
            mailbox: EstimateMailbox::new(settings.mailbox, interval),
            last_texts: BTreeMap::new(),
            frames,
            damage_counters: FramerCounters::default(),
            settings: settings.clone(),
        }
    }

    /// Emits a text unless it repeats the last one of its topic.
    pub(super) fn report(
        &mut self,
        topic: StatusTopic,
        severity: u8,
        text: impl Into<String>,
        sink: CodecEventSink<'_>,
    ) {
        let text = text.into();
        if self.last_texts.insert(topic, text.clone()).as_ref() != Some(&text) {
            sink(CodecEvent::StatusText { from: self.brick, severity, text });
        }
    }

    fn expire(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        if let Some(part) = self.framer.expire(now) {
            self.handle(now, part, sink);
        }
        while let Some(request) = self.requests.expire(now) {
            self.damage_counters.stalls += 1;
            if request == NxtRequest::SyncBarrier {
                self.handle_barrier_timeout(sink);
            }
            self.handle_timeout(&request, sink);
        }
        if self.presence.expire(now) {
            let text = "the NXT has not answered for two seconds";
            self.report(StatusTopic::Presence, WARNING, text, sink);
        }
    }

    fn handle(&mut self, now: Timestamp<HostClock>, piece: TelegramPart, sink: CodecEventSink<'_>) {
        match piece {
            TelegramPart::OutOfSync { bytes } => {
                self.damage_counters.garbage_bytes += bytes as u64;
                sink(CodecEvent::Error(ReceiveError::UnframedBytes { bytes: bytes as u32 }));
                for request in self.requests.abort_all() {
                    self.handle_timeout(&request, sink);
                }
            }
            TelegramPart::Foreign(telegram) => self.handle_foreign(now, &telegram, sink),
            TelegramPart::Telegram(telegram) if telegram.first() == Some(&START_BYTE_V2) => {
                self.handle_frame(now, &telegram, sink);
            }
            TelegramPart::Telegram(telegram) => {
                // A program's message to a mailbox of ours has no receiver here.
                if let Some(reply) = NxtReply::parse(&telegram) {
                    self.match_reply(now, &reply, sink);
                }
            }
        }
    }

    /// A program on the brick sent a telegram for another receiver.
    fn handle_foreign(&mut self, now: Timestamp<HostClock>, telegram: &[u8], sink: CodecEventSink<'_>) {
        self.damage_counters.unknown_ids += 1;
        // Whether or not it replies, it is there, and the possible reason for no reply is reported.
        self.presence.record_activity(now);
        let text = if telegram.first() == Some(&START_BYTE_V2) {
            "a program on the NXT sends MAVLink frames, which are not read as it is asked: try --brick nxt-push"
        } else {
            "a program on the NXT sends messages of its own, which are skipped; if they are to be MAVLink frames, try --brick nxt-push"
        };
        self.report(StatusTopic::ForeignMessages, NOTICE, text, sink);
    }

    fn handle_frame(&mut self, now: Timestamp<HostClock>, frame: &[u8], sink: CodecEventSink<'_>) {
        let Some(frames) = &mut self.frames else {
            return;
        };
        let brick = &mut self.brick;
        let mut has_message = false;
        frames.push(now, frame, &mut |event| {
            if let CodecEvent::Message { from, .. } = &event {
                // Clock replies must have the address that the program sends for.
                *brick = *from;
                has_message = true;
            }
            sink(event);
        });
        if has_message {
            self.record_activity(now, sink);
        }
    }

    fn match_reply(&mut self, now: Timestamp<HostClock>, reply: &NxtReply<'_>, sink: CodecEventSink<'_>) {
        self.lost_barriers = 0;
        match self.requests.match_reply(reply) {
            ReplyMatch::Reply(request) => self.handle_reply(now, &request, reply, sink),
            ReplyMatch::TooLate | ReplyMatch::Unexpected => self.report_late(sink),
        }
        self.record_activity(now, sink);
    }

    fn record_activity(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        if self.presence.record_reply(now) {
            self.report(StatusTopic::Presence, NOTICE, "the NXT answers again", sink);
            // It may be another program, or the brick without one: requests that the old one left unanswered say nothing about it.
            self.lost_barriers = 0;
            self.schedule.try_tick_again(now);
        }
        if let Some(message) = self.heartbeat.heartbeat_if_due(now) {
            sink(CodecEvent::Message { from: self.brick, message });
        }
    }

    /// Reports the number of late replies, each time that it doubles.
    fn report_late(&mut self, sink: CodecEventSink<'_>) {
        let late = self.requests.counts().late;
        if late.is_power_of_two() {
            let limit = self.settings.answer_timeout.as_millis_f64();
            let text = format!("{late} answers so far came later than {limit:.0} ms and were not used");
            self.report(StatusTopic::LateReplies, INFO, text, sink);
        }
    }

    /// A barrier had no reply within the time-out. If noise interrupted it, that is no evidence about what answers.
    fn handle_barrier_timeout(&mut self, sink: CodecEventSink<'_>) {
        self.lost_barriers = self.lost_barriers.saturating_add(1);
        if self.is_blocked_by_program() {
            let text = "the program on the NXT answers no commands: its clock is known by its frames alone";
            self.report(StatusTopic::Clock, NOTICE, text, sink);
        }
    }

    fn handle_timeout(&mut self, request: &NxtRequest, sink: CodecEventSink<'_>) {
        if *request == NxtRequest::SyncBarrier {
            return;
        }
        sink(CodecEvent::Error(ReceiveError::SequenceGap { source: self.brick, frames: 1 }));
        self.handle_failure(request, RequestFailure::Lost, sink);
    }

    pub(super) fn handle_failure(&mut self, request: &NxtRequest, why: RequestFailure, sink: CodecEventSink<'_>) {
        match self.schedule.record_failure(request, why) {
            None => {}
            Some(ScheduleChange::ReadSize) => {
                let text = match self.schedule.read_size() {
                    ReadSize::Complete | ReadSize::Partial => {
                        "this NXT's firmware gives IO maps only in pieces: fewer readings per second"
                    }
                    ReadSize::Single => {
                        "this NXT's firmware gives no IO maps: every motor and port is asked alone, at a fraction of the rate"
                    }
                };
                self.report(StatusTopic::IoMaps, WARNING, text, sink);
            }
            Some(ScheduleChange::Outstanding) => {
                let text = "this NXT does not answer two questions at a time: asking one by one";
                self.report(StatusTopic::Outstanding, NOTICE, text, sink);
            }
            Some(ScheduleChange::Tick) => {
                let text = "this NXT does not tell its clock: readings bear the station's time";
                self.report(StatusTopic::Clock, WARNING, text, sink);
            }
            Some(ScheduleChange::Battery) => {
                self.report(StatusTopic::Battery, INFO, "this NXT does not report the voltage of its battery", sink);
            }
        }
    }

    /// Whether a pushing program leaves all requests without a reply, so that none is sent any more.
    fn is_blocked_by_program(&self) -> bool {
        self.frames.is_some() && self.lost_barriers >= MAX_UNANSWERED_BARRIERS
    }

    fn send_requests(&mut self, now: Timestamp<HostClock>) {
        if !self.is_started || self.framer.is_draining() || self.is_blocked_by_program() {
            return;
        }
        while self.requests.has_capacity(self.schedule.max_outstanding()) {
            let Some(request) = self.next_request(now) else {
                return;
            };
            if self.requests.is_waiting_for(&request) {
                self.held_request = Some(request);
                return;
            }
            if let Some(carried) = self.next_piggyback(now) {
                self.send(&carried);
            }
            self.send(&request.telegram());
            self.requests.record_sent(request, now);
        }
    }

    fn next_request(&mut self, now: Timestamp<HostClock>) -> Option<NxtRequest> {
        if self.requests.needs_barrier() {
            return Some(NxtRequest::SyncBarrier);
        }
        if let Some(held) = self.held_request.take() {
            return Some(held);
        }
        if self.schedule.is_read_size_known()
            && let Some(probe) = self.mailbox.take_probe(now)
        {
            return Some(NxtRequest::Mailbox(probe));
        }
        let pending_ports: Vec<u8> = (0..4)
            .zip(&self.devices)
            .filter(|(_, device)| device.is_some_and(|device| device.pending_since().is_some()))
            .map(|(port, _)| port)
            .collect();
        self.schedule.next_request(now, &pending_ports)
    }

    /// A telegram without a reply that is sent before a request, so that the brick never has more than two of ours at a
    /// time.
    fn next_piggyback(&mut self, now: Timestamp<HostClock>) -> Option<Vec<u8>> {
        if self.requests.needs_barrier() {
            return None;
        }
        if now >= self.next_keep_alive {
            self.next_keep_alive = now + KEEP_ALIVE_PERIOD;
            return Some(keep_alive());
        }
        let ports = (0..4).zip(&mut self.devices).zip(self.schedule.ports);
        for ((port, device), state) in ports {
            if state == PortState::Ready
                && let Some(device) = device
                && let Some(telegram) = device.write(port, now)
            {
                return Some(telegram);
            }
        }
        None
    }

    fn send(&mut self, telegram: &[u8]) {
        self.outbox.push_back(framed(telegram));
    }
}

impl BrickCodec for NxtCodec {
    fn on_link_up(&mut self, now: Timestamp<HostClock>) {
        self.is_started = true;
        let source = self.schedule.source;
        self.framer = TelegramFramer::new(source);
        self.requests.restart();
        self.held_request = None;
        self.lost_barriers = 0;
        self.outbox.clear();
        self.schedule = PollSchedule::new(&self.settings, source, now);
        self.presence.reset(now);
        self.mailbox.reset();
        self.motors = MotorReadings::default();
        self.next_keep_alive = now;
        if let Some(frames) = &mut self.frames {
            frames.on_link_up(now);
        }
        self.send_requests(now);
    }

    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: CodecEventSink<'_>) {
        self.expire(now, sink);
        let mut found = Vec::new();
        self.framer.push(now, bytes, &mut found);
        for piece in found {
            self.handle(now, piece, sink);
        }
        self.send_requests(now);
    }

    fn deadline(&self) -> Option<Timestamp<HostClock>> {
        if !self.is_started {
            return None;
        }
        let is_free = !self.framer.is_draining()
            && !self.is_blocked_by_program()
            && self.held_request.is_none()
            && self.requests.has_capacity(self.schedule.max_outstanding());
        [
            self.framer.deadline(),
            self.requests.deadline(),
            self.presence.deadline(),
            self.schedule.next_wake().filter(|_| is_free),
        ]
        .into_iter()
        .flatten()
        .min()
    }

    fn tick(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        self.expire(now, sink);
        self.send_requests(now);
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        self.outbox.pop_front()
    }

    fn encode(&mut self, now: Timestamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        let Message::PlanarPose(pose) = message else {
            return 0;
        };
        let brick_millis = self.millis_of(pose);
        let Some(telegram) = self.mailbox.publish(now, pose, brick_millis) else {
            return 0;
        };
        let bytes = framed(&telegram);
        out.extend_from_slice(&bytes);
        bytes.len()
    }

    fn counters(&self) -> FramerCounters {
        let mut counters = self.damage_counters;
        counters.frames = self.requests.counts().answered;
        match &self.frames {
            Some(frames) => counters.merged(&frames.counters()),
            None => counters,
        }
    }

    fn source_health(&self) -> Vec<SourceHealth> {
        if let Some(frames) = &self.frames {
            return frames.source_health();
        }
        let tally = self.requests.counts();
        if tally.answered == 0 {
            return Vec::new();
        }
        vec![SourceHealth { source: self.brick, frames: tally.answered, lost: tally.lost }]
    }
}

impl NxtCodec {
    /// The brick's tick for the instant of an estimate.
    fn millis_of(&self, pose: &PlanarPose) -> u32 {
        match pose.stamp {
            WireStamp::Micros32(micros) => self.clock.millis_of(micros),
            WireStamp::Millis32(millis) => millis,
            WireStamp::Micros64(_) | WireStamp::HostInterval { .. } => (pose.stamp.as_micros() / 1_000) as u32,
        }
    }
}

/// Silence after which the brick counts as lost for the session: LEGO's own limit of two seconds.
const LOST_AFTER: TimeDelta = TimeDelta::from_millis(2_000);

/// Detects from its replies whether the brick is alive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BrickLiveness {
    last_reply: Option<Timestamp<HostClock>>,
    is_lost: bool,
}

impl BrickLiveness {
    /// The link came up: the time-out starts again.
    pub(super) const fn reset(&mut self, now: Timestamp<HostClock>) {
        self.last_reply = Some(now);
        self.is_lost = false;
    }

    /// A reply was received; true if the brick was lost before.
    pub(super) const fn record_reply(&mut self, now: Timestamp<HostClock>) -> bool {
        self.last_reply = Some(now);
        std::mem::replace(&mut self.is_lost, false)
    }

    /// Something else than a reply was received.
    const fn record_activity(&mut self, now: Timestamp<HostClock>) {
        if !self.is_lost {
            self.last_reply = Some(now);
        }
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let last = self.last_reply.filter(|_| !self.is_lost)?;
        Some(last + LOST_AFTER)
    }

    /// True once when the brick is lost.
    pub(super) fn expire(&mut self, now: Timestamp<HostClock>) -> bool {
        let is_lost = self.deadline().is_some_and(|due| due <= now);
        self.is_lost |= is_lost;
        is_lost
    }
}

/// The subject of a status text; a new text replaces the previous one of its subject.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum StatusTopic {
    Presence,
    Firmware,
    Clock,
    IoMaps,
    Motors,
    Outstanding,
    Program,
    LateReplies,
    ForeignMessages,
    Battery,
    Gyro,
    /// A sensor port, 0 to 3.
    Port(u8),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_brick_is_lost_after_two_seconds_and_back_with_its_next_answer() {
        let at = Timestamp::from_millis;
        let mut presence = BrickLiveness::default();
        assert_eq!(presence.deadline(), None);
        presence.reset(at(0));
        assert!(!presence.record_reply(at(1_950)));
        assert!(!presence.expire(at(3_949)) && presence.expire(at(3_950)) && !presence.expire(at(9_000)));
        assert_eq!(presence.deadline(), None);
        assert!(presence.record_reply(at(9_000)));
    }
}

//! The LEGO MINDSTORMS EV3 as it comes out of the box: polled by direct commands, without a program on the brick.
//!
//! One telegram reads the brick's clock, both motors and the sensors, so all values have the brick's own timestamp, and
//! the round trip of the request bounds its clock. SPEC.md beside this file defines the bytes. The same telegrams are
//! used over Bluetooth (RFCOMM), USB and, after a greeting, WiFi (TCP).

mod cycle;
mod replies;
mod sensors;
mod settings;
mod stamps;
mod telegrams;

use std::collections::VecDeque;

use posebridge_telemetry::severity::{ERROR, INFO, WARNING};
use posebridge_telemetry::{Address, HostClock, ReceiveError, SourceHealth, TimeDelta, Timestamp};

use self::cycle::{CycleValues, decode_battery, decode_reply, encode_request, sensor_message, wheel_ticks};
use self::replies::{
    Ev3Request, Ev3Telegram, OutstandingRequest, OutstandingRequests, ReplyBody, ReplyFramer, ReplyTiming,
};
use self::sensors::{CycleSensors, SensorBank, SetUpFailure, TurnAccumulator};
pub use self::settings::{
    DistanceKind, DistanceSettings, Ev3Settings, GyroMounting, GyroReading, GyroSettings, MotorDirection, MotorPort,
    SensorPort,
};
use self::stamps::{BrickStamp, StampAdvance, StampChecker};
use self::telegrams::{DirectCommand, encode_estimate, encode_mailbox_write};
use super::battery::BatterySchedule;
use super::codec::{
    BrickCodec, CodecEvent, CodecEventSink, CodecSettings, DEFAULT_BRICK_ADDRESS, HeartbeatSource, emit_message,
    emit_status_text,
};
use super::counters::{CounterUpdate, MotorCounters, MotorCounts, MotorLimits, Standstill};
use crate::framing::FramerCounters;
use crate::message::{Heartbeat, Message};

/// Shortest and longest distance of two telegrams: 50 Hz is more than a Bluetooth link carries, and below 0.1 Hz steering is impossible.
const MIN_CYCLE: TimeDelta = TimeDelta::from_millis(20);
const MAX_CYCLE: TimeDelta = TimeDelta::from_millis(10_000);
/// Most outstanding requests: the brick keeps them in the buffers of its Bluetooth chip.
const MAX_OUTSTANDING: u8 = 4;
/// Time-out of a request; doubled by each one, so that a stalled link does not fill up.
const REPLY_TIMEOUT_MS: i64 = 500;
/// Limit of the doublings: four seconds.
const MAX_TIMEOUT_DOUBLINGS: u32 = 3;
/// How long setting up a sensor may take: changing the mode of an EV3 sensor resets it, about a second.
const SET_UP_TIMEOUT: TimeDelta = TimeDelta::from_millis(3_000);
/// Wheels whose counts have not changed for this long are at rest, and probably stay so during a set-up.
const STANDSTILL_TIME: TimeDelta = TimeDelta::from_millis(1_000);
/// A telegram that is interrupted for longer is incomplete.
const QUIET_TIME: TimeDelta = TimeDelta::from_millis(100);
/// Interval of requests to a brick that refuses even its counters.
const REJECTED_PAUSE: TimeDelta = TimeDelta::from_millis(1_000);
/// No motor of the set is faster, counts of 1 degree per second: 260 rpm of the EV3's medium motor at 9 V without load (Philohome,
/// Pybricks' identified model).
const LIMITS: MotorLimits = MotorLimits { max_counts_per_s: 1_600.0, margin: 3.0 };
/// The message id of a reply in [`ReceiveError::Payload`]: its type on the wire.
const ANSWER_ID: u32 = 0x02;

#[derive(Debug)]
struct Ev3Codec {
    settings: Ev3Settings,
    /// Nothing is requested before the link is up.
    is_up: bool,
    framer: ReplyFramer,
    last_byte: Timestamp<HostClock>,
    /// Bytes that are no telegram were received: the reply that they were will not come.
    is_damaged: bool,
    requests: OutstandingRequests,
    sensors: SensorBank,
    battery: BatterySchedule,
    stamps: StampChecker,
    counters: MotorCounters,
    standstill: Standstill,
    turn: TurnAccumulator,
    heartbeat: HeartbeatSource,
    /// Consecutive requests without a reply.
    timeouts: u32,
    next_cycle: Timestamp<HostClock>,
    /// When a request can be sent that must wait now.
    wake: Option<Timestamp<HostClock>>,
    outbox: VecDeque<Vec<u8>>,
    counts: FramerCounters,
    lost: u64,
    is_rejection_reported: bool,
    estimates_sent: u16,
}

#[derive(Clone, Copy, Debug)]
struct CycleReply {
    sent: Timestamp<HostClock>,
    timing: ReplyTiming,
    sensors: CycleSensors,
    values: CycleValues,
}

pub(super) fn open(settings: &CodecSettings) -> Box<dyn BrickCodec> {
    let settings = settings.ev3.clone();
    Box::new(Ev3Codec {
        sensors: SensorBank::new(&settings, Timestamp::ZERO),
        battery: BatterySchedule::new(Timestamp::ZERO),
        settings,
        is_up: false,
        framer: ReplyFramer::default(),
        last_byte: Timestamp::ZERO,
        is_damaged: false,
        requests: OutstandingRequests::default(),
        stamps: StampChecker::default(),
        counters: MotorCounters::new(LIMITS),
        standstill: Standstill::default(),
        turn: TurnAccumulator::default(),
        heartbeat: HeartbeatSource::new(Heartbeat::ROVER),
        timeouts: 0,
        next_cycle: Timestamp::ZERO,
        wake: None,
        outbox: VecDeque::new(),
        counts: FramerCounters::default(),
        lost: 0,
        is_rejection_reported: false,
        estimates_sent: 0,
    })
}

impl BrickCodec for Ev3Codec {
    fn on_link_up(&mut self, now: Timestamp<HostClock>) {
        self.framer.clear();
        self.requests.clear();
        self.outbox.clear();
        // Clock and counters are those of the brick, which may well have run on while the link was down.
        self.sensors = SensorBank::new(&self.settings, now);
        self.battery = BatterySchedule::new(now);
        self.is_damaged = false;
        self.is_rejection_reported = false;
        self.timeouts = 0;
        self.standstill = Standstill::default();
        self.next_cycle = now;
        self.is_up = true;
        self.send_requests(now);
    }

    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: CodecEventSink<'_>) {
        self.last_byte = now;
        self.framer.push(bytes);
        self.process_replies(now, sink);
        self.send_requests(now);
    }

    fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let quiet = self.is_awaiting_quiet().then(|| self.last_byte + QUIET_TIME);
        let all = [quiet, self.requests.deadline(), self.wake];
        all.into_iter().flatten().min()
    }

    fn tick(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        if self.is_awaiting_quiet() && self.last_byte + QUIET_TIME <= now {
            self.abandon_damaged(now, sink);
        }
        while let Some(request) = self.requests.expired(now) {
            self.record_timeout(request, sink);
            if let Ev3Request::SetUp(index) = request
                && let Some(text) = self.sensors.is_absent(index, now, SetUpFailure::TimedOut)
            {
                emit_status_text(sink, WARNING, text);
            }
        }
        self.send_requests(now);
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        self.outbox.pop_front()
    }

    fn encode(&mut self, _now: Timestamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        let (Message::PlanarPose(pose), Some(name), true) = (message, &self.settings.mailbox, self.is_up) else {
            return 0;
        };
        let Some(payload) = encode_estimate(pose, self.estimates_sent) else {
            return 0;
        };
        self.estimates_sent = self.estimates_sent.wrapping_add(1);
        let telegram = encode_mailbox_write(self.requests.allocate_counter(), name, &payload);
        out.extend_from_slice(&telegram);
        telegram.len()
    }

    fn counters(&self) -> FramerCounters {
        self.counts
    }

    fn source_health(&self) -> Vec<SourceHealth> {
        let health = SourceHealth { source: DEFAULT_BRICK_ADDRESS, frames: self.counts.frames, lost: self.lost };
        (self.counts.frames + self.lost > 0).then_some(health).into_iter().collect()
    }
}

impl Ev3Codec {
    /// Sends as many requests as allowed, and sets the time of the next.
    fn send_requests(&mut self, now: Timestamp<HostClock>) {
        self.wake = None;
        if !self.is_up {
            return;
        }
        let most = usize::from(self.settings.outstanding.clamp(1, MAX_OUTSTANDING));
        while self.requests.waiting() < most {
            if let Some(index) = self.sensors.next_pending(now, self.standstill.wheel_state(now, STANDSTILL_TIME)) {
                // Alone: the brick stands still while a sensor changes over.
                if self.requests.waiting() == 0 {
                    self.request_set_up(now, index);
                }
                return;
            }
            if self.next_cycle > now {
                self.wake = Some(self.next_cycle);
                break;
            }
            if self.battery.take_due(now) {
                self.request_battery(now);
            } else {
                self.request_cycle(now);
            }
        }
        let again = self.sensors.deadline().filter(|again| *again > now);
        self.wake = [self.wake, again].into_iter().flatten().min();
    }

    fn request_set_up(&mut self, now: Timestamp<HostClock>, index: usize) {
        let mut command = DirectCommand::default();
        self.sensors.write_set_up(index, &mut command);
        self.send(now, Ev3Request::SetUp(index), &command, SET_UP_TIMEOUT);
    }

    fn request_cycle(&mut self, now: Timestamp<HostClock>) {
        let (command, included) = encode_request(&self.settings, &self.sensors);
        self.next_cycle = now + self.cycle_period();
        self.send(now, Ev3Request::Cycle(included), &command, self.patience());
    }

    /// Alone, so that a brick that refuses it refuses nothing else.
    fn request_battery(&mut self, now: Timestamp<HostClock>) {
        let mut command = DirectCommand::default();
        command.read_battery();
        self.send(now, Ev3Request::Battery, &command, self.patience());
    }

    fn patience(&self) -> TimeDelta {
        TimeDelta::from_millis(REPLY_TIMEOUT_MS << self.timeouts.min(MAX_TIMEOUT_DOUBLINGS))
    }

    fn send(&mut self, now: Timestamp<HostClock>, request: Ev3Request, command: &DirectCommand, patience: TimeDelta) {
        let counter = self.requests.record_sent(request, command.reply_bytes(), now, patience);
        self.outbox.push_back(command.telegram(counter));
    }

    fn cycle_period(&self) -> TimeDelta {
        let period = TimeDelta::from_secs_f64(1.0 / self.settings.rate_hz);
        period.clamp(MIN_CYCLE, MAX_CYCLE)
    }
}

fn begins_with_number(values: &[u8]) -> bool {
    values.first_chunk().is_some_and(|first| f32::from_le_bytes(*first).is_finite())
}

impl Ev3Codec {
    fn is_awaiting_quiet(&self) -> bool {
        self.framer.waiting_bytes() > 0 || self.is_damaged
    }

    fn process_replies(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        loop {
            let requests = &self.requests;
            let values_of = |counter| requests.values_of(counter);
            match self.framer.next_telegram(&values_of) {
                None => return,
                Some(Ev3Telegram::UnframedBytes(bytes)) => {
                    self.counts.garbage_bytes += u64::from(bytes);
                    self.is_damaged = self.requests.waiting() > 0;
                    sink(CodecEvent::Error(ReceiveError::UnframedBytes { bytes }));
                }
                Some(Ev3Telegram::Mailbox) => {
                    self.counts.frames += 1;
                    self.counts.unknown_ids += 1;
                }
                Some(Ev3Telegram::Reply { counter, answer }) => {
                    if let Some((request, timing)) = self.requests.match_reply(counter) {
                        while let Some(overtaken) = self.requests.pop_overtaken(&request) {
                            self.record_timeout(overtaken, sink);
                        }
                        self.record_reply(now, timing, sink);
                        self.handle_reply(now, &request, timing, &answer, sink);
                    }
                }
            }
        }
    }

    fn record_reply(&mut self, now: Timestamp<HostClock>, timing: ReplyTiming, sink: CodecEventSink<'_>) {
        self.counts.frames += 1;
        self.timeouts = 0;
        if timing == ReplyTiming::Late {
            self.counts.stalls += 1;
            self.lost = self.lost.saturating_sub(1);
        } else {
            self.is_damaged = false;
        }
        if let Some(message) = self.heartbeat.heartbeat_if_due(now) {
            emit_message(sink, message);
        }
    }

    fn handle_reply(
        &mut self,
        now: Timestamp<HostClock>,
        request: &OutstandingRequest,
        timing: ReplyTiming,
        answer: &ReplyBody,
        sink: CodecEventSink<'_>,
    ) {
        match (request.request, answer) {
            (Ev3Request::SetUp(index), ReplyBody::Values(values)) if begins_with_number(values) => {
                self.sensors.is_ready(index);
            }
            (Ev3Request::SetUp(index), ReplyBody::Values(_) | ReplyBody::Rejected) => {
                if let Some(text) = self.sensors.is_absent(index, now, SetUpFailure::Rejected) {
                    emit_status_text(sink, WARNING, text);
                }
            }
            (Ev3Request::Battery, ReplyBody::Rejected) => self.record_battery_failure(sink),
            (Ev3Request::Battery, ReplyBody::Values(values)) => {
                self.battery.record_answer();
                match decode_battery(values) {
                    Some(battery) => emit_message(sink, Message::BatteryStatus(battery)),
                    None => sink(CodecEvent::Error(ReceiveError::Payload { message_id: ANSWER_ID })),
                }
            }
            (Ev3Request::Cycle(included), ReplyBody::Rejected) => self.handle_rejection(now, included, sink),
            (Ev3Request::Cycle(included), ReplyBody::Values(values)) => {
                if let Some(values) = decode_reply(values, included) {
                    self.handle_cycle(now, CycleReply { sent: request.sent, timing, sensors: included, values }, sink);
                }
            }
        }
    }

    fn handle_rejection(&mut self, now: Timestamp<HostClock>, included: CycleSensors, sink: CodecEventSink<'_>) {
        if included != CycleSensors::default() {
            self.sensors.restart_set_up(now);
            return;
        }
        self.next_cycle = now + REJECTED_PAUSE;
        if !std::mem::replace(&mut self.is_rejection_reported, true) {
            let text = "the EV3 refuses to tell its clock and its motors' counts; it is asked again each second";
            emit_status_text(sink, ERROR, text);
        }
    }

    fn handle_cycle(&mut self, now: Timestamp<HostClock>, reply: CycleReply, sink: CodecEventSink<'_>) {
        let values = reply.values;
        let stamped = BrickStamp { micros: values.micros, sent: reply.sent, answered: now };
        let Some(advance) = self.stamps.push(stamped) else {
            sink(CodecEvent::Error(ReceiveError::Payload { message_id: ANSWER_ID }));
            return;
        };
        // The round trip of an abandoned reply is that of a stall, and is not used for predictions.
        if reply.timing == ReplyTiming::OnTime {
            sink(CodecEvent::ClockReply {
                from: DEFAULT_BRICK_ADDRESS,
                sent: reply.sent,
                peer_nanos: i64::from(values.micros) * 1_000,
            });
        }
        let elapsed = match advance {
            StampAdvance::Continuous(elapsed) => elapsed,
            StampAdvance::Stepped(elapsed) => {
                let text = "the clock of the EV3 was set, or the brick was switched off and on; what was read in between counts by the station's time";
                emit_status_text(sink, INFO, text);
                elapsed
            }
        };
        self.standstill.record(values.counts, now);
        if self.handle_counts(now, &values, elapsed, sink) {
            self.handle_sensors(now, &reply, elapsed, sink);
        }
    }

    /// False if a program may have started, so that the sensors may be in other modes than they were set to.
    fn handle_counts(
        &mut self,
        now: Timestamp<HostClock>,
        values: &CycleValues,
        elapsed: TimeDelta,
        sink: CodecEventSink<'_>,
    ) -> bool {
        let counts = MotorCounts { wheels: values.counts, third: None };
        let counted = self.counters.push(elapsed, counts);
        let total = match counted {
            CounterUpdate::Total(total) => total,
            CounterUpdate::Rebased(total) => {
                let text = "the counters of the EV3 began anew, as when a program starts; that is taken for no motion";
                emit_status_text(sink, INFO, text);
                // A program's start puts every sensor into its first mode; the gyro then shows an angle.
                self.sensors.restart_set_up(now);
                total
            }
            CounterUpdate::Rejected => {
                sink(CodecEvent::Error(ReceiveError::Payload { message_id: ANSWER_ID }));
                return false;
            }
        };
        emit_message(sink, wheel_ticks(&self.settings, values.stamp(), total));
        matches!(counted, CounterUpdate::Total(_))
    }

    fn handle_sensors(
        &mut self,
        now: Timestamp<HostClock>,
        reply: &CycleReply,
        elapsed: TimeDelta,
        sink: CodecEventSink<'_>,
    ) {
        let stamp = reply.values.stamp();
        for (index, (role, values)) in reply.sensors.0.iter().zip(reply.values.sensors).enumerate() {
            let Some(role) = role else { continue };
            let shown = values.get(..usize::from(role.value_count())).unwrap_or(&values);
            if let Some(text) = self.sensors.record_reading(index, now, shown) {
                emit_status_text(sink, WARNING, text);
            }
            if let Some(message) = sensor_message(*role, stamp, values, &mut self.turn, elapsed) {
                emit_message(sink, message);
            }
        }
    }

    /// Drops an interrupted telegram, and the requests whose replies it was.
    fn abandon_damaged(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>) {
        let bytes = self.framer.waiting_bytes() as u32;
        if bytes > 0 {
            self.counts.stalls += 1;
            sink(CodecEvent::Error(ReceiveError::Timeout { bytes }));
        }
        while self.framer.waiting_bytes() > 0 {
            self.counts.garbage_bytes += 1;
            self.framer.skip_byte();
            self.process_replies(now, sink);
        }
        self.is_damaged = false;
        while let Some(request) = self.requests.abandon_all() {
            self.record_timeout(request, sink);
        }
    }

    fn record_battery_failure(&mut self, sink: CodecEventSink<'_>) {
        if self.battery.record_failure() {
            emit_status_text(sink, INFO, "this EV3 does not report the voltage of its battery");
        }
    }

    fn record_timeout(&mut self, request: Ev3Request, sink: CodecEventSink<'_>) {
        if request == Ev3Request::Battery {
            self.record_battery_failure(sink);
        }
        self.timeouts = self.timeouts.saturating_add(1);
        self.lost += 1;
        sink(CodecEvent::Error(ReceiveError::SequenceGap { source: DEFAULT_BRICK_ADDRESS, frames: 1 }));
    }
}

//! Outstanding requests with their replies and timeouts ([`RequestTracker`]), and the next request ([`PollSchedule`]).
//!
//! Replies have no number, and a late reply must not be matched to a later request of its kind. The brick answers in order,
//! so after every disturbance one request of another kind is sent, the barrier: its reply proves that every earlier request
//! is answered or lost. The schedule is the first of these that is due: barrier; tick (three at connect, one after every
//! disturbance, one after every nineteenth other request); set-up of ports; the size of reads; the trial with two
//! outstanding; an estimate that requires a reply; a round of bus sensors, motors and analog ports.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::digital::is_digital;
use super::io_maps::{self, ALL_BUFFERS, ALL_INPUTS, ALL_MOTORS, FirmwareModule, IoMapWindow, TICK, parse_reply};
use super::settings::{MaxOutstanding, MotorPort, NxtSensor, NxtSettings, WheelSource};
use super::telegram::{self, NxtReply, bytes_at, opcode};

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum NxtRequest {
    /// Reads the firmware's version, which nothing else does: its reply proves that every earlier request is answered
    /// or lost.
    SyncBarrier,
    IoMap(IoMapWindow),
    Motor(MotorPort),
    Analog(u8),
    Digital(u8),
    SetUp {
        port: u8,
        kind: u8,
    },
    /// Writes this telegram to a mailbox, to detect whether a program reads it.
    Mailbox(Vec<u8>),
}

impl NxtRequest {
    pub(super) fn telegram(&self) -> Vec<u8> {
        match self {
            Self::SyncBarrier => telegram::firmware_version(),
            Self::IoMap(window) => telegram::read_io_map(window.module.id(), window.offset, window.length),
            Self::Motor(port) => telegram::get_output_state(*port),
            Self::Analog(port) => telegram::get_input_values(*port),
            Self::Digital(port) => telegram::ls_read(*port),
            Self::SetUp { port, kind } => telegram::set_input_mode(*port, *kind),
            Self::Mailbox(telegram) => telegram.clone(),
        }
    }

    const fn opcode(&self) -> u8 {
        match self {
            Self::SyncBarrier => opcode::FIRMWARE_VERSION,
            Self::IoMap(_) => opcode::READ_IO_MAP,
            Self::Motor(_) => opcode::GET_OUTPUT_STATE,
            Self::Analog(_) => opcode::GET_INPUT_VALUES,
            Self::Digital(_) => opcode::LS_READ,
            Self::SetUp { .. } => opcode::SET_INPUT_MODE,
            Self::Mailbox(_) => opcode::MESSAGE_WRITE,
        }
    }

    /// Whether a reply can belong to this request: by its opcode, and by the port or the map where the reply repeats
    /// it. A refusal may repeat nothing.
    pub(super) fn matches_reply(&self, reply: &NxtReply<'_>) -> bool {
        if reply.opcode != self.opcode() {
            return false;
        }
        let repeated = bytes_at::<1>(reply.values, 0);
        match self {
            _ if reply.status.0 != 0 => true,
            Self::IoMap(window) => parse_reply(reply)
                .is_some_and(|(module, length, _)| module == window.module.id() && length == window.length),
            Self::Motor(port) => repeated == Some([port.number()]),
            Self::Analog(port) => repeated == Some([*port]),
            Self::SyncBarrier | Self::Digital(_) | Self::SetUp { .. } | Self::Mailbox(_) => true,
        }
    }

    /// True if it is sent in almost every round.
    pub(super) const fn is_for_data(&self) -> bool {
        match self {
            Self::IoMap(window) => !matches!(window.module, FirmwareModule::Command),
            Self::Motor(_) | Self::Analog(_) | Self::Digital(_) => true,
            Self::SyncBarrier | Self::SetUp { .. } | Self::Mailbox(_) => false,
        }
    }
}

/// Most abandoned requests that are remembered; while a barrier is outstanding nothing else is sent, so there are only
/// a few.
const MAX_OVERDUE: usize = 8;

#[derive(Clone, Debug, PartialEq)]
pub(super) struct PendingRequest {
    pub(super) request: NxtRequest,
    pub(super) sent: Timestamp<HostClock>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum ReplyMatch {
    Reply(PendingRequest),
    TooLate,
    Unexpected,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SyncBarrier {
    Clear,
    Needed,
    Pending,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RequestCounts {
    pub(super) answered: u64,
    /// Abandoned requests, barriers excluded.
    pub(super) lost: u64,
    /// Replies to abandoned requests, and to none.
    pub(super) late: u64,
}

#[derive(Debug)]
pub(super) struct RequestTracker {
    timeout: TimeDelta,
    waiting: VecDeque<PendingRequest>,
    overdue: VecDeque<NxtRequest>,
    barrier: SyncBarrier,
    tally: RequestCounts,
}

impl RequestTracker {
    pub(super) const fn new(timeout: TimeDelta) -> Self {
        Self {
            timeout,
            waiting: VecDeque::new(),
            overdue: VecDeque::new(),
            barrier: SyncBarrier::Needed,
            tally: RequestCounts { answered: 0, lost: 0, late: 0 },
        }
    }

    pub(super) fn restart(&mut self) {
        self.waiting.clear();
        self.overdue.clear();
        self.barrier = SyncBarrier::Needed;
    }

    pub(super) fn needs_barrier(&self) -> bool {
        self.barrier == SyncBarrier::Needed
    }

    /// Whether another request may be sent with at most `most` outstanding.
    pub(super) fn has_capacity(&self, most: usize) -> bool {
        match self.barrier {
            SyncBarrier::Clear => self.waiting.len() < most,
            SyncBarrier::Needed => self.waiting.is_empty(),
            SyncBarrier::Pending => false,
        }
    }

    /// Whether an equal request is outstanding. It must not be sent again before: the reply would be ambiguous.
    pub(super) fn is_waiting_for(&self, request: &NxtRequest) -> bool {
        self.waiting.iter().any(|pending| pending.request == *request)
    }

    pub(super) const fn counts(&self) -> RequestCounts {
        self.tally
    }

    pub(super) fn record_sent(&mut self, request: NxtRequest, sent: Timestamp<HostClock>) {
        if request == NxtRequest::SyncBarrier {
            self.barrier = SyncBarrier::Pending;
        }
        self.waiting.push_back(PendingRequest { request, sent });
    }

    pub(super) fn match_reply(&mut self, reply: &NxtReply<'_>) -> ReplyMatch {
        let fits = |request: &NxtRequest| request.matches_reply(reply);
        if NxtRequest::SyncBarrier.matches_reply(reply) {
            return self.match_barrier();
        }
        if let Some(at) = self.overdue.iter().position(fits) {
            self.overdue.remove(at);
            self.tally.late += 1;
            return ReplyMatch::TooLate;
        }
        let found = self.waiting.iter().position(|pending| fits(&pending.request));
        let Some(pending) = found.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return ReplyMatch::Unexpected;
        };
        self.tally.answered += 1;
        ReplyMatch::Reply(pending)
    }

    /// Any reply to a barrier settles all earlier requests.
    fn match_barrier(&mut self) -> ReplyMatch {
        let is_waited_for = self.barrier == SyncBarrier::Pending;
        let waiting = self.waiting.iter().position(|pending| pending.request == NxtRequest::SyncBarrier);
        let Some(pending) = waiting.and_then(|at| self.waiting.remove(at)) else {
            self.tally.late += 1;
            return if is_waited_for { ReplyMatch::TooLate } else { ReplyMatch::Unexpected };
        };
        self.overdue.clear();
        self.barrier = SyncBarrier::Clear;
        self.tally.answered += 1;
        ReplyMatch::Reply(pending)
    }

    /// Abandons the oldest request after the time-out; a barrier must follow.
    pub(super) fn expire(&mut self, now: Timestamp<HostClock>) -> Option<NxtRequest> {
        if self.deadline().is_none_or(|due| due > now) {
            return None;
        }
        let pending = self.waiting.pop_front()?;
        self.abandon(pending.request.clone());
        Some(pending.request)
    }

    /// The stream is out of step: replies to the outstanding requests will not be recognized. Returns these requests.
    pub(super) fn abort_all(&mut self) -> Vec<NxtRequest> {
        let mut lost = Vec::new();
        while let Some(pending) = self.waiting.pop_front() {
            self.abandon(pending.request.clone());
            lost.push(pending.request);
        }
        self.barrier = SyncBarrier::Needed;
        lost
    }

    fn abandon(&mut self, request: NxtRequest) {
        self.barrier = SyncBarrier::Needed;
        if request == NxtRequest::SyncBarrier {
            return;
        }
        self.tally.lost += 1;
        if self.overdue.len() >= MAX_OVERDUE {
            self.overdue.pop_front();
        }
        self.overdue.push_back(request);
    }

    pub(super) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.waiting.front().map(|pending| pending.sent + self.timeout)
    }
}

/// Ticks at connect: the first sets the clock, the others narrow it.
const FIRST_TICKS: u8 = 3;
/// Other requests between two ticks: over Bluetooth, with 30 ms for each, 0.6 s. A clock with an error of 2000 ppm
/// drifts by 1.2 ms in that time, and the ticks cost a twentieth of the readings.
const BETWEEN_TICKS: u8 = 19;
const TRIAL_REQUESTS: u8 = 8;
/// Consecutive refusals or time-outs of one kind of read after which the brick is taken not to support it.
const MAX_FAILURES: u8 = 2;
/// Shortest round over a fast link: the brick counts once in a millisecond, and a turn of a degree takes longer.
const MIN_ROUND: TimeDelta = TimeDelta::from_millis(10);
/// Interval between ticks while a program on the brick pushes the data.
const PUSHED_TICK_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
/// SETINPUTMODE types: LIGHT_INACTIVE gives a raw value without 9 V pulses, LOWSPEED_9V is the bus with 9 V.
const LIGHT_INACTIVE: u8 = 0x06;
const LOWSPEED_9V: u8 = 0x0B;

/// How much of an IO map the brick returns in one reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReadSize {
    /// 119 bytes: a complete module.
    Complete,
    /// 55 bytes: two motors, one port.
    Partial,
    /// None: one command for each motor and port.
    Single,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PortState {
    Unused,
    Unconfigured,
    Configuring,
    /// Set up, without a valid value yet.
    Settling,
    Ready,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RequestFailure {
    Lost,
    Rejected,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ScheduleChange {
    ReadSize,
    Outstanding,
    Tick,
}

#[derive(Debug)]
pub(super) struct PollSchedule {
    pub(super) source: WheelSource,
    wheels: [MotorPort; 2],
    sensors: [NxtSensor; 4],
    pub(super) ports: [PortState; 4],
    read_size: ReadSize,
    is_read_size_known: bool,
    failures: u8,
    /// Requests of the trial that have not been sent, and that have not been answered.
    trial: Option<(u8, u8)>,
    most: usize,
    has_tick: bool,
    is_tick_known: bool,
    tick_failures: u8,
    ticks_remaining: u8,
    since_tick: u8,
    next_tick: Timestamp<HostClock>,
    round: VecDeque<NxtRequest>,
    next_round: Timestamp<HostClock>,
}

impl PollSchedule {
    /// For a link that comes up at `now`: everything is still to be detected.
    pub(super) fn new(settings: &NxtSettings, source: WheelSource, now: Timestamp<HostClock>) -> Self {
        let is_polled = source == WheelSource::Polled;
        let is_tried = is_polled && settings.outstanding == MaxOutstanding::Two;
        let mut schedule = Self {
            source,
            wheels: [settings.left_motor.port, settings.right_motor.port],
            sensors: settings.sensors,
            ports: [PortState::Unused; 4],
            read_size: ReadSize::Complete,
            is_read_size_known: !is_polled,
            failures: 0,
            trial: is_tried.then_some((TRIAL_REQUESTS, TRIAL_REQUESTS)),
            most: 1,
            has_tick: true,
            is_tick_known: false,
            tick_failures: 0,
            ticks_remaining: FIRST_TICKS,
            since_tick: 0,
            next_tick: now,
            round: VecDeque::with_capacity(8),
            next_round: now,
        };
        schedule.set_up_again();
        schedule
    }

    /// The brick has lost its sensor set-up, or may have.
    pub(super) fn set_up_again(&mut self) {
        self.round.clear();
        self.ports = self.sensors.map(|sensor| match (sensor, self.source) {
            (NxtSensor::None, _) | (_, WheelSource::Pushed) => PortState::Unused,
            _ => PortState::Unconfigured,
        });
    }

    /// The brick was away, and may now be able to report its clock.
    pub(super) fn try_tick_again(&mut self, now: Timestamp<HostClock>) {
        if !self.has_tick {
            self.has_tick = true;
            self.tick_failures = 0;
            self.next_tick = now;
        }
    }

    pub(super) fn request_tick(&mut self) {
        self.ticks_remaining = self.ticks_remaining.max(1);
    }

    pub(super) const fn max_outstanding(&self) -> usize {
        self.most
    }

    pub(super) const fn has_tick(&self) -> bool {
        self.has_tick
    }

    pub(super) const fn is_read_size_known(&self) -> bool {
        self.is_read_size_known
    }

    /// The next request of the schedule, barriers and mailbox excluded; `pending_ports` are the bus ports that were written to.
    pub(super) fn next_request(&mut self, now: Timestamp<HostClock>, pending_ports: &[u8]) -> Option<NxtRequest> {
        if let Some(tick) = self.next_tick_request(now) {
            return Some(tick);
        }
        if self.source == WheelSource::Pushed {
            return None;
        }
        if let Some(request) = self.next_set_up() {
            return Some(request);
        }
        if !self.is_read_size_known {
            return self.motors().first().cloned();
        }
        if let Some((unasked @ 1.., unanswered)) = self.trial {
            self.trial = Some((unasked - 1, unanswered));
            self.most = 2;
            return if unasked % 2 == 0 { Some(NxtRequest::IoMap(TICK)) } else { self.motors().first().cloned() };
        }
        if self.round.is_empty() {
            if now < self.next_round {
                return None;
            }
            self.next_round = now + MIN_ROUND;
            self.fill_round(pending_ports);
        }
        self.since_tick = self.since_tick.saturating_add(1);
        self.round.pop_front()
    }

    fn next_tick_request(&mut self, now: Timestamp<HostClock>) -> Option<NxtRequest> {
        if !self.has_tick {
            return None;
        }
        let is_due = match self.source {
            WheelSource::Polled => self.since_tick >= BETWEEN_TICKS,
            WheelSource::Pushed => now >= self.next_tick,
        };
        if self.ticks_remaining == 0 && !is_due {
            return None;
        }
        self.ticks_remaining = self.ticks_remaining.saturating_sub(1);
        self.since_tick = 0;
        self.next_tick = now + PUSHED_TICK_PERIOD;
        Some(NxtRequest::IoMap(TICK))
    }

    fn next_set_up(&mut self) -> Option<NxtRequest> {
        let index = self.ports.iter().position(|port| *port == PortState::Unconfigured)?;
        self.ports[index] = PortState::Configuring;
        let kind = if is_digital(self.sensors[index]) { LOWSPEED_9V } else { LIGHT_INACTIVE };
        let port = index as u8;
        Some(NxtRequest::SetUp { port, kind })
    }

    /// When `next_request` may have a request again if nothing is received before.
    pub(super) fn next_wake(&self) -> Option<Timestamp<HostClock>> {
        match self.source {
            WheelSource::Pushed => self.has_tick.then_some(self.next_tick),
            WheelSource::Polled => Some(self.next_round),
        }
    }

    fn fill_round(&mut self, pending_ports: &[u8]) {
        let inputs: Vec<u8> = (0..4).filter(|port| self.needs_input(*port)).collect();
        let buffers = match self.read_size {
            ReadSize::Complete if pending_ports.is_empty() => Vec::new(),
            ReadSize::Complete => vec![NxtRequest::IoMap(ALL_BUFFERS)],
            ReadSize::Partial => one_request_per_port(pending_ports, |port| NxtRequest::IoMap(io_maps::buffer(port))),
            ReadSize::Single => one_request_per_port(pending_ports, NxtRequest::Digital),
        };
        let analog = match self.read_size {
            ReadSize::Complete if inputs.is_empty() => Vec::new(),
            ReadSize::Complete => vec![NxtRequest::IoMap(ALL_INPUTS)],
            ReadSize::Partial => one_request_per_port(&inputs, |port| NxtRequest::IoMap(io_maps::input(port))),
            ReadSize::Single => one_request_per_port(&inputs, NxtRequest::Analog),
        };
        self.round.extend(buffers);
        self.round.extend(self.motors());
        self.round.extend(analog);
    }

    /// Whether the analog side of a port must be read: for its value, or to check its set-up.
    fn needs_input(&self, port: u8) -> bool {
        let index = usize::from(port);
        let is_analog = self.sensors[index] == NxtSensor::HtGyro;
        self.ports[index] == PortState::Settling || (is_analog && self.ports[index] == PortState::Ready)
    }

    fn motors(&self) -> Vec<NxtRequest> {
        let [left, right] = self.wheels;
        let (first, last) = (left.number().min(right.number()), left.number().max(right.number()));
        match self.read_size {
            ReadSize::Complete => vec![NxtRequest::IoMap(ALL_MOTORS)],
            ReadSize::Partial if last - first == 1 => vec![NxtRequest::IoMap(io_maps::motor_pair(first))],
            ReadSize::Partial => one_request_per_port(&[first, last], |motor| NxtRequest::IoMap(io_maps::motor(motor))),
            ReadSize::Single => self.wheels.map(NxtRequest::Motor).to_vec(),
        }
    }

    pub(super) fn record_success(&mut self, request: &NxtRequest) {
        if request.is_for_data() {
            self.failures = 0;
            if !self.is_read_size_known {
                self.is_read_size_known = true;
                self.round.clear();
            }
        }
        let is_tick = *request == NxtRequest::IoMap(TICK);
        self.is_tick_known |= is_tick;
        if (is_tick || request.is_for_data())
            && let Some((unasked, unanswered)) = self.trial
            && unasked < unanswered
        {
            self.trial = (unanswered > 1).then_some((unasked, unanswered - 1));
        }
    }

    /// A request had no reply, or was refused. Returns the resulting change of the schedule, if any.
    pub(super) fn record_failure(&mut self, request: &NxtRequest, why: RequestFailure) -> Option<ScheduleChange> {
        let is_tick = *request == NxtRequest::IoMap(TICK);
        let is_trial = self.trial.is_some_and(|(unasked, _)| unasked < TRIAL_REQUESTS);
        if is_trial && (is_tick || request.is_for_data()) {
            self.trial = None;
            self.most = 1;
            self.request_tick();
            return Some(ScheduleChange::Outstanding);
        }
        if let NxtRequest::SetUp { port, .. } = request
            && let Some(port) = self.ports.get_mut(usize::from(*port))
        {
            *port = match why {
                RequestFailure::Lost => PortState::Unconfigured,
                // Asking again would give the same answer.
                RequestFailure::Rejected => PortState::Unused,
            };
        }
        if is_tick {
            return self.record_tick_failure();
        }
        if why == RequestFailure::Rejected && matches!(request, NxtRequest::Analog(_) | NxtRequest::Digital(_)) {
            // One sensor is not there. The rest of the round has nothing to do with it.
            return None;
        }
        (request.is_for_data() && self.record_data_failure()).then_some(ScheduleChange::ReadSize)
    }

    fn record_tick_failure(&mut self) -> Option<ScheduleChange> {
        self.request_tick();
        if self.is_tick_known {
            return None;
        }
        self.tick_failures += 1;
        if self.tick_failures < MAX_FAILURES {
            return None;
        }
        self.has_tick = false;
        self.trial = None;
        self.most = 1;
        Some(ScheduleChange::Tick)
    }

    fn record_data_failure(&mut self) -> bool {
        self.round.clear();
        self.failures += 1;
        // What has worked is not given up for two stalls in a row.
        let allowed = if self.is_read_size_known { 2 * MAX_FAILURES } else { MAX_FAILURES };
        if self.failures < allowed {
            return false;
        }
        self.failures = 0;
        let next = match self.read_size {
            ReadSize::Complete => ReadSize::Partial,
            ReadSize::Partial => ReadSize::Single,
            ReadSize::Single => return false,
        };
        self.read_size = next;
        self.is_read_size_known = next == ReadSize::Single;
        true
    }

    pub(super) const fn read_size(&self) -> ReadSize {
        self.read_size
    }
}

fn one_request_per_port(ports: &[u8], request: impl Fn(u8) -> NxtRequest) -> Vec<NxtRequest> {
    ports.iter().map(|port| request(*port)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bricks::nxt::io_maps::{ALL_INPUTS, ALL_MOTORS};

    const VERSION: [u8; 7] = [0x02, 0x88, 0x00, 0x7C, 0x01, 0x1F, 0x01];

    fn motors() -> Vec<u8> {
        let mut telegram = vec![0x02, 0x94, 0x00, 0x01, 0x00, 0x02, 0x00, 0x60, 0x00];
        telegram.resize(9 + 96, 0);
        telegram
    }

    fn begun() -> RequestTracker {
        let mut requests = RequestTracker::new(TimeDelta::from_millis(500));
        requests.record_sent(NxtRequest::SyncBarrier, Timestamp::ZERO);
        requests.match_reply(&NxtReply::parse(&VERSION).unwrap());
        requests
    }

    #[test]
    fn a_late_reply_never_matches_a_later_request() {
        let mut requests = begun();
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::ZERO);
        assert_eq!(requests.deadline(), Some(Timestamp::from_millis(500)));
        assert_eq!(requests.expire(Timestamp::from_millis(499)), None);
        let expired = requests.expire(Timestamp::from_millis(500));
        assert_eq!(expired, Some(NxtRequest::IoMap(ALL_MOTORS)));
        assert!(requests.needs_barrier() && requests.has_capacity(1));

        // Only the barrier may be sent before the fate of the reply is known.
        requests.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500));
        assert!(!requests.has_capacity(2));
        let motors = motors();
        assert_eq!(requests.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::TooLate);
        assert!(matches!(requests.match_reply(&NxtReply::parse(&VERSION).unwrap()), ReplyMatch::Reply(_)));
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(600));
        assert!(matches!(requests.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::Reply(_)));
        let tally = requests.counts();
        assert_eq!((tally.answered, tally.lost, tally.late), (4 - 1, 1, 1));
    }

    #[test]
    fn a_reply_that_never_came_is_forgotten_after_the_barrier() {
        let mut requests = begun();
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::ZERO);
        requests.expire(Timestamp::from_millis(500));
        requests.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500));
        requests.match_reply(&NxtReply::parse(&VERSION).unwrap());
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(530));
        let motors = motors();
        assert!(matches!(
            requests.match_reply(&NxtReply::parse(&motors).unwrap()),
            ReplyMatch::Reply(pending) if pending.sent == Timestamp::from_millis(530)
        ));
    }

    #[test]
    fn replies_match_their_own_request_out_of_two() {
        let mut requests = begun();
        requests.record_sent(NxtRequest::IoMap(ALL_INPUTS), Timestamp::ZERO);
        requests.record_sent(NxtRequest::IoMap(ALL_MOTORS), Timestamp::from_millis(1));
        assert!(!requests.has_capacity(2));
        let motors = motors();
        assert!(matches!(
            requests.match_reply(&NxtReply::parse(&motors).unwrap()),
            ReplyMatch::Reply(pending) if pending.request == NxtRequest::IoMap(ALL_MOTORS)
        ));
        assert_eq!(requests.match_reply(&NxtReply::parse(&motors).unwrap()), ReplyMatch::Unexpected);
        assert_eq!(requests.abort_all(), [NxtRequest::IoMap(ALL_INPUTS)]);
        assert!(requests.needs_barrier());
    }

    #[test]
    fn late_barrier_replies_after_a_stall_do_no_harm() {
        let mut requests = RequestTracker::new(TimeDelta::from_millis(500));
        for half_second in 0..3 {
            requests.record_sent(NxtRequest::SyncBarrier, Timestamp::from_millis(500 * half_second));
            if half_second < 2 {
                requests.expire(Timestamp::from_millis(500 * (half_second + 1)));
            }
        }
        let version = NxtReply::parse(&VERSION).unwrap();
        assert!(matches!(requests.match_reply(&version), ReplyMatch::Reply(_)));
        assert_eq!(requests.match_reply(&version), ReplyMatch::Unexpected);
        assert!(requests.has_capacity(1));
        assert_eq!(requests.counts().lost, 0);
    }
}

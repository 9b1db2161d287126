//! The next request.
//!
//! # Model
//! ```text
//! first of these that is due:
//!   barrier   at connect and after every disturbance
//!   tick      three at connect, one after every disturbance, one after every nineteenth other request
//!   set up    each port with a sensor, after connect and whenever the brick's counters started again
//!   size      how much of an IO map one reply holds: 119 bytes, else 55, else none; until that is known
//!   trial     with two outstanding: four ticks and four reads of the motors, by turns; all eight must be answered
//!   mailbox   an estimate that requires a reply
//!   round     sensors on the bus that were written to, motors, analog ports; at most one round in 10 ms
//! ```

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::digital::is_digital;
use super::io_maps::{self, ALL_BUFFERS, ALL_INPUTS, ALL_MOTORS, TICK};
use super::nxt_request::NxtRequest;
use super::settings::{MaxOutstanding, MotorPort, NxtSensor, NxtSettings};

/// Ticks at connect: the first places the clock, the others narrow it.
const FIRST_TICKS: u8 = 3;
/// Other questions between two ticks: at the pace of Bluetooth, with 30 ms for each, 0.6 s. A clock that is 2000 ppm off drifts
/// by 1.2 ms in that time, and what ticks cost is a twentieth of the states per second.
const BETWEEN_TICKS: u8 = 19;
/// Questions of the trial of two outstanding.
const TRIAL_REQUESTS: u8 = 8;
/// Refusals or time-outs of one kind of read in a row that mean that the brick cannot do it.
const MAX_STRIKES: u8 = 2;
/// Over a quick link more rounds than this say nothing new: the brick counts once in a millisecond, and a turn of a degree takes longer.
const MIN_ROUND: TimeDelta = TimeDelta::from_millis(10);
/// A program on the brick pushes the data; then this is how often its clock is asked.
const PUSHED_TICK_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
/// SETINPUTMODE types: LIGHT_INACTIVE gives a raw value without 9 V pulses, LOWSPEED_9V is the bus with 9 V.
const LIGHT_INACTIVE: u8 = 0x06;
const LOWSPEED_9V: u8 = 0x0B;

/// How much of an IO map the brick gives in one reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReadSize {
    /// 119 bytes: a whole module.
    Whole,
    /// 55 bytes: two motors, one port.
    Partial,
    /// None: one command for each motor and port.
    Single,
}

/// The source of wheel readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WheelSource {
    /// The brick, when it is asked.
    Polled,
    /// A program on it, of itself.
    Pushed,
}

/// Where the set-up of a port stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PortState {
    /// Nothing there.
    Unused,
    /// It must be set up.
    Unconfigured,
    /// It was configured so.
    Configuring,
    /// It was set up and has no valid value yet.
    Settling,
    /// Its values are valid.
    Ready,
}

/// Why a question failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RequestFailure {
    /// No answer came.
    Lost,
    /// The brick said no.
    Rejected,
}

/// What the plan has learnt that the brick cannot do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ScheduleChange {
    /// Give so much of an IO map.
    ReadSize,
    /// Answer two questions that wait at the same time.
    Outstanding,
    /// Give its clock.
    Tick,
}

/// The plan of one link.
#[derive(Debug)]
pub(super) struct PollSchedule {
    source: WheelSource,
    wheels: [MotorPort; 2],
    sensors: [NxtSensor; 4],
    pub(super) ports: [PortState; 4],
    reach: ReadSize,
    is_reach_known: bool,
    strikes: u8,
    outstanding: MaxOutstanding,
    /// Questions of the trial that have not been asked, and that have not been answered.
    trial: Option<(u8, u8)>,
    most: usize,
    has_tick: bool,
    is_tick_known: bool,
    tick_strikes: u8,
    ticks_remaining: u8,
    since_tick: u8,
    next_tick: Timestamp<HostClock>,
    round: VecDeque<NxtRequest>,
    next_round: Timestamp<HostClock>,
}

impl PollSchedule {
    pub(super) fn new(settings: &NxtSettings, source: WheelSource) -> Self {
        Self {
            source,
            wheels: [settings.left_motor.port, settings.right_motor.port],
            sensors: settings.sensors,
            ports: [PortState::Unused; 4],
            reach: ReadSize::Whole,
            is_reach_known: false,
            strikes: 0,
            outstanding: settings.outstanding,
            trial: None,
            most: 1,
            has_tick: true,
            is_tick_known: false,
            tick_strikes: 0,
            ticks_remaining: 0,
            since_tick: 0,
            next_tick: Timestamp::ZERO,
            round: VecDeque::with_capacity(8),
            next_round: Timestamp::ZERO,
        }
    }

    /// The link came up: everything is found out anew.
    pub(super) fn reset(&mut self, now: Timestamp<HostClock>) {
        self.reach = ReadSize::Whole;
        self.is_reach_known = self.source == WheelSource::Pushed;
        self.strikes = 0;
        self.most = 1;
        self.trial = (self.outstanding == MaxOutstanding::Two && self.source == WheelSource::Polled)
            .then_some((TRIAL_REQUESTS, TRIAL_REQUESTS));
        self.has_tick = true;
        self.is_tick_known = false;
        self.tick_strikes = 0;
        self.ticks_remaining = FIRST_TICKS;
        self.since_tick = 0;
        self.next_tick = now;
        self.next_round = now;
        self.set_up_again();
    }

    /// The brick forgot its sensors, or may have.
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
            self.tick_strikes = 0;
            self.next_tick = now;
        }
    }

    /// The clock must be looked at soon.
    pub(super) fn request_tick(&mut self) {
        self.ticks_remaining = self.ticks_remaining.max(1);
    }

    /// How many questions may wait.
    pub(super) const fn max_outstanding(&self) -> usize {
        self.most
    }

    pub(super) const fn has_tick(&self) -> bool {
        self.has_tick
    }

    /// True once it is known how much of an IO map comes in one reply.
    pub(super) const fn is_read_size_known(&self) -> bool {
        self.is_reach_known
    }

    /// The next question of the plan, fences and mailbox apart; `asked` are the ports on the bus that were written to.
    pub(super) fn next_request(&mut self, now: Timestamp<HostClock>, asked: &[u8]) -> Option<NxtRequest> {
        if let Some(tick) = self.next_tick_request(now) {
            return Some(tick);
        }
        if self.source == WheelSource::Pushed {
            return None;
        }
        if let Some(question) = self.next_set_up() {
            return Some(question);
        }
        if !self.is_reach_known {
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
            self.fill_round(asked);
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

    /// When [`PollSchedule::next`] may have a question again if nothing is heard before.
    pub(super) fn next_wake(&self) -> Option<Timestamp<HostClock>> {
        match self.source {
            WheelSource::Pushed => self.has_tick.then_some(self.next_tick),
            WheelSource::Polled => Some(self.next_round),
        }
    }

    fn fill_round(&mut self, asked: &[u8]) {
        let inputs: Vec<u8> = (0..4).filter(|port| self.needs_input(*port)).collect();
        let buffers = match self.reach {
            ReadSize::Whole if asked.is_empty() => Vec::new(),
            ReadSize::Whole => vec![NxtRequest::IoMap(ALL_BUFFERS)],
            ReadSize::Partial => one_request_per_port(asked, |port| NxtRequest::IoMap(io_maps::buffer(port))),
            ReadSize::Single => one_request_per_port(asked, NxtRequest::Digital),
        };
        let analog = match self.reach {
            ReadSize::Whole if inputs.is_empty() => Vec::new(),
            ReadSize::Whole => vec![NxtRequest::IoMap(ALL_INPUTS)],
            ReadSize::Partial => one_request_per_port(&inputs, |port| NxtRequest::IoMap(io_maps::input(port))),
            ReadSize::Single => one_request_per_port(&inputs, NxtRequest::Analog),
        };
        self.round.extend(buffers);
        self.round.extend(self.motors());
        self.round.extend(analog);
    }

    /// Whether the analog side of a port must be read: for its value, or to see whether the port is set up.
    fn needs_input(&self, port: u8) -> bool {
        let index = usize::from(port);
        let is_analog = self.sensors[index] == NxtSensor::HtGyro;
        self.ports[index] == PortState::Settling || (is_analog && self.ports[index] == PortState::Ready)
    }

    fn motors(&self) -> Vec<NxtRequest> {
        let [left, right] = self.wheels;
        let (first, last) = (left.number().min(right.number()), left.number().max(right.number()));
        match self.reach {
            ReadSize::Whole => vec![NxtRequest::IoMap(ALL_MOTORS)],
            ReadSize::Partial if last - first == 1 => vec![NxtRequest::IoMap(io_maps::motor_pair(first))],
            ReadSize::Partial => one_request_per_port(&[first, last], |motor| NxtRequest::IoMap(io_maps::motor(motor))),
            ReadSize::Single => self.wheels.map(NxtRequest::Motor).to_vec(),
        }
    }

    /// A question was answered well.
    pub(super) fn record_success(&mut self, question: &NxtRequest) {
        if question.is_for_data() {
            self.strikes = 0;
            if !self.is_reach_known {
                self.is_reach_known = true;
                self.round.clear();
            }
        }
        let is_tick = *question == NxtRequest::IoMap(TICK);
        self.is_tick_known |= is_tick;
        if (is_tick || question.is_for_data())
            && let Some((unasked, unanswered)) = self.trial
            && unasked < unanswered
        {
            self.trial = (unanswered > 1).then_some((unasked, unanswered - 1));
        }
    }

    /// A question was not answered, or refused. Says whether the plan had to change for it.
    pub(super) fn record_failure(&mut self, question: &NxtRequest, why: RequestFailure) -> Option<ScheduleChange> {
        let is_tick = *question == NxtRequest::IoMap(TICK);
        let is_trial = self.trial.is_some_and(|(unasked, _)| unasked < TRIAL_REQUESTS);
        if is_trial && (is_tick || question.is_for_data()) {
            self.trial = None;
            self.most = 1;
            self.request_tick();
            return Some(ScheduleChange::Outstanding);
        }
        if let NxtRequest::SetUp { port, .. } = question
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
        if why == RequestFailure::Rejected && matches!(question, NxtRequest::Analog(_) | NxtRequest::Digital(_)) {
            // One sensor is not there. The rest of the round has nothing to do with it.
            return None;
        }
        (question.is_for_data() && self.record_data_failure()).then_some(ScheduleChange::ReadSize)
    }

    fn record_tick_failure(&mut self) -> Option<ScheduleChange> {
        self.request_tick();
        if self.is_tick_known {
            return None;
        }
        self.tick_strikes += 1;
        if self.tick_strikes < MAX_STRIKES {
            return None;
        }
        self.has_tick = false;
        self.trial = None;
        self.most = 1;
        Some(ScheduleChange::Tick)
    }

    fn record_data_failure(&mut self) -> bool {
        self.round.clear();
        self.strikes += 1;
        // What has worked is not given up for two stalls in a row.
        let allowed = if self.is_reach_known { 2 * MAX_STRIKES } else { MAX_STRIKES };
        if self.strikes < allowed {
            return false;
        }
        self.strikes = 0;
        let next = match self.reach {
            ReadSize::Whole => ReadSize::Partial,
            ReadSize::Partial => ReadSize::Single,
            ReadSize::Single => return false,
        };
        self.reach = next;
        self.is_reach_known = next == ReadSize::Single;
        true
    }

    pub(super) const fn read_size(&self) -> ReadSize {
        self.reach
    }
}

fn one_request_per_port(ports: &[u8], question: impl Fn(u8) -> NxtRequest) -> Vec<NxtRequest> {
    ports.iter().map(|port| question(*port)).collect()
}

//! The next request for the brick, barriers excluded: the first of these that is due.
//!
//! Tick (three at connect, one after every disturbance, one after every nineteenth other request); set-up of ports; the
//! size of reads; the trial with two outstanding; between two rounds the battery; a round of bus sensors, motors and analog
//! ports.

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::digital::is_digital;
use super::io_maps::{self, ALL_BUFFERS, ALL_INPUTS, ALL_MOTORS, TICK};
use super::requests::NxtRequest;
use super::settings::{MaxOutstanding, MotorPort, NxtSensor, NxtSettings, WheelSource};
use crate::bricks::battery::BatterySchedule;

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
    Battery,
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
    battery: BatterySchedule,
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
            battery: BatterySchedule::new(now),
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
            return self.battery.take_due(now).then_some(NxtRequest::Battery);
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
            if self.battery.take_due(now) {
                self.since_tick = self.since_tick.saturating_add(1);
                return Some(NxtRequest::Battery);
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
            WheelSource::Pushed => {
                let tick = self.has_tick.then_some(self.next_tick);
                [tick, self.battery.deadline()].into_iter().flatten().min()
            }
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
        if *request == NxtRequest::Battery {
            self.battery.record_answer();
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
        if *request == NxtRequest::Battery {
            return self.battery.record_failure().then_some(ScheduleChange::Battery);
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

//! What to ask next.
//!
//! # Model
//! ```text
//! first of these that is due:
//!   fence     at connect and after every disturbance
//!   tick      three at connect, one after every disturbance, one after every nineteenth other question
//!   set up    each port with a sensor, after connect and whenever the brick's counters began anew
//!   reach     how much of an IO map one reply holds: 119 bytes, else 55, else none; until that is known
//!   trial     with two outstanding: four ticks and four reads of the motors, by turns; all eight must be answered
//!   mailbox   an estimate that wants a reply
//!   round     sensors on the bus that were written to, motors, analog ports; at most one round in 10 ms
//! ```

use std::collections::VecDeque;

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::digital::is_digital;
use super::io_maps::{self, ALL_BUFFERS, ALL_INPUTS, ALL_MOTORS, TICK};
use super::question::Question;
use super::settings::{MotorPort, NxtSensor, NxtSettings, Outstanding};

/// Ticks at connect: the first places the clock, the others narrow it.
const FIRST_TICKS: u8 = 3;
/// Other questions between two ticks: at the pace of Bluetooth, with 30 ms for each, 0.6 s. A clock that is 2000 ppm off drifts by 1.2 ms in
/// that time, and what ticks cost is a twentieth of the states per second.
const BETWEEN_TICKS: u8 = 19;
/// Questions of the trial of two outstanding.
const TRIAL_QUESTIONS: u8 = 8;
/// Refusals or time-outs of one kind of read in a row that mean that the brick cannot do it.
const STRIKES: u8 = 2;
/// Over a quick link more rounds than this say nothing new: the brick counts once in a millisecond, and a turn of a degree takes longer.
const SHORTEST_ROUND: Span = Span::from_millis(10);
/// A program on the brick pushes the data; then this is how often its clock is asked.
const PUSHED_TICK_PERIOD: Span = Span::from_millis(1_000);
/// SETINPUTMODE types: LIGHT_INACTIVE gives a raw value without 9 V pulses, LOWSPEED_9V is the bus with 9 V.
const LIGHT_INACTIVE: u8 = 0x06;
const LOWSPEED_9V: u8 = 0x0B;

/// How much of an IO map the brick gives in one reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reach {
    /// 119 bytes: a whole module.
    Whole,
    /// 55 bytes: two motors, one port.
    Short,
    /// None: one command for each motor and port.
    Single,
}

/// Who speaks of the wheels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// The brick, when it is asked.
    Asked,
    /// A program on it, of itself.
    Pushed,
}

/// Where the set-up of a port stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Port {
    /// Nothing there.
    Unused,
    /// It must be set up.
    Wanted,
    /// It was told to be.
    Told,
    /// It was set up and has no valid value yet.
    Settling,
    /// Its values are valid.
    Ready,
}

/// Why a question failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Failure {
    /// No answer came.
    Lost,
    /// The brick said no.
    Refused,
}

/// What the plan has learnt that the brick cannot do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// Give so much of an IO map.
    Reach,
    /// Answer two questions that wait at the same time.
    Outstanding,
    /// Give its clock.
    Tick,
}

/// The plan of one link.
#[derive(Debug)]
pub(super) struct Plan {
    source: Source,
    wheels: [MotorPort; 2],
    sensors: [NxtSensor; 4],
    pub(super) ports: [Port; 4],
    reach: Reach,
    is_reach_known: bool,
    strikes: u8,
    outstanding: Outstanding,
    /// Questions of the trial that have not been asked, and that have not been answered.
    trial: Option<(u8, u8)>,
    most: usize,
    has_tick: bool,
    is_tick_known: bool,
    tick_strikes: u8,
    ticks_wanted: u8,
    since_tick: u8,
    next_tick: Stamp<HostClock>,
    round: VecDeque<Question>,
    next_round: Stamp<HostClock>,
}

impl Plan {
    pub(super) fn new(settings: &NxtSettings, source: Source) -> Self {
        Self {
            source,
            wheels: [settings.left_motor.port, settings.right_motor.port],
            sensors: settings.sensors,
            ports: [Port::Unused; 4],
            reach: Reach::Whole,
            is_reach_known: false,
            strikes: 0,
            outstanding: settings.outstanding,
            trial: None,
            most: 1,
            has_tick: true,
            is_tick_known: false,
            tick_strikes: 0,
            ticks_wanted: 0,
            since_tick: 0,
            next_tick: Stamp::ZERO,
            round: VecDeque::with_capacity(8),
            next_round: Stamp::ZERO,
        }
    }

    /// The link came up: everything is found out anew.
    pub(super) fn begin(&mut self, now: Stamp<HostClock>) {
        self.reach = Reach::Whole;
        self.is_reach_known = self.source == Source::Pushed;
        self.strikes = 0;
        self.most = 1;
        self.trial = (self.outstanding == Outstanding::Two && self.source == Source::Asked)
            .then_some((TRIAL_QUESTIONS, TRIAL_QUESTIONS));
        self.has_tick = true;
        self.is_tick_known = false;
        self.tick_strikes = 0;
        self.ticks_wanted = FIRST_TICKS;
        self.since_tick = 0;
        self.next_tick = now;
        self.next_round = now;
        self.set_up_again();
    }

    /// The brick forgot its sensors, or may have.
    pub(super) fn set_up_again(&mut self) {
        self.round.clear();
        self.ports = self.sensors.map(|sensor| match (sensor, self.source) {
            (NxtSensor::None, _) | (_, Source::Pushed) => Port::Unused,
            _ => Port::Wanted,
        });
    }

    /// The brick was away, and what could not tell its clock before may be able to now.
    pub(super) fn try_tick_again(&mut self, now: Stamp<HostClock>) {
        if !self.has_tick {
            self.has_tick = true;
            self.tick_strikes = 0;
            self.next_tick = now;
        }
    }

    /// The clock must be looked at soon.
    pub(super) fn want_tick(&mut self) {
        self.ticks_wanted = self.ticks_wanted.max(1);
    }

    /// How many questions may wait.
    pub(super) const fn most(&self) -> usize {
        self.most
    }

    pub(super) const fn has_tick(&self) -> bool {
        self.has_tick
    }

    /// True once it is known how much of an IO map comes in one reply.
    pub(super) const fn is_reach_known(&self) -> bool {
        self.is_reach_known
    }

    /// The next question of the plan, fences and mailbox apart; `asked` are the ports on the bus that were written to.
    pub(super) fn next(&mut self, now: Stamp<HostClock>, asked: &[u8]) -> Option<Question> {
        if let Some(tick) = self.tick(now) {
            return Some(tick);
        }
        if self.source == Source::Pushed {
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
            return if unasked % 2 == 0 { Some(Question::Map(TICK)) } else { self.motors().first().cloned() };
        }
        if self.round.is_empty() {
            if now < self.next_round {
                return None;
            }
            self.next_round = now + SHORTEST_ROUND;
            self.fill_round(asked);
        }
        self.since_tick = self.since_tick.saturating_add(1);
        self.round.pop_front()
    }

    fn tick(&mut self, now: Stamp<HostClock>) -> Option<Question> {
        if !self.has_tick {
            return None;
        }
        let is_due = match self.source {
            Source::Asked => self.since_tick >= BETWEEN_TICKS,
            Source::Pushed => now >= self.next_tick,
        };
        if self.ticks_wanted == 0 && !is_due {
            return None;
        }
        self.ticks_wanted = self.ticks_wanted.saturating_sub(1);
        self.since_tick = 0;
        self.next_tick = now + PUSHED_TICK_PERIOD;
        Some(Question::Map(TICK))
    }

    fn next_set_up(&mut self) -> Option<Question> {
        let index = self.ports.iter().position(|port| *port == Port::Wanted)?;
        self.ports[index] = Port::Told;
        let kind = if is_digital(self.sensors[index]) { LOWSPEED_9V } else { LIGHT_INACTIVE };
        let port = index as u8;
        Some(Question::SetUp { port, kind })
    }

    /// When [`Plan::next`] may have a question again if nothing is heard before.
    pub(super) fn wake(&self) -> Option<Stamp<HostClock>> {
        match self.source {
            Source::Pushed => self.has_tick.then_some(self.next_tick),
            Source::Asked => Some(self.next_round),
        }
    }

    fn fill_round(&mut self, asked: &[u8]) {
        let inputs: Vec<u8> = (0..4).filter(|port| self.needs_input(*port)).collect();
        let buffers = match self.reach {
            Reach::Whole if asked.is_empty() => Vec::new(),
            Reach::Whole => vec![Question::Map(ALL_BUFFERS)],
            Reach::Short => one_each(asked, |port| Question::Map(io_maps::buffer(port))),
            Reach::Single => one_each(asked, Question::Digital),
        };
        let analog = match self.reach {
            Reach::Whole if inputs.is_empty() => Vec::new(),
            Reach::Whole => vec![Question::Map(ALL_INPUTS)],
            Reach::Short => one_each(&inputs, |port| Question::Map(io_maps::input(port))),
            Reach::Single => one_each(&inputs, Question::Analog),
        };
        self.round.extend(buffers);
        self.round.extend(self.motors());
        self.round.extend(analog);
    }

    /// Whether the analog side of a port must be read: for its value, or to see whether the port is set up.
    fn needs_input(&self, port: u8) -> bool {
        let index = usize::from(port);
        let is_analog = self.sensors[index] == NxtSensor::HtGyro;
        self.ports[index] == Port::Settling || (is_analog && self.ports[index] == Port::Ready)
    }

    fn motors(&self) -> Vec<Question> {
        let [left, right] = self.wheels;
        let (first, last) = (left.number().min(right.number()), left.number().max(right.number()));
        match self.reach {
            Reach::Whole => vec![Question::Map(ALL_MOTORS)],
            Reach::Short if last - first == 1 => vec![Question::Map(io_maps::neighbours(first))],
            Reach::Short => one_each(&[first, last], |motor| Question::Map(io_maps::motor(motor))),
            Reach::Single => self.wheels.map(Question::Motor).to_vec(),
        }
    }

    /// A question was answered well.
    pub(super) fn succeeded(&mut self, question: &Question) {
        if question.is_for_data() {
            self.strikes = 0;
            if !self.is_reach_known {
                self.is_reach_known = true;
                self.round.clear();
            }
        }
        let is_tick = *question == Question::Map(TICK);
        self.is_tick_known |= is_tick;
        if (is_tick || question.is_for_data())
            && let Some((unasked, unanswered)) = self.trial
            && unasked < unanswered
        {
            self.trial = (unanswered > 1).then_some((unasked, unanswered - 1));
        }
    }

    /// A question was not answered, or refused. Says whether the plan had to change for it.
    pub(super) fn failed(&mut self, question: &Question, why: Failure) -> Option<Change> {
        let is_tick = *question == Question::Map(TICK);
        let is_trial = self.trial.is_some_and(|(unasked, _)| unasked < TRIAL_QUESTIONS);
        if is_trial && (is_tick || question.is_for_data()) {
            self.trial = None;
            self.most = 1;
            self.want_tick();
            return Some(Change::Outstanding);
        }
        if let Question::SetUp { port, .. } = question
            && let Some(port) = self.ports.get_mut(usize::from(*port))
        {
            *port = match why {
                Failure::Lost => Port::Wanted,
                // Asking again would give the same answer.
                Failure::Refused => Port::Unused,
            };
        }
        if is_tick {
            return self.tick_failed();
        }
        if why == Failure::Refused && matches!(question, Question::Analog(_) | Question::Digital(_)) {
            // One sensor is not there. The rest of the round has nothing to do with it.
            return None;
        }
        (question.is_for_data() && self.data_failed()).then_some(Change::Reach)
    }

    fn tick_failed(&mut self) -> Option<Change> {
        self.want_tick();
        if self.is_tick_known {
            return None;
        }
        self.tick_strikes += 1;
        if self.tick_strikes < STRIKES {
            return None;
        }
        self.has_tick = false;
        self.trial = None;
        self.most = 1;
        Some(Change::Tick)
    }

    fn data_failed(&mut self) -> bool {
        self.round.clear();
        self.strikes += 1;
        // What has worked is not given up for two stalls in a row.
        let allowed = if self.is_reach_known { 2 * STRIKES } else { STRIKES };
        if self.strikes < allowed {
            return false;
        }
        self.strikes = 0;
        let next = match self.reach {
            Reach::Whole => Reach::Short,
            Reach::Short => Reach::Single,
            Reach::Single => return false,
        };
        self.reach = next;
        self.is_reach_known = next == Reach::Single;
        true
    }

    pub(super) const fn reach(&self) -> Reach {
        self.reach
    }
}

fn one_each(ports: &[u8], question: impl Fn(u8) -> Question) -> Vec<Question> {
    ports.iter().map(|port| question(*port)).collect()
}

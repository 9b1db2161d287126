//! The LEGO MINDSTORMS EV3 as it comes out of the box: asked by direct commands, no program on the brick needed.
//!
//! One telegram reads the brick's clock, both motors and the sensors, so all of it has the brick's own stamp and the question's round trip
//! bounds its clock. Gets bytes from a link and gives messages; what it wants to ask stands in `poll`. SPEC.md beside this file says what
//! passes. The same telegrams go by Bluetooth (RFCOMM), USB and, after an opening exchange, by WiFi (TCP).

mod bytecode;
mod cycle;
mod inbox;
mod mailbox;
mod requests;
mod sensors;
mod settings;
mod stamps;
mod turn;

use std::collections::VecDeque;

use posebridge_telemetry::{Address, Defect, HostClock, SourceHealth, Span, Stamp};

use self::bytecode::DirectCommand;
use self::cycle::Included;
use self::inbox::{Answer, Found, Inbox};
use self::requests::{Asked, Promptness, Question, Requests};
use self::sensors::{Failed, Sensors, Wheels};
pub use self::settings::{
    DistanceKind, DistanceSettings, Ev3Settings, GyroMounting, GyroReading, GyroSettings, MotorDirection, MotorPort,
    SensorPort,
};
use self::stamps::{Passed, Stamped, Stamps};
use self::turn::Turn;
use super::counters::{Counted, Counters, Counts, Limits};
use super::pulse::Pulse;
use super::{BrickCodec, BrickSettings, Heard, ONLY_BRICK};
use crate::framing::ScanCounters;
use crate::message::{Message, WireStamp};

/// Shortest and longest distance of two telegrams: 50 Hz is more than a Bluetooth link carries, and below 0.1 Hz nobody steers.
const FASTEST_CYCLE: Span = Span::from_millis(20);
const SLOWEST_CYCLE: Span = Span::from_millis(10_000);
/// Most questions that wait at once: the brick keeps them in the buffers of its Bluetooth chip.
const MOST_OUTSTANDING: u8 = 4;
/// How long an answer is waited for; doubled by each that does not come, so that a stalled link does not fill up.
const PATIENCE_MS: i64 = 500;
/// So often it is doubled: four seconds.
const MOST_DOUBLINGS: u32 = 3;
/// How long setting up a sensor may take: changing the mode of an EV3 sensor resets it, about a second.
const SET_UP_PATIENCE: Span = Span::from_millis(3_000);
/// Wheels whose counts have not changed for so long stand, and are likely to for as long as a set-up takes.
const STANDS_AFTER: Span = Span::from_millis(1_000);
/// A telegram that stops for so long will not go on.
const QUIET: Span = Span::from_millis(100);
/// A brick that refuses even its counters is asked again after so long.
const REFUSED_PAUSE: Span = Span::from_millis(1_000);
/// No motor of the set is faster, counts of 1 degree per second: 260 rpm of the EV3's medium motor at 9 V without load (Philohome,
/// Pybricks' identified model).
const LIMITS: Limits = Limits { fastest_per_s: 1_600.0, margin: 3.0 };
/// MAV_SEVERITY_ERROR, _WARNING, _INFO.
const ERROR: u8 = 3;
const WARNING: u8 = 4;
const INFO: u8 = 6;
/// What [`Defect::Payload`] calls an answer: its type on the wire.
const ANSWER_ID: u32 = 0x02;

type Sink<'a> = dyn FnMut(Heard<'_>) + 'a;

/// The state of one link to an EV3.
#[derive(Debug)]
struct Ev3 {
    settings: Ev3Settings,
    /// The link has come up; before that nothing is asked.
    is_up: bool,
    inbox: Inbox,
    last_byte: Stamp<HostClock>,
    /// Something that came is no telegram: the answer that it was will not come.
    is_damaged: bool,
    requests: Requests,
    sensors: Sensors,
    stamps: Stamps,
    counters: Counters,
    /// The counts as they were read last, and since when they are these.
    stand_since: Option<([i32; 2], Stamp<HostClock>)>,
    turn: Turn,
    pulse: Pulse,
    /// Questions in a row that were not answered.
    misses: u32,
    next_cycle: Stamp<HostClock>,
    /// When something can be asked that cannot be now.
    wake: Option<Stamp<HostClock>>,
    out: VecDeque<Vec<u8>>,
    counts: ScanCounters,
    lost: u64,
    /// That the brick refuses to be read was told.
    is_refusal_told: bool,
    estimates_sent: u16,
}

pub(super) fn open(settings: &BrickSettings) -> Box<dyn BrickCodec> {
    let settings = settings.ev3.clone();
    Box::new(Ev3 {
        sensors: Sensors::new(&settings, Stamp::ZERO),
        settings,
        is_up: false,
        inbox: Inbox::default(),
        last_byte: Stamp::ZERO,
        is_damaged: false,
        requests: Requests::default(),
        stamps: Stamps::default(),
        counters: Counters::new(LIMITS),
        stand_since: None,
        turn: Turn::default(),
        pulse: Pulse::default(),
        misses: 0,
        next_cycle: Stamp::ZERO,
        wake: None,
        out: VecDeque::new(),
        counts: ScanCounters::default(),
        lost: 0,
        is_refusal_told: false,
        estimates_sent: 0,
    })
}

impl BrickCodec for Ev3 {
    fn begin(&mut self, now: Stamp<HostClock>) {
        self.inbox.clear();
        self.requests.clear();
        self.out.clear();
        // Clock and counters are those of the brick, which may well have run on while the link was down.
        self.sensors = Sensors::new(&self.settings, now);
        self.is_damaged = false;
        self.is_refusal_told = false;
        self.misses = 0;
        self.stand_since = None;
        self.next_cycle = now;
        self.is_up = true;
        self.ask(now);
    }

    fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        self.last_byte = now;
        self.inbox.push(bytes);
        self.read(now, sink);
        self.ask(now);
    }

    fn deadline(&self) -> Option<Stamp<HostClock>> {
        let quiet = self.awaits_quiet().then(|| self.last_byte + QUIET);
        let all = [quiet, self.requests.deadline(), self.wake];
        all.into_iter().flatten().min()
    }

    fn tick(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>)) {
        if self.awaits_quiet() && self.last_byte + QUIET <= now {
            self.give_up_damaged(now, sink);
        }
        while let Some(question) = self.requests.expired(now) {
            self.miss(sink);
            if let Question::SetUp(index) = question
                && let Some(text) = self.sensors.is_absent(index, now, Failed::InSilence)
            {
                tell(sink, WARNING, &text);
            }
        }
        self.ask(now);
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        self.out.pop_front()
    }

    fn encode(&mut self, _now: Stamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        let (Message::PlanarPose(pose), Some(name), true) = (message, &self.settings.mailbox, self.is_up) else {
            return 0;
        };
        let Some(payload) = mailbox::estimate(pose, self.estimates_sent) else {
            return 0;
        };
        self.estimates_sent = self.estimates_sent.wrapping_add(1);
        let telegram = mailbox::telegram(self.requests.take_counter(), name, &payload);
        out.extend_from_slice(&telegram);
        telegram.len()
    }

    fn counters(&self) -> ScanCounters {
        self.counts
    }

    fn sources(&self) -> Vec<SourceHealth> {
        let heard = SourceHealth { source: ONLY_BRICK, frames: self.counts.frames, lost: self.lost };
        (self.counts.frames + self.lost > 0).then_some(heard).into_iter().collect()
    }
}

/// Asking.
impl Ev3 {
    /// Asks as much as may be asked, and sets when more may be.
    fn ask(&mut self, now: Stamp<HostClock>) {
        self.wake = None;
        if !self.is_up {
            return;
        }
        let most = usize::from(self.settings.outstanding.clamp(1, MOST_OUTSTANDING));
        while self.requests.waiting() < most {
            if let Some(index) = self.sensors.awaited(now, self.wheels(now)) {
                // Alone: the brick stands still while a sensor changes over.
                if self.requests.waiting() == 0 {
                    self.ask_set_up(now, index);
                }
                return;
            }
            if self.next_cycle > now {
                self.wake = Some(self.next_cycle);
                break;
            }
            self.ask_cycle(now);
        }
        let again = self.sensors.deadline().filter(|again| *again > now);
        self.wake = [self.wake, again].into_iter().flatten().min();
    }

    fn wheels(&self, now: Stamp<HostClock>) -> Wheels {
        match self.stand_since {
            Some((_, since)) if now - since >= STANDS_AFTER => Wheels::Standing,
            _ => Wheels::Turning,
        }
    }

    fn ask_set_up(&mut self, now: Stamp<HostClock>, index: usize) {
        let mut command = DirectCommand::default();
        self.sensors.write_set_up(index, &mut command);
        self.send(now, Question::SetUp(index), &command, SET_UP_PATIENCE);
    }

    fn ask_cycle(&mut self, now: Stamp<HostClock>) {
        let (command, included) = cycle::question(&self.settings, &self.sensors);
        let patience_ms = PATIENCE_MS << self.misses.min(MOST_DOUBLINGS);
        self.next_cycle = now + self.cycle();
        self.send(now, Question::Cycle(included), &command, Span::from_millis(patience_ms));
    }

    fn send(&mut self, now: Stamp<HostClock>, question: Question, command: &DirectCommand, patience: Span) {
        let telegram = command.telegram(self.requests.next_counter());
        self.out.push_back(telegram);
        self.requests.left(question, command.answer_bytes(), now, patience);
    }

    fn cycle(&self) -> Span {
        let wanted = Span::from_secs_f64(1.0 / self.settings.rate_hz);
        wanted.clamp(FASTEST_CYCLE, SLOWEST_CYCLE)
    }
}

/// Hearing.
impl Ev3 {
    fn awaits_quiet(&self) -> bool {
        self.inbox.waiting_bytes() > 0 || self.is_damaged
    }

    fn read(&mut self, now: Stamp<HostClock>, sink: &mut Sink<'_>) {
        loop {
            let requests = &self.requests;
            let values_of = |counter| requests.values_of(counter);
            match self.inbox.next(&values_of) {
                None => return,
                Some(Found::Garbage(bytes)) => {
                    self.counts.garbage_bytes += u64::from(bytes);
                    self.is_damaged = self.requests.waiting() > 0;
                    sink(Heard::Defect(Defect::Garbage { bytes }));
                }
                Some(Found::Mailbox) => {
                    self.counts.frames += 1;
                    self.counts.unknown_ids += 1;
                }
                Some(Found::Answer { counter, answer }) => {
                    if let Some((asked, promptness)) = self.requests.answered(counter) {
                        while self.requests.overtaken(&asked).is_some() {
                            self.miss(sink);
                        }
                        self.note_answer(now, promptness, sink);
                        self.hear(now, (&asked, promptness), &answer, sink);
                    }
                }
            }
        }
    }

    fn note_answer(&mut self, now: Stamp<HostClock>, promptness: Promptness, sink: &mut Sink<'_>) {
        self.counts.frames += 1;
        self.misses = 0;
        if promptness == Promptness::Late {
            self.counts.stalls += 1;
            self.lost = self.lost.saturating_sub(1);
        } else {
            self.is_damaged = false;
        }
        if let Some(message) = self.pulse.heard(now) {
            say(sink, message);
        }
    }

    fn hear(
        &mut self,
        now: Stamp<HostClock>,
        (asked, promptness): (&Asked, Promptness),
        answer: &Answer,
        sink: &mut Sink<'_>,
    ) {
        match (asked.question, answer) {
            (Question::SetUp(index), Answer::Values(values)) => {
                let shown = values.first_chunk().map(|first| f32::from_le_bytes(*first));
                if shown.is_some_and(f32::is_finite) {
                    self.sensors.is_ready(index);
                } else if let Some(text) = self.sensors.is_absent(index, now, Failed::AtOnce) {
                    tell(sink, WARNING, &text);
                }
            }
            (Question::SetUp(index), Answer::Refused) => {
                if let Some(text) = self.sensors.is_absent(index, now, Failed::AtOnce) {
                    tell(sink, WARNING, &text);
                }
            }
            (Question::Cycle(included), Answer::Refused) => self.hear_refusal(now, included, sink),
            (Question::Cycle(included), Answer::Values(values)) => {
                self.hear_cycle(now, (asked, promptness, included), values, sink);
            }
        }
    }

    fn hear_refusal(&mut self, now: Stamp<HostClock>, included: Included, sink: &mut Sink<'_>) {
        if included != Included::default() {
            self.sensors.are_in_doubt(now);
            return;
        }
        self.next_cycle = now + REFUSED_PAUSE;
        if !std::mem::replace(&mut self.is_refusal_told, true) {
            tell(
                sink,
                ERROR,
                "the EV3 refuses to tell its clock and its motors' counts; it is asked again each second",
            );
        }
    }

    fn hear_cycle(
        &mut self,
        now: Stamp<HostClock>,
        (asked, promptness, included): (&Asked, Promptness, Included),
        answer: &[u8],
        sink: &mut Sink<'_>,
    ) {
        let Some(values) = cycle::values(answer, included) else {
            return;
        };
        let stamped = Stamped { micros: values.micros, sent: asked.sent, answered: now };
        let Some(passed) = self.stamps.take(stamped) else {
            sink(Heard::Defect(Defect::Payload { message_id: ANSWER_ID }));
            return;
        };
        // The round trip of an answer that was given up is that of a stall, and nobody should predict by it.
        if promptness == Promptness::InTime {
            sink(Heard::Time { from: ONLY_BRICK, sent: asked.sent, peer_nanos: i64::from(values.micros) * 1_000 });
        }
        let since = match passed {
            Passed::RunsOn(since) => since,
            Passed::Stepped(since) => {
                tell(
                    sink,
                    INFO,
                    "the clock of the EV3 was set, or the brick was switched off and on; what was read in between counts by the station's time",
                );
                since
            }
        };
        if self.stand_since.is_none_or(|(counts, _)| counts != values.counts) {
            self.stand_since = Some((values.counts, now));
        }
        let stamp = WireStamp::Micros32(values.micros);
        if self.hear_counts(now, (stamp, since), values.counts, sink) {
            self.hear_sensors(now, (stamp, since, included), &values, sink);
        }
    }

    /// False if a program may have begun, so that the sensors may show something else than they were set up for.
    fn hear_counts(
        &mut self,
        now: Stamp<HostClock>,
        (stamp, since): (WireStamp, Span),
        wheels: [i32; 2],
        sink: &mut Sink<'_>,
    ) -> bool {
        let counts = Counts { wheels, third: None };
        let counted = self.counters.take(since, counts);
        let total = match counted {
            Counted::Total(total) => total,
            Counted::Rebased(total) => {
                tell(
                    sink,
                    INFO,
                    "the counters of the EV3 began anew, as when a program starts; that is taken for no motion",
                );
                // A program's start puts every sensor into its first mode; the gyro then shows an angle.
                self.sensors.are_in_doubt(now);
                total
            }
            Counted::Doubted => {
                sink(Heard::Defect(Defect::Payload { message_id: ANSWER_ID }));
                return false;
            }
        };
        say(sink, cycle::wheel_ticks(&self.settings, stamp, total));
        matches!(counted, Counted::Total(_))
    }

    fn hear_sensors(
        &mut self,
        now: Stamp<HostClock>,
        (stamp, since, included): (WireStamp, Span, Included),
        values: &cycle::Values,
        sink: &mut Sink<'_>,
    ) {
        for (index, (role, values)) in included.0.iter().zip(values.sensors).enumerate() {
            let Some(role) = role else { continue };
            let shown = values.get(..usize::from(role.values())).unwrap_or(&values);
            if let Some(text) = self.sensors.showed(index, now, shown) {
                tell(sink, WARNING, &text);
            }
            if let Some(message) = cycle::sensed(*role, stamp, values, (&mut self.turn, since)) {
                say(sink, message);
            }
        }
    }

    /// Gives up what stopped in its middle, and the questions whose answers that was.
    fn give_up_damaged(&mut self, now: Stamp<HostClock>, sink: &mut Sink<'_>) {
        let bytes = self.inbox.waiting_bytes() as u32;
        if bytes > 0 {
            self.counts.stalls += 1;
            sink(Heard::Defect(Defect::Stall { bytes }));
        }
        while self.inbox.waiting_bytes() > 0 {
            self.counts.garbage_bytes += 1;
            self.inbox.give_up();
            self.read(now, sink);
        }
        self.is_damaged = false;
        while self.requests.give_up().is_some() {
            self.miss(sink);
        }
    }

    /// A question was given up.
    fn miss(&mut self, sink: &mut Sink<'_>) {
        self.misses = self.misses.saturating_add(1);
        self.lost += 1;
        sink(Heard::Defect(Defect::Lost { source: ONLY_BRICK, frames: 1 }));
    }
}

fn say(sink: &mut Sink<'_>, message: Message) {
    sink(Heard::Message { from: ONLY_BRICK, message });
}

fn tell(sink: &mut Sink<'_>, severity: u8, text: &str) {
    sink(Heard::Note { from: ONLY_BRICK, severity, text: text.to_owned() });
}

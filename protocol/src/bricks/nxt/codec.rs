//! The NXT as a brick protocol: asks what is due, gives replies to `answers.rs`, and says what was lost.

use std::collections::VecDeque;

use posebridge_telemetry::{Address, Defect, HostClock, SourceHealth, Span, Stamp};

use super::answers::Accelerations;
use super::conversation::{Conversation, Matched};
use super::counters::Totals;
use super::cutter::{Cutter, Piece, Speech};
use super::digital::Device;
use super::estimate::{Mailbox, PUSHED_INTERVAL};
use super::gyro::Gyro;
use super::motion::Motors;
use super::notes::{INFO, NOTICE, Notes, Topic, WARNING};
use super::plan::{Change, Failure, Plan, Port, Reach, Source};
use super::presence::{HEARTBEAT, Presence};
use super::question::Question;
use super::settings::{NxtSensor, NxtSettings};
use super::telegram::{Reply, framed, keep_alive};
use super::tick::TickClock;
use crate::bricks::{BrickCodec, BrickSettings, Heard, ONLY_BRICK, mavlink};
use crate::framing::{Framing, START_V2, ScanCounters, ScannerConfig};
use crate::message::{Message, PlanarPose, WireStamp};

/// The brick sleeps after ten minutes without a command that counts; each of these begins them anew.
const KEEP_ALIVE_PERIOD: Span = Span::from_millis(60_000);

/// So many fences without an answer, while frames come or not, mean that a pushing program has taken over the link: leJOS answers no command
/// of LEGO's, and would find ours in its own input.
const MOST_FENCES_TO_A_PROGRAM: u8 = 4;

/// The state of one link to an NXT.
#[derive(Debug)]
pub(super) struct Nxt {
    pub(super) settings: NxtSettings,
    pub(super) brick: Address,
    cutter: Cutter,
    talk: Conversation,
    pub(super) plan: Plan,
    /// What is to be sent; each element is one telegram on the wire.
    outbox: VecDeque<Vec<u8>>,
    is_begun: bool,
    /// The next question, while the same one waits for its answer.
    held: Option<Question>,
    /// Fences in a row that were not answered.
    lost_fences: u8,
    next_keep_alive: Stamp<HostClock>,
    pub(super) presence: Presence,
    pub(super) clock: TickClock,
    /// Answers since the clock of the host stood in for the brick's.
    pub(super) since_own_tick: u8,
    pub(super) motors: Motors,
    pub(super) totals: Totals,
    /// The gyro and its port.
    pub(super) gyro: Option<(u8, Gyro)>,
    pub(super) devices: [Option<Device>; 4],
    pub(super) accelerations: Accelerations,
    pub(super) mailbox: Mailbox,
    pub(super) notes: Notes,
    /// What a program on the brick sends of itself.
    frames: Option<Box<dyn BrickCodec>>,
    broken: ScanCounters,
}

/// The brick is asked; no program need run on it.
pub(in crate::bricks) fn open(settings: &BrickSettings) -> Box<dyn BrickCodec> {
    Box::new(Nxt::new(&settings.nxt, None))
}

/// A program on the brick pushes MAVLink frames; only the clock is asked.
pub(in crate::bricks) fn open_push(settings: &BrickSettings) -> Box<dyn BrickCodec> {
    let frames = mavlink::open(&BrickSettings {
        scanner: ScannerConfig {
            // A frame in each telegram: there is nothing to look for.
            transport: Framing::Datagram,
            ..settings.scanner
        },
        ..settings.clone()
    });
    Box::new(Nxt::new(&settings.nxt, Some(frames)))
}

impl Nxt {
    fn new(settings: &NxtSettings, frames: Option<Box<dyn BrickCodec>>) -> Self {
        let (speech, source) = match &frames {
            Some(_) => (Speech::TelegramsAndFrames, Source::Pushed),
            None => (Speech::Telegrams, Source::Asked),
        };
        let interval = settings.estimate_interval.unwrap_or(match source {
            Source::Asked => Span::ZERO,
            Source::Pushed => PUSHED_INTERVAL,
        });
        let gyro = (0..4).zip(settings.sensors).find_map(|(port, sensor)| {
            let gyro = Gyro::new(settings.gyro_rest, settings.gyro_sign);
            (sensor == NxtSensor::HtGyro).then_some((port, gyro))
        });
        Self {
            brick: ONLY_BRICK,
            cutter: Cutter::new(speech),
            talk: Conversation::new(settings.answer_timeout),
            plan: Plan::new(settings, source),
            outbox: VecDeque::new(),
            is_begun: false,
            held: None,
            lost_fences: 0,
            next_keep_alive: Stamp::ZERO,
            presence: Presence::default(),
            clock: TickClock::default(),
            since_own_tick: 0,
            motors: Motors::default(),
            totals: Totals::default(),
            gyro,
            devices: settings.sensors.map(Device::new),
            accelerations: Accelerations::default(),
            mailbox: Mailbox::new(settings.mailbox, interval),
            notes: Notes::default(),
            frames,
            broken: ScanCounters::default(),
            settings: settings.clone(),
        }
    }

    /// Says a line to people, once.
    pub(super) fn note(&mut self, about: (Topic, u8), text: impl Into<String>, sink: &mut dyn FnMut(Heard<'_>)) {
        self.notes.say(about, text.into(), self.brick, sink);
    }

    /// What time alone brings: silence, time-outs.
    fn expire(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>)) {
        if let Some(torn) = self.cutter.expire(now) {
            self.handle(now, torn, sink);
        }
        while let Some(question) = self.talk.expire(now) {
            self.broken.stalls += 1;
            if question == Question::Fence {
                self.fence_unanswered(sink);
            }
            self.lose(&question, sink);
        }
        if self.presence.expire(now) {
            let text = "the NXT has not answered for two seconds";
            self.note((Topic::Presence, WARNING), text, sink);
        }
    }

    fn handle(&mut self, now: Stamp<HostClock>, piece: Piece, sink: &mut dyn FnMut(Heard<'_>)) {
        match piece {
            Piece::OutOfStep { bytes } => {
                self.broken.garbage_bytes += bytes as u64;
                sink(Heard::Defect(Defect::Garbage { bytes: bytes as u32 }));
                for question in self.talk.break_off() {
                    self.lose(&question, sink);
                }
            }
            Piece::Foreign(telegram) => self.hear_foreign(now, &telegram, sink),
            Piece::Telegram(telegram) if telegram.first() == Some(&START_V2) => {
                self.hear_frame(now, &telegram, sink);
            }
            Piece::Telegram(telegram) => {
                // A program's message to a mailbox of ours is for nobody here.
                if let Some(reply) = Reply::of(&telegram) {
                    self.hear_reply(now, &reply, sink);
                }
            }
        }
    }

    /// A program on the brick says something that is not for this station.
    fn hear_foreign(&mut self, now: Stamp<HostClock>, telegram: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        self.broken.unknown_ids += 1;
        // Whether or not it answers, it is there, and why it may not answer is told.
        self.presence.speaks(now);
        let text = if telegram.first() == Some(&START_V2) {
            "a program on the NXT sends MAVLink frames, which are not read as it is asked: try --brick nxt-push"
        } else {
            "a program on the NXT sends messages of its own, which are skipped; if they are to be MAVLink frames, try --brick nxt-push"
        };
        self.note((Topic::Foreign, NOTICE), text, sink);
    }

    fn hear_frame(&mut self, now: Stamp<HostClock>, frame: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        let Some(frames) = &mut self.frames else {
            return;
        };
        let brick = &mut self.brick;
        let mut is_heard = false;
        frames.push(now, frame, &mut |heard| {
            if let Heard::Message { from, .. } = &heard {
                // Answers for the clock must bear the name of whom the program speaks for.
                *brick = *from;
                is_heard = true;
            }
            sink(heard);
        });
        if is_heard {
            self.lives(now, sink);
        }
    }

    fn hear_reply(&mut self, now: Stamp<HostClock>, reply: &Reply<'_>, sink: &mut dyn FnMut(Heard<'_>)) {
        self.lost_fences = 0;
        match self.talk.take(reply) {
            Matched::Answer(asked) => self.answered(now, &asked, reply, sink),
            Matched::TooLate | Matched::Unasked => self.tell_late(sink),
        }
        self.lives(now, sink);
    }

    /// The brick has said something.
    fn lives(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>)) {
        let sign = self.presence.answered(now);
        if sign.is_return {
            self.note((Topic::Presence, NOTICE), "the NXT answers again", sink);
            // It may be another program, or the brick without one: what the old one left unanswered says nothing about it.
            self.lost_fences = 0;
            self.plan.try_tick_again(now);
        }
        if sign.is_beat {
            sink(Heard::Message { from: self.brick, message: Message::Heartbeat(HEARTBEAT) });
        }
    }

    /// Says how many came late, at each doubling.
    fn tell_late(&mut self, sink: &mut dyn FnMut(Heard<'_>)) {
        let late = self.talk.tally().late;
        if late.is_power_of_two() {
            let limit = self.settings.answer_timeout.as_millis_f64();
            let text = format!("{late} answers so far came later than {limit:.0} ms and were not used");
            self.note((Topic::Late, INFO), text, sink);
        }
    }

    /// A fence stayed without an answer for the whole time-out. One that noise broke off says nothing about who is there.
    fn fence_unanswered(&mut self, sink: &mut dyn FnMut(Heard<'_>)) {
        self.lost_fences = self.lost_fences.saturating_add(1);
        if self.is_refused_by_program() {
            let text = "the program on the NXT answers no commands: its clock is known by its frames alone";
            self.note((Topic::Clock, NOTICE), text, sink);
        }
    }

    fn lose(&mut self, question: &Question, sink: &mut dyn FnMut(Heard<'_>)) {
        if *question == Question::Fence {
            return;
        }
        sink(Heard::Defect(Defect::Lost { source: self.brick, frames: 1 }));
        self.fail(question, Failure::Lost, sink);
    }

    /// A question failed; people hear what changes by it.
    pub(super) fn fail(&mut self, question: &Question, why: Failure, sink: &mut dyn FnMut(Heard<'_>)) {
        match self.plan.failed(question, why) {
            None => {}
            Some(Change::Reach) => {
                let text = match self.plan.reach() {
                    Reach::Whole | Reach::Short => {
                        "this NXT's firmware gives IO maps only in pieces: fewer readings per second"
                    }
                    Reach::Single => {
                        "this NXT's firmware gives no IO maps: every motor and port is asked alone, at a fraction of the rate"
                    }
                };
                self.note((Topic::Maps, WARNING), text, sink);
            }
            Some(Change::Outstanding) => {
                let text = "this NXT does not answer two questions at a time: asking one by one";
                self.note((Topic::Outstanding, NOTICE), text, sink);
            }
            Some(Change::Tick) => {
                let text = "this NXT does not tell its clock: readings bear the station's time";
                self.note((Topic::Clock, WARNING), text, sink);
            }
        }
    }

    /// Whether a pushing program leaves all questions unanswered, so that none is asked any more.
    fn is_refused_by_program(&self) -> bool {
        self.frames.is_some() && self.lost_fences >= MOST_FENCES_TO_A_PROGRAM
    }

    /// Asks whatever is due and has room.
    fn ask(&mut self, now: Stamp<HostClock>) {
        if !self.is_begun || self.cutter.is_draining() || self.is_refused_by_program() {
            return;
        }
        while self.talk.has_room(self.plan.most()) {
            let Some(question) = self.next_question(now) else {
                return;
            };
            if self.talk.waits_for(&question) {
                self.held = Some(question);
                return;
            }
            if let Some(carried) = self.carried(now) {
                self.send(&carried);
            }
            self.send(&question.telegram());
            self.talk.ask(question, now);
        }
    }

    fn next_question(&mut self, now: Stamp<HostClock>) -> Option<Question> {
        if self.talk.wants_fence() {
            return Some(Question::Fence);
        }
        if let Some(held) = self.held.take() {
            return Some(held);
        }
        if self.plan.is_reach_known()
            && let Some(probe) = self.mailbox.take_probe(now)
        {
            return Some(Question::Mailbox(probe));
        }
        let asked: Vec<u8> = (0..4)
            .zip(&self.devices)
            .filter(|(_, device)| device.is_some_and(|device| device.asked().is_some()))
            .map(|(port, _)| port)
            .collect();
        self.plan.next(now, &asked)
    }

    /// A telegram without a reply that goes in front of a question, so that the brick never gets more than two at a time of us.
    fn carried(&mut self, now: Stamp<HostClock>) -> Option<Vec<u8>> {
        if self.talk.wants_fence() {
            return None;
        }
        if now >= self.next_keep_alive {
            self.next_keep_alive = now + KEEP_ALIVE_PERIOD;
            return Some(keep_alive());
        }
        let ports = (0..4).zip(&mut self.devices).zip(self.plan.ports);
        for ((port, device), stands) in ports {
            if stands == Port::Ready
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

impl BrickCodec for Nxt {
    fn begin(&mut self, now: Stamp<HostClock>) {
        self.is_begun = true;
        self.cutter = Cutter::new(match self.frames {
            Some(_) => Speech::TelegramsAndFrames,
            None => Speech::Telegrams,
        });
        self.talk.restart();
        self.held = None;
        self.lost_fences = 0;
        self.outbox.clear();
        self.plan.begin(now);
        self.presence.begin(now);
        self.mailbox.begin();
        self.motors = Motors::default();
        self.next_keep_alive = now;
        if let Some(frames) = &mut self.frames {
            frames.begin(now);
        }
        self.ask(now);
    }

    fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        self.expire(now, sink);
        let mut found = Vec::new();
        self.cutter.push(now, bytes, &mut found);
        for piece in found {
            self.handle(now, piece, sink);
        }
        self.ask(now);
    }

    fn deadline(&self) -> Option<Stamp<HostClock>> {
        if !self.is_begun {
            return None;
        }
        let is_free = !self.cutter.is_draining()
            && !self.is_refused_by_program()
            && self.held.is_none()
            && self.talk.has_room(self.plan.most());
        [self.cutter.deadline(), self.talk.deadline(), self.presence.deadline(), self.plan.wake().filter(|_| is_free)]
            .into_iter()
            .flatten()
            .min()
    }

    fn tick(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>)) {
        self.expire(now, sink);
        self.ask(now);
    }

    fn poll(&mut self) -> Option<Vec<u8>> {
        self.outbox.pop_front()
    }

    fn encode(&mut self, now: Stamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        let Message::PlanarPose(pose) = message else {
            return 0;
        };
        let brick_millis = self.millis_of(pose);
        let Some(telegram) = self.mailbox.post(now, pose, brick_millis) else {
            return 0;
        };
        let bytes = framed(&telegram);
        out.extend_from_slice(&bytes);
        bytes.len()
    }

    fn counters(&self) -> ScanCounters {
        let mut counters = self.broken;
        counters.frames = self.talk.tally().answered;
        match &self.frames {
            Some(frames) => counters.plus(&frames.counters()),
            None => counters,
        }
    }

    fn sources(&self) -> Vec<SourceHealth> {
        if let Some(frames) = &self.frames {
            return frames.sources();
        }
        let tally = self.talk.tally();
        if tally.answered == 0 {
            return Vec::new();
        }
        vec![SourceHealth { source: self.brick, frames: tally.answered, lost: tally.lost }]
    }
}

impl Nxt {
    /// The brick's tick for which an estimate holds.
    fn millis_of(&self, pose: &PlanarPose) -> u32 {
        match pose.stamp {
            WireStamp::Micros32(micros) => self.clock.millis_of(micros),
            WireStamp::Millis32(millis) => millis,
            WireStamp::Micros64(_) | WireStamp::Asked { .. } => (pose.stamp.as_micros() / 1_000) as u32,
        }
    }
}

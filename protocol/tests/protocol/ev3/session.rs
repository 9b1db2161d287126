//! Station and brick in virtual time: the codec's requests go to the double, its replies come back when the link lets them.

use posebridge_protocol::bricks::ev3::Ev3Settings;
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings};
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_telemetry::{EncoderTicks, HostClock, Radians, RadiansPerSecond, SourceHealth, TimeDelta, Timestamp};

use crate::support::ev3_double::{DelayLine, Ev3Double, curve};
use crate::support::{RecordedEvent, recorded, status_texts};

pub(crate) const TURN_AROUND: TimeDelta = TimeDelta::from_millis(30);

pub(crate) fn codec(settings: Ev3Settings) -> Box<dyn BrickCodec> {
    crate::support::codec("ev3", &CodecSettings { ev3: settings, ..CodecSettings::default() })
}

pub(crate) fn without_gyro() -> Ev3Settings {
    Ev3Settings { gyro: None, ..Ev3Settings::default() }
}

/// Damages one answer.
pub(crate) type ReplyCorruption = Box<dyn Fn(Vec<u8>) -> Vec<u8>>;

/// What happens to the bytes of an answer on their way, by its number.
pub(crate) type ReplyDamage<'a> = &'a dyn Fn(usize, Vec<u8>) -> Vec<u8>;

/// Station and brick in virtual time.
pub(crate) struct Ev3Session {
    pub(crate) codec: Box<dyn BrickCodec>,
    pub(crate) brick: Ev3Double,
    pub(crate) delay_line: DelayLine,
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) replies: usize,
    pub(crate) events: Vec<(Timestamp<HostClock>, RecordedEvent)>,
}

impl Ev3Session {
    pub(crate) fn new(settings: Ev3Settings, brick: Ev3Double) -> Self {
        let mut session = Self {
            codec: codec(settings),
            brick,
            delay_line: DelayLine::new(TURN_AROUND),
            now: Timestamp::ZERO,
            replies: 0,
            events: vec![],
        };
        session.codec.on_link_up(session.now);
        session.send();
        session
    }

    /// A session that has lasted so long.
    pub(crate) fn run(settings: Ev3Settings, brick: Ev3Double, seconds: f64) -> Self {
        let mut session = Self::new(settings, brick);
        session.run_for(seconds);
        session
    }

    pub(crate) fn send(&mut self) {
        while let Some(bytes) = self.codec.poll() {
            self.delay_line.send(&mut self.brick, self.now, &bytes);
        }
    }

    pub(crate) fn run_until(&mut self, until: Timestamp<HostClock>, damage: ReplyDamage<'_>) {
        loop {
            let next = [self.delay_line.next(), self.codec.deadline()];
            let Some(next) = next.into_iter().flatten().min().filter(|next| *next <= until) else {
                self.now = until;
                return;
            };
            assert!(next >= self.now, "{next:?} is past at {:?}", self.now);
            self.now = next;
            let (now, events) = (self.now, &mut self.events);
            let mut sink = |found: CodecEvent<'_>| events.push((now, recorded(found)));
            if self.delay_line.next() == Some(next) {
                let bytes = self.delay_line.pop().expect("it is there");
                let bytes = damage(self.replies, bytes);
                self.replies += 1;
                self.codec.push(now, &bytes, &mut sink);
            } else {
                self.codec.tick(now, &mut sink);
                assert!(self.codec.deadline().is_none_or(|due| due > now));
            }
            self.send();
        }
    }

    pub(crate) fn run_for(&mut self, seconds: f64) {
        self.run_until(self.now + TimeDelta::from_secs_f64(seconds), &|_, bytes| bytes);
    }

    pub(crate) fn ticks(&self) -> impl Iterator<Item = (Timestamp<HostClock>, &WheelTicks)> {
        self.events.iter().filter_map(|(now, item)| match item {
            RecordedEvent::Message(Message::WheelTicks(ticks)) => Some((*now, ticks)),
            _ => None,
        })
    }

    pub(crate) fn notes(&self) -> Vec<&str> {
        status_texts(&self.events)
    }

    pub(crate) fn turns(&self) -> Vec<(Option<RadiansPerSecond>, Option<Radians>)> {
        let turns = self.events.iter().filter_map(|(_, item)| match item {
            RecordedEvent::Message(Message::Inertial(inertial)) => Some((inertial.turn_rate, inertial.turn)),
            _ => None,
        });
        turns.collect()
    }

    pub(crate) fn source(&self) -> SourceHealth {
        self.codec.source_health()[0]
    }

    /// How far the counts received last are from those of the brick at the instant of their stamp.
    pub(crate) fn error(&self, (now, ticks): (Timestamp<HostClock>, &WheelTicks)) -> i64 {
        let WireStamp::Micros32(micros) = ticks.stamp else {
            panic!("the brick's own clock: {ticks:?}");
        };
        let [_, left, right, _] = curve(self.brick.host_s(micros, now));
        let off = |reported: EncoderTicks, count: i32| (reported.0 - i64::from(count)).abs();
        off(ticks.left, left).max(off(ticks.right, right))
    }
}

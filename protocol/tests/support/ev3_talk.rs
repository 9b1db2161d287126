//! Station and brick in virtual time: the codec's questions go to the double, its answers come back when the link lets them.

use posebridge_protocol::bricks::ev3::Ev3Settings;
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings, DEFAULT_BRICK_ADDRESS, brick_protocol};
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_telemetry::{EncoderTicks, HostClock, ReceiveError, SourceHealth, TimeDelta, Timestamp};

use super::ev3_double::{DelayLine, Ev3Double, curve};

pub(crate) const TURN_AROUND: TimeDelta = TimeDelta::from_millis(30);

/// What was heard, owned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum RecordedEvent {
    Message(Message),
    ClockReply { sent: Timestamp<HostClock>, peer_nanos: i64 },
    StatusText(String),
    Error(ReceiveError),
}

pub(crate) fn item(heard: CodecEvent<'_>) -> RecordedEvent {
    match heard {
        CodecEvent::Message { from, message } => {
            assert_eq!(from, DEFAULT_BRICK_ADDRESS);
            RecordedEvent::Message(message)
        }
        CodecEvent::ClockReply { sent, peer_nanos, .. } => RecordedEvent::ClockReply { sent, peer_nanos },
        CodecEvent::StatusText { text, .. } => RecordedEvent::StatusText(text),
        CodecEvent::Error(defect) => RecordedEvent::Error(defect),
        CodecEvent::ForwardFrame(frame) => panic!("an EV3 sends no {frame:?}"),
    }
}

pub(crate) fn codec(settings: Ev3Settings) -> Box<dyn BrickCodec> {
    let protocol = brick_protocol("ev3").expect("there is a row");
    (protocol.open)(&CodecSettings { ev3: settings, ..CodecSettings::default() })
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
        let mut talk = Self {
            codec: codec(settings),
            brick,
            delay_line: DelayLine::new(TURN_AROUND),
            now: Timestamp::ZERO,
            replies: 0,
            events: vec![],
        };
        talk.codec.on_link_up(talk.now);
        talk.send();
        talk
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
            let (now, heard) = (self.now, &mut self.events);
            let mut sink = |found: CodecEvent<'_>| heard.push((now, item(found)));
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
        self.events.iter().filter_map(|(now, item)| {
            if let RecordedEvent::Message(Message::WheelTicks(ticks)) = item { Some((*now, ticks)) } else { None }
        })
    }

    pub(crate) fn notes(&self) -> Vec<&str> {
        let notes = self.events.iter().filter_map(|(_, item)| {
            if let RecordedEvent::StatusText(text) = item { Some(text.as_str()) } else { None }
        });
        notes.collect()
    }

    pub(crate) fn source(&self) -> SourceHealth {
        self.codec.source_health()[0]
    }

    /// How far the counts that were heard last are from those of the brick at the instant of their stamp.
    pub(crate) fn error(&self, (now, ticks): (Timestamp<HostClock>, &WheelTicks)) -> i64 {
        let WireStamp::Micros32(micros) = ticks.stamp else {
            panic!("the brick's own clock: {ticks:?}");
        };
        let [_, left, right, _] = curve(self.brick.host_s(micros, now));
        let off = |heard: EncoderTicks, count: i32| (heard.0 - i64::from(count)).abs();
        off(ticks.left, left).max(off(ticks.right, right))
    }
}

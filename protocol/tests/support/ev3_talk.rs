//! Station and brick in virtual time: the codec's questions go to the double, its answers come back when the link lets them.

use posebridge_protocol::bricks::ev3::Ev3Settings;
use posebridge_protocol::bricks::{BrickCodec, BrickSettings, Heard, ONLY_BRICK, brick_protocol};
use posebridge_protocol::message::{Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Defect, EncoderTicks, HostClock, SourceHealth, Span, Stamp};

use super::ev3_double::{Ev3Double, Way, curve};

pub(crate) const TURN_AROUND: Span = Span::from_millis(30);

/// What was heard, owned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Item {
    Message(Message),
    Time { sent: Stamp<HostClock>, peer_nanos: i64 },
    Note(String),
    Defect(Defect),
}

pub(crate) fn item(heard: Heard<'_>) -> Item {
    match heard {
        Heard::Message { from, message } => {
            assert_eq!(from, ONLY_BRICK);
            Item::Message(message)
        }
        Heard::Time { sent, peer_nanos, .. } => Item::Time { sent, peer_nanos },
        Heard::Note { text, .. } => Item::Note(text),
        Heard::Defect(defect) => Item::Defect(defect),
        Heard::Other(frame) => panic!("an EV3 sends no {frame:?}"),
    }
}

pub(crate) fn codec(settings: Ev3Settings) -> Box<dyn BrickCodec> {
    let protocol = brick_protocol("ev3").expect("there is a row");
    (protocol.open)(&BrickSettings { ev3: settings, ..BrickSettings::default() })
}

pub(crate) fn without_gyro() -> Ev3Settings {
    Ev3Settings { gyro: None, ..Ev3Settings::default() }
}

/// Damages one answer.
pub(crate) type Spoil = Box<dyn Fn(Vec<u8>) -> Vec<u8>>;

/// What happens to the bytes of an answer on their way, by its number.
pub(crate) type Damage<'a> = &'a dyn Fn(usize, Vec<u8>) -> Vec<u8>;

/// Station and brick in virtual time.
pub(crate) struct Talk {
    pub(crate) codec: Box<dyn BrickCodec>,
    pub(crate) brick: Ev3Double,
    pub(crate) way: Way,
    pub(crate) now: Stamp<HostClock>,
    pub(crate) answers: usize,
    pub(crate) heard: Vec<(Stamp<HostClock>, Item)>,
}

impl Talk {
    pub(crate) fn new(settings: Ev3Settings, brick: Ev3Double) -> Self {
        let mut talk = Self {
            codec: codec(settings),
            brick,
            way: Way::new(TURN_AROUND),
            now: Stamp::ZERO,
            answers: 0,
            heard: vec![],
        };
        talk.codec.begin(talk.now);
        talk.send();
        talk
    }

    pub(crate) fn send(&mut self) {
        while let Some(bytes) = self.codec.poll() {
            self.way.send(&mut self.brick, self.now, &bytes);
        }
    }

    pub(crate) fn run_until(&mut self, until: Stamp<HostClock>, damage: Damage<'_>) {
        loop {
            let next = [self.way.next(), self.codec.deadline()];
            let Some(next) = next.into_iter().flatten().min().filter(|next| *next <= until) else {
                self.now = until;
                return;
            };
            assert!(next >= self.now, "{next:?} is past at {:?}", self.now);
            self.now = next;
            let (now, heard) = (self.now, &mut self.heard);
            let mut sink = |found: Heard<'_>| heard.push((now, item(found)));
            if self.way.next() == Some(next) {
                let bytes = self.way.take().expect("it is there");
                let bytes = damage(self.answers, bytes);
                self.answers += 1;
                self.codec.push(now, &bytes, &mut sink);
            } else {
                self.codec.tick(now, &mut sink);
                assert!(self.codec.deadline().is_none_or(|due| due > now));
            }
            self.send();
        }
    }

    pub(crate) fn run_for(&mut self, seconds: f64) {
        self.run_until(self.now + Span::from_secs_f64(seconds), &|_, bytes| bytes);
    }

    pub(crate) fn ticks(&self) -> impl Iterator<Item = (Stamp<HostClock>, &WheelTicks)> {
        self.heard.iter().filter_map(|(now, item)| {
            if let Item::Message(Message::WheelTicks(ticks)) = item { Some((*now, ticks)) } else { None }
        })
    }

    pub(crate) fn notes(&self) -> Vec<&str> {
        let notes = self.heard.iter().filter_map(
            |(_, item)| {
                if let Item::Note(text) = item { Some(text.as_str()) } else { None }
            },
        );
        notes.collect()
    }

    pub(crate) fn source(&self) -> SourceHealth {
        self.codec.sources()[0]
    }

    /// How far the counts that were heard last are from those of the brick at the instant of their stamp.
    pub(crate) fn error(&self, (now, ticks): (Stamp<HostClock>, &WheelTicks)) -> i64 {
        let WireStamp::Micros32(micros) = ticks.stamp else {
            panic!("the brick's own clock: {ticks:?}");
        };
        let [_, left, right, _] = curve(self.brick.host_s(micros, now));
        let off = |heard: EncoderTicks, count: i32| (heard.0 - i64::from(count)).abs();
        off(ticks.left, left).max(off(ticks.right, right))
    }
}

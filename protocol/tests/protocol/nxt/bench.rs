//! A codec and a double of the brick in virtual time.

use posebridge_protocol::bricks::nxt::NxtSettings;
use posebridge_protocol::bricks::{BrickCodec, CodecEvent, CodecSettings};
use posebridge_protocol::message::{Message, WireStamp};
use posebridge_telemetry::{HostClock, ReceiveError, Timestamp};

use super::brick::SimulatedNxt;
use crate::support::{RecordedEvent, recorded, status_texts};

/// What happens to the bytes of the n-th reply.
pub(crate) type DamageFn = Box<dyn FnMut(usize, Vec<u8>) -> Vec<u8>>;

pub(crate) struct Bench {
    pub(crate) codec: Box<dyn BrickCodec>,
    pub(crate) brick: SimulatedNxt,
    pub(crate) now_micros: i64,
    pub(crate) events: Vec<(i64, RecordedEvent)>,
    pub(crate) damage: DamageFn,
    /// Bytes of each chunk in which a reply arrives.
    pub(crate) chunk: usize,
    /// Whether anything arrives, either way.
    pub(crate) is_cut: bool,
    replies: usize,
}

impl Bench {
    pub(crate) fn new(settings: NxtSettings, brick: SimulatedNxt) -> Self {
        Self::of("nxt", settings, brick)
    }

    /// A bench whose link has been up until then.
    pub(crate) fn run(settings: NxtSettings, brick: SimulatedNxt, end_micros: i64) -> Self {
        let mut bench = Self::new(settings, brick);
        bench.begin();
        bench.run_to(end_micros);
        bench
    }

    pub(crate) fn of(protocol: &str, nxt: NxtSettings, brick: SimulatedNxt) -> Self {
        Self {
            codec: crate::support::codec(protocol, &CodecSettings { nxt, ..CodecSettings::default() }),
            brick,
            now_micros: 0,
            events: Vec::new(),
            damage: Box::new(|_, reply| reply),
            chunk: usize::MAX,
            is_cut: false,
            replies: 0,
        }
    }

    pub(crate) fn now(&self) -> Timestamp<HostClock> {
        Timestamp::from_micros(self.now_micros)
    }

    pub(crate) fn begin(&mut self) {
        self.codec.on_link_up(self.now());
        self.deliver();
    }

    /// Runs until then; `each` sees the brick before every reply that arrives.
    pub(crate) fn run_to_with(&mut self, end_micros: i64, each: &mut dyn FnMut(i64, &mut SimulatedNxt)) {
        loop {
            let deadline = self.codec.deadline().map(Timestamp::as_micros);
            let next = [deadline, self.brick.next_reply()].into_iter().flatten().min().unwrap_or(i64::MAX);
            if next > end_micros {
                break;
            }
            // A deadline between two microseconds is met at the later one.
            self.now_micros = self.now_micros.max(next + i64::from(deadline == Some(next)));
            each(self.now_micros, &mut self.brick);
            if let Some(reply) = self.brick.queue_reply(self.now_micros) {
                self.deliver_replies(reply);
            } else {
                let (now, events, at) = (self.now(), &mut self.events, self.now_micros);
                self.codec.tick(now, &mut |item| record(events, at, item));
            }
            self.deliver();
        }
        self.now_micros = end_micros;
    }

    pub(crate) fn run_to(&mut self, end_micros: i64) {
        self.run_to_with(end_micros, &mut |_, _| {});
    }

    fn deliver_replies(&mut self, reply: Vec<u8>) {
        if self.is_cut {
            return;
        }
        let reply = (self.damage)(self.replies, reply);
        self.replies += 1;
        for part in reply.chunks(self.chunk.min(reply.len().max(1))) {
            self.push(part);
        }
    }

    /// Bytes from the brick.
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        let (now, events, at) = (self.now(), &mut self.events, self.now_micros);
        self.codec.push(now, bytes, &mut |item| record(events, at, item));
        self.deliver();
    }

    pub(crate) fn deliver(&mut self) {
        while let Some(bytes) = self.codec.poll() {
            if !self.is_cut {
                self.brick.push_bytes(self.now_micros, &bytes);
            }
        }
    }

    pub(crate) fn messages(&self) -> impl Iterator<Item = &Message> {
        self.events.iter().filter_map(|(_, item)| match item {
            RecordedEvent::Message(message) => Some(message),
            _ => None,
        })
    }

    pub(crate) fn notes(&self) -> Vec<&str> {
        status_texts(&self.events)
    }

    /// When each clock request left, and its reply, nanoseconds.
    pub(crate) fn clock_replies(&self) -> Vec<(i64, i64)> {
        let replies = self.events.iter().filter_map(|(_, item)| match item {
            RecordedEvent::ClockReply { sent, peer_nanos } => Some((sent.as_nanos(), *peer_nanos)),
            _ => None,
        });
        replies.collect()
    }

    pub(crate) fn turn_rates_deg_per_s(&self) -> Vec<f64> {
        let rates = self.messages().filter_map(|message| match message {
            Message::Inertial(inertial) => inertial.turn_rate,
            _ => None,
        });
        rates.map(|rate| rate.0.to_degrees()).collect()
    }

    /// Left and right totals, in their order.
    pub(crate) fn wheels(&self) -> Vec<(i64, i64)> {
        self.messages()
            .filter_map(|message| match message {
                Message::WheelTicks(ticks) => Some((ticks.left.0, ticks.right.0)),
                _ => None,
            })
            .collect()
    }

    pub(crate) fn lost(&self) -> u32 {
        self.events
            .iter()
            .map(|(_, item)| match item {
                RecordedEvent::Error(ReceiveError::SequenceGap { frames, .. }) => *frames,
                _ => 0,
            })
            .sum()
    }
}

/// When the request left and when the reply arrived, milliseconds.
pub(crate) fn request_and_reply_ms(stamp: WireStamp) -> (f64, f64) {
    let WireStamp::HostInterval { sent, answered } = stamp else {
        panic!("{stamp:?} is no answer");
    };
    (sent.as_secs_f64() * 1e3, answered.as_secs_f64() * 1e3)
}

/// Frames that are only passed on are left out.
fn record(events: &mut Vec<(i64, RecordedEvent)>, at: i64, item: CodecEvent<'_>) {
    if !matches!(item, CodecEvent::ForwardFrame(_)) {
        events.push((at, recorded(item)));
    }
}

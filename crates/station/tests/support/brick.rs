//! A brick that says what it is told to: messages to bytes, and the station's bytes to messages.

use posebridge_protocol::dialect::{self, Encoder};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks, Timestamp};

pub(crate) const BRICK: Address = Address::new(1, 1);

/// The frame of one message, sequence number 0.
pub(crate) fn frame(from: Address, message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    Encoder::new(WireVersion::V2).encode(from, message, &mut bytes);
    bytes
}

/// The wheels' counts at an instant of the brick's clock.
pub(crate) fn ticks(millis: u32, left: i64, right: i64) -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(millis * 1_000),
        left: EncoderTicks(left),
        right: EncoderTicks(right),
    })
}

/// The heartbeat of a rover.
pub(crate) const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });

/// The messages in some bytes.
pub(crate) fn messages(bytes: &[u8]) -> Vec<Message> {
    let mut messages = Vec::new();
    let mut framer = Framer::new(FramerConfig::default());
    framer.push(Timestamp::ZERO, bytes, &mut |scanned| {
        if let FramerOutput::Frame(frame) = scanned {
            messages.extend(dialect::decode(&frame).expect("the station makes sense"));
        }
    });
    messages
}

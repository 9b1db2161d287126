//! Peers that speak MAVLink to the program and know nothing of it but the wire.
#![allow(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

use std::io::Read;
use std::time::Duration;

use posebridge_protocol::dialect::{Encoder, PayloadError, decode};
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message, WheelTicks, WireStamp};
use posebridge_telemetry::{Address, EncoderTicks, Timestamp};

/// Only a test that fails waits for so long.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

/// The brick's heartbeat.
pub(crate) const HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 });
/// That of a ground station.
pub(crate) const GCS_HEARTBEAT: Message =
    Message::Heartbeat(Heartbeat { vehicle_type: 6, autopilot: 8, base_mode: 0, system_status: 4 });

/// The wheel counts of the `step`-th interval of 20 Hz.
pub(crate) fn wheel_ticks(step: u32) -> Message {
    Message::WheelTicks(WheelTicks {
        stamp: WireStamp::Micros32(5_000_000 + step * 50_000),
        left: EncoderTicks(4 * i64::from(step)),
        right: EncoderTicks(4 * i64::from(step)),
    })
}

/// One participant: its address, its sequence numbers and the frames that it has received in part.
pub(crate) struct MavlinkPeer {
    address: Address,
    encoder: Encoder,
    framer: Framer,
}

impl MavlinkPeer {
    pub(crate) fn new(address: Address) -> Self {
        Self { address, encoder: Encoder::new(WireVersion::V2), framer: Framer::new(FramerConfig::default()) }
    }

    /// The message as its next frame.
    pub(crate) fn frame(&mut self, message: &Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encoder.encode(self.address, message, &mut bytes);
        bytes
    }

    /// The messages in these bytes, each with its sender; frames of unknown messages are left out.
    pub(crate) fn decode(&mut self, bytes: &[u8]) -> Vec<(Address, Message)> {
        let mut messages = Vec::new();
        self.framer.push(Timestamp::ZERO, bytes, &mut |output| {
            let FramerOutput::Frame(frame) = output else { return };
            let message = match decode(&frame) {
                // Before the first fix an ODOMETRY says that it is none.
                Err(PayloadError::SenderFailed { .. }) => None,
                decoded => decoded.expect("the payload is valid"),
            };
            messages.extend(message.map(|message| (frame.source, message)));
        });
        messages
    }

    /// Reads from a link until `take` has an answer for a message.
    pub(crate) fn wait_for<T>(&mut self, link: &mut impl Read, take: impl Fn(&Message) -> Option<T>) -> T {
        let mut buffer = [0; 4_096];
        loop {
            let read = link.read(&mut buffer).expect("the station speaks");
            assert!(read > 0, "the station has hung up");
            let messages = self.decode(&buffer[..read]);
            if let Some(taken) = messages.iter().find_map(|(_, message)| take(message)) {
                return taken;
            }
        }
    }
}

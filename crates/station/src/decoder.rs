//! Decodes frames to messages. The first bad payload of a sender's message is described in words; all are counted.

use std::collections::BTreeSet;

use posebridge_protocol::dialect;
use posebridge_protocol::framing::FrameRef;
use posebridge_protocol::message::Message;
use posebridge_telemetry::Address;

/// Most senders and messages of a link whose bad payloads are described.
const MAX_DESCRIPTIONS: usize = 64;

/// A frame with an invalid payload.
#[derive(Debug)]
pub(crate) struct PayloadError {
    pub(crate) message_id: u32,
    /// The error in words, the first time for this sender and message.
    pub(crate) description: Option<String>,
}

/// Decodes the frames of one link.
#[derive(Debug, Default)]
pub(crate) struct Decoder {
    described: BTreeSet<(Address, u32)>,
}

impl Decoder {
    /// The message of a frame; `None` if the dialect has no such message.
    pub(crate) fn decode(&mut self, frame: &FrameRef<'_>) -> Result<Option<Message>, PayloadError> {
        dialect::decode(frame).map_err(|error| {
            let message_id = error.message_id();
            let is_new = self.described.len() < MAX_DESCRIPTIONS && self.described.insert((frame.source, message_id));
            PayloadError { message_id, description: is_new.then(|| error.to_string()) }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
    use posebridge_protocol::message::{Odometry, OdometryPose, WireStamp};
    use posebridge_telemetry::{HostClock, MetersPerSecond, Pose, RadiansPerSecond, Timestamp};

    /// The result of an ODOMETRY that reports a failure.
    fn decode_failed(decoder: &mut Decoder, sender: Address) -> PayloadError {
        let message = Message::Odometry(Odometry {
            stamp: WireStamp::Micros64(1),
            pose: OdometryPose::Arena(Pose::default()),
            forward_speed: MetersPerSecond(0.0),
            turn_rate: RadiansPerSecond(0.0),
            covariance: None,
            reset_counter: 0,
            quality: -1,
        });
        let mut bytes = Vec::new();
        Encoder::new(WireVersion::V2).encode(sender, &message, &mut bytes);
        let mut found = None;
        Framer::new(FramerConfig::default()).push(Timestamp::<HostClock>::ZERO, &bytes, &mut |output| {
            if let FramerOutput::Frame(frame) = output {
                found = decoder.decode(&frame).err();
            }
        });
        found.unwrap()
    }

    #[test]
    fn each_bad_payload_is_an_error_and_the_first_of_each_of_some_senders_is_described() {
        let mut decoder = Decoder::default();
        let mut described = 0;
        for round in 0..2 {
            for number in 0..=u8::MAX {
                let error = decode_failed(&mut decoder, Address::new(1, number));
                assert_eq!(error.message_id, 331);
                assert!(round == 0 || error.description.is_none(), "it was described before");
                described += usize::from(error.description.is_some());
            }
        }
        assert_eq!(described, MAX_DESCRIPTIONS);
    }
}

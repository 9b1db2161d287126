//! The last output stage of each link: rate limits, sequence numbers, encoding and signing.

use std::collections::BTreeMap;

use posebridge_protocol::dialect::{Encoder, RenumberError};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::LinkRateLimiter;
use posebridge_telemetry::{Address, HostClock, LinkId, LinkState, Priority, Timestamp};

use crate::config::LinkConfig;
use crate::forwarded_frame::ForwardedFrame;
use crate::link_context::LinkContext;

/// Message ids have 24 bits; the sensor's number may be above them.
const MAX_MESSAGE_ID: u32 = 0x00FF_FFFF;

/// A message of the station on its way to one link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutgoingMessage<'a> {
    pub(crate) link: LinkId,
    pub(crate) sender: Address,
    pub(crate) message: &'a Message,
    pub(crate) priority: Priority,
}

/// The sending side of all links.
#[derive(Debug)]
pub(crate) struct Egress {
    links: BTreeMap<LinkId, LinkEgress>,
}

#[derive(Debug)]
struct LinkEgress {
    encoder: Encoder,
    send_version: WireVersion,
    limiter: LinkRateLimiter,
}

impl Egress {
    pub(crate) fn new(links: &[LinkConfig], now: Timestamp<HostClock>) -> Self {
        let egress = links.iter().map(|link| {
            let egress = LinkEgress {
                encoder: Encoder::new(link.send_version),
                send_version: link.send_version,
                limiter: LinkRateLimiter::new(link.rules.limits.clone(), now),
            };
            (link.id, egress)
        });
        Self { links: egress.collect() }
    }

    /// The bytes of a message; `None` if the link is down, its limits drop the message, or it cannot carry the message.
    /// Each of these is counted in the link's health.
    pub(crate) fn send(
        &mut self,
        now: Timestamp<HostClock>,
        link: &mut LinkContext,
        outgoing: OutgoingMessage<'_>,
    ) -> Option<Vec<u8>> {
        let OutgoingMessage { link: id, sender, message, priority } = outgoing;
        let egress = self.links.get_mut(&id)?;
        if link.state == LinkState::Down {
            link.health.drops_out += 1;
            return None;
        }
        // Before it takes a sequence number: what is held back must not look like a loss.
        let stream = match priority {
            Priority::Estimate { stream } => Some(stream & MAX_MESSAGE_ID),
            Priority::Command | Priority::Session | Priority::Forwarded => None,
        };
        if stream.is_some_and(|id| !egress.limiter.admits(now, sender, id, 0)) {
            link.health.rate_limited += 1;
            return None;
        }
        let mut bytes = Vec::new();
        let length = match &mut link.codec {
            Some(codec) => codec.encode(now, sender, message, &mut bytes),
            None if link.verifier.is_signed() => {
                // Without a signing time nothing leaves: an unsigned frame would show the peers that signatures do not matter.
                let signer = link.verifier.next_signer(now);
                signer.map_or(0, |signer| egress.encoder.encode_signed(sender, message, &signer, &mut bytes))
            }
            None => egress.encoder.encode(sender, message, &mut bytes),
        };
        if length == 0 {
            // A message that this link's MAVLink version does not have, or that cannot be signed. A robot with a protocol of its own
            // gets what it understands; the rest was never meant for it.
            link.health.drops_out += u64::from(link.codec.is_none());
            return None;
        }
        if stream.is_some() || priority == Priority::Command {
            egress.limiter.charge(now, bytes.len());
        }
        Some(bytes)
    }

    /// Whether a forwarded frame may be sent on a link; it is limited and charged once, however many peers receive it.
    pub(crate) fn admit_forwarded(
        &mut self,
        now: Timestamp<HostClock>,
        id: LinkId,
        link: &mut LinkContext,
        frame: &ForwardedFrame,
    ) -> bool {
        let Some(egress) = self.links.get_mut(&id) else {
            return false;
        };
        let is_foreign = egress.send_version == WireVersion::V1 && frame.version == WireVersion::V2;
        if link.state == LinkState::Down || is_foreign {
            link.health.drops_out += 1;
            return false;
        }
        let length = frame.bytes.len();
        if frame.priority == Priority::Command {
            egress.limiter.charge(now, length);
        } else if !egress.limiter.admits(now, frame.source, frame.message_id, length) {
            link.health.rate_limited += 1;
            return false;
        }
        true
    }

    /// Gives a forwarded frame a sender's address and the next sequence number of that address on this link.
    ///
    /// Fails if the frame is signed and must not be changed.
    pub(crate) fn readdress(&mut self, id: LinkId, bytes: &[u8], sender: Address) -> Result<Vec<u8>, RenumberError> {
        let egress = self.links.get_mut(&id).ok_or(RenumberError::Signed)?;
        let mut bytes = bytes.to_vec();
        egress.encoder.readdress(&mut bytes, sender).map(|()| bytes)
    }

    /// A sender's frame is sent with its original sequence number: the next one with this address has the number after
    /// it.
    pub(crate) fn follow_sequence(&mut self, id: LinkId, source: Address, sequence: u8) {
        if let Some(egress) = self.links.get_mut(&id) {
            egress.encoder.note_forwarded(source, sequence);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::{LINK, link};
    use posebridge_protocol::message::Heartbeat;
    use posebridge_protocol::routing::{LinkRules, RateLimits};

    const BEAT: Message =
        Message::Heartbeat(Heartbeat { vehicle_type: 18, autopilot: 8, base_mode: 0, system_status: 4 });

    fn link_with_limits(limits: RateLimits) -> LinkConfig {
        LinkConfig { rules: LinkRules { limits, ..LinkRules::default() }, ..link(LINK, vec![]) }
    }

    fn outgoing(priority: Priority) -> OutgoingMessage<'static> {
        OutgoingMessage { link: LINK, sender: Address::new(1, 197), message: &BEAT, priority }
    }

    #[test]
    fn each_message_has_the_next_number_of_its_sender_and_a_link_that_is_down_uses_none() {
        let config = link_with_limits(RateLimits::default());
        let mut link = LinkContext::new(&config);
        let mut egress = Egress::new(&[config], Timestamp::ZERO);
        assert_eq!(egress.send(Timestamp::ZERO, &mut link, outgoing(Priority::Session)), None);
        assert_eq!(link.health.drops_out, 1);
        link.set_state(Timestamp::ZERO, LinkState::Up);
        let numbers: Vec<u8> = (0..3)
            .map(|_| egress.send(Timestamp::ZERO, &mut link, outgoing(Priority::Session)).expect("the link is up")[4])
            .collect();
        assert_eq!(numbers, [0, 1, 2]);
    }

    #[test]
    fn an_estimate_over_the_limit_is_held_back_and_a_command_is_not() {
        let config = link_with_limits(RateLimits { bytes_per_s: Some(10), ..RateLimits::default() });
        let mut link = LinkContext::new(&config);
        let mut egress = Egress::new(&[config], Timestamp::ZERO);
        link.set_state(Timestamp::ZERO, LinkState::Up);
        let estimate = Priority::Estimate { stream: 0 };
        let mut sent = 0;
        for _ in 0..100 {
            sent += usize::from(egress.send(Timestamp::ZERO, &mut link, outgoing(estimate)).is_some());
        }
        assert!(sent < 100, "10 bytes a second do not carry 100 messages at once");
        assert_eq!(link.health.rate_limited, 100 - sent as u64);
        assert!(egress.send(Timestamp::ZERO, &mut link, outgoing(Priority::Command)).is_some());
    }
}

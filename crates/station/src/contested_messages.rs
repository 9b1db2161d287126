//! Messages of senders whose identity is undecided, kept until it is known: see [`crate::sender_identity`] and
//! [`crate::observers`].
//!
//! Otherwise a robot with the ids of another would lose its first messages, and one that reconnected those until the
//! old peer counts as silent.

use std::collections::{BTreeMap, VecDeque};

use posebridge_protocol::message::Message;
use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::Address;

use crate::observation_extractor::UnalignedObservation;
use crate::receive::{ReceiveInfo, TimeExchange};
use crate::sender_identity::MAX_CONTENDERS;

/// Most messages kept of one sender: half a second of one that sends 100 messages a second and replies to time
/// requests. The oldest are dropped first.
const MAX_PER_SENDER: usize = 64;

/// A message of an undecided sender.
#[derive(Debug)]
pub(crate) enum ContestedMessage {
    /// May be from a robot.
    Message(ReceiveInfo, Message),
    Fix(ReceiveInfo, UnalignedObservation),
    TimeExchange(TimeExchange),
}

/// Messages of all such senders, in order of arrival for each.
#[derive(Debug, Default)]
pub(crate) struct ContestedMessages(BTreeMap<(Endpoint, Address), VecDeque<ContestedMessage>>);

impl ContestedMessages {
    pub(crate) fn push(&mut self, endpoint: Endpoint, address: Address, message: ContestedMessage) {
        if self.0.len() >= MAX_CONTENDERS && !self.0.contains_key(&(endpoint, address)) {
            self.0.clear();
        }
        let messages = self.0.entry((endpoint, address)).or_default();
        if messages.len() >= MAX_PER_SENDER {
            messages.pop_front();
        }
        messages.push_back(message);
    }

    /// The messages of a sender that is now known, oldest first.
    pub(crate) fn take(&mut self, endpoint: Endpoint, address: Address) -> VecDeque<ContestedMessage> {
        if self.0.is_empty() {
            return VecDeque::new();
        }
        self.0.remove(&(endpoint, address)).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{HostClock, LinkId, PeerId, TimeDelta, Timestamp};

    use super::*;

    #[test]
    fn a_new_sender_beyond_the_limit_clears_all_and_a_known_one_drops_its_oldest() {
        let endpoint = Endpoint { link: LinkId(0), peer: PeerId(0) };
        let message = |nanos| {
            let received =
                ReceiveInfo { endpoint, host_time: Timestamp::<HostClock>::ZERO + TimeDelta::from_nanos(nanos) };
            let heartbeat = posebridge_protocol::message::Heartbeat {
                vehicle_type: 10,
                autopilot: 0,
                base_mode: 0,
                system_status: 4,
            };
            ContestedMessage::Message(received, Message::Heartbeat(heartbeat))
        };
        let address = |index: usize| Address::new((index >> 8) as u8, index as u8);
        let mut messages = ContestedMessages::default();
        for index in 0..MAX_CONTENDERS {
            messages.push(endpoint, address(index), message(0));
        }
        for nanos in 1..=MAX_PER_SENDER as i64 {
            messages.push(endpoint, address(0), message(nanos));
        }
        assert_eq!(messages.0.len(), MAX_CONTENDERS);
        let first = messages.take(endpoint, address(0));
        let oldest = match first.front() {
            Some(ContestedMessage::Message(received, _)) => received.host_time.as_nanos(),
            other => panic!("{other:?}"),
        };
        assert_eq!((first.len(), oldest), (MAX_PER_SENDER, 1));
        messages.push(endpoint, address(0), message(0));
        messages.push(endpoint, address(MAX_CONTENDERS), message(0));
        assert_eq!(messages.0.len(), 1);
    }
}

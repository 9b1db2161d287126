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

//! What may pass on a link: plain values, as the configuration gives them.

use mavlink::dialects::common;
use mavlink_core::Message;
use posebridge_telemetry::{Address, ComponentId, SystemId};

use super::limits::RateLimits;
use crate::dialect::generated::posebridge;

/// The rules of one link.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkRules {
    /// Redundant links to one robot share a number; `None` for a link that stands alone.
    pub group: Option<u16>,
    /// What of the others' frames is passed on to it.
    pub forward: ForwardPolicy,
    /// Which of its frames are used and forwarded.
    pub inward: FrameFilter,
    /// What of the others' frames may leave on it.
    pub outward: FrameFilter,
    /// How much of the others' frames and of our estimates may leave on it.
    pub limits: RateLimits,
}

/// What of the others' frames is passed on to a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForwardPolicy {
    /// Everything that concerns it.
    #[default]
    All,
    /// Only what names a target that was heard there.
    Targeted,
    /// Nothing, and nothing that comes from it goes to another link: the link takes no part.
    Disabled,
}

/// Lets frames pass or not, by message, system and component of their sender. The default lets all pass.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FrameFilter {
    /// By message id.
    pub messages: AllowBlockList<u32>,
    /// By the sender's system.
    pub systems: AllowBlockList<SystemId>,
    /// By the sender's component.
    pub components: AllowBlockList<ComponentId>,
}

impl FrameFilter {
    /// Whether a frame of this sender with this message passes.
    pub fn admits(&self, source: Address, message_id: u32) -> bool {
        self.messages.admits(&message_id)
            && self.systems.admits(&source.system)
            && self.components.admits(&source.component)
    }
}

/// Two lists that choose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AllowBlockList<T> {
    /// Only these; empty means all.
    pub allow: Vec<T>,
    /// But not these.
    pub block: Vec<T>,
}

impl<T> Default for AllowBlockList<T> {
    fn default() -> Self {
        Self { allow: Vec::new(), block: Vec::new() }
    }
}

impl<T: PartialEq> AllowBlockList<T> {
    /// Whether `item` is chosen.
    pub fn admits(&self, item: &T) -> bool {
        (self.allow.is_empty() || self.allow.contains(item)) && !self.block.contains(item)
    }
}

/// The id of the message with this name, in the standard dialect or ours. Case matters, as in the definitions.
pub fn message_id_named(name: &str) -> Option<u32> {
    common::MavMessage::message_id_from_name(name).or_else(|| posebridge::MavMessage::message_id_from_name(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_choice_takes_all_and_a_block_beats_an_allow() {
        let mut choice = AllowBlockList::default();
        assert!(choice.admits(&7));
        choice.allow = vec![7, 8];
        assert!(choice.admits(&7) && !choice.admits(&9));
        choice.block = vec![7];
        assert!(!choice.admits(&7) && choice.admits(&8));
    }

    #[test]
    fn every_condition_of_a_filter_must_hold() {
        let filter = FrameFilter {
            messages: AllowBlockList { allow: vec![0, 30], block: vec![] },
            systems: AllowBlockList { allow: vec![SystemId(1)], block: vec![] },
            components: AllowBlockList { allow: vec![], block: vec![ComponentId(9)] },
        };
        assert!(filter.admits(Address::new(1, 1), 30));
        assert!(!filter.admits(Address::new(1, 1), 31));
        assert!(!filter.admits(Address::new(2, 1), 30));
        assert!(!filter.admits(Address::new(1, 9), 30));
    }

    #[test]
    fn messages_have_the_names_of_their_definitions() {
        assert_eq!(message_id_named("HEARTBEAT"), Some(0));
        assert_eq!(message_id_named("WHEEL_DISTANCE"), Some(9_000));
        assert_eq!(message_id_named("PB_PLANAR_POSE"), Some(42_102));
        assert_eq!(message_id_named("heartbeat"), None);
    }
}

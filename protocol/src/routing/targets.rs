//! Whom a message is for, read from its payload without decoding it.
//!
//! About seventy messages name a target. Where its bytes stand follows from the definition in ways that are easy to get wrong:
//! fields travel by falling size and not in the order of the definition, extension fields last. The table is therefore made by
//! the generated encoders themselves, when it is first needed: each message is written twice with different targets, and the
//! byte that differs is the field. Decoding would not do: one enumeration value that is newer than our dialect makes the
//! generated decoder refuse a command that another system understands.
//!
//! # Sources
//! minimal.xml, standard.xml and common.xml of the MAVLink project, as the `mavlink` crate ships them; our own dialect.

use std::sync::LazyLock;

use mavlink::dialects::common;
use mavlink_core::{MavlinkVersion, Message};
use posebridge_telemetry::{Address, ComponentId, SystemId};

use crate::dialect::RenumberError;
use crate::dialect::generated::posebridge;
use crate::dialect::rewrite::rewrite;

/// A payload is at most this long.
const MAX_PAYLOAD: usize = 255;

/// Whom a message is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageTarget {
    /// Broadcast: it names no target, target 0, or its definition is not known.
    Broadcast,
    /// All components of a system.
    System(SystemId),
    /// One component.
    Component(Address),
}

impl MessageTarget {
    /// The system that it is for; `None` for a broadcast.
    pub const fn system(self) -> Option<SystemId> {
        match self {
            Self::Broadcast => None,
            Self::System(system) => Some(system),
            Self::Component(address) => Some(address.system),
        }
    }
}

/// Where the target fields of one message stand in its payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct TargetOffsets {
    message_id: u32,
    system: u8,
    component: Option<u8>,
}

/// By rising message id.
static OFFSETS: LazyLock<Vec<TargetOffsets>> = LazyLock::new(|| {
    let standard = common::MavMessage::all_ids().iter();
    let own = posebridge::MavMessage::all_ids().iter();
    let mut offsets: Vec<TargetOffsets> = standard
        .filter_map(|id| offsets_of::<common::MavMessage>(*id))
        .chain(own.filter_map(|id| offsets_of::<posebridge::MavMessage>(*id)))
        .collect();
    offsets.sort_unstable_by_key(|entry| entry.message_id);
    offsets
});

/// Whom the message `message_id` with this payload is for. Trailing zeros of the payload may be cut off.
pub fn target_of(message_id: u32, payload: &[u8]) -> MessageTarget {
    let Ok(index) = OFFSETS.binary_search_by_key(&message_id, |entry| entry.message_id) else {
        return MessageTarget::Broadcast;
    };
    let TargetOffsets { system, component, .. } = OFFSETS[index];
    let byte = |offset: u8| payload.get(usize::from(offset)).copied().unwrap_or(0);
    match (byte(system), component.map_or(0, byte)) {
        (0, _) => MessageTarget::Broadcast,
        (system, 0) => MessageTarget::System(SystemId(system)),
        (system, component) => {
            MessageTarget::Component(Address { system: SystemId(system), component: ComponentId(component) })
        }
    }
}

/// Changes for whom a whole frame is: the system, and the component if the frame names one. Its checksum follows; nothing else changes.
///
/// # Errors
/// A frame that names no target, or that cannot be changed, stays as it is.
pub fn retarget(message_id: u32, frame: &mut [u8], to: Address) -> Result<(), RenumberError> {
    let index = OFFSETS.binary_search_by_key(&message_id, |entry| entry.message_id);
    let offsets = index.map_err(|_unknown| RenumberError::NoFrame)?;
    let TargetOffsets { system, component, .. } = OFFSETS[offsets];
    rewrite(frame, |frame, layout| {
        let position = |offset: u8| layout.payload_at + usize::from(offset);
        // What is cut off is zero: a broadcast.
        if position(system) >= layout.end {
            return Err(RenumberError::NoFrame);
        }
        frame[position(system)] = to.system.0;
        let component = component.map(position).filter(|position| *position < layout.end);
        if let Some(component) = component.filter(|position| frame[*position] != 0) {
            frame[component] = to.component.0;
        }
        Ok(())
    })
}

fn offsets_of<M: Message>(message_id: u32) -> Option<TargetOffsets> {
    let mut message = M::default_message_from_id(message_id)?;
    Some(TargetOffsets {
        message_id,
        system: offset_of(&mut message, M::target_system_id_mut)?,
        component: offset_of(&mut message, M::target_component_id_mut),
    })
}

/// Where the field that `field` reaches stands on the wire; `None` if the message does not have it.
fn offset_of<M: Message>(message: &mut M, field: fn(&mut M) -> Option<&mut u8>) -> Option<u8> {
    let mut written_with = |value: u8| {
        *field(message)? = value;
        let mut bytes = [0; MAX_PAYLOAD];
        message.ser(MavlinkVersion::V2, &mut bytes);
        Some(bytes)
    };
    let (zero, full) = (written_with(0x00)?, written_with(0xFF)?);
    let offset = zero.iter().zip(&full).position(|(a, b)| a != b)?;
    u8::try_from(offset).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_cut_off_is_zero() {
        // COMMAND_LONG: seven floats, the command, then target system and component.
        let payload = [0; 31];
        assert_eq!(target_of(76, &payload[..30]), MessageTarget::Broadcast);
        let mut payload = [0; 32];
        payload[30] = 7;
        assert_eq!(target_of(76, &payload[..31]), MessageTarget::System(SystemId(7)));
        payload[31] = 9;
        assert_eq!(target_of(76, &payload), MessageTarget::Component(Address::new(7, 9)));
        assert_eq!(target_of(76, &[]), MessageTarget::Broadcast);
    }

    #[test]
    fn a_command_for_another_system_is_otherwise_the_same_command() {
        use crate::dialect::{Encoder, decode};
        use crate::framing::{Framer, FramerConfig, FramerOutput, WireVersion};
        use crate::message::{CommandLong, Message};
        let command = |target| {
            Message::Command(CommandLong { target, command: 400, params: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0] })
        };
        let mut bytes = Vec::new();
        Encoder::new(WireVersion::V2).encode(Address::new(254, 190), &command(Address::new(7, 1)), &mut bytes);
        assert_eq!(retarget(76, &mut bytes, Address::new(9, 3)), Ok(()));
        let mut found = Vec::new();
        Framer::new(FramerConfig::default()).push(
            posebridge_telemetry::Timestamp::<posebridge_telemetry::HostClock>::ZERO,
            &bytes,
            &mut |output| {
                if let FramerOutput::Frame(frame) = output {
                    found.extend(decode(&frame).unwrap());
                }
            },
        );
        assert_eq!(found, [command(Address::new(9, 3))]);
        assert_eq!(
            retarget(0, &mut bytes, Address::new(9, 3)),
            Err(RenumberError::NoFrame),
            "a heartbeat is for everybody"
        );
    }

    #[test]
    fn a_message_without_target_and_one_of_no_dialect_are_for_everybody() {
        assert_eq!(target_of(0, &[1; 9]), MessageTarget::Broadcast);
        assert_eq!(target_of(42_100, &[1; 13]), MessageTarget::Broadcast);
        assert_eq!(target_of(60_000, &[1; 255]), MessageTarget::Broadcast);
    }
}

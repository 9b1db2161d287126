//! What stations send each other, as bytes: a version, then the message in postcard's encoding. Received bytes are not trusted.

use posebridge_telemetry::{Address, Fix, HostClock, TimeDelta, Timestamp};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::epoch::Epoch;
use crate::io::{QueryId, Reception, StateAnswer, StateSnapshot};
use crate::names::{RobotName, StationId};

const VERSION: u8 = 1;

/// A message of one station to others.
pub trait FleetMessage: Serialize + DeserializeOwned {
    /// For error messages.
    const NAME: &'static str;
}

/// Asks about a robot, on its key of states.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateQuestion {
    pub from: StationId,
    /// The only station that is to answer; `None` is for everyone.
    pub to: Option<StationId>,
    pub id: QueryId,
    /// How long the asker has heard the robot without a break.
    pub heard_for: TimeDelta,
}

/// Answers a [`StateQuestion`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateReply {
    pub from: StationId,
    pub answer: StateAnswer,
}

/// The state of a robot as its owner publishes it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateNotice {
    pub from: StationId,
    pub reception: Reception,
    pub state: StateSnapshot,
}

/// The bytes of a [`StateSnapshot`]: the engine's own, and on which clock their times are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SavedState {
    pub station: StationId,
    /// The clock of that station when it saved the state.
    pub saved_at: Timestamp<HostClock>,
    #[serde(with = "serde_bytes")]
    pub engine_state: Vec<u8>,
}

/// A station's sign of life: its clock, and what it owns.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StationReport {
    pub from: StationId,
    pub host_time: Timestamp<HostClock>,
    pub tokens: Vec<(RobotName, Epoch)>,
}

/// A camera's fix of a robot that another station owns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SharedFix {
    pub from: StationId,
    /// Counts the fixes of this camera for this robot, so that gaps are seen; wraps.
    pub sequence: u32,
    /// The camera's own.
    pub camera: Address,
    /// On the clock of that station.
    pub time: Timestamp<HostClock>,
    /// The time is at most this far from the true one.
    pub uncertainty: TimeDelta,
    pub fix: Fix,
}

impl FleetMessage for SharedFix {
    const NAME: &'static str = "fix";
}
impl FleetMessage for StateQuestion {
    const NAME: &'static str = "question about a state";
}
impl FleetMessage for StateReply {
    const NAME: &'static str = "answer about a state";
}
impl FleetMessage for StateNotice {
    const NAME: &'static str = "published state";
}
impl FleetMessage for SavedState {
    const NAME: &'static str = "saved state";
}
impl FleetMessage for StationReport {
    const NAME: &'static str = "sign of life";
}

/// Why bytes are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MessageError {
    #[error(
        "a {name} of version {version}, which this station does not know: all stations of a fleet need the same version"
    )]
    Version { name: &'static str, version: u8 },
    #[error("no {name}: its bytes end early, go on too long or hold something impossible")]
    Content { name: &'static str },
}

/// The bytes of a message.
pub fn encode_message<M: FleetMessage>(message: &M) -> Vec<u8> {
    // It fails for nothing that has a length.
    postcard::to_extend(message, vec![VERSION]).unwrap_or_default()
}

/// Never panics.
pub fn decode_message<M: FleetMessage>(bytes: &[u8]) -> Result<M, MessageError> {
    let content = MessageError::Content { name: M::NAME };
    let (version, rest) = bytes.split_first().ok_or(content)?;
    if *version != VERSION {
        return Err(MessageError::Version { name: M::NAME, version: *version });
    }
    match postcard::take_from_bytes(rest) {
        Ok((message, [])) => Ok(message),
        Ok(_) | Err(_) => Err(content),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::epoch::OwnershipToken;
    use crate::names::StationName;

    fn station() -> StationId {
        StationId { name: StationName::new("lab").unwrap(), instance: 7 }
    }

    fn reply() -> StateReply {
        let epoch = Epoch::FIRST;
        let state = StateSnapshot { epoch, age: TimeDelta::from_millis(20), bytes: vec![1, 2, 3] };
        let owner = Some(OwnershipToken { epoch, station: station() });
        let answer = StateAnswer::NotOwner { owner, highest_epoch: Some(epoch.next()), state: Some(state) };
        StateReply { from: station(), answer }
    }

    #[test]
    fn the_bytes_of_a_question_are_those_that_postcard_specifies() {
        let to = None;
        let question = StateQuestion { from: station(), to, id: QueryId(300), heard_for: TimeDelta::from_nanos(-2) };
        // Version; length and text of the name, its instance; none; 300 as a varint; -2 in zigzag.
        assert_eq!(encode_message(&question), [1, 3, b'l', b'a', b'b', 7, 0, 0xAC, 0x02, 3]);
    }

    #[test]
    fn a_message_that_is_cut_longer_or_of_another_version_is_refused() {
        let bytes = encode_message(&reply());
        assert_eq!(decode_message(&bytes), Ok(reply()));
        let content = Err(MessageError::Content { name: StateReply::NAME });
        for len in 0..bytes.len() {
            assert_eq!(decode_message::<StateReply>(&bytes[..len]), content, "{len} bytes");
        }
        assert_eq!(decode_message::<StateReply>(&[&bytes[..], &[0]].concat()), content);
        let other = [&[2], &bytes[1..]].concat();
        let version = MessageError::Version { name: StateReply::NAME, version: 2 };
        assert_eq!(decode_message::<StateReply>(&other), Err(version));
    }

    #[test]
    fn a_name_that_is_no_name_and_an_epoch_of_zero_are_refused() {
        let question =
            encode_message(&StateQuestion { from: station(), to: None, id: QueryId(1), heard_for: TimeDelta::ZERO });
        let mut slash = question;
        slash[2] = b'/';
        assert!(decode_message::<StateQuestion>(&slash).is_err());
        let report = StationReport {
            from: station(),
            host_time: Timestamp::ZERO,
            tokens: vec![(RobotName::new("r").unwrap(), Epoch::FIRST)],
        };
        let mut zero = encode_message(&report);
        assert_eq!(zero.pop(), Some(1), "the epoch");
        zero.push(0);
        assert!(decode_message::<StationReport>(&zero).is_err());
    }
}

//! The signing of a link: key, link id, and frames accepted without a signature.

use std::collections::BTreeSet;

use posebridge_protocol::signing::{
    Key, RADIO_STATUS, SignedStreamState, SigningConfig, SigningState, SigningTime, StreamId, UnsignedPolicy,
};
use posebridge_telemetry::Address;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the frames of a link are signed.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct SigningSection {
    /// The file with the key, as `posebridge key new` makes it; relative to the working directory.
    pub key_file: String,
    /// What the station calls this link in its signatures; different for every link and every station that uses the key.
    #[serde(default)]
    pub link_id: u8,
    /// Message ids that are accepted without a signature; radios inject RADIO_STATUS (109).
    #[serde(default = "default_accept_unsigned")]
    pub accept_unsigned: Vec<u32>,
    /// Refuse everything else that has no signature. With false only wrong signatures are refused, and any sender is let in.
    #[serde(default = "default_required")]
    pub required: bool,
    /// With which stamps a recorded session began: only the station writes it, into its recordings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begun: Option<MemoryRecord>,
}

/// A [`SigningState`] in TOML, with the name of its key. Times are units of 10 µs since 2015-01-01 UTC.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct MemoryRecord {
    /// Which key the stamps belong to: its name, not the key.
    pub key_name: String,
    /// The computer's date.
    pub date: u64,
    /// The time of signatures.
    pub clock: u64,
    /// The last stamp of our own.
    pub own: u64,
    /// Streams that are not listed must be later than this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub floor: Option<u64>,
    /// The last accepted timestamp of every stream.
    #[serde(default)]
    pub streams: Vec<StreamRecord>,
}

/// One stream of a [`MemoryRecord`].
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct StreamRecord {
    /// The sender's system.
    pub system: u8,
    /// The sender's component.
    pub component: u8,
    /// What the sender calls the link.
    pub link_id: u8,
    /// Its last stamp.
    pub timestamp: u64,
    /// When it came, by the computer's date.
    pub date: u64,
}

fn default_accept_unsigned() -> Vec<u32> {
    vec![RADIO_STATUS]
}

const fn default_required() -> bool {
    true
}

impl SigningSection {
    pub fn to_signing_config(&self, key: Key, memory: SigningState) -> SigningConfig {
        let accepted: BTreeSet<u32> = self.accept_unsigned.iter().copied().collect();
        SigningConfig {
            key,
            link_id: self.link_id,
            unsigned: if self.required { UnsignedPolicy::RejectExcept(accepted) } else { UnsignedPolicy::Accept },
            state: memory,
        }
    }
}

impl MemoryRecord {
    pub fn of(key: &Key, memory: &SigningState) -> Self {
        let stream = |(id, state): (&StreamId, &SignedStreamState)| StreamRecord {
            system: id.source.system.0,
            component: id.source.component.0,
            link_id: id.link_id,
            timestamp: state.timestamp.units(),
            date: state.date.units(),
        };
        Self {
            key_name: key.name(),
            date: memory.written_at.units(),
            clock: memory.clock.units(),
            own: memory.last_sent.units(),
            floor: memory.min_timestamp.map(SigningTime::units),
            streams: memory.streams.iter().map(stream).collect(),
        }
    }

    pub fn memory(&self) -> SigningState {
        let stream = |stream: &StreamRecord| {
            let id = StreamId { source: Address::new(stream.system, stream.component), link_id: stream.link_id };
            let state = SignedStreamState {
                timestamp: SigningTime::from_units(stream.timestamp),
                date: SigningTime::from_units(stream.date),
            };
            (id, state)
        };
        SigningState {
            written_at: SigningTime::from_units(self.date),
            clock: SigningTime::from_units(self.clock),
            last_sent: SigningTime::from_units(self.own),
            min_timestamp: self.floor.map(SigningTime::from_units),
            streams: self.streams.iter().map(stream).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load_text;

    #[test]
    fn a_key_file_is_enough_and_another_link_id_allows_the_same_key() {
        let link = |signing: &str| format!("[[link]]\nurl = \"udp://127.0.0.1:1\"\nsigning = {{ {signing} }}\n");
        let two = link("key_file = \"a.key\"") + &link("key_file = \"a.key\", link_id = 1");
        let config = load_text("test", &two, &[]).unwrap().config;
        config.station_config().unwrap();
        let section = config.links[0].signing.clone().unwrap();
        assert_eq!((section.required, section.accept_unsigned), (true, vec![109]));
    }

    #[test]
    fn a_memory_survives_toml() {
        let key = Key::from_bytes([3; 32]);
        let stream = StreamId { source: Address::new(1, 2), link_id: 3 };
        let state = SignedStreamState { timestamp: SigningTime::MAX, date: SigningTime::from_units(4) };
        for floor in [None, Some(SigningTime::from_units(9))] {
            let memory = SigningState {
                written_at: SigningTime::from_units(5),
                clock: SigningTime::from_units(6),
                last_sent: SigningTime::from_units(7),
                min_timestamp: floor,
                streams: [(stream, state)].into(),
            };
            let text = toml::to_string(&MemoryRecord::of(&key, &memory)).unwrap();
            let record: MemoryRecord = toml::from_str(&text).unwrap();
            assert_eq!(record.memory(), memory);
            assert_eq!(record.key_name, key.name());
        }
    }
}

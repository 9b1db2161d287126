//! The signing of a link: which key, under which number, and what may come without.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Result, ensure};
use posebridge_protocol::signing::{Heard, Key, Memory, RADIO_STATUS, SigningConfig, StreamId, Timestamp, Unsigned};
use posebridge_telemetry::Address;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Config;
use crate::link_target::LinkTarget;

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
    /// Refuse everything else that has no signature. With false only wrong signatures are refused, and nobody is kept out.
    #[serde(default = "default_required")]
    pub required: bool,
    /// With which stamps a recorded session began: the station writes it into its recordings, nobody else writes it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub begun: Option<MemoryRecord>,
}

/// A [`Memory`] in TOML, with the name of its key. Times are units of 10 µs since 2015-01-01 UTC.
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
    /// The last that was believed of every stream.
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
    /// What the pipeline needs, with the key and with what the link begins with.
    #[must_use]
    pub fn pipeline(&self, key: Key, memory: Memory) -> SigningConfig {
        let accepted: BTreeSet<u32> = self.accept_unsigned.iter().copied().collect();
        SigningConfig {
            key,
            link_id: self.link_id,
            unsigned: if self.required { Unsigned::RefuseExcept(accepted) } else { Unsigned::Accept },
            memory,
        }
    }
}

impl MemoryRecord {
    /// A memory as it is written down.
    #[must_use]
    pub fn of(key: &Key, memory: &Memory) -> Self {
        let stream = |(id, heard): (&StreamId, &Heard)| StreamRecord {
            system: id.source.system.0,
            component: id.source.component.0,
            link_id: id.link_id,
            timestamp: heard.timestamp.units(),
            date: heard.date.units(),
        };
        Self {
            key_name: key.name(),
            date: memory.written.units(),
            clock: memory.clock.units(),
            own: memory.own.units(),
            floor: memory.floor.map(Timestamp::units),
            streams: memory.streams.iter().map(stream).collect(),
        }
    }

    /// The memory that was written down.
    #[must_use]
    pub fn memory(&self) -> Memory {
        let stream = |stream: &StreamRecord| {
            let id = StreamId { source: Address::new(stream.system, stream.component), link_id: stream.link_id };
            let heard =
                Heard { timestamp: Timestamp::from_units(stream.timestamp), date: Timestamp::from_units(stream.date) };
            (id, heard)
        };
        Memory {
            written: Timestamp::from_units(self.date),
            clock: Timestamp::from_units(self.clock),
            own: Timestamp::from_units(self.own),
            floor: self.floor.map(Timestamp::from_units),
            streams: self.streams.iter().map(stream).collect(),
        }
    }
}

impl Config {
    /// Refuses signing that cannot work; reads no key.
    ///
    /// # Errors
    /// The message names the link and what stands against it.
    pub(super) fn check_signing(&self) -> Result<()> {
        let mut used = BTreeMap::new();
        for (index, link) in self.links.iter().enumerate() {
            let Some(signing) = &link.signing else {
                continue;
            };
            let name = format!("link {index} `{}`", link.url);
            ensure!(!link.send_mavlink1, "{name}: MAVLink 1 cannot be signed; take away `send_mavlink1` or `signing`");
            ensure!(
                !matches!(LinkTarget::parse(&link.url), Ok(LinkTarget::Sim(_))),
                "{name}: the simulated brick does not sign; take away `signing`"
            );
            let before = used.insert((&signing.key_file, signing.link_id), index);
            if let Some(other) = before {
                ensure!(
                    false,
                    "{name}: link {other} uses the same key with the same `signing.link_id` {}; give each link its own",
                    signing.link_id
                );
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load_text;

    fn checked(links: &str) -> Result<(), String> {
        let config = load_text("test", links, &[]).unwrap().config;
        config.pipeline().map(drop).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn a_key_file_is_enough_and_what_cannot_work_is_refused() {
        let signing = "signing = { key_file = \"a.key\" }";
        let link = format!("[[link]]\nurl = \"udp://127.0.0.1:1\"\n{signing}\n");
        let config = load_text("test", &link, &[]).unwrap().config;
        let section = config.links[0].signing.clone().unwrap();
        assert!(section.required);
        assert_eq!(section.accept_unsigned, [109]);
        assert_eq!(checked(&link), Ok(()));
        let twice = checked(&format!("{link}{link}")).unwrap_err();
        assert!(twice.contains("the same key"), "{twice}");
        let other = link.replace("a.key\"", "a.key\", link_id = 1");
        assert_eq!(checked(&format!("{link}{other}")), Ok(()));
        let old = checked(&format!("{link}send_mavlink1 = true\n")).unwrap_err();
        assert!(old.contains("MAVLink 1 cannot be signed"), "{old}");
        let sim = checked(&link.replace("udp://127.0.0.1:1", "sim://square")).unwrap_err();
        assert!(sim.contains("simulated brick"), "{sim}");
    }

    #[test]
    fn a_memory_survives_toml() {
        let key = Key::from_bytes([3; 32]);
        let stream = StreamId { source: Address::new(1, 2), link_id: 3 };
        let heard = Heard { timestamp: Timestamp::MAX, date: Timestamp::from_units(4) };
        for floor in [None, Some(Timestamp::from_units(9))] {
            let memory = Memory {
                written: Timestamp::from_units(5),
                clock: Timestamp::from_units(6),
                own: Timestamp::from_units(7),
                floor,
                streams: [(stream, heard)].into(),
            };
            let text = toml::to_string(&MemoryRecord::of(&key, &memory)).unwrap();
            let record: MemoryRecord = toml::from_str(&text).unwrap();
            assert_eq!(record.memory(), memory);
            assert_eq!(record.key_name, key.name());
        }
    }
}

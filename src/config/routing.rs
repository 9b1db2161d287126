//! Forwarding between links: the keys of `[[link]]` and `[routing]` that docs/routing.md explains.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use posebridge_protocol::dialect::message_id_named;
use posebridge_protocol::routing::{AllowBlockList, FrameFilter, RateLimits};
use posebridge_telemetry::{ComponentId, SystemId, TimeDelta};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const LARGEST_ID: u32 = 0x00FF_FFFF;
/// Limit of the duplicate window: longer than any routing loop.
const LONGEST_WINDOW_MS: u32 = 60_000;

/// What holds for all links.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(default, deny_unknown_fields)]
pub struct RoutingSection {
    /// How long a frame is remembered, to know it again when it comes by another link; 0 turns this off.
    pub duplicate_window_ms: u32,
}

impl Default for RoutingSection {
    /// Longer than a frame may travel in a loop: a Bluetooth link stalls for up to 10 s (config/links/bluetooth-spp.toml), and a queue
    /// of 64 KiB takes 11.4 s at 57600 baud.
    fn default() -> Self {
        Self { duplicate_window_ms: 15_000 }
    }
}

/// What of the others' frames is passed on to a link.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum ForwardChoice {
    /// Robots' frames to ground stations, cameras' to a lone robot, ground stations' to all, those with a target to it.
    #[default]
    ByRole,
    /// Everything that concerns it, also from robot to robot.
    All,
    /// Only frames whose target was received from there.
    Targeted,
    /// Nothing, nor anything from it to other links.
    None,
}

/// The dialects of others' frames that are passed on to a link.
#[derive(Clone, Copy, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum DialectChoice {
    /// Those of the MAVLink project, which ground stations know; without our own.
    Stock,
    /// All, known or not.
    All,
}

/// Which frames pass. An empty list of those that are allowed allows all.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(default, deny_unknown_fields)]
pub struct FrameFilterSection {
    /// Only these messages, by name or number.
    pub allow_messages: Vec<MessageRef>,
    /// Not these messages.
    pub block_messages: Vec<MessageRef>,
    /// Only from these systems.
    pub allow_systems: Vec<u8>,
    /// Not from these systems.
    pub block_systems: Vec<u8>,
    /// Only from these components.
    pub allow_components: Vec<u8>,
    /// Not from these components.
    pub block_components: Vec<u8>,
}

/// A message by its name or its number.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(untagged, expecting = "a message is its name, such as \"ATTITUDE\", or its number")]
pub enum MessageRef {
    /// The number on the wire.
    Id(u32),
    /// The name in the definitions of common.xml or of our own dialect.
    Name(String),
}

/// How much may leave.
#[derive(Clone, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(default, deny_unknown_fields)]
pub struct LimitsSection {
    /// Bytes per second of forwarded frames and of our own estimates; 0 for no limit.
    pub bytes_per_s: u32,
    /// Least time between two messages of one kind from one sender, by name or number.
    pub min_interval_ms: BTreeMap<String, u32>,
}

impl RoutingSection {
    pub(super) fn window(self) -> Result<TimeDelta> {
        ensure!(
            self.duplicate_window_ms <= LONGEST_WINDOW_MS,
            "`routing.duplicate_window_ms` is {}; at most {LONGEST_WINDOW_MS}",
            self.duplicate_window_ms
        );
        Ok(TimeDelta::from_millis(i64::from(self.duplicate_window_ms)))
    }
}

impl FrameFilterSection {
    pub(super) fn filter(&self) -> Result<FrameFilter> {
        Ok(FrameFilter {
            messages: AllowBlockList {
                allow: ids(&self.allow_messages).context("`allow_messages`")?,
                block: ids(&self.block_messages).context("`block_messages`")?,
            },
            systems: allow_block_list(&self.allow_systems, &self.block_systems, SystemId),
            components: allow_block_list(&self.allow_components, &self.block_components, ComponentId),
        })
    }
}

impl LimitsSection {
    pub(super) fn limits(&self) -> Result<RateLimits> {
        let mut least_intervals = BTreeMap::new();
        for (name, millis) in &self.min_interval_ms {
            let id = id_of(name).context("`min_interval_ms`")?;
            let interval = TimeDelta::from_millis(i64::from(*millis));
            ensure!(
                least_intervals.insert(id, interval).is_none(),
                "`min_interval_ms`: message {id} stands there by its name and by its number"
            );
        }
        Ok(RateLimits {
            min_intervals: least_intervals,
            bytes_per_s: (self.bytes_per_s != 0).then_some(self.bytes_per_s),
        })
    }
}

fn allow_block_list<T>(allow: &[u8], block: &[u8], typed: fn(u8) -> T) -> AllowBlockList<T> {
    AllowBlockList {
        allow: allow.iter().copied().map(typed).collect(),
        block: block.iter().copied().map(typed).collect(),
    }
}

fn ids(messages: &[MessageRef]) -> Result<Vec<u32>> {
    messages
        .iter()
        .map(|message| match message {
            MessageRef::Id(id) => checked(*id),
            MessageRef::Name(name) => id_of(name),
        })
        .collect()
}

fn id_of(name: &str) -> Result<u32> {
    if let Ok(id) = name.parse() {
        return checked(id);
    }
    let Some(id) = message_id_named(name) else {
        bail!("there is no message `{name}`; names are those of common.xml and posebridge.xml, others go by number");
    };
    Ok(id)
}

fn checked(id: u32) -> Result<u32> {
    ensure!(id <= LARGEST_ID, "message {id} cannot be; ids end at {LARGEST_ID}");
    Ok(id)
}

#[cfg(test)]
mod tests {
    use crate::config::load_text;
    use posebridge_protocol::routing::{ForwardPolicy, LinkRules};
    use posebridge_telemetry::{SystemId, TimeDelta};

    fn rules(text: &str) -> anyhow::Result<Vec<LinkRules>> {
        let config = load_text("test", text, &[])?.config;
        Ok(config.station_config()?.links.into_iter().map(|link| link.rules).collect())
    }

    #[test]
    fn every_key_reaches_its_rule() {
        let links = rules(
            r#"
            [[link]]
            url = "udp://:14550"
            group = "brick"
            forward = "targeted"
            filter_in = { block_messages = ["ATTITUDE", 42102], allow_systems = [1, 2] }
            [[link]]
            url = "udp://:14551"
            [[link]]
            url = "udp://:14552"
            group = "brick"
            filter_out = { allow_components = [190], block_components = [1], block_systems = [7], allow_messages = [0] }
            limits = { bytes_per_s = 500, min_interval_ms = { ATTITUDE = 200, 42102 = 100 } }
            "#,
        )
        .unwrap();
        assert_eq!(links[0].group, links[2].group);
        assert!(links[0].group.is_some());
        assert_eq!(links[1], LinkRules::default());
        assert_eq!(links[0].forward, ForwardPolicy::Targeted);
        assert_eq!(links[0].inward.messages.block, [30, 42_102]);
        assert_eq!(links[0].inward.systems.allow, [SystemId(1), SystemId(2)]);
        let out = &links[2].outward;
        assert_eq!((out.messages.allow.clone(), out.systems.block.clone()), (vec![0], vec![SystemId(7)]));
        assert_eq!((out.components.allow[0].0, out.components.block[0].0), (190, 1));
        let limits = &links[2].limits;
        assert_eq!(limits.bytes_per_s, Some(500));
        let intervals: Vec<_> = limits.min_intervals.iter().collect();
        assert_eq!(intervals, [(&30, &TimeDelta::from_millis(200)), (&42_102, &TimeDelta::from_millis(100))]);
    }
}

//! `[[robot]]` blocks: a list of robots, each with its own configuration.
//! TOML has either one table `[robot]` or a list `[[robot]]`. In a list every block has a `match`, except at most one, which applies to
//! all robots that no other block matches. The others inherit missing keys from that one.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use posebridge_station::RobotMatch;
use posebridge_telemetry::{ComponentId, LinkId, SystemId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::robot::RobotFile;

/// Robot sections that configure a link's protocol.
const LINK_SECTIONS: [&str; 3] = ["nxt", "ev3", "line"];
/// In characters: with its ids the name fits into two parts of a STATUSTEXT.
const MAX_NAME_CHARS: usize = 50;

/// A robot with a configuration of its own, as `[[robot]]` with a `match` in a file.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct RobotBlockSection {
    /// Which robots it is for.
    #[serde(rename = "match")]
    pub matches: RobotMatchSection,
    /// The number of the robot's tag, by which fixes name it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tag: Option<u32>,
    /// The robot.
    pub robot: RobotFile,
}

/// Which robots a block is for: all that is given must hold.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize, JsonSchema, PartialEq, Eq)]
#[serde(default, deny_unknown_fields)]
pub struct RobotMatchSection {
    /// The number of the link that it is heard on, from 0 in the order of the configuration.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub link: Option<u16>,
    /// Its MAVLink system.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub system: Option<u8>,
    /// Its MAVLink component.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub component: Option<u8>,
}

impl RobotBlockSection {
    /// The robot's name, if the block has another one than `default`. Rejects names that are too long or contain non-printable
    /// characters: the file is untrusted, and the name is shown in terminals and pages.
    pub(super) fn own_name(&self, default: &str) -> Result<Option<String>> {
        let name = &self.robot.name;
        let is_shown = |letter: char| letter.is_alphanumeric() || matches!(letter, ' '..='~');
        ensure!(
            name.chars().count() <= MAX_NAME_CHARS && name.chars().all(is_shown),
            "`robot.name` is {name:?}, must be at most {MAX_NAME_CHARS} letters, digits, spaces and ASCII punctuation"
        );
        Ok((name != default && !name.is_empty()).then(|| name.clone()))
    }
}

impl RobotMatchSection {
    pub fn to_match(self) -> RobotMatch {
        RobotMatch {
            link: self.link.map(LinkId),
            system: self.system.map(SystemId),
            component: self.component.map(ComponentId),
        }
    }
}

/// Splits a list `[[robot]]` into the table `robot` and the list `robots`; returns whether there was one. Rejects a list with two
/// entries without `match`, and a link section that no link would read.
pub(super) fn split_robot_list(file: &mut toml::Table) -> Result<bool, String> {
    let Some(toml::Value::Array(entries)) = file.get("robot") else {
        return Ok(false);
    };
    let mut default = None;
    let mut blocks = Vec::new();
    let mut by_link = BTreeMap::new();
    for (index, entry) in entries.iter().enumerate() {
        let toml::Value::Table(entry) = entry else {
            return Err(format!("`robot[{index}]` is no table"));
        };
        if entry.contains_key("match") {
            check_link_sections(index, entry, &mut by_link)?;
            blocks.push(entry.clone());
        } else if default.replace(entry.clone()).is_some() {
            return Err(format!(
                "`robot[{index}]` has no `match`, and another block has none: only one can be for all other robots"
            ));
        }
    }
    let default = default.unwrap_or_default();
    let blocks = blocks.into_iter().map(|mut block| {
        let mut section = toml::Table::new();
        for key in ["match", "tag"] {
            section.extend(block.remove(key).map(|value| (key.to_owned(), value)));
        }
        let mut robot = default.clone();
        overlay(&mut robot, block);
        section.insert("robot".to_owned(), toml::Value::Table(robot));
        toml::Value::Table(section)
    });
    let blocks = blocks.collect();
    file.insert("robot".to_owned(), toml::Value::Table(default));
    file.insert("robots".to_owned(), toml::Value::Array(blocks));
    Ok(true)
}

/// Rejects link sections that would be ignored: a link reads them once, from the first block that names it. `by_link` maps each link to
/// an earlier block.
fn check_link_sections(index: usize, block: &toml::Table, by_link: &mut BTreeMap<i64, usize>) -> Result<(), String> {
    let link = block.get("match").and_then(|matches| matches.get("link")).and_then(toml::Value::as_integer);
    let first = link.map(|link| (link, *by_link.entry(link).or_insert(index)));
    for key in LINK_SECTIONS.iter().filter(|key| block.contains_key(**key)) {
        match first {
            None => {
                return Err(format!(
                    "`robot[{index}].{key}` is read for one link, and `robot[{index}].match` names none: add `link = N` to it, or move \
                     `{key}` to the block without `match`"
                ));
            }
            Some((link, first)) if first != index => {
                return Err(format!(
                    "`robot[{index}].{key}` is never read: link {link} takes what is plugged in from `robot[{first}]`, the first block \
                     that names it; move `{key}` there"
                ));
            }
            Some(_) => {}
        }
    }
    Ok(())
}

fn overlay(under: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(toml::Value::Table(under)), toml::Value::Table(over)) => overlay(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::config::load::load_text;
    use posebridge_station::{RobotBlock, RobotMatch};
    use posebridge_telemetry::SystemId;

    const FILE: &str = r#"
        [[robot]]
        track_width_m = 0.2
        noise.gyro_rad_per_s = 0.02

        [[robot]]
        match = { system = 7 }
        tag = 4
        name = "ada"
        track_width_m = 0.15
    "#;

    #[test]
    fn a_block_takes_from_the_one_without_a_match_what_it_does_not_say() {
        let config = load_text("f.toml", FILE, &[]).unwrap().config.station_config().unwrap();
        let other = &config.robot;
        assert_eq!((other.name.as_deref(), other.filter_config.geometry.track_width.0), (None, 0.2));
        let [RobotBlock { matches, robot: ada }] = config.robots.as_slice() else { panic!("there is one block") };
        assert_eq!(*matches, RobotMatch { system: Some(SystemId(7)), ..RobotMatch::default() });
        assert_eq!(
            (ada.name.as_deref(), ada.tag, ada.filter_config.geometry.track_width.0),
            (Some("ada"), Some(4), 0.15)
        );
        assert_eq!(ada.filter_config.noise.gyro_rad_per_s, 0.02);
    }

    #[test]
    fn a_name_is_the_blocks_own_and_can_be_shown_anywhere() {
        let name_of = |name: &str| {
            let text = format!("[[robot]]\nname = \"all\"\n[[robot]]\nmatch = {{}}\nname = \"{name}\"");
            let config = load_text("f.toml", &text, &[]).unwrap().config;
            config.station_config().map(|config| config.robots[0].robot.name.clone()).map_err(|error| error.to_string())
        };
        let longest = "\u{f6}".repeat(50);
        for (name, expected) in
            [("ada-1", Some("ada-1")), (longest.as_str(), Some(longest.as_str())), ("", None), ("all", None)]
        {
            assert_eq!(name_of(name), Ok(expected.map(str::to_owned)));
        }
        let too_long = "a".repeat(51);
        for name in [too_long.as_str(), r"a\u001b[2J", r"a\nb", r"a\u202eb"] {
            let error = name_of(name).unwrap_err();
            assert!(error.contains("`robot.name`") && error.chars().all(|letter| !letter.is_control()), "{error}");
        }
    }

    #[test]
    fn the_robot_of_a_link_is_plugged_in_as_its_block_says() {
        let text = r#"
            [[link]]
            url = "serial:///dev/rfcomm0"
            brick = "nxt"
            [[link]]
            url = "serial:///dev/rfcomm1"
            brick = "nxt"
            [[robot]]
            nxt.mailbox = 3
            [[robot]]
            match = { link = 1 }
            nxt.left_motor = "A"
            [[robot.thermometer]]
            channel = "temp1"
        "#;
        let config = load_text("f.toml", text, &[]).unwrap().config.station_config().unwrap();
        let nxt = |link: usize| config.links[link].brick.as_ref().unwrap().settings.nxt.clone();
        assert_ne!(nxt(0).left_motor, nxt(1).left_motor);
        assert_eq!(
            (nxt(0).mailbox, nxt(1).mailbox),
            (3, 3),
            "what a block does not say is that of the block without a match"
        );
        assert_eq!((config.robot.thermometers.len(), config.robots[0].robot.thermometers.len()), (0, 1));
    }

    #[test]
    fn what_is_printed_is_read_again() {
        let config = load_text("f.toml", FILE, &[]).unwrap().config;
        let printed = toml::to_string(&config).unwrap();
        assert_eq!(load_text("printed", &printed, &[]).unwrap().config, config);
    }
}

//! The configuration of a merged recording: what concerns the engine must be the same at all stations; the links stand one behind the
//! other, and so do the `[[robot]]` blocks of links.

use anyhow::{Context, Result, ensure};
use posebridge_telemetry::TimeDelta;

use crate::config::{
    Config, DashboardSection, FleetSection, MergedSection, PlotJugglerSection, RecordSection, RobotBlockSection,
    Ros2Section,
};

/// A station's part of the configuration.
#[derive(Clone, Copy, Debug)]
pub(super) struct StationConfiguration<'a> {
    /// Of its recording, for errors.
    pub(super) file: &'a str,
    /// Its id in the fleet, else the name of its recording.
    pub(super) station: &'a str,
    pub(super) config: &'a Config,
    pub(super) clock_ahead: TimeDelta,
}

/// The configuration of the merged recording. What does not concern the engine (recording, page, PlotJuggler, ROS 2) is that
/// of the first station.
///
/// Fails with the file and the key of what differs.
pub(super) fn merge_configurations(stations: &[StationConfiguration<'_>]) -> Result<Config> {
    let (first, others) = stations.split_first().context("there is no recording")?;
    for other in others {
        check_shared_keys(first, other)?;
    }
    let mut merged =
        Config { links: Vec::new(), robots: Vec::new(), fleet: shared_fleet(first.config), ..first.config.clone() };
    for one in stations {
        let links = u16::try_from(one.config.links.len()).ok();
        merged.merged.push(MergedSection {
            station: one.station.to_owned(),
            links: links.with_context(|| format!("`{}`: too many links", one.file))?,
            clock_ahead_ns: one.clock_ahead.as_nanos(),
        });
        merged.links.extend(one.config.links.iter().cloned());
    }
    ensure!(u16::try_from(merged.links.len()).is_ok(), "there are more than {} links together", u16::MAX);
    merged.robots = merge_blocks(stations)?;
    Ok(merged)
}

/// What all stations of a fleet have in common.
fn shared_fleet(config: &Config) -> FleetSection {
    FleetSection { name: config.fleet.name.clone(), ..FleetSection::default() }
}

/// Refuses a configuration in which a key that concerns the engine has another value than at the first station.
fn check_shared_keys(first: &StationConfiguration<'_>, other: &StationConfiguration<'_>) -> Result<()> {
    let shared = |config: &Config| {
        toml::Value::try_from(Config {
            links: Vec::new(),
            robots: Vec::new(),
            fleet: shared_fleet(config),
            ros2: Ros2Section::default(),
            record: RecordSection::default(),
            dashboard: DashboardSection::default(),
            plotjuggler: PlotJugglerSection::default(),
            ..config.clone()
        })
    };
    let mut differences = Vec::new();
    let (ours, theirs) = (shared(first.config)?, shared(other.config)?);
    push_differences(&mut Vec::new(), Some(&ours), Some(&theirs), &mut differences);
    let texts: Vec<String> = differences
        .iter()
        .map(|Difference { key, ours, theirs }| {
            format!("`{key}` is {theirs} in `{}` and {ours} in `{}`", other.file, first.file)
        })
        .collect();
    ensure!(
        texts.is_empty(),
        "the configurations of the stations differ, but a merged recording has one: {}",
        texts.join("; ")
    );
    Ok(())
}

struct Difference {
    key: String,
    /// As text; so is the other.
    ours: String,
    theirs: String,
}

fn push_differences<'v>(
    path: &mut Vec<&'v str>,
    ours: Option<&'v toml::Value>,
    theirs: Option<&'v toml::Value>,
    differences: &mut Vec<Difference>,
) {
    if let (Some(toml::Value::Table(ours)), Some(toml::Value::Table(theirs))) = (ours, theirs) {
        let further = theirs.keys().filter(|key| !ours.contains_key(*key));
        for key in ours.keys().chain(further) {
            path.push(key);
            push_differences(path, ours.get(key), theirs.get(key), differences);
            path.pop();
        }
    } else if ours != theirs {
        let text = |value: Option<&toml::Value>| value.map_or_else(|| "not set".to_owned(), toml::Value::to_string);
        differences.push(Difference { key: path.join("."), ours: text(ours), theirs: text(theirs) });
    }
}

/// The blocks of all stations in an order in which each station finds the same one first as before: those without a link, which all must
/// have, and between them those of links, renumbered.
fn merge_blocks(stations: &[StationConfiguration<'_>]) -> Result<Vec<RobotBlockSection>> {
    let common = |config: &Config| -> Vec<RobotBlockSection> {
        config.robots.iter().filter(|block| block.matches.link.is_none()).cloned().collect()
    };
    let expected = stations.first().map(|first| common(first.config)).unwrap_or_default();
    // Before each of the common blocks, and behind the last.
    let mut gaps: Vec<Vec<RobotBlockSection>> = vec![Vec::new(); expected.len() + 1];
    let mut first_link = 0;
    for one in stations {
        ensure!(
            common(one.config) == expected,
            "`robot` in `{}`: the blocks whose `match` has no `link` are not those of the other recordings: {}",
            one.file,
            describe_difference(&common(one.config), &expected)
        );
        let links = one.config.links.len() as u16;
        let mut gap = 0;
        for block in &one.config.robots {
            match block.matches.link {
                None => gap += 1,
                // Of a link that there was not it was never used.
                Some(link) if link >= links => {}
                Some(link) => {
                    let mut block = block.clone();
                    block.matches.link = Some(first_link + link);
                    gaps[gap].push(block);
                }
            }
        }
        first_link += links;
    }
    let mut blocks = Vec::new();
    let mut common = expected.into_iter();
    for gap in gaps {
        blocks.extend(gap);
        blocks.extend(common.next());
    }
    Ok(blocks)
}

fn describe_difference(ours: &[RobotBlockSection], expected: &[RobotBlockSection]) -> String {
    let differing = ours.iter().zip(expected).find(|(ours, expected)| ours != expected);
    match differing {
        Some((ours, _)) => format!("that of robot `{}` is another one", ours.robot.name),
        None => format!("there are {} and not {}", ours.len(), expected.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load_text;

    fn config(text: &str) -> Config {
        load_text("test", text, &[]).unwrap().config
    }

    fn merge(first: &Config, second: &Config) -> Result<Config> {
        let of =
            |file, config| StationConfiguration { file, station: file, config, clock_ahead: TimeDelta::from_nanos(-7) };
        merge_configurations(&[of("a.mcap", first), of("b.mcap", second)])
    }

    const FIRST: &str = r#"
        [[link]]
        url = "udp://:1"
        [fleet]
        name = "class"
        station = "left"
        [[robot]]
        match = { link = 0 }
        name = "ada"
        [[robot]]
        match = { system = 7 }
        name = "eve"
        [[robot]]
        match = { link = 0, component = 2 }
        name = "fay"
        [[robot]]
        match = { link = 5 }
        name = "nowhere"
    "#;
    const SECOND: &str = r#"
        [[link]]
        url = "udp://:2"
        [[link]]
        url = "udp://:3"
        [fleet]
        name = "class"
        station = "right"
        listen = ["tcp/0.0.0.0:7447"]
        [record]
        enabled = false
        [[robot]]
        match = { link = 1 }
        name = "bob"
        [[robot]]
        match = { system = 7 }
        name = "eve"
    "#;

    #[test]
    fn links_and_blocks_of_the_second_come_behind_those_of_the_first() {
        let merged = merge(&config(FIRST), &config(SECOND)).unwrap();
        let urls: Vec<&str> = merged.links.iter().map(|link| link.url.as_str()).collect();
        assert_eq!(urls, ["udp://:1", "udp://:2", "udp://:3"]);
        let blocks: Vec<_> =
            merged.robots.iter().map(|block| (block.robot.name.as_str(), block.matches.link)).collect();
        assert_eq!(blocks, [("ada", Some(0)), ("bob", Some(2)), ("eve", None), ("fay", Some(0))]);
        let stations: Vec<_> = merged.merged.iter().map(|one| (one.station.as_str(), one.links)).collect();
        assert_eq!(stations, [("a.mcap", 1), ("b.mcap", 2)]);
        assert!(merged.fleet.station.is_empty() && merged.record.enabled);
        // What is written is read again.
        assert_eq!(config(&toml::to_string(&merged).unwrap()), merged);
    }

    #[test]
    fn what_differs_is_refused_with_its_key_and_both_files() {
        let error = |text: &str| format!("{:#}", merge(&config(FIRST), &config(text)).unwrap_err());
        let changed = SECOND.to_owned() + "[filter]\ngate_prob = 0.9\n[station]\nsystem = 4";
        let text = error(&changed);
        assert!(text.contains("`filter.gate_prob` is 0.9 in `b.mcap` and "), "{text}");
        assert!(text.contains("`station.system` is 4 in `b.mcap` and 1 in `a.mcap`"), "{text}");
        let text = error(&SECOND.replace("\"class\"", "\"other\""));
        assert!(text.contains("`fleet.name` is \"other\" in `b.mcap`"), "{text}");
        let text = error(&(SECOND.to_owned() + "track_width_m = 0.2"));
        assert!(text.contains("`robot` in `b.mcap`") && text.contains("robot `eve` is another one"), "{text}");
        let text = error(&SECOND.replace("system = 7", "link = 0"));
        assert!(text.contains("there are 0 and not 1"), "{text}");
    }
}

//! The files of contrib/ against the program: metrics that it prints, flags that it has, rules that udev reads.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

#[path = "../crates/dashboard/tests/support/http.rs"]
mod http;
mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use clap::Parser;
use http::{StreamReader, get};
use posebridge::cli::{self, Cli};
use support::{RunningProgram, posebridge, root};

fn read(file: &str) -> String {
    std::fs::read_to_string(root().join("contrib").join(file)).unwrap()
}

/// The values of each label of each metric that a station prints, once its simulated robot has been seen and asked for its time.
fn printed_metrics() -> BTreeMap<String, BTreeMap<String, BTreeSet<String>>> {
    let folder = tempfile::tempdir().unwrap();
    let mut command = posebridge(folder.path());
    command.args(["run", "--dashboard", "127.0.0.1:0", "--out", "run"]);
    let mut program = RunningProgram::start(&mut command);
    let line = program.wait_for("dashboard: http://");
    let (_, rest) = line.split_once("http://").unwrap();
    let address = rest.trim().trim_end_matches('/').parse().unwrap();
    let mut reader = StreamReader::open(address);
    reader.wait_for(|message| message["links"][0]["round_trip_ms"].is_number());
    reader.wait_for(|message| {
        let fixes = message["robots"][0]["fixes"].as_array();
        fixes.is_some_and(|fixes| fixes.iter().any(|fix| fix["verdict"] == "accepted"))
    });
    // Said once a second, like the health of a link.
    for _ in 0..2 {
        reader.wait_for(|message| message["links"].is_array());
    }
    let page = get(address, "/metrics").text();
    program.interrupt();
    let mut metrics: BTreeMap<String, BTreeMap<String, BTreeSet<String>>> = BTreeMap::new();
    for line in page.lines().filter(|line| !line.starts_with('#')) {
        let (name, rest) = line.split_at(line.find(['{', ' ']).unwrap());
        let labels = metrics.entry(name.to_owned()).or_default();
        for (label, value) in selectors(rest) {
            labels.entry(label).or_default().insert(value);
        }
    }
    metrics
}

/// The labels with their values in `{a="b",c!="d"}` and so on; without braces none.
fn selectors(text: &str) -> Vec<(String, String)> {
    let Some((_, inner)) = text.split_once('{') else {
        return Vec::new();
    };
    let inner = inner.split('}').next().unwrap();
    let pairs = inner.split("\",").map(|pair| {
        let (label, value) = pair.split_once('=').unwrap();
        let label = label.trim_end_matches('!').to_owned();
        (label, value.trim_matches(['~', '"']).to_owned())
    });
    pairs.collect()
}

/// Every query of a dashboard, and every legend beside it.
fn queries(dashboard: &serde_json::Value) -> Vec<(String, String)> {
    let panels = dashboard["panels"].as_array().unwrap();
    let targets = panels.iter().flat_map(|panel| panel["targets"].as_array().unwrap());
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    targets.map(|target| (text(&target["expr"]), text(&target["legendFormat"]))).collect()
}

/// Labels that Prometheus adds itself.
const OF_PROMETHEUS: [&str; 1] = ["instance"];

#[test]
fn every_metric_of_the_grafana_dashboard_is_printed_with_the_labels_that_it_names() {
    let metrics = printed_metrics();
    let dashboard: serde_json::Value = serde_json::from_str(&read("grafana/posebridge.json")).unwrap();
    let mut used = BTreeSet::new();
    for (query, legend) in queries(&dashboard) {
        let mut labels = BTreeSet::new();
        for part in query.split("posebridge_").skip(1) {
            let name_end = part.find(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            let (name, rest) = part.split_at(name_end.unwrap());
            let name = format!("posebridge_{name}");
            let known = metrics.get(&name).unwrap_or_else(|| panic!("nobody prints {name}: {query}"));
            assert!(rest.starts_with('{'), "{query}");
            for (label, value) in selectors(rest) {
                if OF_PROMETHEUS.contains(&label.as_str()) {
                    continue;
                }
                let values = known.get(&label);
                let values = values.unwrap_or_else(|| panic!("{name} has no {label}: {query}"));
                assert!(values.contains(&value), "{name} has no {label} {value}: {values:?}");
            }
            labels.extend(known.keys().map(String::as_str));
            used.insert(name);
        }
        labels.extend(OF_PROMETHEUS);
        let braces = |text: &str, open: &str, close: &str| -> Vec<String> {
            let parts = text.split(open).skip(1);
            let inner = parts.map(|part| part.split(close).next().unwrap().to_owned());
            inner.collect()
        };
        let grouped = braces(&query, "by (", ")");
        let grouped = grouped.iter().flat_map(|list| list.split(", "));
        let told = braces(&legend, "{{", "}}");
        for label in grouped.chain(told.iter().map(String::as_str)) {
            assert!(labels.contains(label), "no metric has `{label}`: {query}, {legend}");
        }
    }
    assert!(used.len() > 15, "{used:?}");
    let variable = &dashboard["templating"]["list"][0]["query"]["query"];
    assert_eq!(variable, "label_values(posebridge_estimates_total, instance)");
    assert!(metrics.contains_key("posebridge_estimates_total"));
}

#[test]
fn the_panels_of_the_grafana_dashboard_do_not_overlap() {
    let dashboard: serde_json::Value = serde_json::from_str(&read("grafana/posebridge.json")).unwrap();
    let mut taken = BTreeSet::new();
    let mut ids = BTreeSet::new();
    for panel in dashboard["panels"].as_array().unwrap() {
        let place = |key: &str| panel["gridPos"][key].as_u64().unwrap();
        let title = &panel["title"];
        assert!(ids.insert(panel["id"].as_u64().unwrap()), "{title}");
        assert!(place("x") + place("w") <= 24, "{title}");
        for x in place("x")..place("x") + place("w") {
            for y in place("y")..place("y") + place("h") {
                assert!(taken.insert((x, y)), "{title}");
            }
        }
    }
}

/// Sections of a unit with their keys, in their order.
fn unit(text: &str) -> BTreeMap<String, Vec<(String, String)>> {
    let mut sections: BTreeMap<String, Vec<(String, String)>> = BTreeMap::new();
    let mut section = String::new();
    for line in text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if let Some(name) = line.strip_prefix('[') {
            name.trim_end_matches(']').clone_into(&mut section);
            continue;
        }
        let (key, value) = line.split_once('=').unwrap_or_else(|| panic!("{line}"));
        let keys = sections.entry(section.clone()).or_default();
        keys.push((key.to_owned(), value.to_owned()));
    }
    sections
}

#[test]
fn the_service_calls_the_program_as_it_wants_to_be_called() {
    let sections = unit(&read("systemd/posebridge.service"));
    let value = |key: &str| {
        let found = sections["Service"].iter().find(|(name, _)| name == key);
        found.unwrap_or_else(|| panic!("{key}")).1.as_str()
    };
    let words: Vec<&str> = value("ExecStart").split(' ').collect();
    assert_eq!(words[0], "/usr/local/bin/posebridge");
    let Some(cli::Command::Run(run)) = Cli::try_parse_from(&words).unwrap().command else {
        panic!("{words:?}");
    };
    // The folders that systemd makes are those that the command line and the comments name.
    let config = format!("/etc/{}/posebridge.toml", value("ConfigurationDirectory"));
    assert_eq!(run.config.config.unwrap().to_str(), Some(config.as_str()));
    let state = format!("/var/lib/{}", value("StateDirectory"));
    assert_eq!(value("WorkingDirectory"), state);
    // 2 is what the program says where it could not start.
    let could_not_start = posebridge::exit::Failure::CouldNotStart(anyhow::anyhow!(""));
    let code = could_not_start.exit_code().to_string();
    assert_eq!(value("RestartPreventExitStatus"), code);
}

/// Where there is no systemd on this computer the unit is only read by the test above.
#[test]
fn systemd_finds_no_fault_in_the_service() {
    let folder = tempfile::tempdir().unwrap();
    let here = env!("CARGO_BIN_EXE_posebridge");
    let text = read("systemd/posebridge.service").replace("/usr/local/bin/posebridge", here);
    let path = folder.path().join("posebridge.service");
    std::fs::write(&path, text).unwrap();
    let verified =
        Command::new("systemd-analyze").args(["verify", "--man=no", "--recursive-errors=no"]).arg(&path).output();
    if let Ok(verified) = verified {
        let said = String::from_utf8_lossy(&verified.stderr);
        assert!(verified.status.success() && said.is_empty(), "{said}");
    }
}

/// What udev knows, as far as these rules use it (udev(7)): keys that are compared, keys that are assigned.
const MATCHED: [&str; 7] = ["ACTION", "KERNEL", "SUBSYSTEM", "ATTR", "ATTRS", "ENV", "TAG"];
const ASSIGNED: [&str; 8] = ["MODE", "GROUP", "TAG", "ENV", "SYMLINK", "GOTO", "LABEL", "OWNER"];

/// One part of a rule: key, what stands in its braces, operator, value.
type RulePart<'a> = (&'a str, Option<&'a str>, &'a str, &'a str);

fn part(text: &str) -> Result<RulePart<'_>, String> {
    let operator_at = text.find(['=', '!', '+', '-', ':']).ok_or("no operator")?;
    let (name, rest) = text.split_at(operator_at);
    let value_at = rest.find('"').ok_or("no quote")?;
    let (operator, value) = rest.split_at(value_at);
    let value = value
        .strip_prefix('"')
        .and_then(|value| value.strip_suffix('"'))
        .filter(|value| !value.contains('"'))
        .ok_or("a value is in quotes")?;
    let (key, braces) = match name.split_once('{') {
        Some((key, inner)) => (key, Some(inner.strip_suffix('}').ok_or("no brace")?)),
        None => (name, None),
    };
    let known = match operator {
        "==" | "!=" => MATCHED.contains(&key),
        "=" | "+=" => ASSIGNED.contains(&key),
        _ => false,
    };
    let needs_braces = ["ATTR", "ATTRS", "ENV"].contains(&key);
    if known && needs_braces == braces.is_some() {
        Ok((key, braces, operator, value))
    } else {
        Err(format!("`{key}` with `{operator}`"))
    }
}

fn rules(text: &str) -> Vec<Vec<RulePart<'_>>> {
    let lines = text.lines().enumerate();
    let lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    lines
        .map(|(number, line)| {
            let parts = line.split(", ");
            let read: Result<Vec<_>, _> = parts.map(part).collect();
            read.unwrap_or_else(|error| panic!("line {}: {error}: {line}", number + 1))
        })
        .collect()
}

#[test]
fn the_rules_are_such_as_udev_reads() {
    let text = read("udev/70-posebridge.rules");
    let rules = rules(&text);
    let (mut labels, mut ids) = (BTreeSet::new(), 0);
    // From the end: a jump leads forward.
    for rule in rules.iter().rev() {
        for (key, braces, operator, value) in rule {
            match (*key, *braces) {
                ("LABEL", _) => assert!(labels.insert(*value), "{value} twice"),
                ("GOTO", _) => assert!(labels.contains(value), "{value} is not behind it"),
                ("ATTR" | "ATTRS", Some("idVendor" | "idProduct")) => {
                    let is_id = |id: &str| id.len() == 4 && id.chars().all(|c| matches!(c, '0'..='9' | 'a'..='f'));
                    assert!(value.split('|').all(is_id), "{value}");
                    ids += 1;
                }
                ("MODE", _) => assert_eq!(*value, "0660", "nothing is open to everybody"),
                ("GROUP", _) => assert_eq!((*operator, *value), ("=", "dialout")),
                _ => {}
            }
        }
        // Attributes of a parent are those of one parent: two of them in a rule speak of the same device.
        let parents = rule.iter().filter(|(key, ..)| *key == "ATTRS").count();
        assert!(parents <= 2, "{rule:?}");
    }
    assert!(ids > 20, "{ids}");
    for wrong in ["GROUP==\"dialout\"", "ATTRS=\"0694\"", "MODE=0660", "KERNEL=\"tty\"", "FOO==\"a\""] {
        part(wrong).unwrap_err();
    }
}

/// `udevadm verify` came with systemd 254; without it, only the test above looks at the rules.
#[test]
fn udev_finds_no_fault_in_the_rules() {
    let verifies = Command::new("udevadm").args(["verify", "--help"]).output();
    if verifies.is_ok_and(|output| output.status.success()) {
        let path = root().join("contrib/udev/70-posebridge.rules");
        let verified = Command::new("udevadm").arg("verify").arg(path).output();
        let verified = verified.unwrap();
        let said = String::from_utf8_lossy(&verified.stderr);
        assert!(verified.status.success(), "{said}");
    }
}

/// A port that the doctor would warn about is one that the rules keep ModemManager away from.
#[test]
fn every_board_of_the_rules_is_kept_from_modem_manager() {
    let text = read("udev/70-posebridge.rules");
    let rules = rules(&text);
    let vendors = |rule: &[RulePart<'_>], of: &str| -> Vec<String> {
        let found = rule.iter().find(|(key, braces, ..)| *key == of && *braces == Some("idVendor"));
        let ids = found.map_or("", |(.., value)| value);
        ids.split('|').filter(|id| !id.is_empty()).map(str::to_owned).collect()
    };
    let sets = |rule: &[RulePart<'_>], variable: &str| {
        rule.iter().any(|(key, braces, operator, _)| (*key, *braces, *operator) == ("ENV", Some(variable), "="))
    };
    let ignored: BTreeSet<String> =
        rules.iter().filter(|rule| sets(rule, "ID_MM_DEVICE_IGNORE")).flat_map(|rule| vendors(rule, "ATTR")).collect();
    let boards: BTreeSet<String> =
        rules.iter().filter(|rule| sets(rule, "POSEBRIDGE_ROBOT")).flat_map(|rule| vendors(rule, "ATTRS")).collect();
    assert!(boards.len() > 8, "{boards:?}");
    assert_eq!(boards.difference(&ignored).count(), 0, "{ignored:?}");
}

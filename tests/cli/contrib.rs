//! The files of contrib/ against the program: metrics that it prints, flags that it has, boards that it knows.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use crate::http::{StreamReader, get};
use crate::support::{RunningProgram, read_text, root};
use clap::Parser;
use posebridge::cli::{self, Cli};

fn read(file: &str) -> String {
    read_text(&root().join("contrib"), file)
}

/// The values of each label of each metric that a station prints, once its simulated robot has been seen and asked for its time.
fn printed_metrics() -> BTreeMap<String, BTreeMap<String, BTreeSet<String>>> {
    let folder = tempfile::tempdir().unwrap();
    let run = ["run", "--dashboard", "127.0.0.1:0", "--out", "run"];
    let mut program = RunningProgram::posebridge(folder.path(), &run);
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

/// Labels that Prometheus adds itself.
const OF_PROMETHEUS: [&str; 1] = ["instance"];

#[test]
fn every_metric_of_the_grafana_dashboard_is_printed_with_the_labels_that_it_names() {
    let metrics = printed_metrics();
    let dashboard: serde_json::Value = serde_json::from_str(&read("grafana/posebridge.json")).unwrap();
    let panels = dashboard["panels"].as_array().unwrap();
    let mut used = BTreeSet::new();
    for target in panels.iter().flat_map(|panel| panel["targets"].as_array().unwrap()) {
        let [query, legend] = ["expr", "legendFormat"].map(|key| target[key].as_str().unwrap());
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
        let grouped = braces(query, "by (", ")");
        let grouped = grouped.iter().flat_map(|list| list.split(", "));
        let told = braces(legend, "{{", "}}");
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
fn the_service_calls_the_program_as_it_wants_to_be_called() {
    let unit = read("systemd/posebridge.service");
    let value = |key: &str| {
        let found = unit.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
        found.unwrap_or_else(|| panic!("{key}"))
    };
    let words: Vec<&str> = value("ExecStart").split(' ').collect();
    assert_eq!(words[0], "/usr/local/bin/posebridge");
    let Some(cli::Command::Run(run)) = Cli::try_parse_from(&words).unwrap().command else {
        panic!("{words:?}");
    };
    // The folders that systemd makes are those that the command line and the comments name.
    let config = format!("/etc/{}/posebridge.toml", value("ConfigurationDirectory"));
    assert_eq!(run.config.config.unwrap().to_str(), Some(config.as_str()));
    assert_eq!(value("WorkingDirectory"), format!("/var/lib/{}", value("StateDirectory")));
    // 2 is what the program says where it could not start.
    let could_not_start = posebridge::exit::Failure::CouldNotStart(anyhow::anyhow!(""));
    assert_eq!(value("RestartPreventExitStatus"), could_not_start.exit_code().to_string());
}

/// Where systemd and udev are on this computer, they find no fault in their files.
#[test]
fn systemd_and_udev_find_no_fault_in_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let unit = folder.path().join("posebridge.service");
    let here = env!("CARGO_BIN_EXE_posebridge");
    std::fs::write(&unit, read("systemd/posebridge.service").replace("/usr/local/bin/posebridge", here)).unwrap();
    let analyze = ["verify", "--man=no", "--recursive-errors=no"];
    if let Ok(verified) = Command::new("systemd-analyze").args(analyze).arg(&unit).output() {
        let complaints = String::from_utf8_lossy(&verified.stderr);
        assert!(verified.status.success() && complaints.is_empty(), "{complaints}");
    }
    // `udevadm verify` came with systemd 254.
    let verifies = Command::new("udevadm").args(["verify", "--help"]).output();
    if verifies.is_ok_and(|output| output.status.success()) {
        let rules = root().join("contrib/udev/70-posebridge.rules");
        let verified = Command::new("udevadm").arg("verify").arg(rules).output().unwrap();
        assert!(verified.status.success(), "{}", String::from_utf8_lossy(&verified.stderr));
    }
}

/// A port that the doctor would warn about is one that the rules keep ModemManager away from, and nothing is open to everybody.
#[test]
fn every_board_of_the_rules_is_kept_from_modem_manager() {
    let text = read("udev/70-posebridge.rules");
    let rules = || text.lines().filter(|line| !line.starts_with('#'));
    let value = |rule: &str, key: &str| -> Option<String> {
        let behind = rule.split(", ").find_map(|part| part.strip_prefix(key))?;
        Some(behind.trim_start_matches(['=', '+']).trim_matches('"').to_owned())
    };
    let vendors = |variable: &str, vendor: &str| -> BTreeSet<String> {
        let setting = rules().filter(|rule| value(rule, &format!("ENV{{{variable}}}=\"")).is_some());
        let ids = setting.filter_map(|rule| value(rule, vendor));
        ids.flat_map(|ids| ids.split('|').map(str::to_owned).collect::<Vec<_>>()).collect()
    };
    let boards = vendors("POSEBRIDGE_ROBOT", "ATTRS{idVendor}");
    let ignored = vendors("ID_MM_DEVICE_IGNORE", "ATTR{idVendor}");
    assert!(boards.len() > 8, "{boards:?}");
    assert_eq!(boards.difference(&ignored).count(), 0, "{boards:?} {ignored:?}");
    for mode in rules().filter_map(|rule| value(rule, "MODE")) {
        assert_eq!(mode, "0660");
    }
    for group in rules().filter_map(|rule| value(rule, "GROUP")) {
        assert_eq!(group, "dialout");
    }
}

//! `--plotjuggler`: the datagrams of the real program, held against the table of docs/dashboard.md.

use std::collections::BTreeSet;
use std::net::UdpSocket;

use crate::support::{RunningProgram, exit_code_and_stderr, write_text};
use posebridge::station::plotjuggler::{fields, pattern_of};
use serde_json::Value;

/// The fields of a message as docs/dashboard.md names them, with their values: all of them must be numbers.
fn add_fields(prefix: &str, value: &Value, fields: &mut Vec<(String, f64)>) {
    let Value::Object(inner) = value else {
        let number = value.as_f64().unwrap_or_else(|| panic!("{prefix} is {value}"));
        return fields.push((prefix.to_owned(), number));
    };
    for (name, value) in inner {
        let name = if prefix.is_empty() { name.clone() } else { format!("{prefix}/{name}") };
        add_fields(&name, value, fields);
    }
}

/// The fields of the next message.
fn receive(socket: &UdpSocket) -> Vec<(String, f64)> {
    let mut bytes = vec![0; 65_536];
    let read = socket.recv(&mut bytes).unwrap();
    let mut fields = Vec::new();
    add_fields("", &serde_json::from_slice(&bytes[..read]).unwrap(), &mut fields);
    fields
}

fn value(fields: &[(String, f64)], name: &str) -> Option<f64> {
    let found = fields.iter().find(|(known, _)| known == name);
    found.map(|(_, value)| *value)
}

/// What no simulated brick sends: ranges and bearings.
fn is_of_other_sensors(pattern: &str) -> bool {
    pattern.ends_with("/range_m") || pattern.ends_with("/bearing_rad")
}

#[test]
fn what_is_sent_is_what_the_page_says() {
    let folder = tempfile::tempdir().unwrap();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = format!("--plotjuggler={}", socket.local_addr().unwrap());
    let args = ["run", "--no-dashboard", "--out", "run", &address];
    let mut run = RunningProgram::posebridge(folder.path(), &args);
    run.wait_for("plotjuggler: sending to udp://127.0.0.1:");
    let wanted: BTreeSet<String> =
        fields().into_iter().map(|(path, _)| path).filter(|path| !is_of_other_sensors(path)).collect();
    let mut seen = BTreeSet::new();
    let (mut truth_x_m, mut nearest_m) = (None, f64::MAX);
    let mut last_s = 0.0;
    while seen != wanted || nearest_m > 0.05 {
        let received = receive(&socket);
        let at_s = value(&received, "timestamp").unwrap();
        last_s = f64::max(last_s, at_s);
        let missing: Vec<&String> = wanted.difference(&seen).collect();
        assert!(last_s < 60.0, "a minute without {missing:?}; nearest {nearest_m} m");
        for (name, _) in &received {
            let pattern = pattern_of(name);
            seen.insert(pattern.unwrap_or_else(|| panic!("`{name}` stands nowhere")));
        }
        truth_x_m = value(&received, "truth/x_m").or(truth_x_m);
        if let (Some(x_m), Some(truth_x_m)) = (value(&received, "robot_0_1_1/estimate/x_m"), truth_x_m)
            && last_s > 5.0
        {
            nearest_m = nearest_m.min((x_m - truth_x_m).abs());
        }
    }
    let (code, _, said) = run.interrupted();
    assert_eq!(code, Some(0), "{said}");
    let sent = said.lines().find(|line| line.starts_with("plotjuggler: "));
    assert!(sent.is_some_and(|line| line.contains(" datagrams sent")), "{said}");
}

#[test]
fn who_does_not_listen_costs_nothing_and_it_is_off_unless_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    // Bound and closed: nobody is there any more.
    let gone = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let config = format!("[plotjuggler]\nenabled = true\naddress = \"{gone}\"\n");
    write_text(folder.path(), "station.toml", &config);
    let run = |more: &[&str]| {
        let common = ["run", "--no-dashboard", "--no-record", "--duration", "0.5"];
        let (code, stderr) = exit_code_and_stderr(folder.path(), &[&common[..], more].concat());
        assert_eq!(code, Some(0), "{stderr}");
        stderr
    };
    let configured = run(&["--out", "one", "--config", "station.toml"]);
    assert!(configured.contains(&format!("plotjuggler: sending to udp://{gone}")), "{configured}");
    assert!(configured.contains(" datagrams sent"), "{configured}");
    let unconfigured = run(&["--out", "two"]);
    assert!(!unconfigured.contains("plotjuggler") && !unconfigured.contains("dashboard"), "{unconfigured}");
}

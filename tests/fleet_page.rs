//! Two stations of a fleet over loopback: the page of one shows the robot of the other, and commands it with the shared token.
#![cfg(feature = "fleet")]
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

#[path = "../crates/dashboard/tests/support/http.rs"]
mod http;
mod support;

use std::net::{SocketAddr, TcpListener};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use http::{StreamReader, get, metric, post};
use posebridge_dashboard::model::{FleetRobotRow, FleetState};
use serde_json::Value;
use support::RunningProgram;

const TOKENS: &str = "operator teacher-teacher-1\nreader student-student-1\n";
const RESET: &str = r#"{"command":"reset-pose","fleet_robot":"1-1"}"#;

/// A station of the fleet with a page that needs no token on this computer.
struct Station {
    _program: RunningProgram,
    page: SocketAddr,
}

impl Station {
    fn start(folder: &Path, name: &str, token_file: Option<&str>, further: &[&str]) -> Self {
        let station = format!("fleet.station={name}");
        let tokens = token_file.map(|file| format!("dashboard.token_file={file}"));
        let mut arguments = vec!["run", "--dashboard", "127.0.0.1:0", "--no-record", "--out", name, "--fleet", "class"];
        arguments.extend(["--set", &station]);
        arguments.extend(tokens.iter().flat_map(|setting| ["--set", setting.as_str()]));
        arguments.extend(further);
        let mut program = RunningProgram::posebridge(folder, &arguments);
        let line = program.wait_for("dashboard: http://");
        let (_, rest) = line.split_once("http://").unwrap();
        let page = rest.trim().trim_end_matches('/').parse().unwrap();
        Self { _program: program, page }
    }

    fn fleet(&self) -> FleetState {
        serde_json::from_slice(&get(self.page, "/v1/fleet").body).unwrap()
    }

    /// Looks at the robot until it is so.
    fn robot_when(&self, holds: impl Fn(&FleetRobotRow) -> bool) -> FleetRobotRow {
        loop {
            let robot = self.fleet().robots.into_iter().find(|robot| robot.name == "1-1");
            if let Some(robot) = robot.filter(&holds) {
                return robot;
            }
        }
    }

    /// Sends a command for the other station's robot until it is refused for this reason.
    fn refused_with(&self, why: &str) {
        loop {
            let answer = post(self.page, RESET);
            if answer.status == 502 && answer.error().contains(why) {
                return;
            }
        }
    }
}

/// For an endpoint of Zenoh, which has to be known before it listens.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Replaces a file of tokens as a person would, for its owner alone.
fn write_tokens(folder: &Path, name: &str, text: &str) {
    let new = folder.join("new");
    std::fs::write(&new, text).unwrap();
    std::fs::set_permissions(&new, std::fs::Permissions::from_mode(0o600)).unwrap();
    std::fs::rename(&new, folder.join(name)).unwrap();
}

fn log_contains(message: &Value, what: &str) -> bool {
    let mut lines = message["log"].as_array().into_iter().flatten();
    lines.any(|line| line["text"].as_str().is_some_and(|text| text.contains(what)))
}

/// The robot's station and one without robots, which has joined it.
fn two_stations(folder: &Path, owner_tokens: Option<&str>, other_tokens: Option<&str>) -> (Station, Station) {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let owner = Station::start(folder, "owner", owner_tokens, &["--link", "sim://square", "--fleet-listen", &endpoint]);
    let other = Station::start(folder, "other", other_tokens, &["--listen", "tcp://127.0.0.1:0", "--join", &endpoint]);
    (owner, other)
}

#[test]
fn a_station_shows_and_commands_the_robot_of_another_one() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["owner.tokens", "other.tokens"] {
        write_tokens(folder.path(), name, TOKENS);
    }
    let (owner, other) = two_stations(folder.path(), Some("owner.tokens"), Some("other.tokens"));

    let robot = other.robot_when(|robot| {
        let estimate = robot.estimate.as_ref();
        robot.owner.is_some()
            && estimate.is_some_and(|estimate| estimate.is_position_valid && estimate.transit_s.is_some())
    });
    let owned_by = robot.owner.unwrap();
    assert_eq!((owned_by.name.as_str(), owned_by.is_this, robot.robot), ("owner", false, None));
    assert!(robot.received > 0 && robot.estimate.unwrap().age_s >= 0.0);
    let stations = other.fleet().stations;
    let names: Vec<_> = stations.iter().map(|row| (row.name.as_str(), row.is_this, row.robots > 0)).collect();
    assert_eq!(names, [("other", true, false), ("owner", false, true)]);
    assert!(stations[1].clock_offset_s.is_some() && stations[1].clock_uncertainty_s.is_some());
    let own = owner.robot_when(|robot| robot.owner.as_ref().is_some_and(|owner| owner.is_this));
    assert_eq!(own.robot.as_deref(), Some("0/1/1"));
    assert!(metric(other.page, "posebridge_fleet_received_estimates_total{robot=\"1-1\"}") > 0.0);

    // From the other station's page, then from that of the owner itself.
    let mut log = StreamReader::open(owner.page);
    for page in [other.page, owner.page] {
        let answer = post(page, RESET);
        assert_eq!(answer.status, 202, "{}", answer.text());
        log.wait_for(|message| log_contains(message, "robot link 0 1/1: "));
    }
    let unknown = post(other.page, &RESET.replace("1-1", "ada"));
    assert_eq!((unknown.status, unknown.error().contains("no station that owns the robot")), (502, true));
    let station = post(other.page, r#"{"command":"stop-recording","fleet_robot":"1-1"}"#);
    assert_eq!(station.status, 400);

    // Another file is another fleet of operators.
    write_tokens(folder.path(), "other.tokens", "operator another-teacher-22\n");
    other.refused_with("does not know the operator's token");
    assert_eq!(post(owner.page, RESET).status, 202, "its own operators need no token of the fleet");
    write_tokens(folder.path(), "other.tokens", "reader student-student-1\n");
    other.refused_with("sent no operator's token");
}

#[test]
fn without_a_shared_token_a_station_says_what_to_configure() {
    let folder = tempfile::tempdir().unwrap();
    write_tokens(folder.path(), "tokens", TOKENS);
    let (_owner, other) = two_stations(folder.path(), None, Some("tokens"));
    other.robot_when(|robot| robot.owner.is_some());
    other.refused_with("give it a page and `dashboard.token_file`");
}

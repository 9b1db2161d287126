//! The fleet on the page's interface; the test plays the other stations.

use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt as _;
use std::sync::{Arc, Mutex};

use posebridge_dashboard::model::{FleetEstimateRow, FleetOwnerRow, FleetRobotRow, FleetState, FleetStationRow};
use posebridge_dashboard::{
    BoundListener, Dashboard, DashboardInputs, EventFeed, FleetRobotCommand, FleetSource, ListenAddress,
    OperatorTokenError, StationInfo, TokenPolicy,
};
use posebridge_telemetry::Input;
use tokio::sync::mpsc;

use crate::http::{StreamReader, get, metric, post, refused};
use crate::played::{ManualClock, TestStation, sources};

fn state() -> FleetState {
    let estimate = FleetEstimateRow {
        epoch: 3,
        x_m: 1.5.into(),
        is_position_valid: true,
        age_s: 0.02,
        transit_s: Some(0.003),
        ..FleetEstimateRow::default()
    };
    let owner = FleetOwnerRow { id: "b-1".to_owned(), name: "b".to_owned(), is_this: false, epoch: 3 };
    let robot = FleetRobotRow {
        name: "ada".to_owned(),
        owner: Some(owner),
        estimate: Some(estimate),
        received: 90,
        lost: 7,
        stale: 2,
        ..FleetRobotRow::default()
    };
    let this =
        FleetStationRow { id: "a-1".to_owned(), name: "a".to_owned(), is_this: true, ..FleetStationRow::default() };
    FleetState { name: "class".to_owned(), stations: vec![this], robots: vec![robot] }
}

/// A station of a fleet whose other stations answer each command so.
struct FleetTest {
    dashboard: Dashboard,
    _feed: EventFeed,
    commands: mpsc::Receiver<Input>,
    sent: Arc<Mutex<Vec<(String, serde_json::Value)>>>,
    _folder: tempfile::TempDir,
}

impl FleetTest {
    fn start(info: StationInfo, answer: impl Fn(FleetRobotCommand) + Send + Sync + 'static) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let sent: Arc<Mutex<Vec<_>>> = Arc::default();
        let sent_too = Arc::clone(&sent);
        let fleet = FleetSource {
            name: "class".to_owned(),
            state: Arc::new(state),
            send: Arc::new(move |command: FleetRobotCommand| {
                sent_too.lock().unwrap().push((command.robot.clone(), command.command.clone()));
                answer(command);
            }),
        };
        let inputs = DashboardInputs { fleet: Some(fleet), ..sources(folder.path(), &ManualClock::running()) };
        let bound = BoundListener::new(ListenAddress::Exact("127.0.0.1:0".parse().unwrap())).unwrap();
        let (dashboard, feed, commands) = Dashboard::start(Some(bound), info, inputs).unwrap();
        Self { dashboard, _feed: feed, commands, sent, _folder: folder }
    }

    fn address(&self) -> SocketAddr {
        self.dashboard.address().unwrap()
    }
}

const RESET: &str = r#"{"command":"reset-pose","fleet_robot":"ada"}"#;

#[test]
fn a_station_of_a_fleet_shows_stations_and_robots_and_counts_losses() {
    let station = FleetTest::start(StationInfo::default(), |_| {});
    let address = station.address();
    let seen: FleetState = serde_json::from_slice(&get(address, "/v1/fleet").body).unwrap();
    assert_eq!(seen, state());
    assert_eq!(StreamReader::open(address).next()["fleet"], "class");
    for (name, count) in [("received", 90.0), ("lost", 7.0), ("stale", 2.0)] {
        assert_eq!(metric(address, &format!("posebridge_fleet_{name}_estimates_total{{robot=\"ada\"}}")), count);
    }
}

#[test]
fn a_station_of_its_own_has_no_fleet_and_says_how_to_join_one() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    let missing = get(address, "/v1/fleet");
    assert_eq!((missing.status, missing.error().contains("`posebridge run --fleet NAME`")), (404, true));
    assert_eq!(StreamReader::open(address).next()["fleet"], serde_json::Value::Null);
    let refused = post(address, RESET);
    assert_eq!((refused.status, refused.error().contains("is in no fleet")), (400, true));
}

#[test]
fn a_command_for_a_robot_of_the_fleet_goes_to_its_owner_and_the_answer_to_the_sender() {
    let answer = |FleetRobotCommand { robot, reply, .. }: FleetRobotCommand| match robot.as_str() {
        "ada" => reply.send(Ok(())),
        // Nobody answers.
        "lost" => drop(reply),
        _ => reply.send(Err(format!("`{robot}` is not here"))),
    };
    let mut station = FleetTest::start(StationInfo::default(), answer);
    let address = station.address();
    let accepted = post(address, RESET);
    assert_eq!((accepted.status, accepted.json()["accepted"].as_str()), (202, Some("reset-pose")));
    let command = serde_json::json!({ "command": "reset-pose" });
    assert_eq!(*station.sent.lock().unwrap(), [("ada".to_owned(), command)]);
    let denied = post(address, &RESET.replace("ada", "bob"));
    assert_eq!((denied.status, denied.error()), (502, "`bob` is not here".to_owned()));
    assert_eq!(post(address, &RESET.replace("ada", "lost")).status, 502);
    let mut reader = StreamReader::open(address);
    reader.send(&RESET.replace("ada", "eve"));
    let error = reader.wait_for(|message| message["type"] == "error");
    assert_eq!(error["error"], "`eve` is not here");
    assert_eq!(refused(address, "fleet"), 3.0);
    assert!(station.commands.try_recv().is_err(), "nothing is for this station");
}

#[test]
fn the_token_file_holds_the_fleet_s_operators_also_where_the_page_asks_for_no_token() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tokens");
    std::fs::write(&path, "reader student-student-1\noperator teacher-teacher-1\n").unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    let info = StationInfo { token_file: Some(path), ..StationInfo::default() };
    let with_file = FleetTest::start(info, |_| {});
    assert_eq!(get(with_file.address(), "/v1/fleet").status, 200, "it is open on loopback");
    let tokens = with_file.dashboard.operator_tokens();
    assert_eq!(tokens.first().unwrap().expose(), "teacher-teacher-1");
    assert_eq!(tokens.check(Some("student-student-1")), Err(OperatorTokenError::Unknown));
    let without = FleetTest::start(StationInfo::default(), |_| {});
    assert_eq!(without.dashboard.operator_tokens().check(Some("x")), Err(OperatorTokenError::NotConfigured));
}

//! The dashboard of the real program, with its simulated brick: stream, REST and commands, and what hostile peers cannot do to it.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

#[path = "../crates/dashboard/tests/support/http.rs"]
mod http;
mod support;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};

use http::{StreamReader, connect, exchange, get, metric, post, refused, request};
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use posebridge_dashboard::model::{Frame, Message, ParameterRow, RecordingRow, RobotRow, SourceRow, State};
use serde::de::DeserializeOwned;
use support::{RunningProgram, posebridge, root, stdout_of};
use tungstenite::Message as Packet;

/// A station with its simulated brick and a dashboard at a free port.
struct Station {
    program: RunningProgram,
    address: SocketAddr,
}

impl Station {
    fn start(folder: &Path) -> Self {
        let mut command = posebridge(folder);
        command.args(["run", "--dashboard", "127.0.0.1:0", "--out", "run"]);
        command.args(["--events", "live.txt"]);
        let mut program = RunningProgram::start(&mut command);
        let line = program.wait_for("dashboard: http://");
        let (_, rest) = line.split_once("http://").unwrap();
        let address = rest.trim().trim_end_matches('/').parse().unwrap();
        Self { program, address }
    }
}

fn has_estimate(message: &serde_json::Value) -> bool {
    let estimates = message["robots"][0]["estimates"].as_array();
    estimates.is_some_and(|estimates| !estimates.is_empty())
}

/// Whether a line of the log holds this.
fn log_contains(message: &serde_json::Value, what: &str) -> bool {
    let lines = message["log"].as_array().into_iter().flatten();
    let texts = lines.filter_map(|line| line["text"].as_str());
    texts.into_iter().any(|text| text.contains(what))
}

/// What is at a path, as the type that its schema is made from.
fn typed<T: DeserializeOwned>(address: SocketAddr, path: &str) -> T {
    let answer = get(address, path);
    assert_eq!(answer.status, 200, "{path}: {}", answer.text());
    let read = serde_json::from_slice(&answer.body);
    read.unwrap_or_else(|error| panic!("{path}: {error}: {}", answer.text()))
}

#[test]
fn page_stream_and_requests_tell_of_the_same_run() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let page = get(address, "/");
    assert_eq!((page.status, page.header("content-type")), (200, Some("text/html; charset=utf-8")));
    let mut reader = StreamReader::open(address);
    let hello = reader.next();
    assert_eq!(hello["simulator"]["scenario"], "square");
    assert_eq!(hello["needs_token"], false);
    // Every message is what the schema's structs say.
    let mut frame = hello;
    for _ in 0..200 {
        let read: Result<Message, _> = serde_json::from_value(frame.clone());
        read.unwrap_or_else(|error| panic!("{error}: {frame}"));
        frame = reader.next();
    }
    reader.wait_for(|message| message["recording"]["name"] == "recording.mcap");
    reader.wait_for(|message| {
        let records = message["robots"][0]["fusion"].as_array();
        records.is_some_and(|records| records.iter().any(|one| one["kind"] == "wheel_angles"))
    });
    reader.wait_for(|message| message["errors"]["estimate_m"].is_number());
    reader.wait_for(|message| message["truth"][0]["odometry"][0].is_number());
    let frame = reader.wait_for(has_estimate);
    let t_s = frame["robots"][0]["estimates"][0]["t_s"].as_f64().unwrap();
    let state: State = typed(address, "/v1/state");
    let estimate = state.robots[0].estimate.clone().unwrap();
    assert!(estimate.t_s >= t_s, "the state is no older than the stream");
    assert_eq!(state.recording.unwrap().name, "recording.mcap");
    let sources: Vec<SourceRow> = typed(address, "/v1/sources");
    assert!(sources.iter().any(|source| source.name == "wheels" && source.kind == "wheel_angles"));
    let robots: Vec<RobotRow> = typed(address, "/v1/robots");
    assert_eq!(robots, [RobotRow { id: "0/1/1".to_owned(), name: None }]);
    let parameters: Vec<ParameterRow> = typed(address, "/v1/parameters");
    assert!(parameters.iter().any(|row| row.mavlink_name == "GATE_PROB"));
    assert!(metric(address, "posebridge_estimates_total") > 0.0);
    assert_eq!(metric(address, "posebridge_dashboard_events_dropped_total"), 0.0);
    assert_eq!(get(address, "/v1/schema.json").json()["title"], "posebridge /v1");
    station.program.interrupt();
}

#[test]
fn a_command_is_done_told_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let mut reader = StreamReader::open(address);
    reader.wait_for(has_estimate);
    let command = r#"{"command":"set-parameter","name":"gate_prob","value":0.95}"#;
    assert_eq!(post(address, command).status, 202);
    let is_set = |message: &serde_json::Value| {
        let rows = message["parameters"].as_array().into_iter().flatten();
        rows.into_iter().any(|row| row["name"] == "gate_prob" && row["value"] == 0.95)
    };
    reader.wait_for(is_set);
    reader.send(r#"{"command":"set-parameter","name":"gate_prob","value":7}"#);
    let error = reader.wait_for(|message| message["type"] == "error");
    let why = error["error"].as_str().unwrap();
    assert!(why.contains("`value` is 7.0, must be a number from 0.5 to 0.999999"), "{why}");
    let profile = r#"{"command":"link-profile","profile":"../../etc"}"#;
    assert_eq!(post(address, profile).status, 400);
    // A second of estimates behind the first.
    reader.wait_for(|message| message["now_s"].as_f64().is_some_and(|now_s| now_s > 3.0));
    reader.send(r#"{"command":"stop-recording"}"#);
    reader.wait_for(|message| log_contains(message, "recorded recording.mcap"));
    let rows: Vec<RecordingRow> = typed(address, "/v1/recordings");
    assert_eq!((rows.len(), rows[0].is_current), (1, false));
    let sent = get(address, "/v1/recordings/recording.mcap").body;
    let replayed: Frame = typed(address, "/v1/recordings/recording.mcap/replay");
    assert!(replayed.robots[0].estimates.len() > 10);
    assert!(replayed.log.iter().any(|line| line.text.contains("gate_prob set to 0.95")));
    station.program.interrupt();
    assert_eq!(std::fs::read(folder.path().join("run/recording.mcap")).unwrap(), sent);
}

/// What the page's buttons send, and what the log says of each.
const HANDS: [(&str, &str); 12] = [
    (r#"{"command":"kidnap","forward_m":0.1,"left_m":0.1,"turn_rad":0.5}"#, "kidnap: "),
    (r#"{"command":"slip","wheel":"left","factor":0.8,"seconds":0.5}"#, "slip: "),
    (r#"{"command":"camera","on":false}"#, "camera: off"),
    (r#"{"command":"camera-delay","delay_ms":200}"#, "camera-delay: "),
    (r#"{"command":"gyro-bias-step","rad_per_s":0.05}"#, "gyro-bias-step: "),
    (r#"{"command":"camera","on":true}"#, "camera: on"),
    (r#"{"command":"steering","by":"odometry"}"#, "steering: by odometry"),
    (r#"{"command":"link-profile","profile":"bluetooth-spp"}"#, "link-profile: bluetooth-spp"),
    (r#"{"command":"drive","forward_m_per_s":0.1,"turn_rad_per_s":1.0}"#, "drive: "),
    (r#"{"command":"set-parameter","name":"gate_prob","value":0.95}"#, "gate_prob set to 0.95"),
    (r#"{"command":"switch-source","sensor":1,"on":false}"#, "source 1 (gyro) is left out"),
    (r#"{"command":"pull-cable","seconds":0.3}"#, " is down"),
];

/// Over the pseudo-terminal, as the page does it.
#[test]
fn a_session_with_every_command_of_the_page_replays_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let mut reader = StreamReader::open(address);
    reader.wait_for(has_estimate);
    for (command, told) in HANDS {
        // Some of the drive lies between two commands.
        for _ in 0..5 {
            reader.wait_for(has_estimate);
        }
        assert_eq!(post(address, command).status, 202, "{command}");
        reader.wait_for(|message| log_contains(message, told));
    }
    reader.wait_for(|message| log_contains(message, " is up"));
    reader.wait_for(has_estimate);
    // Whoever comes now is told what holds.
    let hello = StreamReader::open(address).next();
    assert_eq!(hello["simulator"]["steering"], "odometry");
    assert_eq!(hello["simulator"]["link_profile"], "bluetooth-spp");
    assert_eq!(hello["history"]["switched_off"], serde_json::json!([1]));
    let sources: Vec<SourceRow> = typed(address, "/v1/sources");
    assert!(sources.iter().all(|source| source.is_used == (source.id != 1)), "{sources:?}");
    station.program.interrupt();
    let replay = ["replay", "run/recording.mcap", "--events", "replayed.txt"];
    stdout_of(posebridge(folder.path()).args(replay));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let (live, replayed) = (read("live.txt"), read("replayed.txt"));
    let mut pairs = live.lines().zip(replayed.lines()).enumerate();
    let different = pairs.find(|(_, (live, replayed))| live != replayed);
    assert_eq!(different, None);
    assert_eq!(live.lines().count(), replayed.lines().count());
    for (_, told) in HANDS {
        // The state of a link is an event and no text.
        assert!(told == " is down" || replayed.contains(told), "{told}");
    }
}

/// Lets this process have as many connections as the system allows; tests share it.
fn allow_many_connections() {
    let (_, most) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    setrlimit(Resource::RLIMIT_NOFILE, most, most).unwrap();
}

#[test]
fn a_thousand_half_open_connections_are_refused_and_counted_while_the_estimates_go_on() {
    allow_many_connections();
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let mut reader = StreamReader::open(address);
    reader.wait_for(has_estimate);
    let begun = b"GET /v1/state HTTP/1.1\r\nhost: 127.0.0.1\r\nx-slow: ";
    let half_open: Vec<TcpStream> = (0..1_000)
        .map(|index| {
            let mut stream = connect(address);
            // Every second one says nothing at all.
            if index % 2 == 0 {
                drop(stream.write_all(begun));
            }
            stream
        })
        .collect();
    for _ in 0..20 {
        reader.wait_for(has_estimate);
    }
    drop(half_open);
    // When one of them gets through all the others are gone, and those that were let in are being let go.
    while exchange(
        address,
        format!("GET /v1/robots HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n").as_bytes(),
    )
    .is_none_or(|answer| answer.status != 200)
    {
        reader.wait_for(has_estimate);
    }
    assert!(refused(address, "connections") >= 800.0, "{}", refused(address, "connections"));
    let state: State = typed(address, "/v1/state");
    assert_eq!(state.counters.events_dropped, 0);
    let estimates = state.counters.estimates;
    station.program.interrupt();
    // Nothing was lost on the way into the recording: its replay makes at least as many estimates as were counted live.
    let json = stdout_of(posebridge(folder.path()).args(["replay", "run/recording.mcap", "--json"]));
    let replayed: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(replayed["observations"].as_u64().unwrap() >= estimates, "{estimates}");
}

/// A frame of a WebSocket client with this first byte and length, its payload masked with zeros.
fn packet(first: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![first, 0x80 | 127];
    bytes.extend((payload.len() as u64).to_be_bytes());
    bytes.extend([0; 4]);
    bytes.extend_from_slice(payload);
    bytes
}

#[test]
fn readers_that_send_what_is_no_websocket_are_let_go_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let mut good = StreamReader::open(address);
    let oversized = packet(0x81, &vec![b'x'; 70_000]);
    // A length that nobody has, without the bytes.
    let endless = [&[0x82, 0xff][..], &[0x7f; 8], &[0; 4]].concat();
    // Not masked; of a kind that there is not; a control frame in pieces; text that is no UTF-8.
    let unmasked = vec![0x81, 0x02, b'h', b'i'];
    let unknown = packet(0x8b, b"?");
    let torn = packet(0x09, b"ping");
    let no_text = packet(0x81, &[0xff, 0xfe]);
    let hostile = [oversized, endless, unmasked, unknown, torn, no_text];
    for bytes in &hostile {
        let mut reader = StreamReader::open(address);
        drop(reader.raw().write_all(bytes));
        reader.drain();
    }
    // Let go when it next reads, so all of them are counted by the time that a new reader is greeted behind them.
    good.send_message(Packet::binary(vec![0; 1_000]));
    let error = good.wait_for(|message| message["type"] == "error");
    assert_eq!(error["error"], "commands are JSON in text messages");
    let dropped = "posebridge_dashboard_clients_dropped_total";
    while metric(address, dropped) < hostile.len() as f64 {
        good.next();
    }
    good.wait_for(has_estimate);
    station.program.interrupt();
}

#[test]
fn requests_that_are_none_are_refused_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let status = |request: &[u8]| exchange(address, request).map(|answer| answer.status);
    assert_eq!(status(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n"), Some(400));
    let long = format!("GET / HTTP/1.1\r\nhost: {address}\r\nx: {}\r\n\r\n", "a".repeat(100_000));
    assert!(matches!(status(long.as_bytes()), Some(431) | None));
    let headers = "content-type: application/json\r\n";
    let large = vec![b' '; 70_000];
    assert_eq!(request(address, "POST /v1/commands", headers, &large).status, 413);
    assert_eq!(request(address, "DELETE /v1/state", "", b"").status, 405);
    assert_eq!(get(address, "/../../../etc/passwd").status, 404);
    assert_eq!(get(address, "/v1/recordings/..%2f..%2fsecret.mcap").status, 404);
    assert_eq!(post(address, "{\"command\":\"reset-pose\",").status, 400);
    assert_eq!(refused(address, "not_found"), 2.0);
    assert_eq!(refused(address, "command"), 1.0);
    assert!(refused(address, "request") >= 3.0);
    // A connection that was refused is closed and does not hang.
    let mut stream = connect(address);
    stream.write_all(b"nonsense\r\n\r\n").unwrap();
    let mut rest = Vec::new();
    drop(stream.read_to_end(&mut rest));
    station.program.interrupt();
}

#[test]
fn the_client_of_the_examples_gives_a_command_and_prints_poses() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    StreamReader::open(station.address).wait_for(has_estimate);
    let mut client = Command::new("python3")
        .arg(root().join("examples/dashboard_client.py"))
        .args([&format!("http://{}", station.address), "freeze-calibration"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let printed = BufReader::new(client.stdout.take().unwrap()).lines();
    let lines: Vec<String> = printed.take(3).map(Result::unwrap).collect();
    client.kill().unwrap();
    client.wait().unwrap();
    assert_eq!(lines[0], "{'accepted': 'freeze-calibration'}");
    assert!(lines[1..].iter().all(|line| line.starts_with("0/1/1 x ")), "{lines:?}");
    station.program.interrupt();
}

#[test]
fn an_address_that_was_chosen_and_is_in_use_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address.to_string();
    let mut command = posebridge(folder.path());
    let output = command.args(["run", "--dashboard", &address, "--out", "other"]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{said}");
    let expected = format!("starting the dashboard: {address} is in use, perhaps by another station; choose");
    assert!(said.contains(&expected), "{said}");
    station.program.interrupt();
    assert!(!folder.path().join("other").exists(), "nothing is left behind");
}

#[test]
fn a_start_that_fails_leaves_nothing_that_the_next_one_stumbles_over() {
    let folder = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| {
        let mut command = posebridge(folder.path());
        let output = command.arg("run").args(args).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), said)
    };
    // No address of this computer: those of RFC 5737 are for examples.
    for args in [&["--dashboard", "127.0.0.1:0", "--ui-dir", "nowhere"][..], &["--dashboard", "192.0.2.1:0"]] {
        let (code, said) = run(args);
        assert_eq!(code, Some(2), "{said}");
        assert!(!folder.path().join("posebridge-runs").exists(), "{args:?}");
    }
    let once = ["--no-dashboard", "--out", "run", "--duration", "0.2"];
    let (code, said) = run(&once);
    assert_eq!(code, Some(0), "{said}");
    let (code, said) = run(&once);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("creating the recording"), "{said}");
    let terminal = folder.path().join("run/brick.tty");
    assert!(terminal.symlink_metadata().is_err(), "a dangling link");
}

#[test]
fn without_a_dashboard_nobody_listens() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = posebridge(folder.path());
    let mut program = RunningProgram::start(command.args([
        "run",
        "--no-dashboard",
        "--listen",
        "tcp://127.0.0.1:0",
        "--out",
        "run",
        "--duration",
        "0.2",
    ]));
    assert!(program.listening_address("").starts_with("127.0.0.1:"));
    let (code, said) = program.interrupted();
    assert_eq!(code, Some(0), "{said}");
    assert!(!said.contains("dashboard"), "{said}");
}

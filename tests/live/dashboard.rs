//! The dashboard of the real program with its simulated brick: page, stream, REST, every command, the client of the examples, and
//! hostile peers.

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::http::{StreamReader, connect, exchange, get, metric, post, refused, request};
use crate::support::{RunningProgram, assert_refused, assert_replays, root};
use posebridge_dashboard::model::{Frame, Message, ParameterRow, RecordingRow, RobotRow, SourceRow, State};
use serde::de::DeserializeOwned;
use serde_json::Value;
use tungstenite::Message as Packet;

/// A station with its simulated brick and a dashboard at a free port.
struct Station {
    program: RunningProgram,
    address: SocketAddr,
}

impl Station {
    fn start(folder: &Path) -> Self {
        let run = ["run", "--dashboard", "127.0.0.1:0", "--out", "run", "--events", "live.txt"];
        let mut program = RunningProgram::posebridge(folder, &run);
        let line = program.wait_for("dashboard: http://");
        let (_, rest) = line.split_once("http://").unwrap();
        let address = rest.trim().trim_end_matches('/').parse().unwrap();
        Self { program, address }
    }
}

fn has_estimate(message: &Value) -> bool {
    message["robots"][0]["estimates"][0].is_object()
}

/// Whether a line of the log holds this.
fn log_contains(message: &Value, what: &str) -> bool {
    let mut lines = message["log"].as_array().into_iter().flatten();
    lines.any(|line| line["text"].as_str().is_some_and(|text| text.contains(what)))
}

/// What is at a path, as the type that its schema is made from.
fn typed<T: DeserializeOwned>(address: SocketAddr, path: &str) -> T {
    let answer = get(address, path);
    assert_eq!(answer.status, 200, "{path}: {}", answer.text());
    serde_json::from_slice(&answer.body).unwrap_or_else(|error| panic!("{path}: {error}: {}", answer.text()))
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
        let mut records = message["robots"][0]["fusion"].as_array().into_iter().flatten();
        records.any(|one| one["kind"] == "wheel_angles")
    });
    reader.wait_for(|message| message["errors"]["estimate_m"].is_number());
    reader.wait_for(|message| message["truth"][0]["odometry"][0].is_number());
    let frame = reader.wait_for(has_estimate);
    let t_s = frame["robots"][0]["estimates"][0]["t_s"].as_f64().unwrap();
    let state: State = typed(address, "/v1/state");
    assert!(state.robots[0].estimate.clone().unwrap().t_s >= t_s, "the state is no older than the stream");
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

    // The client of the examples gives a command and prints poses.
    let mut client = Command::new("python3")
        .arg(root().join("examples/dashboard_client.py"))
        .args([&format!("http://{address}"), "freeze-calibration"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let printed = BufReader::new(client.stdout.take().unwrap()).lines();
    let lines: Vec<String> = printed.take(3).map(Result::unwrap).collect();
    client.kill().unwrap();
    client.wait().unwrap();
    assert_eq!(lines[0], "{'accepted': 'freeze-calibration'}");
    assert!(lines[1..].iter().all(|line| line.starts_with("0/1/1 x ")), "{lines:?}");

    // Nobody else gets the address, and who does not get it leaves nothing behind.
    let taken = format!("starting the dashboard: {address} is in use, perhaps by another station; choose");
    let missing = ("run --dashboard 127.0.0.1:0 --ui-dir nowhere", 2, &["nowhere"][..]);
    assert_refused(folder.path(), &[(&format!("run --dashboard {address} --out other"), 2, &[&taken]), missing]);
    for left in ["other", "posebridge-runs"] {
        assert!(!folder.path().join(left).exists(), "{left}");
    }
    station.program.interrupt();
}

/// What the page's buttons send, and the log line of each.
const COMMANDS: [(&str, &str); 12] = [
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
    for (command, logged) in COMMANDS {
        // Some of the drive lies between two commands.
        for _ in 0..5 {
            reader.wait_for(has_estimate);
        }
        assert_eq!(post(address, command).status, 202, "{command}");
        reader.wait_for(|message| log_contains(message, logged));
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
    reader.send(r#"{"command":"set-parameter","name":"gate_prob","value":7}"#);
    let error = reader.wait_for(|message| message["type"] == "error");
    let why = error["error"].as_str().unwrap();
    assert!(why.contains("`value` is 7.0, must be a number from 0.5 to 0.999999"), "{why}");
    assert_eq!(post(address, r#"{"command":"link-profile","profile":"../../etc"}"#).status, 400);
    station.program.interrupt();
    let events = assert_replays(folder.path(), "run/recording.mcap", "live.txt");
    for (_, logged) in COMMANDS {
        // The state of a link is an event and no text.
        assert!(logged == " is down" || events.contains(logged), "{logged}");
    }
}

#[test]
fn a_recording_that_was_stopped_is_listed_sent_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let mut reader = StreamReader::open(address);
    // A second of estimates behind the first.
    reader.wait_for(|message| has_estimate(message) && message["now_s"].as_f64().is_some_and(|now_s| now_s > 2.0));
    reader.send(r#"{"command":"stop-recording"}"#);
    reader.wait_for(|message| log_contains(message, "recorded recording.mcap"));
    let rows: Vec<RecordingRow> = typed(address, "/v1/recordings");
    assert_eq!((rows.len(), rows[0].is_current), (1, false));
    let sent = get(address, "/v1/recordings/recording.mcap").body;
    let replayed: Frame = typed(address, "/v1/recordings/recording.mcap/replay");
    assert!(!replayed.robots[0].estimates.is_empty());
    station.program.interrupt();
    assert_eq!(std::fs::read(folder.path().join("run/recording.mcap")).unwrap(), sent);
}

/// A frame of a WebSocket client with this first byte, its payload masked with zeros.
fn packet(first: u8, payload: &[u8]) -> Vec<u8> {
    [&[first, 0x80 | 127][..], &(payload.len() as u64).to_be_bytes(), &[0; 4], payload].concat()
}

#[test]
fn hostile_peers_are_refused_and_counted_while_the_estimates_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let station = Station::start(folder.path());
    let address = station.address;
    let mut reader = StreamReader::open(address);
    reader.wait_for(has_estimate);
    // More connections than there is room for; every second one says nothing at all.
    let half_open: Vec<TcpStream> = (0..300)
        .map(|index| {
            let mut stream = connect(address);
            if index % 2 == 0 {
                drop(stream.write_all(b"GET /v1/state HTTP/1.1\r\nhost: 127.0.0.1\r\nx-slow: "));
            }
            stream
        })
        .collect();
    for _ in 0..20 {
        reader.wait_for(has_estimate);
    }
    for _ in 0..20 {
        assert_eq!(get(address, "/v1/robots").status, 200, "they keep nobody out");
    }
    drop(half_open);
    assert_eq!(refused(address, "connections"), 0.0);

    // Requests that are none, too long, too large, or for files that are nobody's business.
    let status = |request: &[u8]| exchange(address, request).map(|answer| answer.status);
    assert_eq!(status(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n"), Some(400));
    let long = format!("GET / HTTP/1.1\r\nhost: {address}\r\nx: {}\r\n\r\n", "a".repeat(100_000));
    assert!(matches!(status(long.as_bytes()), Some(431) | None));
    let headers = "content-type: application/json\r\n";
    assert_eq!(request(address, "POST /v1/commands", headers, &vec![b' '; 70_000]).status, 413);
    for path in ["/../../../etc/passwd", "/v1/recordings/..%2f..%2fsecret.mcap"] {
        assert_eq!(get(address, path).status, 404, "{path}");
    }
    assert_eq!(post(address, "{\"command\":\"reset-pose\",").status, 400);
    assert_eq!((refused(address, "not_found"), refused(address, "command")), (2.0, 1.0));

    // Too large, endless, not masked, of an unknown kind, a control frame in pieces, text that is no UTF-8.
    let endless = [&[0x82, 0xff][..], &[0x7f; 8], &[0; 4]].concat();
    let unmasked = vec![0x81, 0x02, b'h', b'i'];
    let [large, unknown, torn, no_text] =
        [packet(0x81, &vec![b'x'; 70_000]), packet(0x8b, b"?"), packet(0x09, b"ping"), packet(0x81, &[0xff, 0xfe])];
    let hostile = [large, endless, unmasked, unknown, torn, no_text];
    for bytes in &hostile {
        let mut reader = StreamReader::open(address);
        drop(reader.raw().write_all(bytes));
        reader.drain();
    }
    reader.send_message(Packet::binary(vec![0; 1_000]));
    let error = reader.wait_for(|message| message["type"] == "error");
    assert_eq!(error["error"], "commands are JSON in text messages");
    // They are counted when the station next reads from them.
    while metric(address, "posebridge_dashboard_clients_dropped_total") < hostile.len() as f64 {
        reader.next();
    }
    let state: State = typed(address, "/v1/state");
    assert_eq!(state.counters.events_dropped, 0);
    station.program.interrupt();
}

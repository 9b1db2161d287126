//! The limits of the server: each rejection is JSON, says what to do, and is counted.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use posebridge_dashboard::model::{ParameterRow, SimulatorFacts};
use posebridge_dashboard::{StationInfo, TokenPolicy};
use socket2::SockRef;

use crate::http::{StreamReader, connect, get, metric, post, refused, request};
use crate::played::{ManualClock, TestStation, text_event};

const RESET: &str = r#"{"command":"reset-pose"}"#;

/// A station with one tunable and a simulated brick.
fn simulated() -> StationInfo {
    StationInfo {
        parameters: vec![ParameterRow {
            name: "gate_prob".to_owned(),
            value: 0.999,
            least: 0.5,
            most: 0.999_999,
            ..ParameterRow::default()
        }],
        simulator: Some(SimulatorFacts {
            link_profiles: vec!["usb".to_owned(), "bluetooth-spp".to_owned()],
            ..SimulatorFacts::default()
        }),
        ..StationInfo::default()
    }
}

#[test]
fn commands_that_come_too_fast_are_refused_and_counted() {
    let mut played = TestStation::with(StationInfo::default(), ManualClock::default());
    let address = played.address();
    let mut accepted = |count: usize| {
        let responses = (0..count).map(|_| {
            let status = post(address, RESET).status;
            assert_eq!(played.commands.try_recv().is_ok(), status == 202);
            status
        });
        let statuses: Vec<u16> = responses.collect();
        assert!(statuses.iter().all(|status| [202, 503].contains(status)), "{statuses:?}");
        statuses.iter().filter(|status| **status == 202).count()
    };
    assert_eq!(accepted(70), 50, "a second's worth at once");
    played.clock.advance(100);
    assert_eq!(accepted(10), 5, "fifty a second");
    assert_eq!(refused(address, "command_rate"), 25.0);
    // A reader of the stream is told, and has no second limit of its own.
    let mut reader = StreamReader::open(address);
    reader.send(RESET);
    let error = reader.wait_for(|message| message["type"] == "error");
    assert_eq!(error["error"], "more than 50 commands a second come to this station; try again");
    assert_eq!(refused(address, "command_rate"), 26.0);
}

#[test]
fn equal_lines_that_come_quickly_are_joined() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let mut reader = StreamReader::open(played.address());
    reader.next();
    played.publish(vec![text_event("same"); 100]);
    played.publish(vec![text_event("other")]);
    let mut lines = Vec::new();
    while lines.last().is_none_or(|line| line != "1/1: other") {
        let message = reader.next();
        let log = message["log"].as_array().into_iter().flatten();
        lines.extend(log.filter_map(|line| Some(line["text"].as_str()?.to_owned())));
    }
    assert_eq!(lines, ["1/1: same", "1/1: same (99 times more)", "1/1: other"]);
}

#[test]
fn what_the_station_cannot_do_is_refused_by_its_field() {
    let played = TestStation::with(simulated(), ManualClock::default());
    let address = played.address();
    for (command, why) in [
        (
            r#"{"command":"set-parameter","name":"nonsense","value":1}"#,
            "`set-parameter`: the field `name` is \"nonsense\", must be a name of /v1/parameters",
        ),
        (
            r#"{"command":"set-parameter","name":"gate_prob","value":7}"#,
            "`set-parameter`: the field `value` is 7.0, must be a number from 0.5 to 0.999999 for `gate_prob`",
        ),
        (
            r#"{"command":"link-profile","profile":"../../etc"}"#,
            "`link-profile`: the field `profile` is \"../../etc\", must be one of \"usb\", \"bluetooth-spp\", or null",
        ),
        (
            r#"{"command":"switch-source","sensor":200,"on":false}"#,
            "`switch-source`: the field `sensor` is 200, must be the number of a sensor, as listed by /v1/sources",
        ),
    ] {
        let answer = post(address, command);
        assert_eq!(answer.status, 400, "{command}");
        assert_eq!(answer.error(), why);
    }
    assert_eq!(refused(address, "command"), 4.0);
    for command in [
        r#"{"command":"set-parameter","name":"gate_prob","value":0.5}"#,
        r#"{"command":"link-profile","profile":"usb"}"#,
        r#"{"command":"link-profile","profile":null}"#,
        r#"{"command":"switch-source","sensor":3,"on":false}"#,
        r#"{"command":"path"}"#,
    ] {
        assert_eq!(post(address, command).status, 202, "{command}");
    }
}

#[test]
fn a_station_without_a_simulated_brick_refuses_what_is_for_one() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let answer = post(played.address(), r#"{"command":"camera","on":false}"#);
    assert_eq!(answer.status, 400);
    assert_eq!(answer.error(), "`camera` is for a simulated brick, and this station has none of its own");
    let mut commands = played.commands;
    assert!(commands.try_recv().is_err(), "nothing reached the shard");
}

/// Asks for the stream without waiting for the answer.
fn request_stream(address: SocketAddr) -> TcpStream {
    let mut stream = connect(address);
    let request = format!(
        "GET /v1/stream HTTP/1.1\r\nhost: {address}\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
         sec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).unwrap();
    stream
}

fn status_of(stream: &mut TcpStream) -> String {
    let mut line = [0; 12];
    stream.read_exact(&mut line).unwrap();
    String::from_utf8(line[9..].to_vec()).unwrap()
}

#[test]
fn idle_and_half_open_connections_keep_nobody_out() {
    for policy in [TokenPolicy::RemoteOnly, TokenPolicy::Always] {
        let played = TestStation::start(policy);
        let address = played.address();
        let url = played.dashboard.url().unwrap();
        let authorization = url.split_once("token=").map(|(_, token)| format!("authorization: Bearer {token}\r\n"));
        let authorization = authorization.unwrap_or_default();
        let mut crowd: Vec<TcpStream> = (0..300).map(|_| connect(address)).collect();
        for half_open in crowd.iter_mut().step_by(2) {
            // It may have made room for another already.
            drop(half_open.write_all(b"GET /v1/state HTTP/1.1\r\nx-slow: "));
        }
        for _ in 0..20 {
            assert_eq!(request(address, "GET /v1/robots", &authorization, b"").status, 200, "{policy:?}");
        }
        let page = request(address, "GET /metrics", &authorization, b"").text();
        let number = |name: &str| -> f64 {
            let line = page.lines().find_map(|line| line.strip_prefix("posebridge_dashboard_")?.strip_prefix(name));
            line.unwrap().trim().parse().unwrap()
        };
        // 192 of one address are there at a time.
        assert!(number("connections_replaced_total ") >= 108.0, "{page}");
        assert!(number("connections ") <= 192.0, "those that made room were closed: {page}");
        assert!(page.contains("refused_total{reason=\"connections\"} 0\n"), "{page}");
    }
}

#[test]
fn a_download_keeps_its_place_however_slowly_it_is_read() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    // More than the system keeps for a reader.
    let bytes = vec![7; 32_000_000];
    played.record("recording.mcap", &bytes);
    let ask = |path: &str| {
        let mut stream = connect(address);
        let request = format!("GET {path} HTTP/1.1\r\nhost: {address}\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        assert_eq!(status_of(&mut stream), "200");
        stream
    };
    let mut download = ask("/v1/recordings/recording.mcap");
    let _served: Vec<TcpStream> = (0..250).map(|_| ask("/v1/robots")).collect();
    assert!(metric(address, "posebridge_dashboard_connections_replaced_total") >= 59.0);
    let mut received = Vec::new();
    while received.len() < bytes.len() {
        let mut part = vec![0; 1_000_000];
        let count = download.read(&mut part).unwrap();
        assert!(count > 0, "closed after {} bytes", received.len());
        received.extend_from_slice(&part[..count]);
    }
    assert!(received.ends_with(&bytes[..31_000_000]));
}

#[test]
fn readers_that_come_all_at_once_are_no_more_than_there_is_room_for() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    let idle: Vec<TcpStream> = (0..100).map(|_| connect(address)).collect();
    let mut requesting: Vec<TcpStream> = (0..70).map(|_| request_stream(address)).collect();
    let statuses: Vec<String> = requesting.iter_mut().map(status_of).collect();
    let of = |status: &str| statuses.iter().filter(|one| *one == status).count();
    assert_eq!((of("101"), of("503")), (64, 6));
    assert_eq!(refused(address, "clients"), 6.0);
    assert_eq!(metric(address, "posebridge_dashboard_clients"), 64.0);
    // Streams are connections like the others.
    let connections = metric(address, "posebridge_dashboard_connections");
    assert!(connections >= 165.0, "{connections}");
    drop((idle, requesting));
    // Whoever goes makes room.
    while status_of(&mut request_stream(address)) != "101" {}
}

#[test]
fn readers_that_just_go_are_not_counted_as_let_go() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    let mut readers: Vec<StreamReader> = (0..6).map(|_| StreamReader::open(address)).collect();
    for (index, reader) in readers.iter_mut().enumerate() {
        reader.next();
        // Every second one is torn off instead of closed.
        let linger = (index % 2 == 0).then_some(Duration::ZERO);
        SockRef::from(&*reader.raw()).set_linger(linger).unwrap();
    }
    drop(readers);
    while metric(address, "posebridge_dashboard_clients") > 0.0 {}
    let dropped = metric(address, "posebridge_dashboard_clients_dropped_total");
    assert_eq!(dropped, 0.0);
}

#[test]
fn every_refusal_is_json_and_counted() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    played.record("recording.mcap", b"1234");
    for path in ["/v1/recordings/%FF", "/v1/recordings/%FF/replay"] {
        let answer = get(address, path);
        assert_eq!(answer.status, 400, "{path}");
        assert!(answer.error().contains("UTF-8"), "{}", answer.error());
    }
    assert_eq!(refused(address, "request"), 2.0);
    for (request_line, status) in
        [("POST /", 405), ("DELETE /app.js", 405), ("DELETE /v1/state", 405), ("POST /nothing", 404)]
    {
        let answer = request(address, request_line, "", b"");
        assert_eq!(answer.status, status, "{request_line}");
        assert!(!answer.error().is_empty());
        let has_allow_header = answer.header("allow").is_some_and(|allow| allow.contains("get"));
        assert_eq!(has_allow_header, status == 405, "{}", answer.head);
    }
    assert_eq!(refused(address, "request"), 5.0);
    assert_eq!(refused(address, "not_found"), 1.0);
}

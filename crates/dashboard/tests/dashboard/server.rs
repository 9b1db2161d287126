//! Streams, commands, access and files.

use std::fs::Permissions;
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use posebridge_dashboard::model::{Message, State};
use posebridge_dashboard::{
    BoundListener, Dashboard, DashboardInputs, DashboardStartError, EventBatch, FrameTaps, ListenAddress, StationInfo,
    TapPoll, TokenPolicy,
};
use posebridge_telemetry::{Command, Input, TimeDelta, Timestamp};

use crate::http::{StreamReader, exchange, get, metric, post, refused, request};
use crate::played::{ManualClock, TestStation, sources, text_event};

/// Whether a line of a message's log ends so.
fn log_contains(log: &serde_json::Value, text: &str) -> bool {
    let mut lines = log.as_array().into_iter().flatten();
    lines.any(|line| line["text"].as_str().is_some_and(|line| line.ends_with(text)))
}

#[test]
fn a_reader_gets_what_was_before_it_and_then_what_is_new() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let mut first = StreamReader::open(played.address());
    assert_eq!(first.next()["type"], "hello");
    played.publish(vec![text_event("one")]);
    first.wait_for(|message| log_contains(&message["log"], "1/1: one"));
    let mut second = StreamReader::open(played.address());
    let hello = second.next();
    assert!(log_contains(&hello["history"]["log"], "1/1: one"));
    played.publish(vec![text_event("two")]);
    for reader in [&mut first, &mut second] {
        let frame = reader.wait_for(|message| log_contains(&message["log"], "1/1: two"));
        assert!(!log_contains(&frame["log"], "one"), "told once");
    }
    let state: State = serde_json::from_slice(&get(played.address(), "/v1/state").body).unwrap();
    assert_eq!(state.counters.clients, 2);
}

#[test]
fn commands_come_back_in_their_order_and_wrong_ones_are_refused() {
    let mut played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    let accepted = post(address, r#"{"command":"reset-pose"}"#);
    assert_eq!((accepted.status, accepted.json()["accepted"].as_str()), (202, Some("reset-pose")));
    let mut reader = StreamReader::open(address);
    reader.send(r#"{"command":"stop-recording"}"#);
    reader.send(r#"{"command":"stop"}"#);
    let error = reader.wait_for(|message| message["type"] == "error");
    let error: Message = serde_json::from_value(error).unwrap();
    assert!(matches!(error, Message::Error(why) if why.error.starts_with("`command` is `stop`; there are: ")));
    assert_eq!(played.commands.blocking_recv(), Some(Input::Command(Command::ResetPose)));
    assert_eq!(played.commands.blocking_recv(), Some(Input::Command(Command::StopRecording)));
    // A media type is compared without case, and may have parameters.
    let json = "content-type: Application/JSON; Charset=UTF-8\r\n";
    assert_eq!(request(address, "POST /v1/commands", json, br#"{"command":"path"}"#).status, 400, "no simulator");
    let wrong = post(address, r#"{"command":"reset-pose","now":true}"#);
    assert_eq!(wrong.status, 400);
    assert_eq!(wrong.error(), "`reset-pose` has no field `now`; it has: robot");
    assert_eq!(refused(address, "command"), 3.0);
}

#[test]
fn commands_that_nobody_takes_are_refused_when_there_are_too_many() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    let statuses: Vec<u16> = (0..70).map(|_| post(address, r#"{"command":"reset-pose"}"#).status).collect();
    assert!(statuses[..64].iter().all(|status| *status == 202));
    assert!(statuses[64..].iter().all(|status| *status == 503));
    assert_eq!(refused(address, "commands_full"), 6.0);
}

#[test]
fn every_answer_keeps_browsers_careful_and_allows_no_other_origin() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    for path in ["/", "/v1/state", "/nothing"] {
        let answer = get(played.address(), path);
        let policy = answer.header("content-security-policy").unwrap();
        assert!(policy.starts_with("default-src 'self';"), "{path}: {policy}");
        assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
        assert_eq!(answer.header("access-control-allow-origin"), None);
    }
}

#[test]
fn foreign_hosts_and_origins_are_refused_and_counted() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    let rebound = b"GET /v1/state HTTP/1.1\r\nhost: evil.example\r\nconnection: close\r\n\r\n";
    let answer = exchange(address, rebound).unwrap();
    assert_eq!(answer.status, 421);
    assert!(answer.error().contains("`evil.example` is not this station"));
    let foreign = "origin: http://evil.example\r\ncontent-type: application/json\r\n";
    let command = br#"{"command":"reset-pose"}"#;
    let answer = request(address, "POST /v1/commands", foreign, command);
    assert_eq!(answer.status, 403);
    let upgrade = format!(
        "upgrade: websocket\r\nsec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n{foreign}"
    );
    assert_eq!(request(address, "GET /v1/stream", &upgrade, b"").status, 403);
    let form = "content-type: text/plain\r\n";
    assert_eq!(request(address, "POST /v1/commands", form, command).status, 415);
    assert_eq!((refused(address, "host"), refused(address, "origin")), (1.0, 2.0));
    assert_eq!(refused(address, "request"), 1.0);
    let mut commands = played.commands;
    assert!(commands.try_recv().is_err(), "nothing reached the shard");
}

#[test]
fn a_token_opens_the_station_and_a_wrong_one_does_not() {
    let played = TestStation::start(TokenPolicy::Always);
    let address = played.address();
    let url = played.dashboard.url().unwrap();
    let token = url.split_once("?token=").unwrap().1;
    assert_eq!(get(address, "/v1/state").status, 401);
    assert_eq!(get(address, "/?token=0123").status, 401);
    let page = get(address, &format!("/?token={token}"));
    let cookie = page.header("set-cookie").unwrap();
    assert!(cookie.ends_with("; path=/; httponly; samesite=strict"), "{cookie}");
    let cookie = format!("cookie: {}\r\n", cookie.split(';').next().unwrap());
    assert_eq!(request(address, "GET /v1/state", &cookie, b"").status, 200);
    let bearer = format!("authorization: Bearer {token}\r\n");
    let metrics = request(address, "GET /metrics", &bearer, b"").text();
    assert!(metrics.contains("refused_total{reason=\"token\"} 2\n"), "{metrics}");
    let hello_needs = request(address, "GET /v1/stream", &bearer, b"");
    assert_eq!(hello_needs.status, 400, "it is no upgrade, but it was let in");
}

#[test]
fn who_may_only_look_sees_everything_and_commands_nothing() {
    let played = TestStation::start(TokenPolicy::Always);
    let address = played.address();
    let token_in = |url: String| url.split_once("?token=").unwrap().1.to_owned();
    let operator = token_in(played.dashboard.url().unwrap());
    let reader = token_in(played.dashboard.reader_url().unwrap());
    let json = "content-type: application/json\r\n";
    let command = |token: &str| {
        let headers = format!("{json}authorization: Bearer {token}\r\n");
        request(address, "POST /v1/commands", &headers, br#"{"command":"reset-pose"}"#)
    };
    let refused = command(&reader);
    assert_eq!(refused.status, 403);
    assert_eq!(refused.error(), "this token only lets you look; a command needs the token of an operator");
    let mut looking = StreamReader::open_as(address, &reader);
    assert_eq!(looking.next()["can_command"], false);
    looking.send(r#"{"command":"reset-pose"}"#);
    let error = looking.wait_for(|message| message["type"] == "error");
    assert_eq!(error["error"], "this token only lets you look; a command needs the token of an operator");
    let bearer = format!("authorization: Bearer {reader}\r\n");
    let metrics = request(address, "GET /metrics", &bearer, b"").text();
    assert!(metrics.contains("refused_total{reason=\"role\"} 2\n"), "{metrics}");
    let mut commands = played.commands;
    assert!(commands.try_recv().is_err(), "nothing reached the station");
    assert_eq!(StreamReader::open_as(address, &operator).next()["can_command"], true);
    assert_eq!(command(&operator).status, 202);
    assert_eq!(commands.try_recv().unwrap(), Input::Command(Command::ResetPose));
}

/// Replaces a file of tokens as a person would, for its owner alone.
fn write_tokens(path: &Path, text: &str) {
    let new = path.with_extension("new");
    std::fs::write(&new, text).unwrap();
    std::fs::set_permissions(&new, Permissions::from_mode(0o600)).unwrap();
    std::fs::rename(&new, path).unwrap();
}

/// A station with a file of tokens for a teacher, who operates it, and a student, who looks.
fn station_with_tokens(folder: &Path) -> (PathBuf, TestStation) {
    let path = folder.join("tokens");
    write_tokens(&path, "operator teacher-teacher-1\nreader student-student-1\n");
    let facts = StationInfo { token: TokenPolicy::Always, token_file: Some(path.clone()), ..StationInfo::default() };
    (path, TestStation::with(facts, ManualClock::running()))
}

fn status_for(address: SocketAddr, token: &str) -> u16 {
    let bearer = format!("authorization: Bearer {token}\r\n");
    request(address, "GET /v1/robots", &bearer, b"").status
}

#[test]
fn a_token_that_is_taken_out_of_its_file_ends_its_sessions_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let (path, played) = station_with_tokens(folder.path());
    let address = played.address();
    assert!(played.dashboard.urls().iter().all(|url| !url.contains("token")), "people have them already");
    let mut teacher = StreamReader::open_as(address, "teacher-teacher-1");
    teacher.next();
    let student = StreamReader::open_as(address, "student-student-1");
    // One that reads nothing, with more on its way than there is room for.
    let stuck = StreamReader::open_as(address, "student-student-1");
    for _ in 0..150 {
        let events = (0..250).map(|line| text_event(&format!("{line:04}{}", "x".repeat(986))));
        played.publish(events.collect());
        teacher.wait_for(|message| message["log"].as_array().is_some_and(|log| !log.is_empty()));
    }

    write_tokens(&path, "operator teacher-teacher-1\nreader other-student-22\n");
    assert_eq!(student.close_reason().as_deref(), Some("the token was revoked"));
    let status = |token: &str| status_for(address, token);
    assert_eq!((status("student-student-1"), status("other-student-22"), status("teacher-teacher-1")), (401, 200, 200));
    let bearer = "authorization: Bearer teacher-teacher-1\r\n";
    let clients = "posebridge_dashboard_clients 1\n";
    while !request(address, "GET /metrics", bearer, b"").text().contains(clients) {
        teacher.next();
    }
    let metrics = request(address, "GET /metrics", bearer, b"").text();
    assert!(metrics.contains("clients_dropped_total 0\n"), "the stuck one was not waited for: {metrics}");
    drop(stuck);
}

#[test]
fn a_file_of_tokens_with_an_error_locks_nobody_out() {
    let folder = tempfile::tempdir().unwrap();
    let (path, played) = station_with_tokens(folder.path());
    let address = played.address();
    let student = StreamReader::open_as(address, "student-student-1");
    write_tokens(&path, "operatr teacher-teacher-1\n");
    let status = |token: &str| status_for(address, token);
    // Messages come at least fifty times a second: more than a look at the file goes by.
    let mut teacher = StreamReader::open_as(address, "teacher-teacher-1");
    teacher.next();
    for number in 0..80 {
        played.publish(vec![text_event(&format!("{number}"))]);
        teacher.wait_for(|message| log_contains(&message["log"], &format!("1/1: {number}")));
    }
    assert_eq!((status("student-student-1"), status("teacher-teacher-1")), (200, 200));
    write_tokens(&path, "");
    assert_eq!(student.close_reason().as_deref(), Some("the token was revoked"));
    assert_eq!(teacher.close_reason().as_deref(), Some("the token was revoked"));
}

#[test]
fn a_browser_without_the_token_is_told_what_to_do() {
    let played = TestStation::start(TokenPolicy::Always);
    let address = played.address();
    let accept = "accept: text/html,application/xhtml+xml\r\n";
    let page = request(address, "GET /", accept, b"");
    assert_eq!((page.status, page.header("content-type")), (401, Some("text/html; charset=utf-8")));
    assert!(page.header("content-security-policy").is_some());
    assert!(page.text().contains("Open that address"), "{}", page.text());
    let program = request(address, "GET /v1/robots", "accept: */*\r\n", b"");
    assert!(program.error().contains("token"));
}

#[test]
fn recordings_are_listed_sent_and_replayed_and_nothing_else_is() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let address = played.address();
    let bytes: Vec<u8> = (0..300_000_u32).map(|i| (i % 251) as u8).collect();
    played.record("recording.mcap", &bytes);
    played.record("broken.mcap", b"bad");
    let rows = get(address, "/v1/recordings").json();
    assert_eq!(rows.as_array().unwrap().len(), 2);
    assert_eq!((&rows[1]["name"], &rows[1]["bytes"]), (&"recording.mcap".into(), &300_000.into()));
    let sent = get(address, "/v1/recordings/recording.mcap");
    assert_eq!(sent.body, bytes);
    assert_eq!(sent.header("content-disposition"), Some("attachment; filename=\"recording.mcap\""));
    let replayed = get(address, "/v1/recordings/recording.mcap/replay");
    assert_eq!(replayed.json()["robots"][0]["id"], "300000 bytes");
    let broken = get(address, "/v1/recordings/broken.mcap/replay");
    assert_eq!((broken.status, broken.error()), (422, "it is no recording".to_owned()));
    for name in [
        "missing.mcap",
        "..%2fsecret.mcap",
        "../secret.mcap",
        "%2e%2e/secret.mcap",
        "%2fetc%2fpasswd",
        "recording.mcap%00",
    ] {
        for path in ["", "/replay"] {
            let answer = get(address, &format!("/v1/recordings/{name}{path}"));
            assert_eq!(answer.status, 404, "{name}{path}");
            assert!(!answer.text().contains("secret"));
        }
    }
    assert_eq!(refused(address, "not_found"), 12.0);
}

#[test]
fn a_reader_that_is_slow_misses_messages_is_told_so_and_slows_nobody() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let mut slow = StreamReader::open(played.address());
    let mut quick = StreamReader::open(played.address());
    quick.next();
    // A quarter of a megabyte a message: what the system keeps for the slow one, some 11 MB, is full after a third of them, and the server
    // keeps 64 messages more.
    for _ in 0..150 {
        let events = (0..250).map(|line| text_event(&format!("{line:04}{}", "x".repeat(986))));
        played.publish(events.collect());
        let mut lines = 0;
        while lines < 250 {
            let message = quick.next();
            assert_eq!(message["dropped"], 0);
            lines += message["log"].as_array().map_or(0, Vec::len);
        }
    }
    let late = slow.wait_for(|message| message["dropped"].as_u64().is_some_and(|n| n > 0));
    assert_eq!(late["type"], "frame");
    let missed = metric(played.address(), "posebridge_dashboard_frames_missed_total");
    assert!(missed > 0.0);
    assert_eq!(metric(played.address(), "posebridge_dashboard_events_dropped_total"), 0.0);
}

#[test]
fn a_default_port_that_is_taken_moves_on_and_a_chosen_one_does_not() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let taken = played.address();
    let error = BoundListener::new(ListenAddress::Exact(taken)).unwrap_err();
    assert!(matches!(error, DashboardStartError::AddressInUse { address } if address == taken));
    assert!(error.to_string().contains("is in use, perhaps by another station"));
    let folder = tempfile::tempdir().unwrap();
    let sources = sources(folder.path(), &played.clock);
    let bound = BoundListener::new(ListenAddress::FirstFree(taken)).unwrap();
    let (next, _feed, _commands) = Dashboard::start(Some(bound), StationInfo::default(), sources).unwrap();
    let steps = next.address().unwrap().port() - taken.port();
    assert!((1..=20).contains(&steps), "{steps}");
}

#[test]
fn it_ends_when_the_shard_is_gone() {
    let played = TestStation::start(TokenPolicy::RemoteOnly);
    let mut reader = StreamReader::open(played.address());
    reader.next();
    drop(played.feed);
    reader.drain();
    played.dashboard.finish();
}

#[test]
fn without_a_server_readers_in_the_process_hear_the_same_and_give_commands() {
    let folder = tempfile::tempdir().unwrap();
    let mut taps = FrameTaps::default();
    let tap = taps.add(64);
    let sources = DashboardInputs { taps, ..sources(folder.path(), &ManualClock::running()) };
    let started = Dashboard::start(None, StationInfo::default(), sources);
    let (dashboard, feed, mut commands) = started.unwrap();
    assert_eq!((dashboard.address(), dashboard.url()), (None, None));
    feed.publish(EventBatch {
        now: Timestamp::from_millis(5),
        latency: TimeDelta::ZERO,
        events: [text_event("hello")].into(),
        status: None,
    });
    let received = std::iter::from_fn(|| tap.recv()).find(|frame| !frame.log.is_empty());
    assert_eq!(received.unwrap().log[0].text, "1/1: hello");
    assert!(dashboard.commander().send(None, Command::ResetPose));
    assert_eq!(commands.try_recv().unwrap(), Input::Command(Command::ResetPose));
    drop(commands);
    assert!(!dashboard.commander().send(None, Command::ResetPose));
    dashboard.finish();
    // What waits is still told, then comes the end.
    while tap.recv().is_some() {}
    assert_eq!(tap.try_recv(), TapPoll::Closed);
}

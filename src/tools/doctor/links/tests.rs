//! Results of listening, on links of this computer and on made-up speeds.

use std::collections::BTreeMap;

use nix::sys::termios::{BaudRate, ControlFlags, SetArg, cfsetspeed, tcgetattr, tcsetattr};
use posebridge_link::{Link, LinkEvent, LinkOpenConfig};
use posebridge_telemetry::LinkId;
use tokio::io::AsyncWriteExt;

use super::*;
use crate::tools::doctor::Status;

/// A frame that pymavlink packed (protocol/tests/data/README.md).
fn golden(name: &str) -> Vec<u8> {
    let text = include_str!("../../../../protocol/tests/data/golden.json");
    let frames: BTreeMap<String, String> = serde_json::from_str(text).unwrap();
    let hex = &frames[name];
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
}

fn listen_result(bytes: &[u8]) -> ListenResult {
    ListenResult { bytes: bytes.to_vec(), ..ListenResult::default() }
}

fn listener() -> LinkListener {
    LinkListener { timer: HostTimer::start(), listen_for: TimeDelta::from_millis(3_000) }
}

#[test]
fn every_protocol_gets_its_verdict() {
    let nmea = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n";
    let nxt_telegrams = [5, 0, 2, 0x0b, 0, 0xdc, 0x1e].repeat(4);
    let cases: [(&[u8], Status, &str); 8] = [
        (&golden("heartbeat"), Status::Ok, ""),
        (&nxt_telegrams, Status::Ok, ""),
        (b"L 1 R 2\r\n", Status::Ok, ""),
        (&golden("v1_heartbeat"), Status::Warning, "accept_mavlink1"),
        (nmea, Status::Warning, "satellite receiver"),
        (&[0x11; 50], Status::Problem, "speed"),
        (b"", Status::Warning, "is the robot on"),
        (b"", Status::Warning, "is asked"),
    ];
    for (bytes, status, advice) in cases {
        let verdict = classify("here", &listen_result(bytes));
        assert_eq!(verdict.status, status, "{verdict:?}");
        assert!(verdict.advice.contains(advice), "{verdict:?}");
        assert_eq!(verdict.advice.is_empty(), status == Status::Ok);
    }
}

#[test]
fn a_link_that_is_lost_in_silence_says_why() {
    let lost = ListenResult { lost_reason: Some("the other end is gone".to_owned()), ..ListenResult::default() };
    let verdict = classify("here", &lost);
    assert_eq!(verdict.status, Status::Problem);
    assert!(verdict.message.contains("the other end is gone"));
}

/// Tries speeds on a line that carries MAVLink at one of them and noise at the others; also gives the speeds tried.
async fn try_line(link: &str, right_baud: u32) -> (CheckResult, Vec<u32>) {
    let url = LinkUrl::parse(link).unwrap();
    let mut tried = Vec::new();
    let verdict = try_speeds(&url, async |url: &LinkUrl| {
        let baud = baud_of(url);
        tried.push(baud);
        assert_eq!(
            url.to_string().contains("dtr=off"),
            link.contains("dtr=off"),
            "the other options stay at every speed"
        );
        Ok(listen_result(if baud == right_baud { &FRAME } else { &[0x11; 50] }))
    })
    .await;
    (verdict, tried)
}

/// The heartbeat of a ground rover, as in the example of `framing::Scanner`.
const FRAME: [u8; 21] = [0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 4, 3, 0xDE, 0xEB];

#[tokio::test]
async fn a_line_at_another_speed_is_found_and_the_right_link_is_told_with_its_options() {
    for (link, right_baud, speeds, message, advice) in [
        (
            "serial:///nowhere/ttyUSB0",
            9_600,
            &[115_200, 57_600, 9_600][..],
            "/nowhere/ttyUSB0 at 9600 baud: MAVLink 2",
            "write the link as serial:/nowhere/ttyUSB0?baud=9600",
        ),
        (
            "serial:///nowhere/ttyUSB0?dtr=off&baud=57600&rate=900",
            9_600,
            &[57_600, 115_200, 9_600],
            "/nowhere/ttyUSB0 at 9600 baud: MAVLink 2",
            "write the link as serial:/nowhere/ttyUSB0?baud=9600&dtr=off&rate=900",
        ),
        ("serial:///nowhere/ttyUSB0?baud=57600", 57_600, &[57_600], "at 57600 baud", ""),
    ] {
        let (verdict, tried) = try_line(link, right_baud).await;
        assert_eq!(tried, speeds, "{link}");
        assert_eq!(verdict.status, if speeds.len() > 1 { Status::Warning } else { Status::Ok }, "{link}");
        assert!(verdict.message.contains(message), "{verdict:?}");
        assert_eq!(verdict.advice, advice);
    }
}

#[tokio::test]
async fn noise_at_every_speed_is_a_problem_after_each_was_tried_once() {
    let (verdict, mut tried) = try_line("serial:///nowhere/ttyUSB0?baud=9600", 0).await;
    assert_eq!(tried.len(), SPEEDS_BAUD.len());
    tried.sort_unstable();
    tried.dedup();
    assert_eq!(tried.len(), SPEEDS_BAUD.len());
    assert_eq!(verdict.status, Status::Problem);
    assert!(verdict.message.contains("every other usual speed"), "{verdict:?}");
}

/// A pseudo-terminal of our own, open, and a link to its other side.
async fn pseudo_terminal(folder: &tempfile::TempDir) -> (Link, String) {
    let path = folder.path().join("brick.tty");
    let config = LinkOpenConfig { id: LinkId(1), url: LinkUrl::pty(&path).unwrap(), role: ConnectRole::Listen };
    let mut port = Link::new(config, HostTimer::start());
    port.try_open().await.unwrap();
    assert!(matches!(port.next_event().await, LinkEvent::Up { .. }));
    (port, format!("serial:{}", path.display()))
}

/// Sends again and again until the listener has made up its mind.
async fn listen_while_sending(port: &mut Link, link: &str, bytes: &[u8]) -> CheckResult {
    let sending = async {
        loop {
            port.send(bytes);
            // Lets the port write, and the listener have its turn.
            tokio::select! {
                biased;
                _ = port.next_event() => {}
                () = tokio::task::yield_now() => {}
            }
        }
    };
    tokio::select! {
        verdict = listener().listen_on(link) => verdict,
        () = sending => unreachable!("it sends for ever"),
    }
}

#[tokio::test]
async fn on_a_pseudo_terminal_the_speed_does_not_matter_and_its_settings_stay() {
    let folder = tempfile::tempdir().unwrap();
    let (mut port, link) = pseudo_terminal(&folder).await;
    let line = fs::File::open(folder.path().join("brick.tty")).unwrap();
    let mut settings = tcgetattr(&line).unwrap();
    settings.control_flags.insert(ControlFlags::HUPCL);
    cfsetspeed(&mut settings, BaudRate::B19200).unwrap();
    tcsetattr(&line, SetArg::TCSANOW, &settings).unwrap();
    let before = tcgetattr(&line).unwrap();
    let verdict = listen_while_sending(&mut port, &format!("{link}?baud=57600"), &FRAME).await;
    assert_eq!(verdict.status, Status::Ok, "{verdict:?}");
    assert!(verdict.message.contains("the speed does not matter"), "{verdict:?}");
    assert!(verdict.message.contains("MAVLink 2"), "{verdict:?}");
    assert_eq!(tcgetattr(&line).unwrap(), before);
}

#[tokio::test(start_paused = true)]
async fn a_silent_link_is_told_after_the_time_that_was_given() {
    let folder = tempfile::tempdir().unwrap();
    let (_port, link) = pseudo_terminal(&folder).await;
    let listener = listener();
    let verdict = listener.listen_on(&link).await;
    assert_eq!(verdict.status, Status::Warning);
    assert!(verdict.message.ends_with("silence"), "{verdict:?}");
    let took = listener.timer.now().as_nanos() / 1_000_000;
    assert!((3_000..3_010).contains(&took), "{took} ms");
}

#[tokio::test]
async fn a_tcp_server_is_called_and_heard() {
    let server = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let link = format!("tcp://{}", server.local_addr().unwrap());
    let serve = async {
        let (mut client, _) = server.accept().await.unwrap();
        client.write_all(&FRAME.repeat(20)).await.unwrap();
        client
    };
    let (verdict, _client) = tokio::join!(listener().listen_on(&link), serve);
    assert_eq!(verdict.status, Status::Ok, "{verdict:?}");
}

#[tokio::test]
async fn datagrams_are_received() {
    let url = LinkUrl::parse("udp://127.0.0.1:0").unwrap();
    let listener = listener();
    let OpenOutcome::Up(mut port, _) = open(&url, role_of(&url), listener.timer).await else {
        panic!("loopback opens");
    };
    let robot = tokio::net::UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let station = port.local_address().unwrap();
    for _ in 0..20 {
        robot.send_to(&FRAME, station).await.unwrap();
    }
    let received = listen(&mut port, listener.timer, listener.listen_for).await;
    assert_eq!(received.detect().protocol, Protocol::Mavlink2);
}

#[tokio::test]
async fn what_is_no_link_or_cannot_be_opened_says_so() {
    let cases = [
        ("ttyUSB0", Status::Problem, "has no scheme"),
        ("sim://square", Status::Problem, "unknown link scheme"),
        ("pty:x", Status::Skipped, "pty links cannot"),
        ("serial:/nowhere/ttyUSB0", Status::Warning, "is not there"),
        ("serial:/dev/null/x", Status::Warning, "is not there"),
        ("serial:/", Status::Problem, "is a directory"),
    ];
    for (link, status, what) in cases {
        let verdict = listener().listen_on(link).await;
        assert_eq!(verdict.status, status, "{verdict:?}");
        assert!(verdict.message.contains(what), "{verdict:?}");
    }
}

#[test]
fn links_without_a_host_wait_and_nothing_is_sent_by_udp() {
    let roles = [
        ("udp://:14550", ConnectRole::Listen),
        ("udp://127.0.0.1:14550", ConnectRole::Listen),
        ("tcp://:5760", ConnectRole::Listen),
        ("tcp://127.0.0.1:5760", ConnectRole::Dial),
        ("serial:x", ConnectRole::Dial),
    ];
    for (link, role) in roles {
        assert_eq!(role_of(&LinkUrl::parse(link).unwrap()), role, "{link}");
    }
}

//! A recording is readable after `kill -9`, up to at most one second before.
//!
//! The test is the brick: the station's requests for the time carry the station's own clock, so the test knows at what time of the
//! session it kills. It kills at several, so that no period of flushing passes by luck.
#![expect(
    clippy::expect_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

mod support;

use std::io::Read as _;
use std::net::{TcpListener, TcpStream};
use std::path::Path;

use posebridge_protocol::dialect::decode;
use posebridge_protocol::framing::{Scanned, Scanner, ScannerConfig};
use posebridge_protocol::message::Message;
use posebridge_recording::container::Reader;
use posebridge_telemetry::Stamp;
use support::{Running, posebridge, stdout_of};

#[test]
fn a_killed_run_leaves_a_recording_that_replays_up_to_a_second_before() {
    for kill_at_s in [1.3, 2.4, 4.4] {
        let folder = tempfile::tempdir().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let link = format!("tcp://{}", listener.local_addr().unwrap());
        let run = Running::start(
            posebridge(folder.path()).args(["run", "--link", &link, "--out", "run"]),
        );
        let (mut station, _) = listener.accept().unwrap();
        let killed_at_s = wait_for_time(&mut station, kill_at_s);
        run.kill();
        let recorded_to_s = recorded_to_s(&folder.path().join("run/recording.mcap"));
        println!("killed at {killed_at_s:.2} s or later, recorded up to {recorded_to_s:.2} s");
        assert!(
            recorded_to_s > killed_at_s - 1.0,
            "{recorded_to_s} {killed_at_s}"
        );

        let replay =
            stdout_of(posebridge(folder.path()).args(["replay", "run/recording.mcap", "--json"]));
        // Nobody knows where the robot was: the figures are null, not zero.
        let report: serde_json::Value = serde_json::from_str(&replay).unwrap();
        let estimator = &report["estimators"][0];
        assert_eq!(estimator["name"], "pose");
        for figure in [
            "position_rms_m",
            "position_max_m",
            "position_end_m",
            "heading_rms_rad",
            "anees",
        ] {
            assert!(estimator[figure].is_null(), "{report}");
        }
    }
}

/// Reads what the station says until its clock shows at least `secs`; returns what it shows.
fn wait_for_time(station: &mut TcpStream, secs: f64) -> f64 {
    let mut scanner = Scanner::new(ScannerConfig::default());
    let mut buffer = [0; 1024];
    loop {
        let read = station.read(&mut buffer).expect("the station speaks");
        assert!(read > 0, "the station has hung up");
        let mut shown_s = 0.0_f64;
        scanner.push(Stamp::ZERO, &buffer[..read], &mut |scanned| {
            if let Scanned::Frame(frame) = scanned
                && let Ok(Some(Message::TimeSync(request))) = decode(&frame)
            {
                shown_s = shown_s.max(request.request_nanos as f64 * 1e-9);
            }
        });
        if shown_s >= secs {
            return shown_s;
        }
    }
}

/// The last instant in a recording.
fn recorded_to_s(path: &Path) -> f64 {
    let bytes = std::fs::read(path).expect("the recording is there");
    let inputs = Reader::open(&bytes).expect("its header is whole");
    let last = inputs
        .map(|input| input.expect("every whole record is good").0)
        .max();
    last.expect("something was recorded").as_secs_f64()
}

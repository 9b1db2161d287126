//! A recording is readable after `kill -9`, up to at most one second before.
//!
//! The test is the brick: the station's requests for the time carry the station's own clock, so the test knows at what time of the
//! session it kills.

use std::net::TcpListener;

use crate::support::mavlink::MavlinkPeer;
use crate::support::{RunningProgram, json};
use posebridge_protocol::message::Message;
use posebridge_recording::container::RecordingReader;
use posebridge_telemetry::Address;

/// Between two flushes of a recording whose flushes lie a second apart from its beginning on.
const KILL_AT_S: f64 = 2.4;

#[test]
fn a_killed_run_leaves_a_recording_that_replays_up_to_a_second_before() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let link = format!("tcp://{}", listener.local_addr().unwrap());
    let station = RunningProgram::posebridge(folder, &["run", "--link", &link, "--out", "run"]);
    let (mut link, _) = listener.accept().unwrap();
    let killed_at_s = MavlinkPeer::new(Address::new(1, 1)).wait_for(&mut link, |message| match message {
        Message::TimeSync(request) => Some(request.request_nanos as f64 * 1e-9).filter(|now_s| *now_s >= KILL_AT_S),
        _ => None,
    });
    station.kill();

    let bytes = std::fs::read(folder.join("run/recording.mcap")).unwrap();
    let inputs = RecordingReader::open(&bytes).expect("its header is whole");
    let last = inputs.map(|input| input.expect("every whole record is good").0).max();
    let recorded_to_s = last.expect("something was recorded").as_secs_f64();
    println!("killed at {killed_at_s:.2} s or later, recorded up to {recorded_to_s:.2} s");
    assert!(recorded_to_s > killed_at_s - 1.0, "{recorded_to_s} {killed_at_s}");
    // Nobody knows where the robot was: the figures are null, not zero.
    let estimator = &json(folder, &["replay", "run/recording.mcap"])["estimators"][0];
    assert_eq!(estimator["name"], "pose");
    for figure in ["position_rms_m", "position_max_m", "position_end_m", "heading_rms_rad", "anees"] {
        assert!(estimator[figure].is_null(), "{estimator}");
    }
}

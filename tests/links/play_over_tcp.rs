//! A recording of a real robot, played over TCP as a brick would send it, gives the estimates of its replay.

use std::path::Path;

use crate::support::{OPTIODOM_RUN, RunningProgram, committed_data, descriptor, events_named, number, read_text, run};

#[test]
fn a_played_recording_is_estimated_as_its_replay() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (optiodom, data) = (descriptor("optiodom.toml"), committed_data());
    let recording = [&optiodom[..], "--data", &data, "--run", OPTIODOM_RUN];
    let play = [&["play", "--listen", "tcp://127.0.0.1:0", "--speed", "20"], &recording[..]].concat();
    let mut player = RunningProgram::posebridge(folder, &play);
    let link = format!("tcp://{}", player.listening_address(""));
    let live = ["run", "--link", &link, "--robot", &optiodom, "--out", "run", "--events", "live.txt"];
    let mut station = RunningProgram::posebridge(folder, &[&live[..], &["--until-silent", "1"]].concat());
    station.output();
    player.output();
    run(folder, &[&["replay", "--filter", "pose", "--events", "replayed.txt"], &recording[..]].concat());
    let ([live_s, live_x_m, live_y_m], [replayed_s, x_m, y_m]) =
        (last_estimate(folder, "live.txt"), last_estimate(folder, "replayed.txt"));
    assert_eq!(live_s, replayed_s);
    // The wire carries geometry as 32-bit floats: after 4 m of path that is a tenth of a micrometre.
    assert!((live_x_m - x_m).abs() < 1e-6 && (live_y_m - y_m).abs() < 1e-6, "{live_x_m} {x_m} {live_y_m} {y_m}");
}

/// Time in nanoseconds, x and y in metres of the last estimate.
fn last_estimate(folder: &Path, events: &str) -> [f64; 3] {
    let estimated = events_named(&read_text(folder, events), "estimated").pop().expect("something was estimated");
    ["/robot_ns", "/x_m", "/y_m"].map(|key| number(&estimated, key))
}

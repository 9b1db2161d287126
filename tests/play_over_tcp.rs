//! A recording of a real robot, played over TCP as a brick would send it, gives the estimates of its replay.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use support::{RunningProgram, events_named, posebridge, root, stdout_of};

#[test]
fn a_played_recording_is_estimated_as_its_replay() {
    let folder = tempfile::tempdir().unwrap();
    let descriptor = root().join("config/recordings/optiodom.toml");
    let run = "circular/250620202104/run-01";
    let mut player = RunningProgram::start(
        posebridge(folder.path()).arg("play").arg(&descriptor).arg("--data").arg(root().join("tests/data")).args([
            "--run",
            run,
            "--listen",
            "tcp://127.0.0.1:0",
            "--speed",
            "20",
        ]),
    );
    let address = player.listening_address("");
    let mut station = RunningProgram::start(
        posebridge(folder.path())
            .args(["run", "--link", &format!("tcp://{address}"), "--robot"])
            .arg(&descriptor)
            .args(["--out", "run", "--events", "live.txt", "--until-silent", "1"]),
    );
    station.output();
    player.output();
    stdout_of(
        posebridge(folder.path()).arg("replay").arg(&descriptor).arg("--data").arg(root().join("tests/data")).args([
            "--run",
            run,
            "--filter",
            "pose",
            "--events",
            "replayed.txt",
        ]),
    );
    let ([live_s, live_x_m, live_y_m], [replayed_s, x_m, y_m]) =
        (last_estimate(&folder.path().join("live.txt")), last_estimate(&folder.path().join("replayed.txt")));
    assert_eq!(live_s, replayed_s);
    // The wire carries geometry as 32-bit floats: after 4 m of path that is a tenth of a micrometre.
    assert!((live_x_m - x_m).abs() < 1e-6 && (live_y_m - y_m).abs() < 1e-6, "{live_x_m} {x_m} {live_y_m} {y_m}");
}

/// Time, x and y of the last estimate.
fn last_estimate(events: &std::path::Path) -> [f64; 3] {
    let text = std::fs::read_to_string(events).expect("the events are there");
    let estimated = events_named(&text, "estimated").pop().expect("something was estimated");
    [("robot_ns", 1e-9), ("x_m", 1.0), ("y_m", 1.0)]
        .map(|(key, unit)| unit * estimated[key].as_f64().expect("it is a number"))
}

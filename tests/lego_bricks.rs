//! LEGO bricks as they come out of the box: brick and station as two processes, over a pseudo-terminal, with the camera beside it.
#![expect(
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

mod support;

use std::path::Path;

use serde_json::Value;
use support::{Running, posebridge, stdout_of};

/// A lap of a small square, about ten seconds; the camera sees the robot five times a second.
const SQUARE: &str = r#"
seed = 5
steering = "estimate"

[path.square]
side_m = 0.3

[drive]
laps = 1
speed_m_per_s = 0.2

[camera]
rate_hz = 5.0
"#;

/// Where the simulated bricks have their motors and gyros.
const ROBOT: &str = r#"
[robot]
adopt_description = false

[robot.nxt]
sensor = [{ port = 1, kind = "ht-gyro" }]

[robot.ev3]
gyro_port = 2
"#;

/// Drives the square with a brick that speaks so; gives what the station printed.
fn driven(folder: &Path, kind: &str) -> String {
    std::fs::write(folder.join("small.toml"), SQUARE).unwrap();
    std::fs::write(folder.join("robot.toml"), ROBOT).unwrap();
    let mut sim = posebridge(folder);
    sim.args(["sim", "small.toml", "--brick", kind]);
    sim.args(["--listen", "pty:brick.tty", "--truth", "truth.csv"]);
    sim.args(["--camera-listen", "tcp://127.0.0.1:0"]);
    let mut brick = Running::start(&mut sim);
    let camera = format!("tcp://{}", brick.listening_address("camera "));
    let mut run = posebridge(folder);
    run.args(["run", "--link", "serial:brick.tty", "--brick", kind]);
    run.args(["--link", &camera, "--robot", "robot.toml"]);
    run.args(["--until-silent", "2", "--out", "run"]);
    let printed = stdout_of(&mut run);
    brick.output();
    printed
}

#[test]
fn the_table_and_the_picture_are_those_of_any_brick() {
    for kind in ["nxt", "nxt-push", "ev3"] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let printed = driven(folder, kind);
        println!("{kind}\n{printed}");
        for source in ["wheels (0)", "camera (3)"] {
            assert!(printed.contains(source), "{kind}: {printed}");
        }
        for picture in ["track.svg", "error.svg"] {
            assert!(folder.join("run").join(picture).exists(), "{kind}");
        }
        // What was recorded is what happened, and the truth says how far off that was.
        let replay = [
            "replay",
            "run/recording.mcap",
            "--truth",
            "truth.csv",
            "--json",
        ];
        let replayed = stdout_of(posebridge(folder).args(replay));
        let replayed: Value = serde_json::from_str(&replayed).unwrap();
        let off_m = replayed["estimators"][0]["position_rms_m"]
            .as_f64()
            .unwrap();
        println!("{kind}: off by {:.1} mm", 1e3 * off_m);
        assert!(off_m < 0.01, "{kind}: {off_m}");
    }
}

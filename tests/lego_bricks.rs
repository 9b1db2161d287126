//! LEGO bricks as they come out of the box: brick and station as two processes, over a pseudo-terminal, with the camera beside it.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::path::Path;

use support::{RunningProgram, error_to_truth_m, posebridge, stdout_of};

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

/// How brick and station find each other: the arguments of each.
struct LinkArguments<'a> {
    brick: &'a [&'a str],
    station: &'a [&'a str],
}

/// Drives the square with a brick that speaks so; gives what the station printed.
fn driven(folder: &Path, kind: &str, arguments: &LinkArguments<'_>) -> String {
    std::fs::write(folder.join("small.toml"), SQUARE).unwrap();
    std::fs::write(folder.join("robot.toml"), ROBOT).unwrap();
    let mut sim = posebridge(folder);
    sim.args(["sim", "small.toml", "--brick", kind]);
    sim.args(arguments.brick).args(["--truth", "truth.csv"]);
    sim.args(["--camera-listen", "tcp://127.0.0.1:0"]);
    let mut brick = RunningProgram::start(&mut sim);
    let camera = format!("tcp://{}", brick.listening_address("camera "));
    let mut run = posebridge(folder);
    run.arg("run").args(arguments.station);
    run.args(["--brick", kind, "--robot", "robot.toml"]);
    run.args(["--link", &camera]);
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
        let arguments =
            LinkArguments { brick: &["--listen", "pty:brick.tty"], station: &["--link", "serial:brick.tty"] };
        let printed = driven(folder, kind, &arguments);
        println!("{kind}\n{printed}");
        for source in ["wheels (0)", "gyro (1)", "camera (3)"] {
            assert!(printed.contains(source), "{kind}: {printed}");
        }
        for picture in ["track.svg", "error.svg"] {
            assert!(folder.join("run").join(picture).exists(), "{kind}");
        }
        let off_m = error_to_truth_m(folder);
        println!("{kind}: off by {:.1} mm", 1e3 * off_m);
        assert!(off_m < 0.01, "{kind}: {off_m}");
    }
}

/// A TCP port of four digits, as an EV3 announces one.
fn four_digit_port() -> u16 {
    (5_555..=9_999).find(|port| std::net::TcpListener::bind(("127.0.0.1", *port)).is_ok()).unwrap()
}

#[test]
fn an_ev3_in_the_network_is_found_by_its_announcement_and_opened() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let beside = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let announced = beside.local_addr().unwrap();
    drop(beside);
    let door = format!("tcp://127.0.0.1:{}", four_digit_port());
    let arguments = LinkArguments {
        brick: &["--listen", &door, "--announce", &format!("udp://{announced}")],
        station: &["--listen", &format!("ev3://{announced}?serial=0016530b0e03")],
    };
    let printed = driven(folder, "ev3", &arguments);
    assert!(printed.contains("wheels (0)"), "{printed}");
    let off_m = error_to_truth_m(folder);
    println!("by WiFi: off by {:.1} mm", 1e3 * off_m);
    assert!(off_m < 0.01, "{off_m}");
}

//! What goes wrong around a run must not go wrong in it: peers that come and go, a dead terminal, a full disk, an old recording.

mod support;

use std::fs::OpenOptions;
use std::io::Write as _;
use std::process::Stdio;

use support::{RunningProgram, WHEELS_CSV, posebridge, root, stdout_of};

#[test]
fn a_player_that_calls_over_udp_is_heard_by_a_station_that_waits() {
    let folder = tempfile::tempdir().unwrap();
    let mut station = RunningProgram::start(posebridge(folder.path()).args([
        "run",
        "--listen",
        "udp://127.0.0.1:0",
        "--until-silent",
        "2",
        "--out",
        "run",
    ]));
    let address = station.listening_address("");
    let mut player = RunningProgram::start(
        posebridge(folder.path())
            .arg("play")
            .arg(root().join("config/recordings/optiodom.toml"))
            .arg("--data")
            .arg(root().join("tests/data"))
            .args(["--run", "circular/250620202104/run-01", "--speed", "100"])
            .args(["--link", &format!("udp://{address}")]),
    );
    player.output();
    let tables = station.output();
    let wheels = tables.lines().find(|line| line.starts_with("wheels")).expect("the wheels are in the table");
    let used: usize = wheels.split_whitespace().nth(2).unwrap().parse().unwrap();
    assert!(used > 2_000, "{tables}");
}

#[test]
fn another_client_of_our_tcp_server_does_not_mute_the_brick() {
    let folder = tempfile::tempdir().unwrap();
    let mut station =
        RunningProgram::start(posebridge(folder.path()).args(["run", "--listen", "tcp://127.0.0.1:0", "--out", "run"]));
    let address = station.listening_address("");
    let link = format!("tcp://{address}");
    let _brick = RunningProgram::start(posebridge(folder.path()).args(["sim", "circle", "--link", &link]));
    station.wait_for("robot 0/1/1 detected");
    let mut stranger = std::net::TcpStream::connect(&address).unwrap();
    stranger.write_all(b"x").unwrap();
    drop(stranger);
    // Two lines of the status block later the brick is still heard.
    station.wait_for("fix accepted");
    let status = station.wait_for("fix accepted");
    assert!(!status.contains(" 0 B/s"), "{status}");
}

#[test]
fn a_terminal_that_is_gone_does_not_stop_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output = posebridge(folder.path())
        .args(["run", "--duration", "7", "--out", "run"])
        .stderr(Stdio::from(full))
        .output()
        .unwrap();
    assert!(output.status.success(), "{:?}", output.status);
    assert!(String::from_utf8_lossy(&output.stdout).contains("estimate"), "the table is there");
}

#[test]
fn an_event_file_on_a_full_disk_is_named_and_the_exit_code_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let output = posebridge(folder.path())
        .args(["run", "--duration", "3", "--out", "run", "--events", "/dev/full"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("writing the event file"));
}

/// So few events that all of them wait for the end.
#[test]
fn the_events_of_a_foreign_replay_on_a_full_disk_are_named_and_the_exit_code_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let descriptor = r#"
name = "short"
source = "written by this test"
licence = "-"
default_run = "one"
[robot]
[[runs]]
name = "one"
"#;
    let descriptor = [descriptor, WHEELS_CSV].concat();
    std::fs::write(folder.path().join("short.toml"), descriptor).unwrap();
    std::fs::write(folder.path().join("wheels.csv"), "t_s,left,right\n0,0,0\n0.1,9,9\n").unwrap();
    let replay = |events: &str| {
        posebridge(folder.path())
            .args(["replay", "short.toml", "--filter", "odometry", "--events"])
            .arg(events)
            .output()
            .unwrap()
    };
    assert!(replay("events.txt").status.success());
    let written = std::fs::metadata(folder.path().join("events.txt")).unwrap();
    assert!((1..8_000).contains(&written.len()), "{}", written.len());
    let output = replay("/dev/full");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("writing the events"));
}

#[test]
fn a_recording_that_is_there_is_never_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("run")).unwrap();
    std::fs::write(folder.path().join("run/recording.mcap"), b"precious").unwrap();
    let output = posebridge(folder.path()).args(["run", "--duration", "1", "--out", "run"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("run/recording.mcap"));
    assert_eq!(std::fs::read(folder.path().join("run/recording.mcap")).unwrap(), b"precious");
}

#[test]
fn way_points_lie_in_a_file_beside_their_scenario_and_folders_may_have_any_name() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("worlds")).unwrap();
    let scenario = "seed = 1\nsteering = \"estimate\"\n[path.waypoints]\nfile = \"triangle.csv\"\n";
    std::fs::write(folder.path().join("worlds/triangle.toml"), scenario).unwrap();
    std::fs::write(folder.path().join("worlds/triangle.csv"), "x_m,y_m\n0,0\n0.5,0\n0.25,0.3\n").unwrap();
    stdout_of(posebridge(folder.path()).args([
        "run",
        "--link",
        "sim://worlds/triangle.toml",
        "--duration",
        "4",
        "--out",
        "what?&now",
    ]));
    assert!(folder.path().join("what?&now/track.svg").exists());
    std::fs::write(folder.path().join("worlds/triangle.csv"), "0,0\n0.5,zero\n").unwrap();
    let output = posebridge(folder.path()).args(["run", "--link", "sim://worlds/triangle.toml"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("triangle.csv") && said.contains("line 2"), "{said}");
}

#[test]
fn impossible_flags_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for flags in [
        &["run", "--duration=-1"][..],
        &["run", "--duration", "nan"],
        &["run", "--until-silent", "inf"],
        &["sim", "square", "--listen", "pty:x", "--laps", "0"],
        &["run", "--laps", "0"],
        &["play", "x.toml", "--listen", "pty:x", "--speed", "0"],
        &["replay", "x.mcap", "--use-every", "4"],
    ] {
        let output = posebridge(folder.path()).args(flags).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{flags:?}");
        assert!(!output.stderr.is_empty(), "{flags:?}");
    }
}

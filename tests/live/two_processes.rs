//! Brick and station as two processes over a pseudo-terminal: kill and restart either, the other goes on.

use std::path::Path;

use crate::support::{RunningProgram, events_named, read_text};

fn brick(folder: &Path) -> RunningProgram {
    let sim = ["sim", "square", "--listen", "pty:brick.tty", "--laps", "50"];
    let mut brick = RunningProgram::posebridge(folder, &sim);
    brick.wait_for("brick up");
    brick
}

fn station(folder: &Path, name: &str) -> RunningProgram {
    let events = format!("{name}.txt");
    let run = ["run", "--link", "serial:brick.tty", "--out", name, "--events", &events];
    let mut station = RunningProgram::posebridge(folder, &run);
    station.wait_for("robot 0/1/1 detected");
    station
}

#[test]
fn a_killed_brick_comes_back_and_the_station_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let first = brick(folder.path());
    let mut station = station(folder.path(), "run");
    station.wait_for("fix accepted");
    first.kill();
    station.wait_for("link 0 DOWN");
    let _second = brick(folder.path());
    station.wait_for("robot 0/1/1 restarted");
    station.wait_for("robot 0/1/1 detected");
    station.wait_for("fix accepted");
    station.interrupt();
    let events = read_text(folder.path(), "run.txt");
    let states = events_named(&events, "link");
    assert_eq!(states.len(), 3, "one event per change of state: {states:#?}");
}

#[test]
fn a_killed_station_comes_back_and_the_brick_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let _brick = brick(folder.path());
    let mut first = station(folder.path(), "first");
    // The first line of the status block: five seconds have passed.
    first.wait_for("fix accepted");
    first.kill();
    let mut second = station(folder.path(), "second");
    second.wait_for("fix accepted");
    let table = second.interrupt();
    assert!(table.contains("camera"), "{table}");
    let events = read_text(folder.path(), "second.txt");
    let brick_s = 1e-9 * events_named(&events, "observed")[0]["robot_ns"].as_f64().unwrap();
    // Its clock began at 5 s and was not restarted with the station.
    assert!(brick_s > 9.0, "{brick_s}");
}

//! A camera program in Python feeds fixes into a running station: the script of `examples/` as it stands, three processes, real time.

use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::support::{RunningProgram, events_named, json, named, number, read_text, root, write_text};

/// A square whose robot is not quite what its brick believes, with an overhead camera of 10 Hz and a few millimetres.
const SCENARIO: &str = include_str!("../data/camera-square.toml");

/// What the script is late by: the time that a slow detector needs.
const SECONDS_LATE: &str = "0.15";

/// The script; killed when dropped.
struct CameraScript(Child);

impl Drop for CameraScript {
    fn drop(&mut self) {
        // Already gone is as good.
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// The address behind `what` in a line of several.
fn address_in(line: &str, what: &str) -> String {
    let behind = line.split(what).nth(1).expect("it was said");
    behind.split(';').next().unwrap_or(behind).trim().to_owned()
}

/// The simulated brick, where it listens, and where it offers its images.
fn brick(folder: &Path) -> (RunningProgram, String, String) {
    write_text(folder, "square.toml", SCENARIO);
    let sim = ["sim", "square.toml", "--listen", "tcp://127.0.0.1:0", "--images-listen", "tcp://127.0.0.1:0"];
    let mut brick = RunningProgram::posebridge(folder, &[&sim[..], &["--truth", "truth.csv"]].concat());
    let line = brick.wait_for("brick up");
    (brick, address_in(&line, ", listening on "), address_in(&line, "its images listening on "))
}

fn station(folder: &Path, brick: &str) -> (RunningProgram, String) {
    let config = format!(
        "[[link]]\nurl = \"tcp://{brick}\"\n\n[[link]]\nurl = \"udp://127.0.0.1:0\"\nlisten = true\nbrick = \"camera-json\"\n"
    );
    write_text(folder, "station.toml", &config);
    let run = ["run", "--config", "station.toml", "--out", "run", "--events", "events.txt"];
    let mut station = RunningProgram::posebridge(folder, &run);
    let address = station.listening_address("");
    (station, address)
}

#[test]
fn a_script_of_a_few_lines_holds_the_pose_to_three_millimetres_through_150_ms() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (mut brick, own, images) = brick(folder);
    let (station, cameras) = station(folder, &own);
    let script = root().join("examples/camera_fixes.py");
    let mut python = Command::new("python3");
    python.arg(script).args([&cameras, &images, SECONDS_LATE]).stdin(Stdio::null()).stdout(Stdio::null());
    let _script = CameraScript(python.spawn().expect("there is a Python"));
    // Until the path is driven to its end.
    brick.output();
    station.interrupt();

    let scored = json(folder, &["replay", "run/recording.mcap", "--truth", "truth.csv"]);
    let rms_mm = 1e3 * number(&scored, "/estimators/0/position_rms_m");
    let used = number(named(&scored["estimators"][0]["sources"], "camera"), "/used");
    let events = read_text(folder, "events.txt");
    let aligned = events_named(&events, "camera_clock_aligned").len();
    println!("{used} fixes, {aligned} alignments of the camera's clock; position {rms_mm:.2} mm rms");
    assert!(used > 80.0, "{used} fixes were used");
    assert!(aligned > 10, "the script answers for its time");
    assert!(rms_mm <= 3.0, "{rms_mm} mm");
    assert!(events.contains("camera `overhead` is 1/100 here"));
}

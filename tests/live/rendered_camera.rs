//! A camera that renders follows a simulated robot: pictures by HTTP, tags in them, corners to places, in one program and in real time.

use crate::support::{RunningProgram, json, named, number, write_text};

/// The robot is not quite what its brick believes; the camera is late, tilted, and blurs what moves.
const SCENARIO: &str = include_str!("../data/camera-square.toml");
const PICTURES: &str = "\n[camera.pictures]\nlatency_ms = 150\njitter_ms = 10\nline_time_us = 30\n";

#[test]
fn the_pose_stays_within_three_millimetres_by_pictures_that_are_150_ms_late() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "square.toml", &format!("{SCENARIO}{PICTURES}"));
    let run = ["run", "--link", "sim://square.toml", "--camera", "sim", "--laps", "1", "--out", "run"];
    RunningProgram::posebridge(folder, &run).output();
    // The recording holds its truth, the corners, and the camera's file.
    let scored = json(folder, &["replay", "run/recording.mcap"]);
    let rms_mm = 1e3 * number(&scored, "/estimators/0/position_rms_m");
    let camera = named(&scored["estimators"][0]["sources"], "camera");
    let used = number(camera, "/used");
    println!("{used} fixes; position {rms_mm:.2} mm rms");
    assert!(used > 200.0, "{used} fixes were used");
    assert!(rms_mm <= 3.0, "{rms_mm} mm");
}

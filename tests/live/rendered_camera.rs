//! A camera that renders follows a simulated robot: pictures by HTTP, tags in them, corners to places, in one program and in real time.

use std::path::Path;

use posebridge::config::CameraFile;
use posebridge_vision::{CameraModel, FloorView};

use crate::support::{RunningProgram, json, named, number, run, write_text};

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
    calibrate_by_the_drive(folder);
}

/// The same drive, as one that nobody knew the camera of: the sheet and the robot's tag say where it is.
fn calibrate_by_the_drive(folder: &Path) {
    let arguments =
        ["camera", "calibrate", "--drive", "run/recording.mcap", "--sheet-at", "0.395,0.35,0", "--out", "found.toml"];
    let printed = run(folder, &arguments);
    assert!(printed.contains("delay") && !printed.contains("not found"), "{printed}");
    let found = CameraFile::read(&folder.join("found.toml")).unwrap().view().unwrap();
    // The camera of the scenario: its defaults.
    let camera = CameraModel { focal_px: [600.0; 2].into(), centre_px: [319.5, 239.5].into(), radial: [-0.08, 0.02] };
    let (sine, cosine) = 30_f64.to_radians().sin_cos();
    let axes = [[1.0, 0.0, 0.0], [0.0, -cosine, -sine], [0.0, sine, -cosine]];
    let truly = FloorView::from_axes(camera, [0.5, -0.95, 2.5], axes).unwrap();
    for (x_m, y_m) in [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5), (0.25, 0.25)] {
        let pixel = truly.pixel_of([x_m, y_m, 0.085].into()).unwrap();
        let (seen, _) = found.point_at_height(pixel, 0.085).unwrap();
        let away_m = (seen.x - x_m).hypot(seen.y - y_m);
        assert!(away_m <= 0.003, "{away_m} m at ({x_m}, {y_m}): {printed}");
    }
}

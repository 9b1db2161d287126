//! From printed tags to places on the floor: calibration and detection by the program, on pictures of a drawn floor.

use std::fmt::Write as _;
use std::path::Path;

use posebridge::config::CameraFile;
use posebridge_vision::{CameraModel, FloorView, SheetTag, floor_sheet, robot_sheet, tag36h11_modules};
use serde_json::Value;

use crate::support::{exit_code_and_stderr, run};

const WIDTH: usize = 960;
const HEIGHT: usize = 540;
/// Samples of a pixel, along each side.
const SAMPLES: usize = 3;

/// At 1.6 m, tilted by 30 degrees, with barrel distortion.
fn view() -> FloorView {
    let camera = CameraModel {
        focal_px: [700.0, 700.0].into(),
        centre_px: [(WIDTH as f64 - 1.0) / 2.0, (HEIGHT as f64 - 1.0) / 2.0].into(),
        radial: [-0.2, 0.05],
    };
    // Half a turn about x looks straight down; 30 degrees more look ahead along y.
    let half = 105_f64.to_radians();
    FloorView::new(camera, [0.3, -0.5, 1.6], [half.cos(), half.sin(), 0.0, 0.0]).unwrap()
}

/// A tag in the arena: what is printed, where the printed sheet's corner lies, its turn, and the height of the tag.
struct DrawnTag {
    tag: SheetTag,
    origin_m: [f64; 2],
    turned_rad: f64,
    height_m: f64,
}

/// Whether the printed tag, or the white around it, is at a point of its plane.
fn is_white(drawn: &DrawnTag, x_m: f64, y_m: f64) -> Option<bool> {
    let (dx, dy) = (x_m - drawn.origin_m[0], y_m - drawn.origin_m[1]);
    let (sine, cosine) = drawn.turned_rad.sin_cos();
    let (right, up) = (cosine * dx + sine * dy, cosine * dy - sine * dx);
    let module_m = drawn.tag.side_m / 8.0;
    let column = ((right - drawn.tag.middle_m.x) / module_m + 5.0).floor();
    let row = (5.0 - (up - drawn.tag.middle_m.y) / module_m).floor();
    let inside = (0.0..10.0).contains(&column) && (0.0..10.0).contains(&row);
    inside.then(|| tag36h11_modules(drawn.tag.id).unwrap()[row as usize][column as usize])
}

fn picture(folder: &Path, name: &str, tags: &[DrawnTag]) {
    let view = view();
    let mut pixels = format!("P5 {WIDTH} {HEIGHT} 255\n").into_bytes();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let mut sum = 0;
            for sample in 0..SAMPLES * SAMPLES {
                let part = |of: usize| (of as f64 + 0.5) / SAMPLES as f64 - 0.5;
                let pixel = [x as f64 + part(sample % SAMPLES), y as f64 + part(sample / SAMPLES)];
                let grey = tags.iter().find_map(|drawn| {
                    let (at, _) = view.point_at_height(pixel.into(), drawn.height_m)?;
                    is_white(drawn, at.x, at.y)
                });
                sum += match grey {
                    Some(true) => 210,
                    Some(false) => 25,
                    None => 110,
                };
            }
            pixels.push((sum / (SAMPLES * SAMPLES)) as u8);
        }
    }
    std::fs::write(folder.join(name), pixels).unwrap();
}

fn sheet_at(origin_m: [f64; 2], turned_rad: f64) -> Vec<DrawnTag> {
    let tags = floor_sheet(580).unwrap().into_iter();
    tags.map(|tag| DrawnTag { tag, origin_m, turned_rad, height_m: 0.0 }).collect()
}

#[test]
fn a_printed_sheet_and_two_pictures_show_where_a_robot_is_within_three_millimetres() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The tag in the middle of its sheet lies at (0.5, 0.6), 85 mm above the floor.
    let (heading, at_m, height_m) = (0.7_f64, [0.4, 0.5], 0.085);
    let tag = robot_sheet(3, 0.08).unwrap();
    // Its way up is a quarter turn from the sheet's short side.
    let turned_rad = heading - std::f64::consts::FRAC_PI_2;
    let (sine, cosine) = turned_rad.sin_cos();
    let middle = tag.middle_m;
    let origin_m = [at_m[0] - cosine * middle.x + sine * middle.y, at_m[1] - sine * middle.x - cosine * middle.y];
    picture(folder, "first.pgm", &sheet_at([0.0, 0.0], 0.0));
    picture(folder, "second.pgm", &sheet_at([-0.2, 0.6], 0.4));
    picture(folder, "robot.pgm", &[DrawnTag { tag, origin_m, turned_rad, height_m }]);
    let mut places = String::new();
    write!(places, "-0.2,0.6,{}", 0.4_f64.to_degrees()).unwrap();
    let calibrated = run(
        folder,
        &[
            "camera",
            "calibrate",
            "first.pgm",
            "second.pgm",
            "--sheet-at",
            "0,0,0",
            "--sheet-at",
            &places,
            "--out",
            "overhead.toml",
        ],
    );
    assert!(calibrated.contains("32 corners"), "{calibrated}");
    // The sheets lie in the middle.
    assert!(calibrated.contains("known badly") && calibrated.contains("upper left"), "{calibrated}");
    let shown = run(
        folder,
        &[
            "camera",
            "detect",
            "robot.pgm",
            "--camera",
            "overhead.toml",
            "--side-mm",
            "80",
            "--height-mm",
            "85",
            "--json",
        ],
    );
    let shown: Value = serde_json::from_str(&shown).unwrap();
    let found = &shown["pictures"][0]["tags"][0];
    let number = |key: &str| found[key].as_f64().unwrap();
    assert_eq!(found["id"], 3);
    let away_m = (number("x_m") - at_m[0]).hypot(number("y_m") - at_m[1]);
    assert!(away_m < 0.003, "{away_m} m away: {found}");
    assert!((number("heading_rad") - heading).abs() < 0.01, "{found}");
    assert!((number("side_ratio") - 1.0).abs() < 0.01, "{found}");
}

#[test]
fn measured_marks_calibrate_and_a_mistyped_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let marks: [[f64; 2]; 8] =
        [[-0.2, 0.0], [0.8, 0.0], [0.8, 0.9], [-0.2, 0.9], [0.3, 0.4], [0.1, 0.6], [0.6, 0.3], [0.4, 0.8]];
    let table = |slip_m: f64| {
        let rows = marks.iter().enumerate().map(|(index, [x_m, y_m])| {
            let pixel = view().pixel_of([*x_m, *y_m, 0.0].into()).unwrap();
            let x_m = if index == 4 { x_m + slip_m } else { *x_m };
            format!("{:.2},{:.2},{x_m},{y_m}\n", pixel.x, pixel.y)
        });
        "u,v,x_m,y_m\n".to_owned() + &rows.collect::<String>()
    };
    std::fs::write(folder.join("marks.csv"), table(0.0)).unwrap();
    std::fs::write(folder.join("wrong.csv"), table(0.1)).unwrap();
    let size = format!("{WIDTH}x{HEIGHT}");
    let calibrate = |file: &str| run(folder, &["camera", "calibrate", "--points", file, "--picture-px", &size]);
    let right = calibrate("marks.csv");
    assert!(right.contains("8 corners") && !right.contains("mistyped"), "{right}");
    let found = CameraFile::read(&folder.join("camera.toml")).unwrap().view().unwrap();
    for [x_m, y_m] in marks {
        let (seen, _) = found.point_at_height(view().pixel_of([x_m, y_m, 0.0].into()).unwrap(), 0.0).unwrap();
        assert!((seen.x - x_m).hypot(seen.y - y_m) < 0.002, "{seen}");
    }
    let wrong = calibrate("wrong.csv");
    assert!(wrong.contains("without point 5") && wrong.contains("mistyped"), "{wrong}");
}

#[test]
fn a_picture_that_cannot_calibrate_is_named_with_the_cure() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    picture(folder, "empty.pgm", &[]);
    std::fs::write(folder.join("note.txt"), "no picture").unwrap();
    for (arguments, words) in [
        (&["empty.pgm"][..], "shows no tag of the floor sheet (580 to 583)"),
        (&["note.txt"], "neither a JPEG nor a PNG nor a PGM"),
        (&["empty.pgm", "--ruler-mm", "10"], "--ruler-mm 10"),
        (&["empty.pgm", "--sheet-at", "1,2"], "three numbers"),
        (&["empty.pgm", "--sheet-at", "0,0,0", "--sheet-at", "1,0,0"], "given 2 times for 1 pictures"),
    ] {
        let arguments = [&["camera", "calibrate"], arguments].concat();
        let (code, error) = exit_code_and_stderr(folder, &arguments);
        assert!(code != Some(0) && error.contains(words), "{arguments:?}: {error}");
        assert!(!folder.join("camera.toml").exists());
    }
}

//! `replay --smooth`: the path in hindsight beside the filters, on a robot whose drive is known by hand.

use std::fmt::Write as _;

use crate::support::{WHEELS_CSV, json, number, read_text, run, write_text};

/// Straight along x at 0.1 m/s for 20 s: a tick is a millimetre, the camera looks once a second and every second fix is withheld.
const DESCRIPTOR: &str = include_str!("../data/by-hand.toml");

const FIXES: &str = r#"
[[fixes]]
file = "camera"
x = { column = "x_m" }
y = { column = "y_m" }
use_every = 2
"#;

/// The start that it is told is 50 mm beside the true one, and said to be good to 100 mm.
const START: &str = r"
[start]
x_m = 0.0
y_m = 0.05
heading_deg = 0.0
position_sigma_m = 0.1
heading_sigma_rad = 0.1
";

/// The descriptor and its data in a folder; one of the fixes is half a metre off.
fn recording() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut wheels = "t_s,left,right,wall_m\n".to_owned();
    for tenth in 0..=200 {
        let (t_s, ticks) = (f64::from(tenth) / 10.0, tenth * 10);
        writeln!(wheels, "{t_s},{ticks},{ticks},{}", 3.0 - t_s * 0.1).unwrap();
    }
    let mut camera = "t_s,x_m,y_m\n".to_owned();
    for second in 0..=20 {
        let y_m = if second == 10 { 0.5 } else { 0.0 };
        writeln!(camera, "{second},{},{y_m}", f64::from(second) * 0.1).unwrap();
    }
    write_text(folder.path(), "wheels.csv", &wheels);
    write_text(folder.path(), "camera.csv", &camera);
    write_text(folder.path(), "by-hand.toml", &[DESCRIPTOR, FIXES, START, WHEELS_CSV].concat());
    folder
}

#[test]
fn in_hindsight_the_start_is_known_and_the_outlier_left_out() {
    let folder = recording();
    let folder = folder.path();
    let report = json(folder, &["replay", "by-hand.toml", "--filter", "pose", "--smooth"]);
    let smooth = &report["smooth"]["straight"];
    // Of 21 fixes every second one is used, among them the one at 10 s.
    assert_eq!((&smooth["fixes_used"], &smooth["fixes_left_out"]), (&10.into(), &1.into()), "{smooth}");
    assert!(smooth["reason"].is_null());
    assert!(number(smooth, "/iterations") > 0.0 && number(smooth, "/seconds") > 0.0);
    assert_eq!((&smooth["converged"], smooth["not_read"].as_object().unwrap().len()), (&true.into(), 0));
    let sigma = |learned: &serde_json::Value, key: &str| number(&learned[key], "/sigma");
    let learned = &smooth["calibration"];
    assert!(sigma(learned, "radius_scale") > 0.0 && sigma(learned, "beacon_offset_m") == 0.0, "{learned}");
    // The withheld fixes are exact. A filter must begin where it is told; the path knows better.
    let rms_m = number(smooth, "/position_rms_m");
    assert!(rms_m < 0.001, "{rms_m}");
    assert!(number(smooth, "/position_max_m") < 0.002);
    assert!(smooth["heading_rms_rad"].is_null(), "no heading withheld");
    assert!(rms_m < number(&report, "/estimators/0/position_rms_m"));

    let table = run(folder, &["replay", "by-hand.toml", "--smooth", "--figure", "track.svg"]);
    let row = table.lines().find(|line| line.starts_with("straight  "));
    let cells: Vec<&str> = row.unwrap().split_whitespace().collect();
    assert_eq!(cells[4..6], ["10", "1"], "{table}");
    assert!(read_text(folder, "track.svg").contains("smoothed path"));
    assert!(!run(folder, &["replay", "by-hand.toml"]).contains("smooth"), "not asked for");

    let lagged = json(folder, &["replay", "by-hand.toml", "--filter", "pose", "--fixed-lag", "1000"]);
    let lagged = number(&lagged["fixed_lag"]["straight"], "/position_rms_m");
    assert!(lagged < number(&report, "/estimators/0/position_rms_m"), "{lagged}");
    run(folder, &["export", "by-hand.toml", "--format", "csv,tum", "--smooth", "--fixed-lag", "0"]);
    let [smooth, estimate, now] =
        ["smooth", "estimate", "fixed-lag"].map(|name| read_text(folder, &format!("{name}.tum")));
    assert_eq!(smooth.lines().count(), estimate.lines().count());
    let start = |text: &str| text.lines().next().unwrap().split(' ').nth(2).unwrap().parse::<f64>().unwrap();
    assert!(start(&smooth).abs() < 0.5 * start(&now).abs(), "{smooth}{now}");
    let csv = read_text(folder, "smooth.csv");
    assert!(csv.starts_with("t_s,x_m,y_m,heading_rad,var_x_m2,") && csv.lines().count() > 200);
}

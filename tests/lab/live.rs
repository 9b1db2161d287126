//! The experiments of the lab on a real robot: recordings of ours, and a live robot over a real link, with the real program.

use std::fmt::Write as _;
use std::path::Path;

use crate::support::{
    RunningProgram, assert_refused, descriptor, exit_code_and_stderr, json, listening_brick, named, number, read_text,
    run, write_text,
};
use posebridge::config::Config;
use posebridge_recording::container::{FORMAT, RecordingHeader, RecordingWriter};
use posebridge_sim::montecarlo::{Camera, Drive, Scenario};
use posebridge_telemetry::{Input, Meters, Observation, ObservationKind, SensorId, TimeDelta, Timestamp};
use serde_json::Value;

fn lab(folder: &Path, args: &[&str]) -> Value {
    json(folder, &[&["lab"], args].concat())
}

/// A recording that holds these observations, as the station would have recorded them behind its decoder.
fn record(path: &Path, observations: &[Observation]) {
    let config_toml = toml::to_string(&Config::default()).unwrap();
    let header = RecordingHeader { format: FORMAT, config_toml, ..RecordingHeader::default() };
    let mut writer = RecordingWriter::create(std::fs::File::create(path).unwrap(), &header).unwrap();
    let mut now = Timestamp::ZERO;
    for observation in observations {
        // A late fix arrives behind what is newer.
        now = now.max(Timestamp::from_nanos(observation.stamp.as_nanos()));
        writer.record(now, &Input::Observation(*observation)).unwrap();
    }
    writer.finish().unwrap();
}

fn arrived(drive: &Drive) -> Vec<Observation> {
    drive.arrivals.iter().map(|arrival| arrival.observation).collect()
}

/// Two drives of paper 1's square under a camera of 10 Hz.
fn squares(folder: &Path) {
    let mut scenario = Scenario::bundled("paper-square").unwrap().with_seed(2);
    let camera = Scenario::bundled("camera-10hz").unwrap().camera.unwrap();
    scenario.camera = Some(Camera { delay_steps: 2, delay_spread_steps: 0, ..camera });
    for run in 0..2 {
        let path = folder.join(format!("drive-{run}.mcap"));
        record(&path, &arrived(&scenario.drive(run)));
    }
}

#[test]
fn a_recorded_square_is_judged_by_images_as_the_simulated_one_is_by_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    squares(folder);
    let found = lab(folder, &["nxt-square", "--recording", "drive-0.mcap", "drive-1.mcap"]);
    assert_eq!(found["recordings"].as_array().unwrap().len(), 2);
    let truth = lab(folder, &["nxt-square", "--runs", "2", "--seed", "2", "--out", "drawn"]);
    let rms_m = |chain: &Value, name: &str| number(named(&chain["methods"], name), "/position_rms_m");
    for name in ["raw encoders", "wheel-kf, angles", "ekf5"] {
        let [seen, true_rms] = [&found, &truth].map(|report| rms_m(&report["settings"][0], name));
        println!("{name}: by images {seen:.4} m, by the truth {true_rms:.4} m");
        // What is added is the images' noise of 5 mm and that of the start, which is the mean of 20 of them: 0.2 degrees on 1.4 m.
        assert!((seen - true_rms).abs() < 0.005, "{name}");
    }
    // The filters with a camera hear one image in ten, and the others say that it helps.
    let with_camera = rms_m(&found["outlook"], "pose: and camera");
    assert!(with_camera < 0.6 * rms_m(&found["settings"][0], "raw encoders"));
    assert!(found["stop"]["gyro_deg2_per_s2"].is_f64());
    let page = read_text(folder, "lab-nxt-square.html");
    assert!(page.contains("drive-1.mcap") && page.contains("with an image"));
    // Of the wheels alone a closed path says only where it ended.
    let closed = lab(folder, &["nxt-square", "--recording", "drive-0.mcap", "--judge", "start"]);
    let raw = &closed["settings"][0]["methods"][0];
    assert_eq!(raw["position_rms_m"], raw["position_end_m"]);
    assert!(raw["heading_rms_rad"].is_null());
    assert!(closed["source"].as_str().unwrap().contains("the start"));
    // The same drives, as the experiment of paper 4 takes them.
    let indirect = lab(folder, &["indirect", "--recording", "drive-0.mcap", "drive-1.mcap"]);
    assert_eq!((&indirect["runs"], indirect["rows"].as_array().unwrap().len()), (&2.into(), 5));
    let page = read_text(folder, "lab-indirect.html");
    assert!(page.contains("drive-1.mcap") && page.matches("<img ").count() == 3);
    // Its page has the command that gives it again.
    let command = "posebridge lab nxt-square --recording drive-0.mcap --judge start";
    assert!(read_text(folder, "lab-nxt-square.html").contains(command));
}

fn range(millis: i64, range_m: f64) -> Observation {
    Observation {
        sensor: SensorId::RANGE,
        stamp: Timestamp::from_nanos(millis * 1_000_000),
        stamp_sigma: TimeDelta::ZERO,
        measurement: ObservationKind::WallRange(Meters(range_m)),
    }
}

/// A car of 1.5 m/s and 0.6 s from 3 m; somebody walks by in the 20th reading.
fn approach() -> Vec<Observation> {
    let readings = (0..25_u8).map(|index| {
        let t_s = 0.08 * f64::from(index);
        let way_m = 1.5 * (t_s - 0.6 * (1.0 - (-t_s / 0.6).exp()));
        // Noise that repeats: 0, 12, -12 mm.
        let noise_m = [0.0, 0.012, -0.012][usize::from(index % 3)];
        let walks_by = if index == 20 { -0.9 } else { 0.0 };
        range(80 * i64::from(index), 3.0 - way_m + noise_m + walks_by)
    });
    readings.collect()
}

#[test]
fn a_recorded_approach_is_foretold_better_than_by_a_line_and_its_gate_refuses_who_walks_by() {
    let folder = tempfile::tempdir().unwrap();
    record(&folder.path().join("wall.mcap"), &approach());
    let found = lab(folder.path(), &["wall", "--recording", "wall.mcap"]);
    let run = &found["runs"][0];
    assert_eq!((&run["readings"], &run["input"]), (&25.into(), &"assumed".into()));
    println!("{}, {}", run["against_line"], run["gate"]);
    let [filter_m, line_m] = ["filter", "other"].map(|of| number(run, &format!("/against_line/{of}_rms_m")));
    assert!(filter_m < 0.9 * line_m, "{filter_m} {line_m}");
    assert_eq!(run["gate"]["refused"], 1);
    let refused = run["foreseen"].as_array().unwrap().iter().find(|one| one["refused"] == true);
    assert!((number(refused.unwrap(), "/at_s") - 1.6).abs() < 1e-9, "{refused:?}");
}

#[test]
fn what_a_recording_lacks_is_named_with_the_file_and_a_cure() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    squares(folder);
    record(&folder.join("wall.mcap"), &approach());
    record(&folder.join("silent.mcap"), &[]);
    write_text(folder, "empty.mcap", "");
    let whole = std::fs::read(folder.join("drive-0.mcap")).unwrap();
    std::fs::write(folder.join("torn.mcap"), &whole[..200]).unwrap();
    let drive = Scenario::bundled("paper-square").unwrap().drive(0);
    let wheels: Vec<Observation> = arrived(&drive).into_iter().filter(|one| one.sensor == SensorId::WHEELS).collect();
    record(&folder.join("wheels.mcap"), &wheels);
    record(&folder.join("still.mcap"), &wheels[..20]);
    assert_refused(
        folder,
        &[
            ("lab nxt-square --recording none.mcap", 2, &["none.mcap", "reading"]),
            ("lab nxt-square --recording empty.mcap", 2, &["`empty.mcap` (0 bytes)", "not an MCAP file"]),
            ("lab indirect --recording torn.mcap", 2, &["`torn.mcap`", "without a posebridge header"]),
            ("lab wall --recording silent.mcap", 2, &["`silent.mcap` holds nothing", "doctor"]),
            // One bad recording among good ones is the one that is named.
            (
                "lab nxt-square --recording drive-0.mcap wall.mcap",
                2,
                &["`wall.mcap`", "let the robot send WHEEL_TICKS"],
            ),
            ("lab indirect --recording wall.mcap", 2, &["`wall.mcap`", "no wheel ticks"]),
            ("lab indirect --recording wheels.mcap", 2, &["`wheels.mcap` holds no accelerations", "INERTIAL"]),
            ("lab wall --recording wheels.mcap", 2, &["`wheels.mcap` holds no range", "DISTANCE_SENSOR"]),
            ("lab nxt-square --recording still.mcap", 2, &["`still.mcap`", "20 readings"]),
            ("lab nxt-square --recording wheels.mcap --judge fixes", 2, &["`wheels.mcap`", "--judge start"]),
            ("lab nxt-square --recording wheels.mcap --set robot.track=1", 2, &["robot.track", "--set"]),
            ("lab wall --recording wall.mcap --run x", 2, &["`wall.mcap`", "--run"]),
        ],
    );
    // A recording that was cut off is used as far as it goes.
    std::fs::write(folder.join("cut.mcap"), &whole[..whole.len() / 2]).unwrap();
    let (code, stderr) = exit_code_and_stderr(folder, &["lab", "nxt-square", "--recording", "cut.mcap"]);
    assert!(code == Some(0) && stderr.contains("cut.mcap: cut off at byte"), "{stderr}");
}

#[test]
fn a_recording_of_a_live_robot_is_never_made_twice() {
    let folder = tempfile::tempdir().unwrap();
    write_text(folder.path(), "live.mcap", "mine");
    for command in [
        "lab wall",
        "lab nxt-square",
        "lab indirect",
        "lab thermometer",
        "identify rest",
        "identify straight",
        "identify delay",
        "calibrate umbmark",
        "calibrate path",
        "calibrate rest",
    ] {
        let command = format!("{command} --link tcp://127.0.0.1:9");
        assert_refused(folder.path(), &[(&command, 2, &["live.mcap` is there already", "--out"])]);
    }
    assert_eq!(read_text(folder.path(), "live.mcap"), "mine");
}

/// A square of 0.3 m after a second and a half at rest; its brick runs 2000 ppm fast.
const SMALL_SQUARE: &str = include_str!("../data/lab/small-square.toml");

#[test]
fn a_live_square_is_recorded_and_its_recording_says_the_same_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (_brick, url) = listening_brick(folder, SMALL_SQUARE);
    let live = ["lab", "nxt-square", "--link", &url, "--duration", "4", "--out", "out", "--json"];
    let mut station = RunningProgram::posebridge(folder, &live);
    let told = station.wait_for("recording `out/live.mcap`");
    assert!(told.contains("drive the square") && told.contains("4 s"), "{told}");
    station.wait_for("robot 0/1/1 detected");
    let found: Value = serde_json::from_str(&station.output()).unwrap();
    assert!(number(&found, "/settings/0/methods/0/position_rms_m") < 0.2);
    assert_eq!(found["recordings"][0], "out/live.mcap");
    assert!(folder.join("out/lab-nxt-square-3.svg").exists());
    assert_eq!(lab(folder, &["nxt-square", "--recording", "out/live.mcap", "--out", "again"]), found);
    // The live page tells how to have it without the robot.
    let page = read_text(folder, "out/lab-nxt-square.html");
    assert!(page.contains("posebridge lab nxt-square --recording out/live.mcap"));
    assert!(run(folder, &["replay", "out/live.mcap", "--verbose"]).contains("wheels"));
}

#[test]
fn a_live_car_that_calls_the_station_is_foretold_until_somebody_says_stop() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut text = "t_ms,tof_mm\n".to_owned();
    for one in approach() {
        if let ObservationKind::WallRange(range) = one.measurement {
            writeln!(text, "{},{:.0}", one.stamp.as_nanos() / 1_000_000, 1e3 * range.0).unwrap();
        }
    }
    write_text(folder, "approach.csv", &text);
    let tof_wall = std::fs::read_to_string(descriptor("tof-wall.toml")).unwrap();
    let robot = tof_wall.split("[[runs]]").next().unwrap().replace("robotA-80-step", "approach");
    let streams = "[[runs]]\nname = \"approach\"\n\n[files.log]\npath = \"approach.csv\"\nheader_lines = 1\n\
        time = { column = \"t_ms\", unit = \"ms\" }\n\n[[wall_range]]\nfile = \"log\"\n\
        range = { column = \"tof_mm\", unit = \"mm\" }\n";
    write_text(folder, "car.toml", &(robot + streams));
    let live = ["lab", "wall", "--listen", "tcp://127.0.0.1:0", "--out", "out", "--json"];
    let mut station = RunningProgram::posebridge(folder, &live);
    let told = station.wait_for("recording `out/live.mcap`");
    assert!(told.contains("at the wall") && told.contains("Ctrl-C"), "{told}");
    let url = format!("tcp://{}", station.listening_address(""));
    run(folder, &["play", "car.toml", "--link", &url]);
    let found: Value = serde_json::from_str(&station.interrupt()).unwrap();
    let run = &found["runs"][0];
    println!("{} readings, {}", run["readings"], run["against_line"]);
    assert!(number(run, "/readings") >= 20.0, "{run}");
    assert!(folder.join("out/lab-wall.html").exists());
}

/// A straight drive whose stamps are each but the first told twice, and now and then exchanged.
#[test]
fn the_noise_of_a_straight_drive_does_not_hang_on_the_order_of_arrival() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = include_str!("../../src/lab/identify/scenarios/straight.toml");
    let wheels = arrived(&Scenario::from_toml(text).unwrap().drive(0));
    record(&folder.join("ordered.mcap"), &wheels);
    let mut mixed = wheels.clone();
    for index in (10..wheels.len() - 1).step_by(50) {
        mixed.swap(index, index + 1);
    }
    mixed.insert(40, mixed[39]);
    record(&folder.join("mixed.mcap"), &mixed);
    let [ordered, mixed] = ["ordered.mcap", "mixed.mcap"]
        .map(|name| json(folder, &["identify", "straight", "--recording", name])["quantities"].clone());
    assert_eq!(mixed, ordered);
}

//! The experiments of the lab on a real robot: recordings of ours, and a live robot over a real link, with the real program.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::fmt::Write as _;
use std::path::Path;

use posebridge::config::Config;
use posebridge_recording::container::{FORMAT, RecordingHeader, RecordingWriter};
use posebridge_sim::frame_accelerometers::FrameAccelerometers;
use posebridge_sim::montecarlo::{Camera, CameraSees, Drive, FilterPrior, Scenario};
use posebridge_telemetry::{
    Arena, Fix, Input, Meters, Observation, ObservationKind, Point2, Pose, SensorId, TimeDelta, Timestamp,
};
use serde_json::Value;

use support::{RunningProgram, listening_brick, posebridge, root, stdout_of};

fn lab(folder: &Path, args: &[&str]) -> Value {
    let text = stdout_of(posebridge(folder).arg("lab").args(args).arg("--json"));
    serde_json::from_str(&text).unwrap()
}

/// What the program says when it cannot start.
fn refusal(folder: &Path, args: &[&str]) -> String {
    let output = posebridge(folder).arg("lab").args(args).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
    said
}

/// A recording that holds these observations, as the station would have recorded them behind its decoder.
fn record(path: &Path, observations: &[Observation]) {
    record_with(&Config::default(), path, observations);
}

/// The same with another configuration.
fn record_with(config: &Config, path: &Path, observations: &[Observation]) {
    let header = RecordingHeader {
        format: FORMAT,
        program_version: "0".to_owned(),
        utc_start_micros: 0,
        config_toml: toml::to_string(config).unwrap(),
        links: Vec::new(),
    };
    let file = std::fs::File::create(path).unwrap();
    let mut writer = RecordingWriter::create(file, &header).unwrap();
    let mut now = Timestamp::ZERO;
    for observation in observations {
        // A late fix arrives behind what is newer.
        now = now.max(Timestamp::from_nanos(observation.stamp.as_nanos()));
        writer.record(now, &Input::Observation(*observation)).unwrap();
    }
    writer.finish().unwrap();
}

fn arrived(drive: &Drive) -> Vec<Observation> {
    let arrivals = drive.arrivals.iter();
    arrivals.map(|arrival| arrival.observation).collect()
}

fn rms_m(report: &Value, chain: &Value, name: &str) -> f64 {
    let mut methods = chain["methods"].as_array().unwrap().iter();
    let method = methods.find(|method| method["name"] == name);
    let method = method.unwrap_or_else(|| panic!("{name} in {report}"));
    method["position_rms_m"].as_f64().unwrap()
}

/// Two drives of paper 1's square under a camera of 10 Hz with these errors.
fn squares(folder: &Path) {
    let mut scenario = Scenario::bundled("paper-square").unwrap().with_seed(2);
    scenario.camera = Some(Camera {
        sees: CameraSees::Pose,
        every_steps: 2,
        delay_steps: 2,
        delay_spread_steps: 0,
        position_sigma_m: 0.005,
        heading_sigma_deg: 1.0,
        true_noise_factor: 1.0,
        outliers: None,
        blackout: None,
    });
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
    let args = ["nxt-square", "--recording", "drive-0.mcap", "drive-1.mcap"];
    let found = lab(folder, &args);
    assert_eq!(found["recordings"].as_array().unwrap().len(), 2);
    let drawn = ["nxt-square", "--runs", "2", "--seed", "2", "--out", "drawn"];
    let truth = lab(folder, &drawn);
    let of = |report: &Value, name: &str| {
        let outlook = name.starts_with("pose") || name.ends_with("camera");
        let chain = if outlook { &report["outlook"] } else { &report["settings"][0] };
        rms_m(report, chain, name)
    };
    for name in ["raw encoders", "wheel-kf", "ekf5"] {
        let (seen, true_rms) = (of(&found, name), of(&truth, name));
        println!("{name}: by images {seen:.4} m, by the truth {true_rms:.4} m");
        // What is added is the images' noise of 5 mm and that of the start, which is the mean of 20 of them: 0.2 degrees on 1.4 m.
        assert!((seen - true_rms).abs() < 0.005, "{name}");
    }
    // The filters with a camera hear one image in ten, and the others say that it helps.
    assert!(of(&found, "pose: and camera") < 0.6 * of(&found, "raw encoders"));
    assert!(found["stop"]["gyro_deg2_per_s2"].is_f64());
    let page = std::fs::read_to_string(folder.join("lab-nxt-square.html")).unwrap();
    assert!(page.contains("drive-1.mcap") && page.contains("with an image"));
    // Of the wheels alone a closed path says only where it ended.
    let closed = ["nxt-square", "--recording", "drive-0.mcap", "--judge", "start"];
    let closed = lab(folder, &closed);
    let raw = &closed["settings"][0]["methods"][0];
    assert_eq!(raw["position_rms_m"], raw["position_end_m"]);
    assert!(raw["heading_rms_rad"].is_null());
    assert!(closed["source"].as_str().unwrap().contains("the start"));
    // Its page has the command that gives it again.
    let page = std::fs::read_to_string(folder.join("lab-nxt-square.html")).unwrap();
    let command = "posebridge lab nxt-square --recording drive-0.mcap --judge start";
    assert!(page.contains(command));
}

/// A fix without noise, as somebody with a tape measure would give it.
fn measured(stamp: Timestamp<posebridge_telemetry::BrickClock>, pose: Pose<Arena>) -> Observation {
    Observation {
        sensor: SensorId::CAMERA,
        stamp,
        stamp_sigma: TimeDelta::ZERO,
        measurement: ObservationKind::Fix(Fix {
            position: Point2::new(pose.x, pose.y),
            heading: Some(pose.heading),
            covariance: None,
            tag_in_body: Point2::ORIGIN,
            reset_counter: 0,
        }),
    }
}

/// What the experiment tells its filters, as the configuration of a station.
fn config_with(prior: &FilterPrior) -> Config {
    let mut config = Config::default();
    let (noise, known) = (&mut config.robot.noise, &prior.noise);
    noise.wheel_travel_m_per_sqrt_m = known.wheel_travel_m_per_sqrt_m;
    noise.travel_m_per_sqrt_m = known.travel_m_per_sqrt_m;
    noise.turn_rad_per_sqrt_rad = known.turn_rad_per_sqrt_rad;
    noise.heading_rad_per_sqrt_m = known.heading_rad_per_sqrt_m;
    noise.accelerometer_m_per_s2 = known.accelerometer_m_per_s2;
    noise.gyro_rad_per_s = known.gyro_rad_per_s;
    noise.gyro_resolution_rad_per_s = known.gyro_resolution_rad_per_s;
    noise.gyro_bias_rad_per_s = known.gyro_bias_rad_per_s;
    noise.gyro_bias_walk_rad_per_s_sqrt_s = known.gyro_bias_walk_rad_per_s_sqrt_s;
    // The tape is exact.
    noise.fix_position_m = prior.start_position_sigma_m;
    noise.fix_heading_rad = prior.start_heading_sigma_rad;
    let (calibration, known) = (&mut config.robot.calibration, &prior.calibration);
    calibration.radius_scale = known.radius_scale.into();
    calibration.radius_difference = known.radius_difference.into();
    calibration.track_scale = known.track_scale.into();
    config
}

/// Rounds of paper 4's square as the experiment itself draws them, measured at both ends.
fn rounds(folder: &Path, count: u32) -> Vec<String> {
    let text = std::fs::read_to_string(root().join("config/scenarios/lab/indirect.toml")).unwrap();
    let scenario = Scenario::from_toml(&text).unwrap();
    let names = (0..count).map(|run| {
        let drive = scenario.drive(run);
        let accelerometers = FrameAccelerometers {
            sigma_m_per_s2: scenario.accelerometer.unwrap().sigma_m_per_s2,
            bias_sigma_m_per_s2: 0.05,
            spacing: drive.prior.geometry.track_width,
        };
        let drive = accelerometers.add_to(drive, scenario.seed, run);
        let last = drive.truth.len() - 1;
        let mut observations = vec![measured(drive.time_at(0), drive.truth[0])];
        observations.extend(arrived(&drive));
        observations.push(measured(drive.time_at(last), drive.truth[last]));
        let name = format!("round-{run}.mcap");
        record_with(&config_with(&drive.prior), &folder.join(&name), &observations);
        name
    });
    names.collect()
}

#[test]
fn recorded_rounds_end_where_the_experiment_says_and_accelerometers_help() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let names = rounds(folder, 20);
    let mut args = vec!["indirect", "--recording"];
    args.extend(names.iter().map(String::as_str));
    let found = lab(folder, &args);
    let drawn = ["indirect", "--runs", "20", "--out", "drawn"];
    let simulated = lab(folder, &drawn);
    assert_eq!((&found["runs"], &simulated["runs"]), (&20.into(), &20.into()));
    let rows = found["rows"].as_array().unwrap();
    let others = simulated["rows"].as_array().unwrap();
    assert_eq!((rows.len(), others.len()), (5, 5));
    for (row, other) in rows.iter().zip(others) {
        let of = |row: &Value| ["rms_x_m", "rms_y_m", "median_m", "anees"].map(|key| row[key].as_f64().unwrap());
        let (recorded, drawn) = (of(row), of(other));
        println!("{} {}: {recorded:.3?}, drawn {drawn:.3?}", row["filter"], row["sensors"]);
        // The zero that the accelerometers got at rest is one that the filter would have found by itself.
        for (recorded, drawn) in recorded.iter().zip(&drawn) {
            assert!((recorded - drawn).abs() < 1e-3, "{row}");
        }
        assert_eq!(row["runs"], 20);
    }
    let back = &rows[2];
    assert!(back["median_m"].as_f64() < rows[0]["median_m"].as_f64());
    assert!(back["nearer_than_wheels"].as_u64().unwrap() >= 12);
    let page = std::fs::read_to_string(folder.join("lab-indirect.html")).unwrap();
    assert!(page.contains("round-19.mcap") && page.matches("<img ").count() == 2);
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
    let folder = folder.path();
    record(&folder.join("wall.mcap"), &approach());
    let found = lab(folder, &["wall", "--recording", "wall.mcap"]);
    let run = &found["runs"][0];
    assert_eq!((&run["readings"], &run["input"]), (&25.into(), &"assumed".into()));
    let score = &run["against_line"];
    println!("{score}, {}", run["gate"]);
    assert!(score["filter_rms_m"].as_f64().unwrap() < 0.9 * score["other_rms_m"].as_f64().unwrap());
    assert_eq!(run["gate"]["refused"], 1);
    let refused = run["foreseen"].as_array().unwrap().iter();
    let refused: Vec<f64> =
        refused.filter(|one| one["refused"] == true).map(|one| one["at_s"].as_f64().unwrap()).collect();
    assert!((refused[0] - 1.6).abs() < 1e-9, "{refused:?}");
}

/// A command, then what it must say of the file and of the cure.
const LACKS: [(&str, [&str; 2]); 12] = [
    ("nxt-square --recording none.mcap", ["none.mcap", "reading"]),
    ("nxt-square --recording empty.mcap", ["`empty.mcap` (0 bytes)", "not an MCAP file"]),
    ("indirect --recording torn.mcap", ["`torn.mcap`", "without a posebridge header"]),
    ("wall --recording silent.mcap", ["`silent.mcap` holds no observation", "doctor"]),
    ("nxt-square --recording wall.mcap", ["`wall.mcap`", "let the robot send WHEEL_TICKS"]),
    ("indirect --recording wall.mcap", ["`wall.mcap`", "no wheel ticks"]),
    ("indirect --recording wheels.mcap", ["`wheels.mcap` holds no accelerations", "INERTIAL"]),
    ("wall --recording wheels.mcap", ["`wheels.mcap` holds no range", "DISTANCE_SENSOR"]),
    ("nxt-square --recording still.mcap", ["`still.mcap`", "20 readings"]),
    ("nxt-square --recording wheels.mcap --judge fixes", ["`wheels.mcap`", "--judge start"]),
    ("nxt-square --recording wheels.mcap --set robot.track=1", ["robot.track", "--set"]),
    ("wall --recording wall.mcap --run x", ["`wall.mcap`", "--run"]),
];

/// Recordings that each lack something; gives the bytes of a whole one.
fn sick_recordings(folder: &Path) -> Vec<u8> {
    squares(folder);
    record(&folder.join("wall.mcap"), &approach());
    record(&folder.join("silent.mcap"), &[]);
    std::fs::write(folder.join("empty.mcap"), "").unwrap();
    let whole = std::fs::read(folder.join("drive-0.mcap")).unwrap();
    std::fs::write(folder.join("torn.mcap"), &whole[..200]).unwrap();
    let drive = Scenario::bundled("paper-square").unwrap().drive(0);
    let wheels: Vec<Observation> = arrived(&drive).into_iter().filter(|one| one.sensor == SensorId::WHEELS).collect();
    record(&folder.join("wheels.mcap"), &wheels);
    record(&folder.join("still.mcap"), &wheels[..20]);
    whole
}

#[test]
fn what_a_recording_lacks_is_named_with_the_file_and_a_cure() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let whole = sick_recordings(folder);
    for (command, words) in LACKS {
        let args: Vec<&str> = command.split(' ').collect();
        let said = refusal(folder, &args);
        for word in words {
            assert!(said.contains(word), "{command}: `{word}` in {said}");
        }
    }
    // One sick recording among good ones is the one that is named.
    let both = ["nxt-square", "--recording", "drive-0.mcap", "wall.mcap"];
    let said = refusal(folder, &both);
    assert!(said.contains("wall.mcap") && !said.contains("drive-0"), "{said}");
    // A recording that was cut off is used as far as it goes.
    std::fs::write(folder.join("cut.mcap"), &whole[..whole.len() / 2]).unwrap();
    let mut command = posebridge(folder);
    command.args(["lab", "nxt-square", "--recording", "cut.mcap"]);
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("cut.mcap: cut off at byte"), "{said}");
}

#[test]
fn a_recording_that_is_there_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("live.mcap"), "mine").unwrap();
    let said = refusal(folder.path(), &["wall", "--link", "tcp://127.0.0.1:9"]);
    assert!(said.contains("live.mcap` is there already") && said.contains("--out"), "{said}");
    assert_eq!(std::fs::read(folder.path().join("live.mcap")).unwrap(), b"mine");
}

/// A square of 0.3 m after a second and a half at rest; its brick runs 2000 ppm fast.
const SMALL_SQUARE: &str = r#"
seed = 7
steering = "odometry"

[path.square]
side_m = 0.3

[drive]
laps = 1
speed_m_per_s = 0.2
rest_s = 1.5

[brick]
clock_skew_ppm = 2000.0
"#;

#[test]
fn a_live_square_is_recorded_and_its_recording_says_the_same_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (_brick, url) = listening_brick(folder, SMALL_SQUARE);
    let live = ["lab", "nxt-square", "--link", &url, "--duration", "6", "--out", "out", "--json"];
    let mut station = RunningProgram::start(posebridge(folder).args(live));
    let printed = station.wait_for("recording `out/live.mcap`");
    assert!(printed.contains("drive the square") && printed.contains("6 s"), "{printed}");
    station.wait_for("robot 0/1/1 detected");
    let text = station.output();
    let found: Value = serde_json::from_str(&text).unwrap();
    let raw = &found["settings"][0]["methods"][0];
    println!("{}: raw {raw}", found["source"]);
    assert!(raw["position_rms_m"].as_f64().unwrap() < 0.2);
    assert_eq!(found["recordings"][0], "out/live.mcap");
    for file in ["lab-nxt-square.html", "lab-nxt-square-3.svg"] {
        assert!(folder.join("out").join(file).exists(), "{file}");
    }
    let again = ["nxt-square", "--recording", "out/live.mcap", "--out", "again"];
    assert_eq!(lab(folder, &again), found);
    // The live page tells how to have it without the robot.
    let page = std::fs::read_to_string(folder.join("out/lab-nxt-square.html")).unwrap();
    let command = "posebridge lab nxt-square --recording out/live.mcap";
    assert!(page.contains(command));
    // The simulated brick feels its accelerations, so paper 4's filters have their say as well.
    let indirect = lab(folder, &["indirect", "--recording", "out/live.mcap"]);
    let end = indirect["rows"][2]["ends_m"][0].as_array().unwrap();
    println!("indirect-feedback ends {end:?} m off");
    assert!(end.iter().all(|error| error.as_f64().unwrap().abs() < 0.5));
    let replayed = stdout_of(posebridge(folder).args(["replay", "out/live.mcap"]));
    assert!(replayed.contains("wheel_angles") || replayed.contains("wheels"), "{replayed}");
}

#[test]
fn a_live_car_that_calls_the_station_is_foretold_until_somebody_says_stop() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut text = "t_ms,tof_mm\n".to_owned();
    for one in approach() {
        let ObservationKind::WallRange(range) = one.measurement else {
            continue;
        };
        let millis = one.stamp.as_nanos() / 1_000_000;
        writeln!(text, "{millis},{:.0}", 1e3 * range.0).unwrap();
    }
    std::fs::write(folder.join("approach.csv"), text).unwrap();
    let descriptor = std::fs::read_to_string(root().join("config/recordings/tof-wall.toml")).unwrap();
    let robot = descriptor.split("[[runs]]").next().unwrap();
    let robot = robot.replace("robotA-80-step", "approach");
    let streams = "[[runs]]\nname = \"approach\"\n\n[files.log]\npath = \"approach.csv\"\nheader_lines = 1\n\
        time = { column = \"t_ms\", unit = \"ms\" }\n\n[[wall_range]]\nfile = \"log\"\n\
        range = { column = \"tof_mm\", unit = \"mm\" }\n";
    std::fs::write(folder.join("car.toml"), robot + streams).unwrap();
    let live = ["lab", "wall", "--listen", "tcp://127.0.0.1:0", "--out", "out", "--json"];
    let mut station = RunningProgram::start(posebridge(folder).args(live));
    let printed = station.wait_for("recording `out/live.mcap`");
    assert!(printed.contains("at the wall") && printed.contains("Ctrl-C"), "{printed}");
    let url = format!("tcp://{}", station.listening_address(""));
    let mut car = RunningProgram::start(posebridge(folder).args(["play", "car.toml", "--link", &url]));
    let played = car.output();
    println!("{played}");
    let found: Value = serde_json::from_str(&station.interrupt()).unwrap();
    let run = &found["runs"][0];
    println!("{} readings, {}", run["readings"], run["against_line"]);
    assert!(run["readings"].as_u64().unwrap() >= 20, "{run}");
    assert!(folder.join("out/lab-wall.html").exists());
}

#[test]
fn a_live_robot_that_stands_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let standing = SMALL_SQUARE.replace("rest_s = 1.5", "rest_s = 60.0");
    let (_brick, url) = listening_brick(folder, &standing);
    let live = ["calibrate", "rest", "--link", &url, "--duration", "4", "--out", "out"];
    let text = stdout_of(posebridge(folder).args(live));
    println!("{text}");
    assert!(text.contains("gyro") && text.contains("accelerometer"), "{text}");
    // The path of a robot that stands says nothing, and the recording is not made twice.
    let args = ["calibrate", "path", "--link", &url, "--out", "out"];
    let output = posebridge(folder).args(args).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("out/live.mcap` is there already"), "{said}");
}

/// A straight drive whose stamps are each but the first told twice, and now and then exchanged.
#[test]
fn the_noise_of_a_straight_drive_does_not_hang_on_the_order_of_arrival() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = include_str!("../src/lab/identify/scenarios/straight.toml");
    let wheels = arrived(&Scenario::from_toml(text).unwrap().drive(0));
    record(&folder.join("ordered.mcap"), &wheels);
    let mut mixed = wheels.clone();
    for index in (10..wheels.len() - 1).step_by(50) {
        mixed.swap(index, index + 1);
    }
    mixed.insert(40, mixed[39]);
    record(&folder.join("mixed.mcap"), &mixed);
    let found = |name: &str| {
        let args = ["identify", "straight", "--recording", name, "--json"];
        let found: Value = serde_json::from_str(&stdout_of(posebridge(folder).args(args))).unwrap();
        found["quantities"].clone()
    };
    assert_eq!(found("mixed.mcap"), found("ordered.mcap"));
}

//! Recordings of several stations become one, which replays, exports and reports as the single ones do.

use std::fs::File;
use std::path::Path;

use crate::support::virtual_drive::record_drive_and_truth;
use crate::support::{SKEWED_SQUARE, assert_refused, exit_code_and_stderr, json, posebridge, read_text, root, run};
use posebridge::config::load_text;
use posebridge::station::signing::recorded_station_config;
use posebridge_fleet::{ClockNote, IdentityNote, StationId, StationName};
use posebridge_recording::container::{RecordingHeader, RecordingReader, RecordingWriter, read_truth};
use posebridge_sim::Scenario;
use posebridge_station::Station;
use posebridge_telemetry::{
    Address, Command, Fix, Heading, HostClock, Input, LinkId, Meters, Observation, ObservationKind, OutsideFix,
    Ownership, Point2, Pose, Radians, RobotId, RobotSnapshot, SensorId, TimeDelta, Timestamp,
};
use serde_json::Value;

type Recorded = (Timestamp<HostClock>, Input);

const UTC_MICROS: u64 = 1_700_000_000_000_000;
/// The robot of every drive.
const ROBOT: RobotId = RobotId { link: LinkId(0), address: Address::new(1, 1) };
/// How far the clock of the right station is ahead: it began before the left one.
const RIGHT_AHEAD: TimeDelta = TimeDelta::from_nanos(1_234_567_891);

fn station(name: &str) -> StationId {
    StationId { name: StationName::new(name).unwrap(), instance: 7 }
}

fn note(text: &impl ToString) -> Recorded {
    (Timestamp::ZERO, Input::Report { severity: 7, text: text.to_string() })
}

/// A drive of the simulated brick with its truth, and `extra` inputs at their times, as a station has recorded it.
fn record(path: &Path, seed: u64, change: impl FnOnce(&mut RecordingHeader, &mut Vec<Recorded>)) {
    let drive = path.with_extension("drive");
    record_drive_and_truth(
        &drive,
        Scenario::from_toml(SKEWED_SQUARE).unwrap().with_seed(seed),
        TimeDelta::from_millis(500),
    );
    let bytes = std::fs::read(&drive).unwrap();
    let mut header = RecordingReader::open(&bytes).unwrap().header().clone();
    header.utc_start_micros = UTC_MICROS;
    let mut inputs = inputs_of(&drive);
    change(&mut header, &mut inputs);
    inputs.sort_by_key(|(now, _)| *now);
    let mut writer = RecordingWriter::create(File::create(path).unwrap(), &header).unwrap();
    for (now, input) in inputs {
        writer.record(now, &input).unwrap();
    }
    writer.record_truth(Timestamp::ZERO, &read_truth(&bytes).unwrap()).unwrap();
    writer.finish().unwrap();
}

fn inputs_of(path: &Path) -> Vec<Recorded> {
    let bytes = std::fs::read(path).unwrap();
    RecordingReader::open(&bytes).unwrap().map(Result::unwrap).collect()
}

/// Two stations that heard different drives of robots with the same ids. The right one was told a pose in the middle, which concerns its
/// robot alone.
fn record_two(folder: &Path) {
    record(&folder.join("left.mcap"), 7, |_, inputs| {
        let mut measured = |offset, uncertainty_us| {
            let uncertainty = TimeDelta::from_micros(uncertainty_us);
            inputs.push(note(&ClockNote { station: station("right"), offset, uncertainty }));
        };
        measured(TimeDelta::from_nanos(1_200_000_000), 90_000);
        measured(RIGHT_AHEAD, 123);
        measured(TimeDelta::from_nanos(1_300_000_000), 80_000);
        inputs.push(note(&IdentityNote { station: station("left") }));
    });
    record(&folder.join("right.mcap"), 8, |header, inputs| {
        // The dates say something else.
        header.utc_start_micros += 5_000_000;
        inputs.push(note(&IdentityNote { station: station("right") }));
        let pose = Pose::new(Meters(0.2), Meters(0.1), Heading::from_rad(0.3));
        inputs.push((Timestamp::from_millis(3_000), Input::Command(Command::set_pose_by_eye(pose))));
        let fix = Fix {
            position: Point2::new(Meters(0.2), Meters(0.1)),
            heading: None,
            covariance: None,
            tag_in_body: Point2::new(Meters(0.0), Meters(0.0)),
            reset_counter: 0,
        };
        let (time, uncertainty) = (Timestamp::from_millis(2_990), TimeDelta::from_millis(2));
        let fix = OutsideFix { source: Address::new(9, 100), time, uncertainty, fix };
        inputs.push((Timestamp::from_millis(3_010), Input::OutsideFix { robot: ROBOT, fix }));
    });
}

/// The events of a replay that are of one link, which becomes link 0, by a clock that is `ahead` of the recording's.
fn events(folder: &Path, recording: &str, link: u64, ahead: TimeDelta) -> Vec<Value> {
    run(folder, &["replay", recording, "--events", "events.txt"]);
    let text = read_text(folder, "events.txt");
    let events = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let mut found = Vec::new();
    for mut event in events {
        let of_link = if event.get("robot").is_some() { &mut event["robot"]["link"] } else { &mut event["link"] };
        if *of_link != link {
            continue;
        }
        *of_link = 0.into();
        for (key, sign) in [("arrival_host_ns", 1), ("host_ns", 1), ("offset_ns", -1)] {
            if let Some(nanos) = event.get(key).and_then(Value::as_i64) {
                event[key] = (nanos + sign * ahead.as_nanos()).into();
            }
        }
        found.push(event);
    }
    found
}

fn assert_same(merged: &[Value], single: &[Value]) {
    for (number, (merged, single)) in merged.iter().zip(single).enumerate() {
        assert_eq!(merged, single, "event {number}");
    }
    assert_eq!(merged.len(), single.len());
    assert!(single.iter().filter(|event| event["event"] == "estimated").count() > 100);
    assert!(single.iter().filter(|event| event["event"] == "robot_clock_aligned").count() > 10);
}

#[test]
fn a_merged_recording_replays_as_the_single_ones_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record_two(folder);
    let summary = run(folder, &["merge", "left.mcap", "right.mcap", "--out", "both.mcap"]);
    let lines: Vec<&str> = summary.lines().collect();
    assert!(lines[0].starts_with("`left.mcap`: station left-0000000000000007, link 0, "), "{summary}");
    assert!(lines[0].ends_with(" inputs, robot 0/1/1; the others are put on its clock"), "{summary}");
    assert!(lines[1].starts_with("`right.mcap`: station right-0000000000000007, link 1, "), "{summary}");
    assert!(
        lines[1].ends_with("robot 1/1/1; its clock is 1.234567891 s ahead, measured by the stations to 0.000123 s"),
        "{summary}"
    );
    // The right station began first: its clock is that of the merged recording.
    let single = |name| events(folder, name, 0, TimeDelta::ZERO);
    assert_same(&events(folder, "both.mcap", 1, TimeDelta::ZERO), &single("right.mcap"));
    assert_same(&events(folder, "both.mcap", 0, -RIGHT_AHEAD), &single("left.mcap"));
    let inputs = inputs_of(&folder.join("both.mcap"));
    let expected = inputs_of(&folder.join("left.mcap")).len() + inputs_of(&folder.join("right.mcap")).len();
    assert_eq!(inputs.len(), expected);
    assert!(inputs.is_sorted_by_key(|(now, _)| *now));
    let bytes = std::fs::read(folder.join("both.mcap")).unwrap();
    let header = RecordingReader::open(&bytes).unwrap().header().clone();
    assert_eq!(header.utc_start_micros, UTC_MICROS - 1_234_567);
    assert_eq!(header.links, ["sim://square", "sim://square"]);
}

#[test]
fn a_merged_recording_exports_reports_and_is_inspected_with_the_truth_of_each_robot() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record_two(folder);
    run(folder, &["merge", "left.mcap", "right.mcap", "--out", "both.mcap"]);
    let rms = |recording: &str, index: usize| {
        json(folder, &["replay", recording])["estimators"][index]["position_rms_m"].clone()
    };
    assert_eq!([rms("both.mcap", 0), rms("both.mcap", 1)], [rms("right.mcap", 0), rms("left.mcap", 0)]);
    run(folder, &["export", "both.mcap", "--format", "csv,tum,tlog", "--out", "tables"]);
    run(folder, &["export", "left.mcap", "--format", "tum", "--out", "tables"]);
    for name in ["estimate", "truth"] {
        let file = |robot: &str| read_text(folder, &format!("tables/{name}{robot}.tum"));
        assert_eq!(file("-0-1-1"), file(""));
    }
    run(folder, &["export", "both.mcap", "--messages", "--format", "csv", "--out", "messages"]);
    let report = json(folder, &["report", "both.mcap"]);
    assert_eq!(report["runs"].as_array().unwrap().len(), 2);
    let facts = json(folder, &["inspect", "both.mcap"]);
    let links: Vec<u64> = (0..2).map(|link| facts["recording"]["links"][link]["bytes"].as_u64().unwrap()).collect();
    assert!(links.iter().all(|bytes| *bytes > 10_000), "{links:?}");
    assert_eq!(facts["recording"]["commands"], 1);
    // It holds the estimates for viewers.
    let bytes = std::fs::read(folder.join("both.mcap")).unwrap();
    assert!(bytes.windows(8).any(|found| found == b"odometry") || bytes.windows(8).any(|found| found == b"Odometry"));
}

#[test]
fn a_robot_that_moves_to_another_station_continues_with_its_state() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let middle = Timestamp::from_millis(4_000);
    // The right clock is behind: the right station began later, in the middle of the drive.
    let ahead = TimeDelta::from_nanos(-1_500_000_003);
    record(&folder.join("left.mcap"), 7, |_, inputs| {
        let uncertainty = TimeDelta::from_micros(40);
        inputs.push(note(&ClockNote { station: station("right"), offset: ahead, uncertainty }));
        let owned = Ownership::Owner { epoch: 1, state: None };
        inputs.push((Timestamp::ZERO, Input::Ownership { robot: ROBOT, ownership: owned }));
        inputs.push((middle, Input::Ownership { robot: ROBOT, ownership: Ownership::Standby { epoch: 2 } }));
    });
    let left = inputs_of(&folder.join("left.mcap"));
    let bytes = std::fs::read(folder.join("left.mcap")).unwrap();
    let header = RecordingReader::open(&bytes).unwrap().header().clone();
    let config = load_text("header", &header.config_toml, &[]).unwrap().config;
    let mut handing_over = Station::new(recorded_station_config(&config, &[]).unwrap(), Timestamp::ZERO).unwrap();
    for (now, input) in left.iter().filter(|(now, _)| *now < middle) {
        handing_over.handle(*now, input);
        while handing_over.poll().is_some() {}
    }
    let state = RobotSnapshot { bytes: handing_over.robot_state(ROBOT).unwrap(), clock_offset: -ahead };
    record(&folder.join("right.mcap"), 7, |_, inputs| {
        inputs.retain(|(now, input)| *now >= middle && matches!(input, Input::Bytes { .. } | Input::Tick));
        for (now, _) in inputs.iter_mut() {
            *now = *now + ahead;
        }
        inputs.push(note(&IdentityNote { station: station("right") }));
        let owned = Ownership::Owner { epoch: 2, state: Some(state) };
        inputs.push((middle + ahead, Input::Ownership { robot: ROBOT, ownership: owned }));
    });
    run(folder, &["merge", "left.mcap", "right.mcap", "--out", "both.mcap"]);
    let merged = inputs_of(&folder.join("both.mcap"));
    let offsets = merged.iter().filter_map(|(now, input)| match input {
        Input::Ownership { robot, ownership: Ownership::Owner { state: Some(state), .. } } => {
            Some((*now, robot.link, state.clock_offset))
        }
        _ => None,
    });
    // The merged clock is that of the left station, which saved the state.
    assert_eq!(offsets.collect::<Vec<_>>(), [(middle, LinkId(1), TimeDelta::ZERO)]);
    let of_right = events(folder, "both.mcap", 1, ahead);
    let single = events(folder, "right.mcap", 0, TimeDelta::ZERO);
    assert_eq!(of_right, single);
    let position = |event: &Value| ["x_m", "y_m"].map(|key| event[key].as_f64().unwrap());
    let stamp = |event: &Value| event["robot_ns"].as_i64().unwrap();
    let estimates = |link| {
        let all = events(folder, "both.mcap", link, TimeDelta::ZERO);
        all.into_iter().filter(|event| event["event"] == "estimated").collect::<Vec<_>>()
    };
    let (stayed, moved) = (estimates(0), estimates(1));
    // The left station went on to hear it: both know the same, to the bit, until the camera's first fix. Clocks of cameras are not handed
    // over, so that the right station takes a fix for younger than it is: by 42 ms, in which the robot drives 9 mm.
    let after: Vec<&Value> = stayed.iter().filter(|event| stamp(event) >= stamp(&moved[0])).collect();
    assert_eq!(&moved[0], after[0]);
    let pairs = moved.iter().filter_map(|event| {
        let of_stayed = after.iter().find(|other| stamp(other) == stamp(event))?;
        Some([event, of_stayed].map(position))
    });
    let distances_m: Vec<f64> = pairs.map(|[[x, y], [other_x, other_y]]| (x - other_x).hypot(y - other_y)).collect();
    assert!(distances_m.len() > 300, "{}", distances_m.len());
    assert!(distances_m.iter().all(|distance_m| *distance_m < 0.01), "{distances_m:?}");
}

#[test]
fn one_robot_that_two_stations_hear_is_two_robots_as_each_heard_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(&folder.join("left.mcap"), 7, |_, _| {});
    // The same frames, a moment later by the same dates.
    record(&folder.join("right.mcap"), 7, |header, _| header.utc_start_micros += 3_000);
    let output = posebridge(folder).args(["merge", "left.mcap", "right.mcap", "--out", "both.mcap"]).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.contains("WARNING: `right.mcap`: no station measured its clock"), "{stderr}");
    let summary = String::from_utf8(output.stdout).unwrap();
    assert!(
        summary.contains("its clock is -0.003000 s ahead by the dates at the start, to an unknown error"),
        "{summary}"
    );
    let single = events(folder, "left.mcap", 0, TimeDelta::ZERO);
    assert_same(&events(folder, "both.mcap", 0, TimeDelta::ZERO), &single);
    assert_same(&events(folder, "both.mcap", 1, TimeDelta::from_millis(-3)), &single);
}

#[test]
fn what_cannot_be_merged_is_refused_with_the_file_and_the_cause() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record_two(folder);
    record(&folder.join("other.mcap"), 9, |header, _| {
        let mut config = load_text("header", &header.config_toml, &[]).unwrap().config;
        config.robot.track_width_m = 0.5;
        header.config_toml = toml::to_string(&config).unwrap();
    });
    record(&folder.join("again.mcap"), 9, |_, inputs| inputs.push(note(&IdentityNote { station: station("left") })));
    record(&folder.join("foreign.mcap"), 9, |_, inputs| {
        let observation = Observation {
            sensor: SensorId::WHEELS,
            stamp: Timestamp::ZERO,
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::WheelAngles { left: Radians(0.0), right: Radians(0.0) },
        };
        inputs.push((Timestamp::from_millis(10), Input::Observation(observation)));
    });
    std::fs::copy(folder.join("left.mcap"), folder.join("copy.mcap")).unwrap();
    std::fs::copy(root().join("tests/data/tlog/mixed.tlog"), folder.join("mixed.tlog")).unwrap();
    run(folder, &["merge", "left.mcap", "right.mcap", "--out", "both.mcap"]);
    let refused: [(&str, i32, &[&str]); 8] = [
        ("merge left.mcap --out x.mcap", 2, &["FILE"]),
        ("merge left.mcap left.mcap --out x.mcap", 2, &["`left.mcap` is the same recording as `left.mcap`"]),
        (
            "merge left.mcap copy.mcap --out x.mcap",
            2,
            &["`copy.mcap` is the same recording as `left.mcap`: give it once"],
        ),
        ("merge left.mcap again.mcap --out x.mcap", 2, &["`again.mcap` and `left.mcap` are both of station left-"]),
        (
            "merge left.mcap other.mcap --out x.mcap",
            2,
            &["`robot.track_width_m` is 0.5 in `other.mcap`", "in `left.mcap`"],
        ),
        ("merge left.mcap foreign.mcap --out x.mcap", 2, &["`foreign.mcap`", "observations without a link"]),
        (
            "merge left.mcap mixed.tlog --out x.mcap",
            2,
            &["`mixed.tlog` is no recording of posebridge", "posebridge import"],
        ),
        ("merge both.mcap other.mcap --out x.mcap", 2, &["`both.mcap`", "it is a merged recording itself"]),
    ];
    assert_refused(folder, &refused);
    assert!(!folder.join("x.mcap").exists());
    let before = std::fs::read(folder.join("both.mcap")).unwrap();
    assert_refused(folder, &[("merge left.mcap right.mcap --out both.mcap", 2, &["creating `both.mcap`"])]);
    assert_eq!(std::fs::read(folder.join("both.mcap")).unwrap(), before);
    let (code, stderr) = exit_code_and_stderr(folder, &["init", "--from", "both.mcap"]);
    assert!(code != Some(0) && stderr.contains("merged recording"), "{stderr}");
}

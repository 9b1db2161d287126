//! The trails of a recording, as the dashboard's replay shows them, against what `posebridge replay` says of the same file.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

#[path = "support/parted.rs"]
mod parted;
mod support;
#[path = "support/virtual_drive.rs"]
mod virtual_drive;

use std::collections::BTreeMap;
use std::path::Path;

use parted::record_ticks;
use posebridge::station::page_history;
use posebridge_dashboard::model::{Frame, RobotFrame};
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use support::{SKEWED_SQUARE, posebridge, stdout_of};
use virtual_drive::record_drive_and_truth;

fn drive(folder: &Path) -> Frame {
    let path = folder.join("drive.mcap");
    let scenario = Scenario::from_toml(SKEWED_SQUARE).unwrap();
    record_drive_and_truth(&path, scenario, TimeDelta::from_millis(500));
    page_history::build_history(&path).unwrap()
}

fn the_robot(frame: &Frame) -> &RobotFrame {
    let mut robots = frame.robots.iter();
    robots.find(|robot| !robot.estimates.is_empty()).unwrap()
}

#[test]
fn the_errors_of_a_replay_are_those_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let frame = drive(folder);
    let robot = the_robot(&frame);
    let squares = robot.scores.iter().filter_map(|one| one.estimate_m.get());
    let squares: Vec<f64> = squares.map(|off_m| off_m * off_m).collect();
    assert!(squares.len() * 10 >= robot.estimates.len() * 9);
    let rms_m = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let printed = stdout_of(posebridge(folder).args(["replay", "drive.mcap", "--json"]));
    let table: Value = serde_json::from_str(&printed).unwrap();
    let said_m = table["estimators"][0]["position_rms_m"].as_f64();
    let said_m = said_m.unwrap_or_else(|| panic!("{table:#}"));
    assert!((rms_m / said_m - 1.0).abs() < 0.1, "{rms_m} m against {said_m} m");
    assert!(frame.errors.unwrap().estimate_m.get().is_some());
}

#[test]
fn the_truth_of_a_replay_stands_at_its_own_instants() {
    let folder = tempfile::tempdir().unwrap();
    let frame = drive(folder.path());
    let apart = frame.truth.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    let apart: Vec<f64> = apart.collect();
    assert!(apart.len() > 100);
    let usual = apart.iter().filter(|apart_s| (0.04..0.06).contains(*apart_s));
    assert!(usual.count() * 100 > apart.len() * 99, "{apart:?}");
}

#[test]
fn counts_and_what_was_learned_go_with_the_time_of_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let frame = drive(folder.path());
    let robot = the_robot(&frame);
    let mut came = BTreeMap::new();
    for record in &robot.fusion {
        *came.entry(&record.sensor).or_insert(0_u64) += 1;
    }
    for (sensor, count) in came {
        let mut tallies = robot.tallies.iter().filter(|one| one.sensor == *sensor);
        assert_eq!(tallies.clone().next_back().unwrap().seen, count, "{sensor}");
        assert!(tallies.next().unwrap().seen < count / 2, "{sensor}");
    }
    let learned = robot.calibration.as_ref().unwrap();
    let bias = learned.iter().filter(|row| row.name == "gyro_bias_rad_per_s");
    let times: Vec<f64> = bias.map(|row| row.t_s).collect();
    assert!(times.len() as f64 > 0.9 * frame.now_s, "{times:?}");
    assert!(times.is_sorted());
}

#[test]
fn what_a_recording_lacks_stands_first_in_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record_ticks(folder);
    let log = |name: &str| page_history::build_history(&folder.join(name)).unwrap().log;
    let whole = log("recording.mcap");
    assert!(!whole.iter().any(|line| line.text.contains("lacks")));
    let later = log("recording.2.mcap");
    let lack = later.iter().position(|line| line.text.contains("it lacks the first"));
    assert!(lack.is_some_and(|index| index < 2), "{later:?}");
    assert!(later[lack.unwrap()].text.contains("not that of the live run"));
    assert!(later[0].t_s >= 1.5, "in the part's own time");
}

#[test]
fn where_a_recording_was_cut_off_stands_in_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let whole = drive(folder);
    assert!(!whole.log.iter().any(|line| line.text.contains("cut off")));
    let bytes = std::fs::read(folder.join("drive.mcap")).unwrap();
    let path = folder.join("torn.mcap");
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let torn = page_history::build_history(&path).unwrap();
    assert!(torn.log[0].text.contains("cut off at byte"), "{:?}", torn.log);
    let shown = the_robot(&torn).estimates.len();
    assert!(shown > 10, "{shown} estimates before the cut");
}

//! The frame that the dashboard shows of a recording, against what `posebridge replay` says of the same file.

use std::collections::BTreeMap;
use std::path::Path;

use crate::parts::record_ticks;
use crate::support::virtual_drive::record_drive_and_truth;
use crate::support::{SKEWED_SQUARE, json, number};
use posebridge::station::page_history::build_history;
use posebridge_dashboard::model::{Frame, RobotFrame};
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;

fn drive(folder: &Path) -> Frame {
    let path = folder.join("drive.mcap");
    let scenario = Scenario::from_toml(SKEWED_SQUARE).unwrap();
    record_drive_and_truth(&path, scenario, TimeDelta::from_millis(500));
    build_history(&path).unwrap()
}

fn the_robot(frame: &Frame) -> &RobotFrame {
    frame.robots.iter().find(|robot| !robot.estimates.is_empty()).unwrap()
}

#[test]
fn errors_truth_counts_and_what_was_learned_go_with_the_time_of_the_replay() {
    let folder = tempfile::tempdir().unwrap();
    let frame = drive(folder.path());
    let robot = the_robot(&frame);
    let squares = robot.scores.iter().filter_map(|one| one.estimate_m.get()).map(|off_m| off_m * off_m);
    let squares: Vec<f64> = squares.collect();
    assert!(squares.len() * 10 >= robot.estimates.len() * 9);
    let rms_m = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let replayed_m = number(&json(folder.path(), &["replay", "drive.mcap"]), "/estimators/0/position_rms_m");
    assert!((rms_m / replayed_m - 1.0).abs() < 0.1, "{rms_m} m against {replayed_m} m");
    assert!(frame.errors.as_ref().unwrap().estimate_m.get().is_some());

    let apart_s: Vec<f64> = frame.truth.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect();
    let usual = apart_s.iter().filter(|apart_s| (0.04..0.06).contains(*apart_s)).count();
    assert!(apart_s.len() > 100 && usual * 100 > apart_s.len() * 99, "{apart_s:?}");

    let mut records = BTreeMap::new();
    for record in &robot.fusion {
        *records.entry(&record.sensor).or_insert(0_u64) += 1;
    }
    for (sensor, count) in records {
        let mut tallies = robot.tallies.iter().filter(|one| one.sensor == *sensor);
        assert_eq!(tallies.clone().next_back().unwrap().seen, count, "{sensor}");
        assert!(tallies.next().unwrap().seen < count / 2, "{sensor}");
    }
    let learned = robot.calibration.as_ref().unwrap();
    let bias = learned.iter().filter(|row| row.name == "gyro_bias_rad_per_s");
    let times: Vec<f64> = bias.map(|row| row.t_s).collect();
    assert!(times.len() as f64 > 0.9 * frame.now_s && times.is_sorted(), "{times:?}");
}

#[test]
fn the_log_says_what_a_recording_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record_ticks(folder);
    let log = |name: &str| build_history(&folder.join(name)).unwrap().log;
    assert!(!log("recording.mcap").iter().any(|line| line.text.contains("lacks")));
    let later = log("recording.2.mcap");
    let lack = later.iter().take(2).find(|line| line.text.contains("it lacks the first")).expect("it stands first");
    assert!(lack.text.contains("not that of the live run"), "{lack:?}");
    assert!(later[0].t_s >= 1.5, "in the part's own time");

    let whole = drive(folder);
    assert!(!whole.log.iter().any(|line| line.text.contains("cut off")));
    let bytes = std::fs::read(folder.join("drive.mcap")).unwrap();
    std::fs::write(folder.join("torn.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    let torn = build_history(&folder.join("torn.mcap")).unwrap();
    assert!(torn.log[0].text.contains("cut off at byte"), "{:?}", torn.log);
    assert!(the_robot(&torn).estimates.len() > 10, "estimates before the cut");
}

//! Telemetry logs whose times are damaged, whose date was set, or that were cut, with the real program.

use std::io::Write as _;
use std::path::Path;

use crate::support::virtual_drive::record_drive;
use crate::support::{assert_refused, exit_code_and_stderr, json, read_text, run, write_text};
use crate::{trajectory, worst_distance};
use flate2::Compression;
use flate2::write::GzEncoder;
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use tempfile::TempDir;

/// Half a minute with a camera.
const SQUARE: &str = r#"
seed = 11
[path.square]
side_m = 0.8
direction = "right"
"#;
/// 14 November 2023, microseconds since 1970.
const DATE: u64 = 1_700_000_000_000_000;
const SECOND: u64 = 1_000_000;
/// The station's address in a frame of MAVLink 2, bytes 5 and 6.
const STATION: [u8; 2] = [1, 197];

/// Times and frames.
type Records = Vec<(u64, Vec<u8>)>;

/// A drive as a log of today.
fn log() -> (TempDir, Records) {
    let folder = tempfile::tempdir().unwrap();
    let scenario = Scenario::from_toml(SQUARE).unwrap();
    record_drive(&folder.path().join("drive.mcap"), scenario, TimeDelta::from_millis(500));
    run(folder.path(), &["export", "drive.mcap", "--format", "tlog"]);
    let bytes = std::fs::read(folder.path().join("drive.tlog")).unwrap();
    let mut records = Vec::new();
    let mut rest = bytes.as_slice();
    while !rest.is_empty() {
        let micros = u64::from_be_bytes(rest[..8].try_into().unwrap());
        let length = 8 + 12 + usize::from(rest[9]);
        records.push((micros + DATE, rest[8..length].to_vec()));
        rest = &rest[length..];
    }
    assert!(records.len() > 1_000, "{}", records.len());
    (folder, records)
}

fn bytes_of(records: &Records) -> Vec<u8> {
    let records = records.iter();
    records.flat_map(|(micros, frame)| [&micros.to_be_bytes()[..], frame].concat()).collect()
}

fn write(folder: &Path, name: &str, records: &Records) {
    std::fs::write(folder.join(name), bytes_of(records)).unwrap();
}

fn packed(records: &Records) -> Vec<u8> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(&bytes_of(records)).unwrap();
    packed.finish().unwrap()
}

/// Runs a command that must succeed, and returns what it says.
fn stderr_of(folder: &Path, args: &[&str]) -> String {
    let (code, stderr) = exit_code_and_stderr(folder, args);
    assert_eq!(code, Some(0), "{args:?}: {stderr}");
    stderr
}

/// Where the robot was believed, and what was said of the log.
fn estimates(folder: &Path, records: &Records) -> (Vec<(f64, f64, f64)>, String) {
    write(folder, "log.tlog", records);
    let said = stderr_of(folder, &["export", "log.tlog", "--format", "tum"]);
    (trajectory(&folder.join("estimate.tum")), said)
}

/// The log gives the estimates of the other one, and this is said of it.
fn estimates_as(folder: &Path, plain: &Records, other: &Records, note: &str) {
    let (expected, quiet) = estimates(folder, plain);
    assert!(!quiet.contains(note), "{quiet}");
    let (found, said) = estimates(folder, other);
    assert!(said.contains(note), "{note}: {said}");
    let (compared, worst_m) = worst_distance(&expected, &found);
    assert!(compared > expected.len() * 9 / 10, "{compared} of {}", expected.len());
    assert!(worst_m < 0.005, "{worst_m} m");
}

#[test]
fn a_date_that_is_set_ahead_in_the_middle_changes_no_estimate_and_is_told() {
    let (folder, records) = log();
    let of_robot = |(_, frame): &&(u64, Vec<u8>)| frame[5..7] != STATION;
    let robot_alone: Records = records.iter().filter(of_robot).cloned().collect();
    let note = "1 steps ahead of the computer's date";
    for plain in [&records, &robot_alone] {
        for step_s in [600, 6 * 3_600, 30 * 86_400, 3 * 365 * 86_400] {
            let mut stepped = plain.clone();
            for (micros, _) in &mut stepped[300..] {
                *micros += step_s * SECOND;
            }
            estimates_as(folder.path(), plain, &stepped, note);
        }
    }
}

#[test]
fn damaged_times_change_no_estimate_wherever_they_stand() {
    let (folder, records) = log();
    let damage = |at: &[usize], micros: u64| {
        let mut damaged = records.clone();
        for index in at {
            damaged[*index].0 = micros;
        }
        damaged
    };
    let ahead = records[500].0 + 1_000_000_000 * SECOND;
    let ten: Vec<usize> = (500..510).collect();
    for (at, micros) in
        [(&[0][..], u64::MAX), (&[0][..], 0), (&[500][..], ahead), (&[500, 501][..], ahead), (&ten[..], 1 << 63)]
    {
        let note = format!("{} times that are damaged", at.len());
        estimates_as(folder.path(), &records, &damage(at, micros), &note);
    }
    // An unknown frame in front says nothing of when the log began.
    let mut led = records.clone();
    led.insert(0, (5, [&[0xFD, 3, 0, 0, 0, 1, 1, 0x60, 0xEA, 0][..], &[7; 5]].concat()));
    estimates_as(folder.path(), &records, &led, "23 bytes outside frames");
}

#[test]
fn a_log_that_is_written_anew_has_sound_times_and_one_that_never_makes_sense_is_refused_with_the_byte() {
    let (folder, records) = log();
    let folder = folder.path();
    let mut damaged = records.clone();
    damaged[500].0 += 1_000_000_000 * SECOND;
    write(folder, "log.tlog", &damaged);
    let said = stderr_of(folder, &["export", "log.tlog", "--format", "tlog", "--out", "out"]);
    assert!(said.contains("1 times that are damaged"), "{said}");
    let mut expected = records;
    expected[500].0 = expected[499].0;
    assert!(std::fs::read(folder.join("out/log.tlog")).unwrap() == bytes_of(&expected));
    for (micros, _) in &mut expected {
        *micros = u64::MAX;
    }
    write(folder, "log.tlog", &expected);
    assert_refused(folder, &[("replay log.tlog", 2, &["`log.tlog`", "byte 0"])]);
}

#[test]
fn a_reversed_log_has_no_duration() {
    let (folder, mut records) = log();
    records.reverse();
    write(folder.path(), "log.tlog", &records);
    let found = json(folder.path(), &["inspect", "log.tlog"]);
    assert_eq!((&found["duration_s"], &found["frames"]), (&Value::Null, &records.len().into()));
    let printed = run(folder.path(), &["inspect", "log.tlog"]);
    assert!(!printed.contains(", -"), "{printed}");
}

#[test]
fn a_packed_log_that_was_cut_is_read_as_far_as_it_goes() {
    let (folder, records) = log();
    let folder = folder.path();
    let packed = packed(&records);
    std::fs::write(folder.join("cut.tlog.gz"), &packed[..packed.len() / 2]).unwrap();
    let frames = |name: &str| json(folder, &["inspect", name])["frames"].as_u64().unwrap() as usize;
    let kept = frames("cut.tlog.gz");
    assert!(kept > 300 && kept < records.len(), "{kept}");
    for args in [
        &["inspect", "cut.tlog.gz"][..],
        &["replay", "cut.tlog.gz"],
        &["import", "cut.tlog.gz", "--out", "cut.mcap"],
        &["export", "cut.tlog.gz", "--format", "tlog", "--out", "out"],
    ] {
        let said = stderr_of(folder, args);
        assert!(said.contains("end in the middle"), "{args:?}: {said}");
    }
    assert_eq!(frames("out/cut.tlog"), kept);
}

#[test]
fn an_export_that_fails_leaves_nothing_behind_and_touches_nothing() {
    let (folder, records) = log();
    let folder = folder.path();
    let mut packed = packed(&records);
    // The checksum of all that was packed stands in the last eight bytes (RFC 1952, section 2.3.1).
    let checksum = packed.len() - 8;
    packed[checksum] ^= 1;
    std::fs::write(folder.join("bad.tlog.gz"), &packed).unwrap();
    for format in ["mcap", "tlog"] {
        assert_refused(folder, &[(&format!("export bad.tlog.gz --format {format} --out out"), 1, &[])]);
        assert_eq!(std::fs::read_dir(folder.join("out")).unwrap().count(), 0, "{format}");
    }
    write_text(folder, "out/drive.tlog", "mine");
    let (code, said) = exit_code_and_stderr(folder, &["export", "drive.tlog", "--format", "tlog", "--out", "out"]);
    assert!(code != Some(0) && said.contains("is there already"), "{said}");
    assert_eq!(read_text(folder, "out/drive.tlog"), "mine");
}

#[test]
fn a_file_with_nothing_in_it_is_refused_and_so_is_an_empty_part() {
    let (folder, _) = log();
    let folder = folder.path();
    write_text(folder, "empty.tlog", "");
    write_text(folder, "readme.tlog", &"# Nothing of this is MAVLink\n".repeat(50));
    for name in ["empty.tlog", "readme.tlog"] {
        for command in ["replay", "report", "export --format tlog --out out", "import --out a.mcap"] {
            let command = format!("{command} {name}");
            let (code, said) = exit_code_and_stderr(folder, &command.split(' ').collect::<Vec<_>>());
            assert!(code != Some(0) && said.contains("holds no MAVLink frame"), "{command}: {said}");
        }
    }
    assert!(!folder.join("a.mcap").exists());
    let nothing = &["nothing lies between --from and --to"][..];
    assert_refused(
        folder,
        &[
            ("replay drive.mcap --from 1000", 1, nothing),
            ("replay drive.tlog --from 1000", 1, nothing),
            ("report drive.mcap --from 1000", 1, nothing),
        ],
    );
}

//! Telemetry logs whose times are damaged, whose date was set, or that were cut, with the real program.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;
#[path = "support/trajectory.rs"]
mod trajectory;
#[path = "support/virtual_drive.rs"]
mod virtual_drive;

use std::io::Write as _;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use support::{posebridge, stdout_of};
use tempfile::TempDir;
use trajectory::{trajectory, worst_distance};
use virtual_drive::record_drive;

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
    stdout_of(posebridge(folder.path()).args(["export", "drive.mcap", "--format", "tlog"]));
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

/// Exit code and talk.
fn exit_code_and_stderr(folder: &Path, args: &[&str]) -> (Option<i32>, String) {
    let output = posebridge(folder).args(args).output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    (output.status.code(), text)
}

fn inspect(folder: &Path, name: &str) -> Value {
    let printed = stdout_of(posebridge(folder).args(["inspect", name, "--json"]));
    serde_json::from_str(&printed).unwrap()
}

/// Where the robot was believed, and what was said of the log.
fn estimates(folder: &Path, records: &Records) -> (Vec<(f64, f64, f64)>, String) {
    write(folder, "log.tlog", records);
    let args = ["export", "log.tlog", "--format", "tum"];
    let (code, said) = exit_code_and_stderr(folder, &args);
    assert_eq!(code, Some(0), "{said}");
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
fn times_that_never_make_sense_are_refused_with_the_byte() {
    let (folder, mut records) = log();
    for (micros, _) in &mut records {
        *micros = u64::MAX;
    }
    write(folder.path(), "log.tlog", &records);
    let (code, said) = exit_code_and_stderr(folder.path(), &["replay", "log.tlog"]);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("`log.tlog`") && said.contains("byte 0"), "{said}");
}

#[test]
fn a_log_that_is_written_anew_has_sound_times_behind_a_damaged_one() {
    let (folder, records) = log();
    let mut damaged = records.clone();
    damaged[500].0 += 1_000_000_000 * SECOND;
    write(folder.path(), "log.tlog", &damaged);
    let args = ["export", "log.tlog", "--format", "tlog", "--out", "out"];
    let (code, said) = exit_code_and_stderr(folder.path(), &args);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("1 times that are damaged"), "{said}");
    let written = std::fs::read(folder.path().join("out/log.tlog")).unwrap();
    let mut expected = records;
    expected[500].0 = expected[499].0;
    assert!(written == bytes_of(&expected));
}

#[test]
fn a_reversed_log_has_no_duration() {
    let (folder, mut records) = log();
    records.reverse();
    write(folder.path(), "log.tlog", &records);
    let found = inspect(folder.path(), "log.tlog");
    assert_eq!(found["duration_s"], Value::Null);
    assert_eq!(found["frames"], records.len());
    let clear = &stdout_of(posebridge(folder.path()).args(["inspect", "log.tlog"]));
    assert!(!clear.contains(", -"), "{clear}");
}

#[test]
fn a_packed_log_that_was_cut_is_read_as_far_as_it_goes() {
    let (folder, records) = log();
    let folder = folder.path();
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(&bytes_of(&records)).unwrap();
    let packed = packed.finish().unwrap();
    std::fs::write(folder.join("cut.tlog.gz"), &packed[..packed.len() / 2]).unwrap();
    let found = inspect(folder, "cut.tlog.gz");
    let frames = found["frames"].as_u64().unwrap() as usize;
    assert!(frames > 300 && frames < records.len(), "{frames}");
    for args in [
        &["inspect", "cut.tlog.gz"][..],
        &["replay", "cut.tlog.gz"],
        &["import", "cut.tlog.gz", "--out", "cut.mcap"],
        &["export", "cut.tlog.gz", "--format", "tlog", "--out", "out"],
    ] {
        let (code, said) = exit_code_and_stderr(folder, args);
        assert_eq!(code, Some(0), "{args:?}: {said}");
        assert!(said.contains("end in the middle"), "{args:?}: {said}");
    }
    assert_eq!(inspect(folder, "out/cut.tlog")["frames"], frames);
}

#[test]
fn an_export_that_fails_leaves_nothing_behind() {
    let (folder, records) = log();
    let folder = folder.path();
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(&bytes_of(&records)).unwrap();
    let mut packed = packed.finish().unwrap();
    // The checksum of all that was packed stands in the last eight bytes (RFC 1952, section 2.3.1).
    let checksum = packed.len() - 8;
    packed[checksum] ^= 1;
    std::fs::write(folder.join("bad.tlog.gz"), &packed).unwrap();
    for format in ["mcap", "tlog"] {
        let args = ["export", "bad.tlog.gz", "--format", format, "--out", "out"];
        let (code, said) = exit_code_and_stderr(folder, &args);
        assert_eq!(code, Some(1), "{said}");
        let left = std::fs::read_dir(folder.join("out")).unwrap().count();
        assert_eq!(left, 0, "{format}");
    }
    // What is there already is not touched.
    std::fs::write(folder.join("out/drive.tlog"), "mine").unwrap();
    let args = ["export", "drive.tlog", "--format", "tlog", "--out", "out"];
    let (code, said) = exit_code_and_stderr(folder, &args);
    assert!(code != Some(0) && said.contains("is there already"), "{said}");
    let kept = std::fs::read(folder.join("out/drive.tlog")).unwrap();
    assert_eq!(kept, b"mine");
}

#[test]
fn a_file_with_nothing_in_it_is_refused_and_so_is_an_empty_part() {
    let (folder, _) = log();
    let folder = folder.path();
    std::fs::write(folder.join("empty.tlog"), []).unwrap();
    std::fs::write(folder.join("readme.tlog"), "# Nothing of this is MAVLink\n".repeat(50)).unwrap();
    for name in ["empty.tlog", "readme.tlog"] {
        for args in [
            &["replay", name][..],
            &["report", name],
            &["export", name, "--format", "tlog", "--out", "out"],
            &["import", name, "--out", "a.mcap"],
        ] {
            let (code, said) = exit_code_and_stderr(folder, args);
            assert!(code != Some(0), "{args:?}");
            assert!(said.contains("holds no MAVLink frame"), "{args:?}: {said}");
        }
    }
    assert!(!folder.join("a.mcap").exists());
    for args in [
        &["replay", "drive.mcap", "--from", "1000"][..],
        &["replay", "drive.tlog", "--from", "1000"],
        &["report", "drive.mcap", "--from", "1000"],
    ] {
        let (code, said) = exit_code_and_stderr(folder, args);
        assert_eq!(code, Some(1), "{args:?}: {said}");
        assert!(said.contains("nothing lies between --from and --to"), "{said}");
    }
}

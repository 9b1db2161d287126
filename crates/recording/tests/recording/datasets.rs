//! Descriptors and their rows: what becomes of each kind of stream, of bad rows, and of wrong descriptors.
//!
//! `tests/data/datasets.txt` has the cases: a descriptor without its common keys, files (`> path`), and the outcome (`= `). Run the
//! test with `POSEBRIDGE_WRITE_OUTPUTS=1` to write the outcomes anew, and look at the difference.

use std::io::{Cursor, Read};
use std::path::Path;

use posebridge_recording::dataset::{DatasetRun, Descriptor, LoadError, LoadOptions, load};
use posebridge_telemetry::{DriveGeometry, Meters, ObservationKind, Radians, Wiring};
use proptest::prelude::*;

/// Wheels of 10 cm and 5 cm radius, half a metre apart, a tick of 0.1 rad: numbers that are easy to follow.
const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(0.1),
    right_wheel_radius: Meters(0.05),
    track_width: Meters(0.5),
    tick: Radians(0.1),
};

/// The keys that every descriptor has, with one run and one file `data.csv` whose first column is the time.
const COMMON_KEYS: &str = r#"
name = "inline"
source = "written by hand"
licence = "none"
default_run = "only"

[[runs]]
name = "only"

[files.data]
path = "data.csv"
time = { column = 0 }
"#;

fn parse(rest: &str) -> Descriptor {
    Descriptor::from_toml(&(COMMON_KEYS.to_owned() + rest)).unwrap_or_else(|error| panic!("{error}"))
}

fn try_load(descriptor: &Descriptor, run: &str, files: &[(&str, String)]) -> Result<DatasetRun, LoadError> {
    let mut open = |path: &Path| {
        let found = files.iter().find(|(name, _)| Path::new(name) == path);
        found.map(|(_, text)| contents(text.clone())).ok_or_else(|| std::io::ErrorKind::NotFound.into())
    };
    load(descriptor, LoadOptions { run, geometry: GEOMETRY, wiring: Wiring::default(), use_every: None }, &mut open)
}

fn contents(bytes: impl Into<Vec<u8>>) -> Box<dyn Read> {
    Box::new(Cursor::new(bytes.into()))
}

fn load_rows(rest: &str, rows: &str) -> DatasetRun {
    try_load(&parse(rest), "only", &[("data.csv", rows.to_owned())]).unwrap()
}

/// The outcome of a case; numbers have twelve decimals.
fn outcome(case: &[&str]) -> Vec<String> {
    let mut parts = case.split(|line| line.starts_with("> "));
    let rest = parts.next().unwrap_or_default().join("\n");
    let names = case.iter().filter_map(|line| line.strip_prefix("> "));
    let files: Vec<_> = names.zip(parts.map(|lines| lines.join("\n"))).collect();
    let descriptor = match Descriptor::from_toml(&(COMMON_KEYS.to_owned() + &rest)) {
        Ok(descriptor) => descriptor,
        Err(error) => return vec![error.to_string()],
    };
    let run = match try_load(&descriptor, "only", &files) {
        Ok(run) => run,
        Err(error) => return vec![error.to_string()],
    };
    let mut lines: Vec<String> = run.start.iter().map(|start| format!("start {start:.12?}")).collect();
    lines.extend(run.landmarks.iter().map(|(id, at)| format!("{id:?} {at:.12?}")));
    lines.extend(run.beacons.iter().map(|(id, at)| format!("{id:?} {at:.12?}")));
    for timed in run.observations.iter() {
        let observation = timed.observation;
        let nanos = [timed.arrival.as_nanos(), observation.stamp.as_nanos(), observation.stamp_sigma.as_nanos()];
        lines.push(format!("{nanos:?} sensor {}: {:.12?}", observation.sensor, observation.measurement));
    }
    let true_pose = |nanos, position, heading| format!("[{nanos}] truth: {position:.12?} {heading:.12?}");
    lines.extend(run.truth.iter().map(|pose| true_pose(pose.time.as_nanos(), pose.position, pose.heading)));
    lines.extend(run.withheld.iter().map(|one| format!("[{}] withheld: {:.12?}", one.time.as_nanos(), one.fix)));
    lines.extend(run.bad_rows.listed.iter().map(|row| format!("bad row {row}")));
    assert_eq!(run.bad_rows.total(), run.bad_rows.listed.len());
    lines
}

#[test]
fn each_case_has_its_outcome() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/datasets.txt");
    let kept = std::fs::read_to_string(path).unwrap();
    let mut found = String::new();
    for case in kept.split("## ").skip(1) {
        let lines: Vec<&str> = case.lines().take_while(|line| !line.starts_with("= ")).collect();
        let blank = lines.iter().rev().take_while(|line| line.is_empty()).count();
        let input = &lines[..lines.len() - blank];
        found.extend(["## ", &input.join("\n"), "\n"]);
        for line in outcome(&input[1..]) {
            found.extend(["= ", &line, "\n"]);
        }
        found.push('\n');
    }
    found.truncate(found.trim_end().len() + 1);
    if std::env::var_os("POSEBRIDGE_WRITE_OUTPUTS").is_some() {
        std::fs::write(path, &found).unwrap();
    }
    for (number, (found, expected)) in found.lines().zip(kept.lines()).enumerate() {
        assert_eq!(found, expected, "line {} of tests/data/datasets.txt", number + 1);
    }
    assert_eq!(found.len(), kept.len(), "an outcome is missing or too long");
}

#[test]
fn an_option_says_which_fixes_are_used() {
    let descriptor = parse("[[fixes]]\nfile = \"data\"\nx = 1\ny = 1\nuse_every = 3\nuse_first = 1");
    let rows = (0..8).map(|n| format!("{n},{n}")).collect::<Vec<_>>().join("\n");
    let mut open = |_: &Path| Ok(contents(rows.clone()));
    for (use_every, used) in
        [(None, &[1.0, 4.0, 7.0][..]), (Some(1), &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]), (Some(0), &[])]
    {
        let options = LoadOptions { run: "only", geometry: GEOMETRY, wiring: Wiring::default(), use_every };
        let run = load(&descriptor, options, &mut open).unwrap();
        let observed = run.observations.iter().map(|timed| {
            let ObservationKind::Fix(fix) = timed.observation.measurement else { panic!("{timed:?}") };
            fix.position.x.0
        });
        assert_eq!(observed.collect::<Vec<_>>(), used);
        assert_eq!(run.withheld.len(), 8 - used.len());
    }
}

#[test]
fn a_row_that_two_streams_refuse_counts_once_and_twenty_are_named() {
    let rest = "[[gyro]]\nfile = \"data\"\nturn_rate = 1\n[[temperature]]\nfile = \"data\"\ntemperature = 1";
    let rows = (0..100).map(|n| format!("{n},bad")).collect::<Vec<_>>().join("\n");
    let run = load_rows(rest, &rows);
    assert_eq!((run.bad_rows.total(), run.bad_rows.listed.len()), (100, 20));
}

#[test]
fn the_default_run_must_be_there() {
    let text = COMMON_KEYS.replace("default_run = \"only\"", "default_run = \"none\"");
    let found = Descriptor::from_toml(&text).unwrap_err().to_string();
    assert_eq!(found, "line 5: default_run: no run's name begins with `none`");
}

const GROUP: &str = r#"
[robot]
track_width_m = 0.2
name = "a"
noise = { gyro_rad_per_s = 0.01, fix_position_m = 0.02 }

[filter]
history_s = 5

[[runs]]
name = "{set}/run-{each}"
each = ["01", "02"]
values = { set = "square" }
robot = { track_width_m = 0.3, noise = { fix_position_m = 0.5 } }

[files.other]
path = "{set}/{run}/log-{each}.csv"
time = { column = 0 }

[[gyro]]
file = "other"
runs = ["square/"]
turn_rate = 1
"#;

#[test]
fn a_group_of_runs_shares_its_values_and_its_robot() {
    let table = |text: &str| toml::from_str::<toml::Table>(text).unwrap();
    let descriptor = parse(GROUP);
    assert_eq!(descriptor.runs, ["only", "square/run-01", "square/run-02"]);
    assert_eq!(descriptor.select("square"), ["square/run-01", "square/run-02"]);
    assert_eq!(descriptor.robot_for("only"), descriptor.robot);
    let merged = "track_width_m = 0.3\nname = \"a\"\nnoise = { gyro_rad_per_s = 0.01, fix_position_m = 0.5 }";
    assert_eq!(descriptor.robot_for("square/run-02"), table(merged));
    assert_eq!(descriptor.filter, table("history_s = 5"));
}

#[test]
fn a_run_is_found_by_a_beginning_that_no_other_has_and_its_paths_are_filled_in() {
    let descriptor = parse(GROUP);
    let files = [("square/square/run-02/log-02.csv", "0,1\n".to_owned())];
    assert_eq!(try_load(&descriptor, "square/run-02", &files).unwrap().observations.len(), 1);
    let elsewhere = try_load(&descriptor, "on", &Vec::new()).unwrap();
    assert_eq!((elsewhere.name.as_str(), elsewhere.observations.len()), ("only", 0), "the stream is of the other runs");
    let error = try_load(&descriptor, "square", &files).unwrap_err();
    assert_eq!(error.to_string(), "2 runs begin with `square`: use one of: only, square/run-01, square/run-02");
    let error = try_load(&descriptor, "square/run-01", &files).unwrap_err();
    assert!(matches!(error, LoadError::Open { .. }), "{error}");
    assert!(error.to_string().contains("square/square/run-01/log-01.csv"));
}

/// Every kind of stream over one file.
const EVERYTHING: &str = include_str!("../data/everything.toml");

proptest! {
    #[test]
    fn no_text_makes_the_descriptor_panic(text in "\\PC*", rest in "[a-z_\\[\\]{}=\" ,0-9\n.-]{0,120}") {
        for text in [text, COMMON_KEYS.to_owned() + &rest] {
            if let Err(error) = Descriptor::from_toml(&text) {
                prop_assert!(error.to_string().starts_with("line "));
            }
        }
    }

    #[test]
    fn any_text_loads_without_a_panic(text in "\\PC*") {
        let loaded = try_load(&parse(EVERYTHING), "only", &[("data.csv", text)]);
        let is_ambiguous = matches!(loaded, Err(LoadError::Dialect { .. }));
        prop_assert!(loaded.is_ok() || is_ambiguous);
    }

    #[test]
    fn any_rows_of_odd_numbers_load_without_a_panic(
        rows in proptest::collection::vec(
            proptest::collection::vec(
                prop_oneof![
                    prop::sample::select(&["0", "-1e308", "1e308", "9223372036", "-9223372036.854775808", "\""][..])
                        .prop_map(str::to_owned),
                    any::<f64>().prop_map(|value| value.to_string()),
                    (-3_i32..30).prop_map(|value| value.to_string()),
                ],
                0..6,
            ),
            0..12,
        )
    ) {
        let lines: Vec<String> = rows.iter().map(|fields| fields.join(",")).collect();
        let run = load_rows(EVERYTHING, &lines.join("\n"));
        let arrivals: Vec<_> = run.observations.iter().map(|timed| timed.arrival).collect();
        prop_assert!(arrivals.is_sorted());
    }

    #[test]
    fn any_bytes_load_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let descriptor = parse(EVERYTHING);
        let gzip = [&[0x1F, 0x8B][..], &bytes].concat();
        for bytes in [bytes, gzip] {
            let options = LoadOptions { run: "only", geometry: GEOMETRY, wiring: Wiring::default(), use_every: None };
            let mut open = |_: &Path| Ok(contents(bytes.clone()));
            let loaded = load(&descriptor, options, &mut open);
            let is_ambiguous = matches!(loaded, Err(LoadError::Dialect { .. }));
            prop_assert!(loaded.is_ok() || is_ambiguous || bytes.starts_with(&[0x1F, 0x8B]));
        }
    }
}

//! Every reason to drop a row: counted, named with file and line, and the run goes on.

use std::path::Path;

use posebridge_recording::dataset::{BadRowReason, DatasetRun, LoadOptions, load};
use posebridge_telemetry::ObservationKind;
use proptest::prelude::*;

use crate::inline::{GEOMETRY, load_rows, observation_kinds, parse, try_load};

const GYRO: &str = "[[gyro]]\nfile = \"data\"\nturn_rate = 1";

/// Checks the one bad row of a run and how many good ones are left.
fn check(run: &DatasetRun, reason: BadRowReason, named: &str, good: usize) {
    assert_eq!(run.bad_rows.count(reason), 1, "{:?}", run.bad_rows);
    assert_eq!(run.bad_rows.total(), 1);
    assert_eq!(run.bad_rows.listed[0].to_string(), named);
    assert_eq!(run.observations.len() + run.truth.len(), good, "{named}");
}

#[test]
fn what_is_not_a_number_is_left_out() {
    for bad in ["x", "", "nan", "inf", "1.5.2", "--"] {
        let run = load_rows(GYRO, &format!("0,1\n1,{bad}\n2,3\n"));
        let named = format!("data.csv:2: not a number: `{bad}`");
        check(&run, BadRowReason::NotNumeric, &named, 2);
    }
}

/// One bad row in a file.
struct BadRowCase {
    /// What stands in the descriptor.
    stream: &'static str,
    rows: &'static str,
    reason: BadRowReason,
    /// How the row is named.
    named: &'static str,
    /// Rows that are used.
    good: usize,
}

#[test]
fn a_bad_row_is_left_out_and_named_and_the_rest_goes_on() {
    use BadRowReason::{
        ImpossibleJump, MissingColumn, NotNumeric, OutOfRange, RepeatedTimestamp, TimeBackwards, ZeroInterval,
    };
    const FIXES: &str = "[[fixes]]\nfile = \"data\"\nx = 1\ny = 2\nmax_speed_m_per_s = 2";
    const TRUTH: &str = "[[truth]]\nfile = \"data\"\nx = 1\ny = 2\nmax_speed_m_per_s = 2";
    const POSES: &str = "[[odometer]]\nfile = \"data\"\nx = 1\ny = 2\nheading = 3\nmax_speed_m_per_s = 2";
    const STEPS: &str = "[[odometer]]\nfile = \"data\"\ndistance = 1\nturn = 2\nmax_speed_m_per_s = 2";
    const GAPS: &str = "max_gap_s = 5\n[[gyro]]\nfile = \"data\"\nturn_rate = 1";
    const RANGE: &str = "[[wall_range]]\nfile = \"data\"\nrange = 1\nmin_m = 0.04\nmax_m = 4";
    const QUATERNION: &str = "[[compass]]\nfile = \"data\"\nheading = { qz = 1, qw = 2 }";
    const LEAP: &str = "data.csv:3: impossible jump: the time leaps by 899 s";
    const JUMP: &str = "data.csv:3: impossible jump: 50.00 m/s, the limit is 2";
    let case = |stream, rows, reason, named, good| BadRowCase { stream, rows, reason, named, good };
    for BadRowCase { stream, rows, reason, named, good } in [
        case(GYRO, "0,1\nyesterday,2\n2,3\n", NotNumeric, "data.csv:2: not a number: `yesterday`", 2),
        case(
            GYRO,
            "0,1\n\n1\n2,3\n",
            MissingColumn,
            "data.csv:3: missing column: column 1 is wanted, the row has 1",
            2,
        ),
        case(GYRO, "0,1\n2,2\n1.5,3\n3,4\n", TimeBackwards, "data.csv:3: time goes back: by 0.5 s", 3),
        case(GYRO, "0,1\n0,2\n1,3\n", ZeroInterval, "data.csv:2: zero interval: the stamp of the row before", 2),
        case(
            FIXES,
            "0,1,1\n0,1,1\n1,1,1\n",
            RepeatedTimestamp,
            "data.csv:2: repeated stamp: the stamp of the fix before",
            2,
        ),
        case(FIXES, "0,0,0\n1,1,0\n2,51,0\n3,3,0\n", ImpossibleJump, JUMP, 3),
        case(TRUTH, "0,0,0\n1,1,0\n2,51,0\n3,3,0\n", ImpossibleJump, JUMP, 3),
        case(POSES, "0,0,0,0\n1,1,0,0\n2,51,0,0\n3,3,0,0\n", ImpossibleJump, JUMP, 3),
        case(STEPS, "0,0,0\n1,1,0\n2,50,0\n3,1,0\n", ImpossibleJump, JUMP, 3),
        case(GAPS, "0,1\n1,2\n900,3\n2,4\n3,5\n", ImpossibleJump, LEAP, 4),
        // A gap that lasts is believed.
        case(GAPS, "0,1\n1,2\n900,3\n901,4\n902,5\n", ImpossibleJump, LEAP, 4),
        case(RANGE, "0,1\n1,0\n2,2\n", OutOfRange, "data.csv:2: out of range: 0 m, the limits are 0.04 to 4", 2),
        case(QUATERNION, "0,0,1\n1,0,0\n", OutOfRange, "data.csv:2: out of range: a quaternion of zeros", 1),
    ] {
        check(&load_rows(stream, rows), reason, named, good);
    }
}

#[test]
fn a_spike_of_a_counter_is_left_out_with_its_way_back() {
    let wheels = |counting: &str, rows: &str| {
        load_rows(
            &format!(
                "[[wheels]]\nfile = \"data\"\ncounting = \"{counting}\"\nmax_wheel_rad_per_s = 10\n\
                 left = {{ column = 1, unit = \"rad\" }}\nright = {{ column = 1, unit = \"rad\" }}"
            ),
            rows,
        )
    };
    let last = |run: &DatasetRun| {
        let Some((_, ObservationKind::WheelAngles { left, .. })) = observation_kinds(run).pop() else {
            panic!("{run:?}");
        };
        left.0
    };
    let absolute = wheels("absolute", "0,100\n1,101\n2,9000\n3,103\n4,104\n");
    assert_eq!(absolute.bad_rows.count(BadRowReason::ImpossibleJump), 2);
    assert_eq!(last(&absolute), 102.0, "the motion of the two bad rows is unknown");
    let increments = wheels("increments", "0,0\n1,1\n2,9000\n3,1\n4,1\n");
    assert_eq!(increments.bad_rows.count(BadRowReason::ImpossibleJump), 1);
    assert_eq!(last(&increments), 3.0);
}

#[test]
fn an_id_that_the_map_does_not_have_is_left_out() {
    let descriptor = parse(
        "[files.map]\npath = \"map.csv\"\n[landmarks]\nfile = \"map\"\nx = 0\ny = 1\n\
         [[landmark_sightings]]\nfile = \"data\"\nid = 1\nrange = 2\nbearing = 3",
    );
    let files = [("data.csv", "0,1,2,0\n1,5,2,0\n"), ("map.csv", "1,1\n2,2\n")];
    let run = try_load(&descriptor, "only", &files).unwrap();
    check(&run, BadRowReason::UnknownId, "data.csv:2: unknown id: 5", 1);
    let halves = [("data.csv", "0,1,2,0\n1,0.5,2,0\n"), files[1]];
    let run = try_load(&descriptor, "only", &halves).unwrap();
    check(&run, BadRowReason::NotNumeric, "data.csv:2: not a number: `0.5`", 1);
}

#[test]
fn a_row_that_two_streams_refuse_counts_once_and_twenty_are_named() {
    let rest = format!("{GYRO}\n[[temperature]]\nfile = \"data\"\ntemperature = 1");
    let rows: Vec<String> = (0..100).map(|n| format!("{n},bad")).collect();
    let run = load_rows(&rest, &rows.join("\n"));
    assert_eq!(run.bad_rows.total(), 100);
    assert_eq!(run.bad_rows.listed.len(), 20);
}

const EVERYTHING: &str = r#"max_gap_s = 100
[landmarks]
file = "data"
id = 1
x = 2
y = 3
[beacons]
file = "data"
x = 2
y = 3
[start]
from = "fixes"
position_sigma_m = 1
heading_sigma_rad = 1
[[wheels]]
file = "data"
counting = "absolute"
wrap_bits = 16
max_wheel_rad_per_s = 50
left = { column = 1, unit = "ticks" }
right = { column = 2, unit = "ticks" }
[[wheels]]
file = "data"
counting = "increments"
left = { column = 1, unit = "m" }
right = { column = 2, unit = "deg" }
[[odometer]]
file = "data"
distance = 1
turn = 2
[[odometer]]
file = "data"
x = 1
y = 2
heading = { qz = 1, qw = 2 }
max_speed_m_per_s = 3
[[body_velocity]]
file = "data"
left = 1
right = 2
interval = "previous"
[[landmark_sightings]]
file = "data"
id = 1
range = 2
bearing = 3
ids = { file = "data", from = 1, to = 2 }
[[beacon_ranges]]
file = "data"
id = 1
range = 2
[[wall_range]]
file = "data"
range = 1
only_changes = true
[[fixes]]
file = "data"
x = 1
y = 2
heading = 3
use_every = 2
[[truth]]
file = "data"
x = 1
y = 2
"#;

proptest! {
    #[test]
    fn any_text_loads_without_a_panic(text in "\\PC*") {
        load_rows(EVERYTHING, &text);
    }

    #[test]
    fn any_rows_of_odd_numbers_load_without_a_panic(
        rows in proptest::collection::vec(
            proptest::collection::vec(
                prop_oneof![
                    Just("0".to_owned()),
                    Just("-1e308".to_owned()),
                    Just("1e308".to_owned()),
                    Just("9223372036".to_owned()),
                    Just("-9223372036.854775808".to_owned()),
                    Just("\"".to_owned()),
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
        let mut gzip = vec![0x1F, 0x8B];
        gzip.extend_from_slice(&bytes);
        for bytes in [bytes, gzip] {
            let options = LoadOptions { run: "only", geometry: GEOMETRY, use_every: None };
            let mut open = |_: &Path| Ok(bytes.clone());
            let loaded = load(&descriptor, options, &mut open);
            prop_assert!(loaded.is_ok() || bytes.starts_with(&[0x1F, 0x8B]));
        }
    }
}

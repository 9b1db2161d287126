//! Every kind of stream, with good rows.

use std::f64::consts::PI;

use posebridge_recording::dataset::{BadRowReason, LoadOptions, load};
use posebridge_telemetry::{
    BeaconId, Celsius, Heading, LandmarkId, Meters, MetersPerSecond, MetersPerSecondSquared, ObservationKind, Point2,
    Pose, Radians, RadiansPerSecond, SensorId,
};

use crate::inline::{GEOMETRY, load_rows, observation_kinds, parse, try_load};

const SECOND: i64 = 1_000_000_000;

/// The wheel angles of a run, rounded to a microradian.
fn wheels(rest: &str, rows: &str) -> Vec<(i64, [i64; 2])> {
    let run = load_rows(rest, rows);
    let angles = observation_kinds(&run).into_iter().map(|(nanos, observed)| {
        let ObservationKind::WheelAngles { left, right } = observed else {
            panic!("{observed:?}");
        };
        let micros = |angle: Radians| (angle.0 * 1e6).round() as i64;
        (nanos, [micros(left), micros(right)])
    });
    angles.collect()
}

/// Wheels that count ticks in these columns, the left one first.
fn in_ticks(counting: &str, [left, right]: [usize; 2]) -> String {
    format!(
        r#"[[wheels]]
        file = "data"
        counting = "{counting}"
        left = {{ column = {left}, unit = "ticks" }}
        right = {{ column = {right}, unit = "ticks" }}"#
    )
}

/// The microradians of both wheels at each stamp.
type ExpectedAngles = &'static [(i64, [i64; 2])];

#[test]
fn counts_and_lengths_of_wheels_become_rotation() {
    let in_units = |left: &str, right: &str| {
        format!(
            "[[wheels]]\nfile = \"data\"\ncounting = \"absolute\"\n\
             left = {{ column = 1, {left} }}\nright = {{ column = 2, {right} }}"
        )
    };
    let cases: [(&str, String, &str, ExpectedAngles); 5] = [
        (
            "absolute ticks have their base",
            in_ticks("absolute", [1, 2]),
            "0,20795,16067\n0.5,20805,16057\n",
            &[(0, [2_079_500_000, 1_606_700_000]), (SECOND / 2, [2_080_500_000, 1_605_700_000])],
        ),
        (
            "increments add up, and the first row is the base",
            in_ticks("increments", [2, 1]),
            "0,99,99\n1,1,2\n2,-3,4\n",
            &[(0, [0, 0]), (SECOND, [200_000, 100_000]), (2 * SECOND, [600_000, -200_000])],
        ),
        (
            "lengths go through the geometry",
            in_units("unit = \"m\"", "unit = \"mm\", scale = -1"),
            "0,0.2,-50\n",
            &[(0, [2_000_000, 1_000_000])],
        ),
        ("angles do not", in_units("unit = \"rad\"", "unit = \"deg\""), "0,1.5,180\n", &[(0, [1_500_000, 3_141_593])]),
        (
            "a counter of 16 bits wraps either way",
            in_ticks("absolute", [1, 2]) + "\nwrap_bits = 16",
            "0,32760,-32760\n1,-32766,32766\n2,-32756,32756\n",
            &[
                (0, [3_276_000_000, -3_276_000_000]),
                (SECOND, [3_277_000_000, -3_277_000_000]),
                (2 * SECOND, [3_278_000_000, -3_278_000_000]),
            ],
        ),
    ];
    for (what, stream, rows, expected) in cases {
        assert_eq!(wheels(&stream, rows), expected, "{what}");
    }
}

#[test]
fn counters_lose_nothing_on_a_row_without_an_interval() {
    // The layout of the LEGO recording: the same stamp twice, here with different counts.
    let absolute = wheels(&in_ticks("absolute", [1, 2]), "0,0,0\n1,10,10\n1,15,15\n2,20,20\n");
    let increments = wheels(&in_ticks("increments", [1, 2]), "0,0,0\n1,10,10\n1,5,5\n2,5,5\n");
    assert_eq!(absolute, increments);
    assert_eq!(absolute.len(), 3);
    assert_eq!(absolute[2], (2 * SECOND, [2_000_000, 2_000_000]));
}

#[test]
fn an_odometer_is_a_pose_with_a_quaternion_or_distances_and_turns() {
    let half = PI / 8.0;
    let pose = load_rows(
        r#"[[odometer]]
        file = "data"
        x = 1
        y = { column = 2, unit = "cm" }
        heading = { qz = 3, qw = 4 }"#,
        &format!("0,1.5,50,{},{}\n", half.sin(), half.cos()),
    );
    let ObservationKind::OdometerPose(found) = observation_kinds(&pose)[0].1 else {
        panic!("{pose:?}");
    };
    assert_eq!((found.x, found.y), (Meters(1.5), Meters(0.5)));
    assert!((found.heading.rad() - PI / 4.0).abs() < 1e-12);
    let steps = load_rows(
        r#"[[odometer]]
        file = "data"
        distance = 1
        turn = { column = 2, unit = "deg" }"#,
        "0,9,9\n1,1,0\n2,0,90\n3,2,0\n",
    );
    let Some((_, ObservationKind::OdometerPose(last))) = observation_kinds(&steps).pop() else {
        panic!("{steps:?}");
    };
    assert!((last.x.0 - 1.0).abs() < 1e-12 && (last.y.0 - 2.0).abs() < 1e-12);
}

#[test]
fn body_velocity_is_forward_and_turn_or_both_wheels() {
    let body = load_rows(
        "[[body_velocity]]\nfile = \"data\"\nforward = { column = 1, unit = \"mm_per_s\" }\nturn = 2",
        "0,250,-0.5\n",
    );
    let forward = MetersPerSecond(0.25);
    let turn = RadiansPerSecond(-0.5);
    assert_eq!(observation_kinds(&body), [(0, ObservationKind::BodyVelocity { forward, turn })]);
    let wheels = load_rows("[[body_velocity]]\nfile = \"data\"\nleft = 1\nright = 2", "0,0.125,0.375\n");
    let turn = RadiansPerSecond(0.5);
    assert_eq!(observation_kinds(&wheels), [(0, ObservationKind::BodyVelocity { forward, turn })]);
}

#[test]
fn a_mean_speed_holds_from_the_row_before() {
    let run = load_rows(
        "[[body_velocity]]\nfile = \"data\"\nforward = 1\nturn = 2\ninterval = \"previous\"",
        "0,1,0\n1,2,0\n3,4,0\n",
    );
    let found: Vec<_> =
        run.observations.iter().map(|timed| (timed.observation.stamp.as_nanos(), timed.arrival.as_nanos())).collect();
    assert_eq!(found, [(0, SECOND), (SECOND, 3 * SECOND)]);
}

#[test]
fn gyro_accelerometers_compass_and_temperature_are_read_in_si_units() {
    let run = load_rows(
        r#"[[gyro]]
        file = "data"
        turn_rate = { column = 1, unit = "deg_per_s", scale = -1 }
        [[accelerometers]]
        file = "data"
        left = { column = 2, unit = "g" }
        right = 3
        [[compass]]
        file = "data"
        heading = { column = 4, unit = "deg", offset = 90, scale = -1 }
        [[temperature]]
        file = "data"
        temperature = { column = 5, unit = "kelvin" }"#,
        "0,180,1,-2,90,273.15\n",
    );
    let expected = [
        ObservationKind::TurnRate(RadiansPerSecond(-PI)),
        ObservationKind::WheelAccelerations {
            left: MetersPerSecondSquared(9.80665),
            right: MetersPerSecondSquared(-2.0),
        },
        ObservationKind::CompassHeading(Heading::from_rad(0.0)),
        ObservationKind::Temperature(Celsius(0.0)),
    ];
    assert_eq!(observation_kinds(&run), expected.map(|observed| (0, observed)));
    let sensors: Vec<_> = run.observations.iter().map(|t| t.observation.sensor).collect();
    assert_eq!(sensors, [SensorId::GYRO, SensorId::ACCELEROMETER, SensorId::COMPASS, SensorId::THERMOMETER]);
}

#[test]
fn a_wall_range_that_is_only_repeated_says_nothing_new() {
    let run = load_rows(
        "[[wall_range]]\nfile = \"data\"\nrange = { column = 1, unit = \"mm\" }\nonly_changes = true",
        "0,4030\n0.01,4030\n0.02,4000\n0.03,4030\n",
    );
    let ranges: Vec<_> = observation_kinds(&run).into_iter().map(|(_, range)| range).collect();
    assert_eq!(ranges, [4.03, 4.0, 4.03].map(|range| ObservationKind::WallRange(Meters(range))));
    assert_eq!(run.bad_rows.total(), 0);
}

const MAPS: &str = r##"[files.map]
path = "map.dat"
delimiter = "whitespace"
comment = "#"
[files.codes]
path = "codes.dat"
delimiter = "whitespace"
[landmarks]
file = "map"
id = 0
x = 1
y = 2
[[landmark_sightings]]
file = "data"
id = 1
ids = { file = "codes", from = 1, to = 0 }
range = 2
bearing = 3
"##;

#[test]
fn sightings_go_through_the_map_of_ids_and_may_share_a_stamp() {
    let files = [
        ("data.csv", "1,72,3.5,-0.25\n1,9,1,0\n"),
        ("map.dat", "# subject x y\n 6 \t 0.5 -4.25 \n7 1 2\n"),
        ("codes.dat", "6 72\n7 9\n"),
    ];
    let run = try_load(&parse(MAPS), "only", &files).unwrap();
    let sighting = |id, range, bearing| ObservationKind::Landmark {
        id: LandmarkId(id),
        range: Meters(range),
        bearing: Radians(bearing),
    };
    assert_eq!(observation_kinds(&run), [(SECOND, sighting(6, 3.5, -0.25)), (SECOND, sighting(7, 1.0, 0.0))]);
    assert_eq!(
        run.landmarks,
        [
            (LandmarkId(6), Point2::new(Meters(0.5), Meters(-4.25))),
            (LandmarkId(7), Point2::new(Meters(1.0), Meters(2.0)))
        ]
    );
}

#[test]
fn sightings_of_what_is_no_landmark_are_dropped_and_no_bad_rows() {
    let files = [
        ("data.csv", "1,72,3.5,-0.25\n1,9,1,0\n2,55,1,0\n"),
        ("map.dat", "6 0.5 -4.25\n"),
        ("codes.dat", "6 72\n1 9\n"),
    ];
    let run = try_load(&parse(&format!("{MAPS}ignore = [1]\n")), "only", &files).unwrap();
    assert_eq!(run.observations.len(), 1);
    assert_eq!(run.bad_rows.count(BadRowReason::UnknownId), 1, "only 55");
    assert_eq!(run.bad_rows.total(), 1);
}

#[test]
fn beacons_may_stand_in_the_rows_of_the_ranges_and_a_filter_tells_rows_apart() {
    let rest = r#"filter = { column = 1, equals = "range2" }
    [beacons]
    file = "data"
    id = 5
    x = 3
    y = 4
    [[beacon_ranges]]
    file = "data"
    id = 5
    range = 2"#;
    let run = load_rows(rest, "1,range2,2.5,-0.02,-0.01,105\n1,odom2diff,0.1,0.2\n2,range2,2.25,-0.02,-0.01,105\n");
    let id = BeaconId(105);
    let range = |range| ObservationKind::BeaconRange { id, range: Meters(range) };
    assert_eq!(observation_kinds(&run), [(SECOND, range(2.5)), (2 * SECOND, range(2.25))]);
    assert_eq!(run.beacons, [(id, Point2::new(Meters(-0.02), Meters(-0.01)))]);
    assert_eq!(run.bad_rows.total(), 0);
}

#[test]
fn truth_may_have_no_heading() {
    let run = load_rows("[[truth]]\nfile = \"data\"\nx = 1\ny = 2", "1,0.5,0.25\n");
    assert!(run.observations.is_empty());
    let [truth] = run.truth.as_slice() else {
        panic!("{run:?}");
    };
    assert_eq!(truth.position, Point2::new(Meters(0.5), Meters(0.25)));
    assert_eq!((truth.time.as_nanos(), truth.heading), (SECOND, None));
}

const FIXES: &str = r#"arrival = { column = 1 }
offset_s = 10
[[fixes]]
file = "data"
x = { column = 2, unit = "mm" }
y = { column = 3, unit = "mm" }
heading = { column = 4, unit = "deg" }
tag = { x_m = 0.03, y_m = -0.01 }
position_sigma_m = 0.01
heading_sigma_rad = 0.1
use_every = 3
use_first = 1
stamp_shift_s = -0.2
sensor = 77
stamp_sigma_s = 0.005
"#;

fn fix_rows() -> String {
    let row = |n: i32| format!("{n},{n}.5,{},0,90", 100 * n);
    let rows: Vec<String> = (0..8).map(row).collect();
    rows.join("\n")
}

#[test]
fn fixes_have_a_lever_arm_an_arrival_and_a_shifted_stamp() {
    let run = load_rows(FIXES, &fix_rows());
    let timed = run.observations[0];
    assert_eq!(timed.arrival.as_nanos(), 11 * SECOND + SECOND / 2);
    let observation = timed.observation;
    assert_eq!(observation.stamp.as_nanos(), 11 * SECOND - SECOND / 5);
    assert_eq!(observation.stamp_sigma.as_nanos(), 5_000_000);
    assert_eq!(observation.sensor, SensorId(77));
    let ObservationKind::Fix(fix) = observation.measurement else {
        panic!("{observation:?}");
    };
    assert_eq!(fix.position, Point2::new(Meters(0.1), Meters(0.0)));
    assert_eq!(fix.tag_in_body, Point2::new(Meters(0.03), Meters(-0.01)));
    assert_eq!(fix.heading, Some(Heading::from_rad(PI / 2.0)));
    let covariance = fix.covariance.unwrap();
    assert!((covariance.xx_m2 - 1e-4).abs() < 1e-18);
    assert!((covariance.heading_rad2 - 1e-2).abs() < 1e-16);
}

/// A receiver at the equator, with variances of its own.
const GPS: &str = r#"
[[fixes]]
file = "data"
latitude = { column = 1, unit = "deg" }
longitude = { column = 2, unit = "deg" }
origin = { latitude_deg = 0.0, longitude_deg = 10.0 }
variance_x = 3
variance_y = { column = 4, unit = "mm2" }
"#;

#[test]
fn latitude_and_longitude_become_metres_with_the_receiver_s_own_variances() {
    let run = load_rows(GPS, "0,0,10,0.81,1000000\n1,0.001,9.999,0.64,490000\n");
    let fixes: Vec<_> = observation_kinds(&run)
        .into_iter()
        .map(|(_, observed)| {
            let ObservationKind::Fix(fix) = observed else {
                panic!("{observed:?}");
            };
            (fix.position, fix.covariance.unwrap())
        })
        .collect();
    assert_eq!(fixes[0].0, Point2::ORIGIN);
    // A thousandth of a degree at the equator: 110.574 m north, 111.320 m west.
    assert!((fixes[1].0.x.0 + 111.319).abs() < 1e-3, "{:?}", fixes[1].0);
    assert!((fixes[1].0.y.0 - 110.574).abs() < 1e-3, "{:?}", fixes[1].0);
    let claims = fixes[1].1;
    assert_eq!((claims.xx_m2, claims.xy_m2), (0.64, 0.0));
    assert!((claims.yy_m2 - 0.49).abs() < 1e-12);
    assert_eq!(claims.heading_rad2, f64::INFINITY);
}

#[test]
fn a_fix_that_claims_no_error_or_lies_behind_the_pole_is_a_bad_row() {
    let run = load_rows(GPS, "0,0,10,0,1\n1,0,10,1,-1\n2,90.5,10,1,1\n3,0,10,1,1000000\n");
    assert_eq!(run.bad_rows.count(BadRowReason::OutOfRange), 3);
    assert_eq!((run.observations.len(), run.bad_rows.total()), (1, 3));
}

#[test]
fn every_third_fix_is_used_and_the_rest_withheld() {
    let positions = |fixes: &mut dyn Iterator<Item = Meters>| {
        let millimetres = fixes.map(|x| (x.0 * 10.0).round() as i64);
        millimetres.collect::<Vec<_>>()
    };
    let check = |use_every: Option<usize>, used: &[i64], withheld: &[i64]| {
        let mut open = |_: &std::path::Path| Ok(fix_rows().into_bytes());
        let options = LoadOptions { run: "only", geometry: GEOMETRY, use_every };
        let run = load(&parse(FIXES), options, &mut open).unwrap();
        let mut fixes = run.observations.iter().filter_map(|timed| {
            let ObservationKind::Fix(fix) = timed.observation.measurement else {
                return None;
            };
            Some(fix.position.x)
        });
        assert_eq!(positions(&mut fixes), used, "{use_every:?}");
        let mut rest = run.withheld.iter().map(|withheld| withheld.fix.position.x);
        assert_eq!(positions(&mut rest), withheld, "{use_every:?}");
    };
    check(None, &[1, 4, 7], &[0, 2, 3, 5, 6]);
    check(Some(1), &[1, 2, 3, 4, 5, 6, 7], &[0]);
    check(Some(0), &[], &[0, 1, 2, 3, 4, 5, 6, 7]);
}

#[test]
fn observations_come_in_the_order_of_their_arrival() {
    let run =
        load_rows("arrival = { column = 1 }\n[[gyro]]\nfile = \"data\"\nturn_rate = 2", "1,9,0.1\n2,5,0.2\n3,9,0.3\n");
    let rates: Vec<_> = observation_kinds(&run).into_iter().map(|(_, rate)| rate).collect();
    assert_eq!(rates, [0.2, 0.1, 0.3].map(|rate| ObservationKind::TurnRate(RadiansPerSecond(rate))));
}

#[test]
fn a_start_is_given_or_comes_from_the_truth_or_a_fix() {
    let loaded =
        load_rows("[start]\nx_m = 1\ny_m = 2\nheading_deg = 180\nposition_sigma_m = 0.01\nheading_sigma_rad = 0.1", "");
    let start = loaded.start.unwrap();
    assert_eq!(start.pose, Pose::new(Meters(1.0), Meters(2.0), Heading::from_rad(PI)));
    assert_eq!((start.position_sigma_m, start.heading_sigma_rad), (0.01, 0.1));

    let from = "[start]\nfrom = \"fixes\"\nposition_sigma_m = 0.01\nheading_sigma_rad = 0.1";
    let rest = r#"[files.gyro]
    path = "gyro.csv"
    time = { column = 0 }
    [[gyro]]
    file = "gyro"
    turn_rate = 1
    [[fixes]]
    file = "data"
    x = 1
    y = 2
    heading = { column = 3, unit = "deg" }
    tag = { x_m = 0.5, y_m = 0 }
    use_every = 0
    "#;
    let descriptor = parse(&format!("{rest}{from}"));
    let files = [("data.csv", "2,1,1,90\n"), ("gyro.csv", "1,0\n3,0\n")];
    let run = try_load(&descriptor, "only", &files).unwrap();
    let pose = run.start.unwrap().pose;
    assert!((pose.x.0 - 1.0).abs() < 1e-12 && (pose.y.0 - 0.5).abs() < 1e-12);
    assert_eq!(observation_kinds(&run).len(), 1, "what lies before the start is left out");
    assert_eq!(run.withheld.len(), 1);
}

#[test]
fn times_may_have_two_columns_and_rows_another_order() {
    let rest = r#"[files.log]
    path = "log.txt"
    delimiter = "tab"
    header_lines = 2
    order = "time"
    time = { column = "sec", unit = "s", plus = { column = "nsec", unit = "ns" } }
    [[gyro]]
    file = "log"
    turn_rate = "rate"
    "#;
    let log = "a title\nrate\tsec\tnsec\n0.25\t1493325165\t641284114\n0.5\t1493325165\t7\n";
    let run = try_load(&parse(rest), "only", &[("log.txt", log)]).unwrap();
    let rate = |rate| ObservationKind::TurnRate(RadiansPerSecond(rate));
    assert_eq!(
        observation_kinds(&run),
        [(1_493_325_165_000_000_007, rate(0.5)), (1_493_325_165_641_284_114, rate(0.25))]
    );
}

//! The shipped descriptors can be read, and their recordings give the published figures.
//!
//! One set of optiodom is in the repository. The other recordings may not be shipped: their tests run if
//! `POSEBRIDGE_DATA` names the folder that holds them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use posebridge_recording::dataset::{BadRowReason, DatasetRun, Descriptor, LoadOptions};
use posebridge_telemetry::{
    BrickClock, DriveGeometry, Fix, Meters, ObservationKind, Odom, Pose as OdomPose, Timestamp,
};

use crate::dead_reckoning::{
    PathErrorStatistics, Pose, advance, against_truth, dead_reckoning, descriptor, geometry, load_from, motion,
    repository,
};

fn foreign_data() -> Option<PathBuf> {
    std::env::var_os("POSEBRIDGE_DATA").map(PathBuf::from)
}

fn load_with(data: &Path, descriptor: &Descriptor, run: &str, geometry: DriveGeometry) -> DatasetRun {
    let use_every = None;
    let options = LoadOptions { run, geometry, use_every };
    load_from(data, descriptor, options)
}

fn load_run(data: &Path, file: &str, run: &str) -> (DriveGeometry, DatasetRun) {
    let descriptor = descriptor(file);
    let geometry = geometry(&descriptor.robot_for(run));
    (geometry, load_with(data, &descriptor, run, geometry))
}

fn count_by_kind(run: &DatasetRun) -> BTreeMap<&'static str, usize> {
    let mut kinds = BTreeMap::new();
    for timed in &run.observations {
        *kinds.entry(timed.observation.measurement.kind()).or_insert(0) += 1;
    }
    kinds
}

/// The errors as the published tables print them.
fn format_errors(errors: &PathErrorStatistics) -> String {
    format!("{:.4} / {:.4} / {:.4} / {:.2}", errors.rms_m, errors.max_m, errors.end_m, errors.heading_rms_deg)
}

/// The position errors as the coarser tables print them.
fn in_centimetres(errors: &PathErrorStatistics) -> String {
    let PathErrorStatistics { rms_m, max_m, end_m, .. } = errors;
    format!("{rms_m:.2} / {max_m:.2} / {end_m:.2}")
}

#[test]
fn every_shipped_descriptor_is_valid_and_describes_its_robot() {
    let folder = repository().join("config/recordings");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let file = entry.unwrap().file_name().into_string().unwrap();
        let descriptor = descriptor(&file);
        assert_eq!(format!("{}.toml", descriptor.name), file);
        assert!(!descriptor.select(&descriptor.default_run).is_empty());
        for run in &descriptor.runs {
            let geometry = geometry(&descriptor.robot_for(run));
            assert!(geometry.track_width.0 > 0.0, "{file} {run}");
        }
        names.push(descriptor.name);
    }
    assert!(names.len() >= 9, "{names:?}");
}

#[test]
fn the_worked_example_of_the_documentation_is_a_descriptor() {
    let page = std::fs::read_to_string(repository().join("docs/recordings.md")).unwrap();
    let (_, behind) = page.split_once("```toml\n").unwrap();
    let (example, _) = behind.split_once("```").unwrap();
    let descriptor = Descriptor::from_toml(example).unwrap();
    assert_eq!(descriptor.runs, ["corridor/1", "corridor/2"]);
}

/// The calibration that the authors publish for circular/250620202104 (their table of results).
fn calibration_c(nominal: DriveGeometry) -> DriveGeometry {
    DriveGeometry {
        left_wheel_radius: Meters(0.083_378 / 2.0),
        right_wheel_radius: Meters(0.083_342 / 2.0),
        track_width: Meters(0.200_842),
        ..nominal
    }
}

/// Mean over the runs of a set, with the nominal geometry and with the calibration.
fn check_set(data: &Path, set: &str, runs: usize, expected: [&str; 2]) {
    let descriptor = descriptor("optiodom.toml");
    let nominal = geometry(&descriptor.robot);
    let names = descriptor.select(set);
    assert_eq!(names.len(), runs, "{set}");
    let found = [nominal, calibration_c(nominal)].map(|geometry| {
        let mut mean = PathErrorStatistics::default();
        for name in &names {
            let run = load_with(data, &descriptor, name, geometry);
            assert_eq!(run.bad_rows.total(), 0, "{name}: {:?}", run.bad_rows.listed);
            let errors = against_truth(&run, &dead_reckoning(&run, geometry));
            mean.add(&errors, 1.0 / runs as f64);
        }
        format_errors(&mean)
    });
    assert_eq!(found, expected, "{set}");
}

#[test]
fn optiodom_dead_reckoning_gives_the_published_figures() {
    check_set(
        &repository().join("tests/data"),
        "circular/250620202104/",
        6,
        ["0.0291 / 0.0457 / 0.0421 / 5.43", "0.0064 / 0.0121 / 0.0043 / 0.92"],
    );
}

#[test]
fn the_other_optiodom_sets_give_them_too() {
    let Some(data) = foreign_data() else {
        return;
    };
    check_set(
        &data,
        "square/230620202317/",
        10,
        ["0.0115 / 0.0223 / 0.0202 / 1.30", "0.0111 / 0.0204 / 0.0192 / 1.15"],
    );
    check_set(&data, "square/231220200040/", 6, ["0.0509 / 0.0834 / 0.0740 / 2.59", "0.0294 / 0.0488 / 0.0211 / 1.13"]);
    check_set(&data, "free/030120210001/", 2, ["0.0411 / 0.0718 / 0.0418 / 2.23", "0.0175 / 0.0321 / 0.0210 / 1.71"]);
}

/// All fixes of a run, used and withheld, in order.
fn all_fixes(run: &DatasetRun) -> Vec<(i64, Fix)> {
    let used = run.observations.iter().filter_map(|timed| {
        if let ObservationKind::Fix(fix) = timed.observation.measurement {
            return Some((timed.observation.stamp.as_nanos(), fix));
        }
        None
    });
    let withheld = run.withheld.iter().map(|w| (w.time.as_nanos(), w.fix));
    let mut fixes: Vec<_> = used.chain(withheld).collect();
    fixes.sort_by_key(|(nanos, _)| *nanos);
    fixes
}

/// Distance between a fix and where the pose puts its tag, in mm.
fn tag_error_mm([x, y, heading]: Pose, fix: &Fix) -> f64 {
    let [tag_x, tag_y, _] = advance([x, y, heading], fix.tag_in_body.x.0, 0.0);
    1e3 * (tag_x - fix.position.x.0).hypot(tag_y - fix.position.y.0)
}

#[test]
fn lego_dead_reckoning_gives_the_published_figures() {
    let Some(data) = foreign_data() else {
        return;
    };
    let (nominal, run) = load_run(&data, "lego-nxt-camera.toml", "robot4");
    let found = [0.155, 0.173].map(|track_m| {
        let track_width = Meters(track_m);
        let geometry = DriveGeometry { track_width, ..nominal };
        let steps = motion(&run, geometry);
        // The first camera record is the start itself; the last one lies behind the last count.
        let errors: Vec<f64> = all_fixes(&run)[1..]
            .iter()
            .filter_map(|(nanos, fix)| {
                let step = steps.iter().find(|step| step.contains(*nanos))?;
                Some(tag_error_mm(step.at(*nanos), fix))
            })
            .collect();
        assert_eq!(errors.len(), 276);
        let squares: f64 = errors.iter().map(|error| error * error).sum();
        let rms = f64::sqrt(squares / errors.len() as f64);
        let max = errors.iter().copied().fold(0.0, f64::max);
        (format!("{rms:.1}"), format!("{max:.0}"))
    });
    let expected = [("597.4", "1172"), ("68.6", "149")];
    assert_eq!(found, expected.map(|(rms, max)| (rms.to_owned(), max.to_owned())));
    assert_eq!(run.bad_rows.count(BadRowReason::ZeroInterval), 61);
    assert_eq!(run.bad_rows.total(), 61);
    // 278 records, every fourth from the first; of those withheld, 207 lie between the encoder records.
    assert_eq!(run.withheld.len(), 208);
}

#[test]
fn the_early_camera_differs_in_nothing_but_its_stamps() {
    let Some(data) = foreign_data() else {
        return;
    };
    let (_, plain) = load_run(&data, "lego-nxt-camera.toml", "robot4");
    let (_, early) = load_run(&data, "lego-nxt-camera.toml", "camera-200ms-earlier");
    let shifted: Vec<_> = all_fixes(&plain).into_iter().map(|(nanos, fix)| (nanos - 200_000_000, fix)).collect();
    assert_eq!(all_fixes(&early), shifted);
}

#[test]
fn neato_streams_are_complete_and_repeated_stamps_are_counted() {
    let Some(data) = foreign_data() else {
        return;
    };
    let file = "neato-gyro-camera.toml";
    let (_, slip) = load_run(&data, file, "rotate_slip_a");
    assert_eq!(slip.bad_rows.total(), 0);
    assert!(slip.start.is_some());
    assert!(
        slip.observations.iter().any(|timed| timed.arrival.as_nanos() > timed.observation.stamp.as_nanos()),
        "arrivals of their own"
    );
    let (_, square) = load_run(&data, file, "square_undisturbed");
    assert_eq!(square.bad_rows.count(BadRowReason::RepeatedTimestamp), 160);
    assert_eq!(square.bad_rows.total(), 160);
    let (_, turning) = load_run(&data, file, "turning_180");
    assert!(turning.withheld.is_empty());
    assert_eq!(count_by_kind(&turning), BTreeMap::from([("odometer_pose", 207), ("turn_rate", 1373)]));
}

#[test]
fn roomba_counts_and_gyro_give_the_published_turns() {
    let Some(data) = foreign_data() else {
        return;
    };
    for (name, wheels_deg, gyro_deg) in [("drive-turn-180", "-180.4", "-179.5"), ("circle", "-327.9", "-322.2")] {
        let (geometry, run) = load_run(&data, "roomba-imu.toml", name);
        let poses = dead_reckoning(&run, geometry);
        let heading_deg = poses.last().unwrap().1[2].to_degrees();
        let (mut gyro_rad, mut last) = (0.0, None::<Timestamp<BrickClock>>);
        for timed in &run.observations {
            if let ObservationKind::TurnRate(rate) = timed.observation.measurement {
                let now = timed.observation.stamp;
                gyro_rad += last.map_or(0.0, |last| rate.0 * (now - last).as_secs_f64());
                last = Some(now);
            }
        }
        let found = [format!("{heading_deg:.1}"), format!("{:.1}", gyro_rad.to_degrees())];
        assert_eq!(found, [wheels_deg, gyro_deg], "{name}");
    }
}

/// Poses at the observations of a foreign odometer or its speeds, each held until the next.
fn odometer_poses(run: &DatasetRun) -> Vec<(i64, Pose)> {
    let start = run.start.unwrap().pose;
    let mut pose = [start.x.0, start.y.0, start.heading.rad()];
    let mut held: Option<(Timestamp<BrickClock>, f64, f64)> = None;
    let mut last_odometer: Option<OdomPose<Odom>> = None;
    let mut poses = Vec::new();
    for timed in &run.observations {
        let now = timed.observation.stamp;
        if let ObservationKind::BodyVelocity { forward, turn } = timed.observation.measurement {
            if let Some((since, forward, turn)) = held {
                let interval_s = (now - since).as_secs_f64();
                pose = advance(pose, forward * interval_s, turn * interval_s);
            }
            held = Some((now, forward.0, turn.0));
        } else if let ObservationKind::OdometerPose(odom) = timed.observation.measurement {
            if let Some(last) = last_odometer.replace(odom) {
                let moved = last.inverse() * odom.origin();
                let (sin, cos) = pose[2].sin_cos();
                pose = [
                    pose[0] + cos * moved.x.0 - sin * moved.y.0,
                    pose[1] + sin * moved.x.0 + cos * moved.y.0,
                    pose[2] + (odom.heading - last.heading).0,
                ];
            }
        } else {
            continue;
        }
        poses.push((now.as_nanos(), pose));
    }
    if let (Some((since, forward, turn)), Some(end)) = (held, run.truth.last())
        && end.time > since
    {
        let interval_s = (end.time - since).as_secs_f64();
        let last = advance(pose, forward * interval_s, turn * interval_s);
        poses.push((end.time.as_nanos(), last));
    }
    poses
}

#[test]
fn plaza_dead_reckoning_gives_the_published_figures() {
    let Some(data) = foreign_data() else {
        return;
    };
    let (_, run) = load_run(&data, "plaza1.toml", "plaza1");
    let errors = against_truth(&run, &odometer_poses(&run));
    assert_eq!(in_centimetres(&errors), "2.25 / 5.17 / 5.17");
    assert_eq!(count_by_kind(&run)["beacon_range"], 3529);
    assert_eq!((run.beacons.len(), run.bad_rows.total()), (4, 0));
}

#[test]
fn labyrinth_dead_reckoning_gives_the_published_figures() {
    let Some(data) = foreign_data() else {
        return;
    };
    let (_, run) = load_run(&data, "uwb-labyrinth.toml", "labyrinth");
    let errors = against_truth(&run, &odometer_poses(&run));
    assert_eq!(format_errors(&errors), "0.1101 / 0.2205 / 0.1781 / 0.00");
    assert_eq!(count_by_kind(&run), BTreeMap::from([("beacon_range", 233), ("body_velocity", 232)]));
    assert_eq!((run.beacons.len(), run.bad_rows.total()), (4, 0));
}

#[test]
fn mrclam_sightings_are_those_of_known_landmarks() {
    let Some(data) = foreign_data() else {
        return;
    };
    // The published figures, 2.62 / 8.33 / 8.33 and 2.98 / 8.98 / 3.55, are taken at other instants (those of the
    // events); these are taken at the stamps of the truth.
    for (name, sightings, dead_reckoning) in
        [("robot1", 1534, "2.73 / 8.33 / 8.33"), ("robot2", 3239, "3.01 / 8.99 / 3.57")]
    {
        let (_, run) = load_run(&data, "mrclam6.toml", name);
        let errors = against_truth(&run, &odometer_poses(&run));
        assert_eq!(in_centimetres(&errors), dead_reckoning, "{name}");
        assert_eq!(count_by_kind(&run)["landmark"], sightings, "{name}");
        // Nobody carries bar code 43 or the like; the other robots are known and ignored.
        assert!(run.bad_rows.total() <= 3, "{:?}", run.bad_rows.listed);
        assert_eq!(run.landmarks.len(), 15);
    }
}

#[test]
fn ranges_and_temperatures_are_read_in_their_units() {
    let Some(data) = foreign_data() else {
        return;
    };
    let (_, car) = load_run(&data, "tof-wall.toml", "robotA-80-step");
    let ranges: Vec<ObservationKind> = car.observations.iter().map(|timed| timed.observation.measurement).collect();
    assert_eq!(ranges.first(), Some(&ObservationKind::WallRange(Meters(4.03))));
    assert_eq!(ranges.last(), Some(&ObservationKind::WallRange(Meters(0.443))));
    for (name, first) in [("KM", 25.0), ("KiS", 25.0), ("LG", 24.88)] {
        let (_, run) = load_run(&data, "ds18b20-step.toml", name);
        let ObservationKind::Temperature(found) = run.observations[0].observation.measurement else {
            panic!("{name}: not a temperature");
        };
        assert_eq!((found.0, run.bad_rows.total()), (first, 0), "{name}");
    }
}

#[test]
fn husky_streams_are_complete_and_the_gps_draws_the_published_extent() {
    let Some(data) = foreign_data() else {
        return;
    };
    let (_, run) = load_run(&data, "husky-outdoor.toml", "husky");
    assert_eq!(run.bad_rows.total(), 0);
    assert_eq!((run.start, run.truth.len()), (None, 0));
    assert_eq!(count_by_kind(&run), BTreeMap::from([("body_velocity", 3951), ("fix", 494), ("turn_rate", 11_865)]));
    let fixes = all_fixes(&run);
    let (first, last) = (&fixes[0].1, &fixes[fixes.len() - 1].1);
    assert!(first.position.x.0.hypot(first.position.y.0) < 1e-6);
    let end_m = last.position.x.0.hypot(last.position.y.0);
    assert!((end_m - 13.0).abs() < 0.5, "{end_m}");
    let extent = |of: fn(&Fix) -> f64| {
        let values = fixes.iter().map(|(_, fix)| of(fix));
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        high - low
    };
    // Published as 57 x 146 m without a formula; a sphere of 6371 km gives 57.46 m where the ellipsoid gives 57.61 m.
    let (east_m, north_m) = (extent(|fix| fix.position.x.0), extent(|fix| fix.position.y.0));
    assert!((east_m - 57.61).abs() < 0.01, "{east_m}");
    assert!((north_m - 146.0).abs() < 0.5, "{north_m}");
    let withheld_last = run.withheld.last().unwrap().time.as_nanos();
    assert_eq!(withheld_last, fixes[fixes.len() - 1].0, "the end is not given");
    for (_, fix) in &fixes {
        let claims = fix.covariance.unwrap();
        assert!((0.6..3.0).contains(&claims.xx_m2) && claims.xx_m2 == claims.yy_m2);
    }
}

#[test]
fn baths_and_centimetres_are_those_of_their_owners() {
    let Some(data) = foreign_data() else {
        return;
    };
    for (name, from, to) in
        [("heating-20-56", 20.5, 56.0), ("cooling-55-21", 55.5, 21.0), ("heating-21-76", 21.0, 76.0)]
    {
        let (_, run) = load_run(&data, "rtd-step.toml", name);
        let degrees: Vec<f64> = run
            .observations
            .iter()
            .map(|timed| {
                let ObservationKind::Temperature(degrees) = timed.observation.measurement else {
                    panic!("{name}: not a temperature");
                };
                degrees.0
            })
            .collect();
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let (first, last) = (mean(&degrees[..100]), mean(&degrees[degrees.len() - 100..]));
        assert!((first - from).abs() < 0.01, "{name}: {first}");
        assert!((last - to).abs() < 0.01, "{name}: {last}");
        assert_eq!(run.bad_rows.total(), 0, "{name}");
    }
    let (_, run) = load_run(&data, "nxt-ultrasonic.toml", "separation");
    assert_eq!((run.observations.len(), run.bad_rows.total()), (303, 0));
    let first = run.observations[0].observation.measurement;
    assert_eq!(first, ObservationKind::WallRange(Meters(0.21)));
}

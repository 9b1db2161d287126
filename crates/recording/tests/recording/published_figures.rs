//! The shipped descriptors can be read, and their recordings give the published figures.
//!
//! One set of optiodom is in the repository. The other recordings may not be shipped: their tests run if
//! `POSEBRIDGE_DATA` names the folder that holds them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use posebridge_recording::dataset::{BadRowReason, DatasetRun, Descriptor, LoadOptions};
use posebridge_telemetry::{
    BrickClock, DriveGeometry, Fix, Meters, ObservationKind, Odom, Pose as OdomPose, Timestamp, Wiring,
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
    let options = LoadOptions { run, geometry, wiring: Wiring::default(), use_every };
    load_from(data, descriptor, options)
}

fn load_run(data: &Path, file: &str, run: &str) -> (DriveGeometry, DatasetRun) {
    let descriptor = descriptor(file);
    let geometry = geometry(&descriptor.robot_for(run));
    (geometry, load_with(data, &descriptor, run, geometry))
}

/// The errors as the published tables print them.
fn format_errors(errors: &PathErrorStatistics) -> String {
    format!("{:.4} / {:.4} / {:.4} / {:.2}", errors.rms_m, errors.max_m, errors.end_m, errors.heading_rms_deg)
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
fn roomba_counts_and_gyro_give_the_published_turns() {
    let Some(data) = foreign_data() else {
        return;
    };
    for (name, wheels_deg, gyro_deg) in [("drive-turn-180", "-180.4", "-179.5"), ("circle", "-327.9", "-322.2")] {
        let (geometry, run) = load_run(&data, "roomba-imu.toml", name);
        let poses = dead_reckoning(&run, geometry);
        let heading_deg = poses.last().unwrap().1[2].to_degrees();
        let (mut gyro_rad, mut last) = (0.0, None::<Timestamp<BrickClock>>);
        for timed in run.observations.iter() {
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
    for timed in run.observations.iter() {
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

/// What a run holds, in one line.
fn summary((geometry, run): &(DriveGeometry, DatasetRun)) -> String {
    let mut kinds = BTreeMap::new();
    for timed in run.observations.iter() {
        *kinds.entry(timed.observation.measurement.kind()).or_insert(0) += 1;
    }
    let late = run.observations.iter().filter(|timed| timed.arrival.as_nanos() > timed.observation.stamp.as_nanos());
    let maps = [run.landmarks.len(), run.beacons.len()];
    let others = [run.truth.len(), run.withheld.len(), late.count()];
    let ends = [run.observations.first(), run.observations.last()].map(|end| end.unwrap().observation.measurement);
    let errors = run.start.filter(|_| !run.truth.is_empty()).map(|_| {
        let has_wheels = kinds.contains_key("wheel_angles");
        let poses = if has_wheels { dead_reckoning(run, *geometry) } else { odometer_poses(run) };
        format_errors(&against_truth(run, &poses))
    });
    format!("{kinds:?}, bad {:?}, {maps:?}, {others:?}, {ends:.6?}, {errors:?}", run.bad_rows.counts)
}

/// `tests/data/published.txt` has a line for each run; with `POSEBRIDGE_WRITE_OUTPUTS=1` they are written anew.
#[test]
fn foreign_runs_are_complete_and_give_the_published_figures() {
    let Some(data) = foreign_data() else {
        return;
    };
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/published.txt");
    let kept = std::fs::read_to_string(path).unwrap();
    let mut found = String::new();
    for line in kept.lines() {
        let run = line.split(": ").next().unwrap();
        match run.split_once(' ') {
            Some((file, name)) if !run.starts_with('#') => {
                found.extend([run, ": ", &summary(&load_run(&data, file, name)), "\n"]);
            }
            _ => found.extend([line, "\n"]),
        }
    }
    if std::env::var_os("POSEBRIDGE_WRITE_OUTPUTS").is_some() {
        std::fs::write(path, &found).unwrap();
    }
    for (found, expected) in found.lines().zip(kept.lines()) {
        assert_eq!(found, expected);
    }
}

#[test]
fn the_gps_of_the_husky_draws_the_published_extent() {
    let Some(data) = foreign_data() else {
        return;
    };
    let (_, run) = load_run(&data, "husky-outdoor.toml", "husky");
    let fixes = all_fixes(&run);
    let extent = |of: fn(&Fix) -> f64| {
        let values = || fixes.iter().map(|(_, fix)| of(fix));
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    // Published as 57 x 146 m without a formula; a sphere of 6371 km gives 57.46 m where the ellipsoid gives 57.61 m.
    let (east_m, north_m) = (extent(|fix| fix.position.x.0), extent(|fix| fix.position.y.0));
    assert!((east_m - 57.61).abs() < 0.01, "{east_m}");
    assert!((north_m - 146.0).abs() < 0.5, "{north_m}");
    assert_eq!(run.withheld.last().unwrap().time.as_nanos(), fixes.last().unwrap().0, "the end is not given");
    for (_, fix) in &fixes {
        let claims = fix.covariance.unwrap();
        assert!((0.6..3.0).contains(&claims.xx_m2) && claims.xx_m2 == claims.yy_m2);
    }
}

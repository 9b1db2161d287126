//! The filters for a brick, brick/filters/: compiled by the system's C compiler, held step by step against those of the station.
//!
//! Every quantity must agree to 1e-9 of the largest value that it takes in the drive. What single precision costs is printed.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use posebridge::config::{Config, RobotProfile};
use posebridge_estimator::papers::ekf5::{self, FixUsage};
use posebridge_estimator::papers::paper1::{FiveStateMatrices, SAMPLING_INTERVAL_S, SpeedMatrices};
use posebridge_estimator::papers::velocity_kf;
use posebridge_estimator::{Filter, FilterConfig, find_filter};
use posebridge_lab::square::{SensorRow, SensorTable, TableSensor, parse, write};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{
    Celsius, Estimate, FusionOutcome, Meters, MetersPerSecond, Observation, ObservationKind, RadiansPerSecond,
    SensorId, TimeDelta, Timestamp,
};

use crate::support::root;

/// Of the largest value in the drive.
const TOLERANCE: f64 = 1e-9;
const SENSES: &[TableSensor] = &[TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro];

fn config() -> FilterConfig {
    let robot = RobotProfile::from_toml(include_str!("../data/filters-robot.toml")).unwrap();
    let mut config = Config::default().with_robot(robot).filter_config().unwrap();
    // The brick takes the sigma of the gyro's bias from the calibration alone.
    config.noise.gyro_bias_rad_per_s = 0.0;
    config
}

/// The indirect filter learns the geometry; the others would take another one from it.
fn indirect_config() -> FilterConfig {
    let mut config = config();
    config.calibration.radius_scale.sigma = 0.004;
    config.calibration.radius_difference.sigma = 0.002;
    config.calibration.track_scale.sigma = 0.03;
    config
}

/// The same numbers as the program on the brick takes them.
fn settings(config: &FilterConfig) -> Vec<String> {
    let (geometry, noise) = (&config.geometry, &config.noise);
    let start = config.start.unwrap();
    let bias = config.calibration.gyro_bias_rad_per_s;
    let scales = indirect_config().calibration;
    [
        ("left_radius_m", geometry.left_wheel_radius.0),
        ("right_radius_m", geometry.right_wheel_radius.0),
        ("track_m", geometry.track_width.0),
        ("tick_rad", geometry.tick.0),
        ("x_m", start.pose.x.0),
        ("y_m", start.pose.y.0),
        ("heading_rad", start.pose.heading.rad()),
        ("position_sigma_m", start.position_sigma_m),
        ("heading_sigma_rad", start.heading_sigma_rad),
        ("wheel_m_sqrt_m", noise.wheel_travel_m_per_sqrt_m),
        ("travel_m_sqrt_m", noise.travel_m_per_sqrt_m),
        ("turn_rad_sqrt_rad", noise.turn_rad_per_sqrt_rad),
        ("heading_rad_sqrt_m", noise.heading_rad_per_sqrt_m),
        ("gyro_rad_s", noise.gyro_rad_per_s),
        ("gyro_resolution_rad_s", noise.gyro_resolution_rad_per_s),
        ("bias_rad_s", bias.value),
        ("bias_sigma_rad_s", bias.sigma),
        ("bias_walk_rad_s_sqrt_s", noise.gyro_bias_walk_rad_per_s_sqrt_s),
        ("accel_m_s2", config.params.acceleration_m_per_s2),
        ("turn_accel_rad_s2", config.params.turn_acceleration_rad_per_s2),
        ("accelerometer_m_s2", noise.accelerometer_m_per_s2),
        ("radius_scale", scales.radius_scale.sigma),
        ("radius_difference", scales.radius_difference.sigma),
        ("track_scale", scales.track_scale.sigma),
    ]
    .map(|(name, value)| format!("{name}={value}"))
    .to_vec()
}

/// Compiles the program into `folder`; without a compiler the test says what to install.
fn compiled(folder: &Path, real: &str) -> PathBuf {
    let program = folder.join(format!("replay-{real}"));
    let sources = root().join("brick/filters");
    let compiler = ["cc", "gcc", "clang"].into_iter().find(|name| {
        let found = Command::new(name).arg("--version").stdout(Stdio::null()).status();
        found.is_ok_and(|status| status.success())
    });
    let Some(compiler) = compiler else {
        panic!("there is no C compiler: none of cc, gcc, clang starts; install gcc to check brick/filters");
    };
    let output = Command::new(compiler)
        .args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"])
        .arg(format!("-DPB_REAL={real}"))
        .args(["replay.c", "posebridge_filters.c", "posebridge_indirect.c", "-lm", "-o"])
        .arg(&program)
        .current_dir(sources)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{compiler}: {said}");
    program
}

fn run(program: &Path, file: &Path, settings: &[String]) -> Output {
    let input = std::fs::File::open(file).unwrap();
    Command::new(program).args(settings).stdin(input).output().unwrap()
}

/// What the program printed: of each row, of each name, its numbers.
fn beliefs(program: &Path, file: &Path, settings: &[String]) -> Vec<Vec<(String, Vec<f64>)>> {
    let output = run(program, file, settings);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(named_numbers).collect()
}

fn named_numbers(line: &str) -> Vec<(String, Vec<f64>)> {
    let mut named: Vec<(String, Vec<f64>)> = Vec::new();
    for cell in line.split(',').skip(1) {
        match (cell.parse(), named.last_mut()) {
            (Ok(number), Some((_, numbers))) => numbers.push(number),
            _ => named.push((cell.to_owned(), Vec::new())),
        }
    }
    named
}

/// What the station's filters believe, under the names that the program prints.
fn expected(table: &SensorTable, config: &FilterConfig) -> Vec<(&'static str, Vec<Vec<f64>>)> {
    let own_speeds = velocity_kf::build(config, &speeds_by_rounding(config));
    let swapped = ekf5::build(config, &FiveStateMatrices::SWAPPED, FixUsage::Unused);
    vec![
        ("wheel-kf", states(table, config, named("wheel-kf", config))),
        ("velocity-kf", states(table, config, named("velocity-kf", config))),
        ("velocity-kf own", states(table, config, own_speeds)),
        ("ekf5", states(table, config, named("ekf5", config))),
        ("ekf5 swapped", states(table, config, swapped)),
        ("ekf5-corrected", states(table, config, named("ekf5-corrected", config))),
        ("indirect", states(table, &indirect_config(), named("indirect", &indirect_config()))),
        ("indirect-feedback", states(table, &indirect_config(), named("indirect-feedback", &indirect_config()))),
        ("P of ekf5", variances(table, config, "ekf5")),
        ("P of ekf5-corrected", variances(table, config, "ekf5-corrected")),
    ]
}

fn variances(table: &SensorTable, config: &FilterConfig, name: &str) -> Vec<Vec<f64>> {
    estimates(table, config, named(name, config), |estimate| (0..5).map(|i| estimate.covariance[i][i]).collect())
}

fn named(name: &str, config: &FilterConfig) -> Box<dyn Filter> {
    (find_filter(name).unwrap().build)(config)
}

/// The matrices of `pb_speed_corrected`: R by the rounding of the counters, Q by the noise of the accelerometers; cm and degrees.
fn speeds_by_rounding(config: &FilterConfig) -> SpeedMatrices {
    let geometry = &config.geometry;
    let radius_m = f64::midpoint(geometry.left_wheel_radius.0, geometry.right_wheel_radius.0);
    let count_cm = 100.0 * radius_m * geometry.tick.0 / SAMPLING_INTERVAL_S;
    let felt_cm = 100.0 * config.noise.accelerometer_m_per_s2 * SAMPLING_INTERVAL_S;
    // Of a difference of two wheels, over the track.
    let turn_deg = |wheel_cm: f64| (wheel_cm / (100.0 * geometry.track_width.0)).to_degrees();
    let variances = [count_cm.powi(2) / 12.0, turn_deg(count_cm).powi(2) / 3.0];
    let process = [felt_cm.powi(2) / 2.0, 2.0 * turn_deg(felt_cm).powi(2)];
    SpeedMatrices { process, variances, initial: variances }
}

fn states(table: &SensorTable, config: &FilterConfig, filter: Box<dyn Filter>) -> Vec<Vec<f64>> {
    estimates(table, config, filter, |estimate| {
        let pose = estimate.pose;
        vec![pose.x.0, pose.y.0, pose.heading.rad(), estimate.forward_speed.0, estimate.turn_rate.0]
    })
}

fn estimates(
    table: &SensorTable,
    config: &FilterConfig,
    mut filter: Box<dyn Filter>,
    numbers: impl Fn(&Estimate) -> Vec<f64>,
) -> Vec<Vec<f64>> {
    let unit_rad = table.unit.rad_per_unit(&config.geometry);
    let rows = table.rows.iter().map(|row| {
        for observation in row.observations(unit_rad, SENSES) {
            filter.observe(&observation);
        }
        numbers(&filter.estimate_at(row.stamp()).unwrap())
    });
    rows.collect()
}

/// The largest difference of each name's quantities over the drive, as a share of their largest value.
fn worst(found: &[Vec<(String, Vec<f64>)>], table: &SensorTable, config: &FilterConfig) -> Vec<(String, f64)> {
    let all = expected(table, config);
    let mut worst = Vec::new();
    for (place, (name, rows)) in all.iter().enumerate() {
        assert_eq!(rows.len(), found.len());
        for quantity in 0..5 {
            let largest = rows.iter().map(|row| row[quantity].abs()).fold(0.0, f64::max);
            let differences = rows.iter().zip(found).map(|(row, found)| {
                let (found_name, numbers) = &found[place];
                assert_eq!(found_name, name);
                let difference = numbers[quantity] - row[quantity];
                let is_heading = quantity == 2 && !name.starts_with('P');
                let difference = if is_heading { wrap_rad(difference) } else { difference };
                assert!(difference.is_finite(), "{name} {quantity}");
                difference.abs()
            });
            worst.push((format!("{name} {quantity}"), differences.fold(0.0, f64::max) / largest));
        }
    }
    worst
}

/// A simulated drive, exported by the program itself.
fn exported(folder: &Path) -> PathBuf {
    crate::support::run(folder, &["lab", "nxt-square", "--runs", "1", "--export", "drive.csv", "--json"]);
    folder.join("drive.csv")
}

/// A winding drive at intervals of 18 to 78 ms.
fn uneven(folder: &Path) -> PathBuf {
    let rows = (0..600).map(|index: u32| {
        let time_s = 0.054 * f64::from(index) + 0.012 * f64::from(index * 7 % 5);
        let wheel = |phase: f64| (300.0 * time_s + 200.0 * (time_s + phase).sin()).floor();
        SensorRow {
            time_s,
            encoders: [wheel(0.0), wheel(1.0)],
            gyro_deg_per_s: Some((20.0 * time_s.sin()).round()),
            accelerations_m_per_s2: Some([0.1 * time_s.cos(), -0.1 * time_s.sin()]),
            camera: None,
            compass_deg: None,
            truth: None,
        }
    });
    let table = SensorTable { rows: rows.collect(), ..SensorTable::default() };
    let path = folder.join("uneven.csv");
    std::fs::write(&path, write(&table, "made by a test")).unwrap();
    path
}

#[test]
fn in_double_precision_every_step_is_that_of_the_station() {
    let folder = tempfile::tempdir().unwrap();
    let program = compiled(folder.path(), "double");
    let config = config();
    for file in [exported(folder.path()), uneven(folder.path())] {
        let table = parse(&std::fs::read_to_string(&file).unwrap()).unwrap();
        let found = beliefs(&program, &file, &settings(&config));
        let shares = worst(&found, &table, &config);
        let largest = shares.iter().map(|(_, share)| *share).fold(0.0, f64::max);
        println!("{}: largest difference {largest:.1e}", file.display());
        for (name, share) in shares {
            assert!(share <= TOLERANCE, "{} {name}: {share:e}", file.display());
        }
    }
}

/// The numbers of brick/check/filters/steps.c, which runs one filter over rows of numbers.
fn scalar_answers(folder: &Path, filter: u32, rows: &[[f64; 4]]) -> Vec<Vec<f64>> {
    let program = folder.join(format!("steps-{filter}"));
    let sources = root().join("brick/filters");
    let output = Command::new("cc")
        .args(["-std=c99", "-O1", &format!("-DFILTER={filter}"), "-I.", "../check/filters/steps.c"])
        .args(["posebridge_filters.c", "posebridge_indirect.c", "posebridge_slow_sensor.c", "-lm", "-o"])
        .arg(&program)
        .current_dir(sources)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<String> =
        rows.iter().map(|row| format!("{:?} {:?} {:?} {:?} 0 0 0\n", row[0], row[1], row[2], row[3])).collect();
    let file = folder.join("rows.txt");
    std::fs::write(&file, lines.concat()).unwrap();
    let output = run(&program, &file, &[]);
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect()).collect()
}

fn observation(sensor: SensorId, at_s: f64, measurement: ObservationKind) -> Observation {
    Observation { sensor, stamp: Timestamp::from_secs_f64(at_s), stamp_sigma: TimeDelta::ZERO, measurement }
}

fn assert_near(what: &str, found: f64, expected: f64, scale: f64) {
    assert!((found - expected).abs() <= 1e-6 * scale, "{what}: {found} in place of {expected}");
}

/// The host's P holds ten digits behind its prior of 1e5 sigmas, the brick's factors hold all: they agree to 1e-6, not to 1e-9.
#[test]
fn the_thermometer_of_the_brick_is_that_of_the_station() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config();
    config.params.dynamic_tau_s = 20.0;
    config.noise.temperature_k = 0.03;
    let shown = |step: u32| (16.0 * (3.0 + 18.0 * (-f64::from(step) / 21.0).exp())).round() / 16.0;
    let rows: Vec<[f64; 4]> = (0..90).map(|step| [0.5 + 0.25 * f64::from(step % 3), shown(step), 0.0, 0.0]).collect();
    let found = scalar_answers(folder.path(), 7, &rows);
    let mut filter = (find_filter("dynamic").unwrap().build)(&config);
    let mut at_s = 0.0;
    for (row, found) in rows.iter().zip(&found) {
        at_s += row[0];
        filter.observe(&observation(SensorId::THERMOMETER, at_s, ObservationKind::Temperature(Celsius(row[1]))));
        let expected = filter.scalar_at(Timestamp::from_secs_f64(at_s)).unwrap();
        assert_near("final value", found[0], expected.value, 18.0);
        assert_near("sigma", found[2].sqrt(), expected.sigma, expected.sigma);
    }
    assert_eq!(found.len(), 90);
}

#[test]
fn the_wall_filter_of_the_brick_is_that_of_the_station_gate_included() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config();
    (config.params.wall_drag_s_per_m, config.params.wall_mass_s2_per_m) = (0.816_33, 0.353_46);
    (config.params.wall_process_m, config.params.wall_gate_m) = (0.05, 0.1);
    config.noise.wall_range_m = 0.02;
    // One reading in ten steps, that of step 120 just outside the gate, at 3.5 sigmas; step 150 takes longer than Euler's rule may.
    let rows: Vec<[f64; 4]> = (0..300)
        .map(|step| {
            let dt_s = if step == 150 { 0.13 } else { 0.006 + 0.0005 * f64::from(step % 7) };
            let range_m = if step == 120 { 1.21 } else { 2.5 - 0.006 * f64::from(step) + 0.01 * f64::from(step % 3) };
            [dt_s, if step < 200 { 1.0 } else { 0.2 }, f64::from(u32::from(step % 10 == 0)), range_m]
        })
        .collect();
    let found = scalar_answers(folder.path(), 8, &rows);
    let mut filter = (find_filter("range-kf").unwrap().build)(&config);
    let (mut at_s, mut gated) = (0.0, 0);
    for (row, found) in rows.iter().zip(&found) {
        at_s += row[0];
        let forward = MetersPerSecond(row[1] / 0.816_33);
        let command = ObservationKind::BodyVelocity { forward, turn: RadiansPerSecond(0.0) };
        filter.observe(&observation(SensorId::WHEELS, at_s, command));
        if row[2] > 0.0 {
            let reading = ObservationKind::WallRange(Meters(row[3]));
            let outcome = filter.observe(&observation(SensorId::RANGE, at_s, reading)).outcome;
            assert_eq!(found[3] > 0.0, outcome == FusionOutcome::Gated, "at {at_s} s");
            gated += u32::from(outcome == FusionOutcome::Gated);
        }
        let expected = filter.scalar_at(Timestamp::from_secs_f64(at_s)).unwrap();
        assert_near("distance", found[0], expected.value, 2.5);
        assert_near("speed", found[1], -expected.rate_per_s, 1.0);
        assert_near("variance", found[2], expected.sigma.powi(2), 0.02);
    }
    assert_eq!(gated, 1);
}

#[test]
fn single_precision_costs_less_than_a_millimetre_and_a_tenth_of_a_degree() {
    let folder = tempfile::tempdir().unwrap();
    let (double, float) = (compiled(folder.path(), "double"), compiled(folder.path(), "float"));
    let file = exported(folder.path());
    let settings = settings(&config());
    let rows = beliefs(&double, &file, &settings).into_iter().zip(beliefs(&float, &file, &settings));
    let mut costs: Vec<(String, f64, f64)> = Vec::new();
    for (exact, rounded) in rows {
        for (index, ((name, one), (_, other))) in exact.iter().zip(&rounded).take(9).enumerate() {
            let position_m = (one[0] - other[0]).hypot(one[1] - other[1]);
            let heading_rad = wrap_rad(one[2] - other[2]).abs();
            if costs.len() <= index {
                costs.push((name.clone(), 0.0, 0.0));
            }
            costs[index].1 = costs[index].1.max(position_m);
            costs[index].2 = costs[index].2.max(heading_rad);
        }
    }
    assert_eq!(costs.len(), 9);
    for (name, position_m, heading_rad) in costs {
        let heading_deg = heading_rad.to_degrees();
        println!("{name}: float costs {:.4} mm, {heading_deg:.6} degrees", 1e3 * position_m);
        assert!(position_m < 1e-3 && heading_deg < 0.1, "{name}");
        assert!(position_m > 0.0, "{name}: this is no single precision");
    }
}

#[test]
fn what_no_filter_can_use_is_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let program = compiled(folder.path(), "double");
    let cases = [
        ("time_s,left_counts\n0,1\n", "there is no column `right_counts`"),
        ("time_s,left_counts,right_counts\n0,0,0\n0,1,1\n", "a filter refused the row of time `0`"),
        ("time_s,left_counts,right_counts\n0,0,0\n0.4,1,1\n", "a filter refused the row of time `0.4`"),
        ("time_s,left_counts,right_counts\n0,0,0\n0.05,nan,1\n", "no number in the row of time `0.05`"),
        ("", "there is no line with"),
    ];
    for (text, reason) in cases {
        let file = folder.path().join("wrong.csv");
        std::fs::write(&file, text).unwrap();
        let output = run(&program, &file, &[]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(said.contains(reason), "{text}: {said}");
    }
    let output = run(&program, &folder.path().join("wrong.csv"), &["trakc_m=1".to_owned()]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("`trakc_m=1`"));
}

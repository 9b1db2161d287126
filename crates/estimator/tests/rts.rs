//! The flagship run forwards and back: against truth, against the filter, and against the batch, which shares none of its code.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when there is no smoothed path")]

#[path = "support/drive.rs"]
mod drive;
#[path = "support/robot.rs"]
mod robot;
#[path = "support/score.rs"]
mod score;

use drive::{Camera, Drive, Scenario, drive, stamp};
use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::state::CORE_STATES;
use posebridge_estimator::smoother::{OfflineError, SmoothedTrajectory, batch, rts};
use posebridge_estimator::{Filter, FilterConfig, Params};
use posebridge_telemetry::{
    Meters, MetersPerSecond, Observation, ObservationKind, RadiansPerSecond, SensorId, Timestamp, quantities::wrap_rad,
};
use robot::config;
use score::{mean, play, score};

/// 10 Hz, 150 ± 50 ms late.
const CAMERA: Camera = Camera { every: 2, delay: 3, spread: 1, outliers: 0.0 };

fn lap(camera: Option<Camera>, seed: u64) -> Drive {
    drive(&Scenario { laps: 1, camera }, seed)
}

/// The same drive without the fixes that were taken in this range of steps.
fn blind(mut drive: Drive, steps: std::ops::Range<usize>) -> Drive {
    drive.arrivals.retain(|arrival| {
        let seen = arrival.observation;
        let is_fix = matches!(seen.measurement, ObservationKind::Fix(_));
        !(is_fix && stamp(steps.start) <= seen.stamp && seen.stamp < stamp(steps.end))
    });
    drive
}

fn observations(drive: &Drive) -> Vec<Observation> {
    let arrivals = drive.arrivals.iter();
    arrivals.map(|arrival| arrival.observation).collect()
}

fn smoothed(drive: &Drive, config: &FilterConfig) -> SmoothedTrajectory {
    rts(config, &observations(drive)).expect("the drive has a start")
}

/// Sums of squared position errors and of NEES over three, with the number of poses.
fn squares(smoothed: &SmoothedTrajectory, drive: &Drive) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for at in &smoothed.poses {
        let step = at.stamp.as_nanos() / 50_000_000;
        let Some(truth) = usize::try_from(step - 1).ok().and_then(|i| drive.poses.get(i)) else {
            continue;
        };
        let error =
            Vector3::new(at.pose.x.0 - truth.0, at.pose.y.0 - truth.1, wrap_rad(at.pose.heading.rad() - truth.2));
        let p = Matrix3::from_fn(|row, column| at.covariance[row][column]);
        let weighted = p.try_inverse().expect("positive definite") * error;
        sums[0] += error[0] * error[0] + error[1] * error[1];
        sums[1] += error.dot(&weighted) / 3.0;
        sums[2] += 1.0;
    }
    sums
}

/// Position rms of filter and smoother in metres, and the smoother's ANEES, over ten drives.
fn compare(make: impl Fn(u64) -> Drive) -> (f64, f64, f64) {
    let mut filter = vec![];
    let mut back = [0.0; 3];
    for seed in 0..10 {
        let drive = make(seed);
        filter.push(score(&drive, &play(&drive, &config()), 0));
        let of_back = squares(&smoothed(&drive, &config()), &drive);
        back = std::array::from_fn(|i| back[i] + of_back[i]);
    }
    (mean(&filter).position_rms_m, f64::sqrt(back[0] / back[2]), back[1] / back[2])
}

#[test]
fn hindsight_halves_the_error_under_a_camera_and_knows_it() {
    let (filter_m, back_m, anees) = compare(|seed| lap(Some(CAMERA), seed));
    println!("camera: filter {filter_m:.6} m, forwards and back {back_m:.6} m, ANEES {anees:.2}");
    assert!(back_m < 0.65 * filter_m, "{back_m} against {filter_m}");
    // The rounding of the encoders' heading is no error of the heading to the filter: a tenth of a degree is not covered.
    assert!((0.8..1.35).contains(&anees), "{anees}");
}

#[test]
fn hindsight_bridges_a_blind_stretch_from_both_ends() {
    let (filter_m, back_m, anees) = compare(|seed| blind(lap(Some(CAMERA), seed), 200..1_000));
    println!("blind: filter {filter_m:.6} m, forwards and back {back_m:.6} m, ANEES {anees:.2}");
    assert!(back_m < 0.6 * filter_m, "{back_m} against {filter_m}");
    assert!((0.7..1.4).contains(&anees), "{anees}");
}

#[test]
fn without_fixes_hindsight_does_no_harm() {
    let (filter_m, back_m, anees) = compare(|seed| lap(None, seed));
    println!("no fixes: filter {filter_m:.6} m, forwards and back {back_m:.6} m, ANEES {anees:.2}");
    assert!(back_m < 1.03 * filter_m, "{back_m} against {filter_m}");
    assert!((0.6..1.4).contains(&anees), "{anees}");
}

#[test]
fn the_last_pose_is_the_filters() {
    let drive = lap(Some(CAMERA), 3);
    let mut filter = PoseFilter::<CORE_STATES>::new(&config());
    for seen in observations(&drive) {
        filter.observe(&seen);
    }
    let state = filter.state();
    let last = *smoothed(&drive, &config()).poses.last().expect("it moved");
    assert!((last.pose.x.0 - state.pose.x_m).abs() < 1e-9);
    assert!((last.pose.y.0 - state.pose.y_m).abs() < 1e-9);
    let published = state.published_covariance();
    for row in 0..3 {
        for column in 0..3 {
            let apart = last.covariance[row][column] - published[row][column];
            assert!(apart.abs() < 1e-9 * published[row][row].max(published[column][column]));
        }
    }
}

/// Both minimise the same sum of squares but for the rounding at the ends of gyro windows, which the batch takes for noise.
#[test]
fn the_batch_agrees_where_theory_says_so() {
    let mut plain = config();
    plain.params = Params { adapt_gain: 0.0, gyro_window_s: 0.4, ..Params::default() };
    let (mut squares_in_sigmas, mut compared) = (0.0, 0.0);
    for seed in 0..3 {
        let drive = lap(Some(CAMERA), seed);
        let by_batch = batch(&plain, &observations(&drive)).expect("the drive has a start");
        let back = smoothed(&drive, &plain);
        for at in &by_batch.poses {
            // The last one of an instant knows its fix.
            let Some(ours) = back.poses.iter().rfind(|ours| ours.stamp == at.stamp) else {
                continue;
            };
            let apart_m = at.pose.origin().distance(ours.pose.origin()).0;
            squares_in_sigmas += apart_m.powi(2) / (at.covariance[0][0] + at.covariance[1][1]);
            compared += 1.0;
        }
    }
    let apart = f64::sqrt(squares_in_sigmas / compared);
    println!("batch and forwards-and-back differ by {apart:.3} sigmas rms over {compared} poses");
    assert!(compared > 3_000.0, "{compared}");
    assert!(apart < 0.3, "{apart}");
}

#[test]
fn what_says_nothing_is_refused() {
    let nowhere = FilterConfig { start: None, ..config() };
    let drive = lap(None, 1);
    assert!(matches!(rts(&nowhere, &observations(&drive)), Err(OfflineError::NothingObserved { .. })));
    assert!(matches!(rts(&config(), &[]), Err(OfflineError::NothingObserved { .. })));
}

/// With what a second tag and a foreign odometer say at the same instants.
fn crowded() -> Vec<Observation> {
    let all = observations(&lap(Some(CAMERA), 1));
    let mut crowded = all.clone();
    for one in &all {
        if let ObservationKind::Fix(mut fix) = one.measurement {
            fix.position.x.0 += 0.004;
            crowded.push(Observation { measurement: ObservationKind::Fix(fix), ..*one });
        } else if let ObservationKind::WheelAngles { left, .. } = one.measurement {
            crowded.push(Observation {
                sensor: SensorId::ODOMETER,
                measurement: ObservationKind::BodyVelocity {
                    forward: MetersPerSecond(left.0.sin()),
                    turn: RadiansPerSecond(0.0),
                },
                ..*one
            });
        }
    }
    crowded
}

#[test]
fn the_order_of_the_observations_does_not_matter_bit_for_bit() {
    let all = crowded();
    let in_order = rts(&config(), &all).expect("it has a start");
    let backwards: Vec<Observation> = all.iter().rev().copied().collect();
    assert!(rts(&config(), &backwards).expect("it has a start") == in_order);
}

#[test]
fn what_is_damaged_or_comes_twice_changes_nothing() {
    let all = observations(&lap(Some(CAMERA), 2));
    let clean = rts(&config(), &all).expect("it has a start");
    let mut dirty = all.clone();
    for one in all.iter().step_by(5) {
        dirty.push(*one);
        dirty.push(Observation { measurement: ObservationKind::TurnRate(RadiansPerSecond(f64::NAN)), ..*one });
        dirty.push(Observation { stamp: Timestamp::from_nanos(i64::MAX), ..*one });
    }
    assert!(rts(&config(), &dirty).expect("it has a start") == clean);
}

#[test]
fn a_configuration_that_is_no_number_is_refused() {
    let all = observations(&lap(None, 1));
    let mut no_track = config();
    no_track.geometry.track_width = Meters(0.0);
    let mut no_noise = config();
    no_noise.noise.wheel_travel_m_per_sqrt_m = f64::NAN;
    let mut no_start = config();
    no_start.start.as_mut().expect("a start").heading_sigma_rad = f64::NAN;
    for config in [no_track, no_noise, no_start] {
        assert_eq!(rts(&config, &all), Err(OfflineError::NotFinite));
    }
}

#[test]
fn fixes_that_come_twice_count_once_and_those_of_one_instant_in_either_order() {
    let mut observations = observations(&lap(Some(CAMERA), 4));
    // A second view of the same instant by the same camera, a little off.
    let second_views: Vec<Observation> = observations
        .iter()
        .filter_map(|seen| {
            let ObservationKind::Fix(mut fix) = seen.measurement else {
                return None;
            };
            fix.position.x.0 += 0.004;
            Some(Observation { measurement: ObservationKind::Fix(fix), ..*seen })
        })
        .collect();
    observations.extend(second_views);
    let once = rts(&config(), &observations).expect("it has a start");
    let twice: Vec<Observation> = observations.iter().rev().chain(&observations).copied().collect();
    assert_eq!(rts(&config(), &twice).expect("it has a start"), once);
}

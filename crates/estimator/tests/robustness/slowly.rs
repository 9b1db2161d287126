//! Rest and motion that the encoders hardly show: what the gyro's bias makes of them.

use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::state::{CORE_STATES, GYRO_BIAS, ROUNDING, TickActivity, WINDOW_TURN};
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{Observation, ObservationKind, Radians, RadiansPerSecond, SensorId, TimeDelta};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::drive::{STEP_S, stamp};
use crate::robot::{DEGREE, NOISE, RADIUS_M, TRACK_M, config};

fn of(sensor: SensorId, step: usize, observed: ObservationKind) -> Observation {
    Observation { sensor, stamp: stamp(step), stamp_sigma: TimeDelta::ZERO, measurement: observed }
}

/// Feeds wheels that are floored to counts, and the gyro with its noise, of a robot that turns in place.
fn turn_slowly(filter: &mut impl Filter, rate_rad_per_s: f64, bias_rad_per_s: f64, seed: u64) {
    turn_by_counts(filter, bias_rad_per_s, seed, |_| rate_rad_per_s);
}

/// The same at the rate that is told for each step but the first, at which the robot begins.
fn turn_by_counts(
    filter: &mut impl Filter,
    bias_rad_per_s: f64,
    seed: u64,
    mut rate_rad_per_s: impl FnMut(usize) -> f64,
) {
    let mut rng = Pcg64::seed_from_u64(seed);
    // Where within a count the wheels begin.
    let start: [f64; 2] = [rng.random(), rng.random()];
    let mut turned_rad = 0.0;
    for step in 0..1_200 {
        let rate_rad_per_s = if step > 0 { rate_rad_per_s(step) } else { 0.0 };
        turned_rad += rate_rad_per_s * STEP_S;
        let half_rad = 0.5 * turned_rad * TRACK_M / RADIUS_M;
        let counted = |rad: f64, begun: f64| Radians((rad / DEGREE + begun).floor() * DEGREE);
        let wheels =
            ObservationKind::WheelAngles { left: counted(-half_rad, start[0]), right: counted(half_rad, start[1]) };
        let normal: f64 = rng.sample(StandardNormal);
        let rate = rate_rad_per_s + bias_rad_per_s + NOISE.gyro_rad_per_s * normal;
        let rate = ObservationKind::TurnRate(RadiansPerSecond((rate / DEGREE).round() * DEGREE));
        filter.observe(&of(SensorId::GYRO, step, rate));
        filter.observe(&of(SensorId::WHEELS, step, wheels));
    }
}

#[test]
fn a_rotation_below_a_count_per_window_is_not_taken_for_bias() {
    // One count of one wheel is 0.25 degrees of heading: windows of 0.2 s show none at most of these rates.
    for rate_deg_per_s in [0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0] {
        let (mut squares, mut worst, mut sigma, mut worst_heading) = (0.0, 0.0_f64, 0.0, 0.0_f64);
        for seed in 0..10 {
            let bias = 0.7 * DEGREE;
            let mut filter = PoseFilter::<CORE_STATES>::new(&config());
            turn_slowly(&mut filter, rate_deg_per_s * DEGREE, bias, seed);
            let state = filter.state();
            let error = (state.mean[GYRO_BIAS] - bias) / DEGREE;
            sigma = state.covariance[(GYRO_BIAS, GYRO_BIAS)].sqrt() / DEGREE;
            squares += error * error / 10.0;
            worst = worst.max(error.abs());
            let turned = rate_deg_per_s * DEGREE * 1_199.0 * STEP_S;
            let estimate = filter.estimate_at(stamp(1_199)).unwrap();
            let heading_error = posebridge_telemetry::quantities::wrap_rad(estimate.pose.heading.rad() - turned);
            worst_heading = worst_heading.max(heading_error.abs() / DEGREE);
        }
        println!(
            "{rate_deg_per_s} degrees/s: bias off by {:.3} rms, {worst:.3} at worst, sigma {sigma:.3}, heading {worst_heading:.3}",
            f64::sqrt(squares)
        );
        // What bias and heading are known to at rest, three times.
        assert!(sigma < 0.045, "{rate_deg_per_s} degrees/s: {sigma}");
        assert!(worst < 3.0 * sigma, "{rate_deg_per_s} degrees/s: {worst}");
        assert!(worst_heading < 1.0, "{rate_deg_per_s} degrees/s: {worst_heading}");
    }
}

#[test]
fn a_robot_that_brakes_to_a_creep_is_taken_for_resting_no_longer_than_until_its_first_counts() {
    // 90 degrees at 1 rad/s, then on at a rate that shows a count now and then: worse than any rest for telling one from the other.
    for creep_deg_per_s in [0.0, 0.1, 0.2, 0.5, 1.0, 2.0] {
        let (mut worst_bias, mut worst_heading) = (0.0_f64, 0.0_f64);
        for seed in 0..10 {
            let bias = 0.7 * DEGREE;
            let mut filter = PoseFilter::<CORE_STATES>::new(&config());
            let mut heading_rad = 0.0;
            turn_by_counts(&mut filter, bias, seed, |step| {
                let rate = if step < 32 { 1.0 } else { creep_deg_per_s * DEGREE };
                heading_rad += rate * STEP_S;
                rate
            });
            let state = filter.state();
            worst_bias = worst_bias.max((state.mean[GYRO_BIAS] - bias).abs() / DEGREE);
            let estimate = filter.estimate_at(stamp(1_199)).unwrap();
            let error = posebridge_telemetry::quantities::wrap_rad(estimate.pose.heading.rad() - heading_rad);
            worst_heading = worst_heading.max(error.abs() / DEGREE);
        }
        println!("{creep_deg_per_s} degrees/s: bias {worst_bias:.3}, heading {worst_heading:.3}");
        // Three times what a long rest leaves, and the heading that comes of it. A filter that takes every pause for rest is off by
        // tens of degrees.
        assert!(worst_bias < 0.12, "{creep_deg_per_s}: {worst_bias}");
        assert!(worst_heading < 1.2, "{creep_deg_per_s}: {worst_heading}");
    }
}

#[test]
fn after_a_gap_the_rounding_of_a_new_window_is_as_unknown_as_it_can_be() {
    let mut filter = PoseFilter::<CORE_STATES>::new(&config());
    let fresh_var = filter.state().covariance[(ROUNDING, ROUNDING)];
    turn_slowly(&mut filter, 0.3, 0.01, 1);
    let before = *filter.state();
    assert!(before.covariance[(ROUNDING, ROUNDING)] < 0.9 * fresh_var);
    // The counters begin again, somewhere within a count.
    for step in [1_200, 1_201] {
        let again = ObservationKind::WheelAngles { left: Radians(-700.0), right: Radians(700.0) };
        filter.observe(&of(SensorId::GYRO, step, ObservationKind::TurnRate(RadiansPerSecond(0.0))));
        filter.observe(&of(SensorId::WHEELS, step, again));
    }
    let state = filter.state();
    assert!(state.window.is_some());
    assert_eq!(state.mean[ROUNDING], 0.0);
    assert_eq!(state.covariance[(ROUNDING, ROUNDING)], fresh_var);
    assert_eq!(state.covariance[(ROUNDING, GYRO_BIAS)], 0.0);
    assert_eq!(state.covariance[(WINDOW_TURN, WINDOW_TURN)], 0.0);
}

#[test]
fn a_bias_that_was_given_is_where_learning_begins() {
    let mut given: FilterConfig = config();
    given.calibration.gyro_bias_rad_per_s.value = 0.03;
    let filter = PoseFilter::<CORE_STATES>::new(&given);
    let known = filter.calibration().unwrap().gyro_bias_rad_per_s;
    assert_eq!(known.value, 0.03);
    assert_eq!(known.sigma, NOISE.gyro_bias_rad_per_s);
}

#[test]
fn a_restart_of_the_bricks_clock_forgets_when_counts_changed_by_the_old_one() {
    let mut filter = PoseFilter::<CORE_STATES>::new(&config());
    turn_slowly(&mut filter, 0.3, 0.01, 1);
    assert_ne!(filter.state().tick_activity, TickActivity::default());
    filter.restart_clock();
    assert_eq!(filter.state().tick_activity, TickActivity::default());
}

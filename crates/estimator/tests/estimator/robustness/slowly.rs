//! Rest and motion that the encoders hardly show: what the gyro's bias makes of them.

use posebridge_estimator::Filter;
use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::{CORE_STATES, GYRO_BIAS, ROUNDING, WINDOW_TURN};
use posebridge_estimator::filters::pose::state::TickActivity;
use posebridge_telemetry::quantities::wrap_rad;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use crate::support::observe::{gyro, ms, wheels};
use crate::support::robot::{DEGREE, NOISE, RADIUS_M, TRACK_M, config};
use crate::support::simulation::STEP_S;

/// Feeds wheels that are floored to counts, and the gyro with its noise, of a robot that turns in place, at the rate that is told
/// for each step but the first, at which the robot begins; returns how far it turned.
fn turn_slowly(filter: &mut impl Filter, bias_rad_per_s: f64, seed: u64, rate_rad_per_s: impl Fn(i64) -> f64) -> f64 {
    let mut rng = Pcg64::seed_from_u64(seed);
    // Where within a count the wheels begin.
    let start: [f64; 2] = [rng.random(), rng.random()];
    let mut turned_rad = 0.0;
    for step in 0..1_200_i64 {
        let rate_rad_per_s = if step > 0 { rate_rad_per_s(step) } else { 0.0 };
        turned_rad += rate_rad_per_s * STEP_S;
        let half_rad = 0.5 * turned_rad * TRACK_M / RADIUS_M;
        let counted = |rad: f64, begun: f64| (rad / DEGREE + begun).floor() * DEGREE;
        let normal: f64 = rng.sample(StandardNormal);
        let rate = rate_rad_per_s + bias_rad_per_s + NOISE.gyro_rad_per_s * normal;
        filter.observe(&gyro(50 * step, (rate / DEGREE).round() * DEGREE));
        filter.observe(&wheels(50 * step, counted(-half_rad, start[0]), counted(half_rad, start[1])));
    }
    turned_rad
}

/// At 0.3 rad/s.
fn turn_steadily(filter: &mut impl Filter) {
    turn_slowly(filter, 0.01, 1, |_| 0.3);
}

/// Ten runs at the rate of each step with a bias of 0.7 degrees per second: the worst error of the bias, its sigma, and the worst
/// error of the heading, in degrees.
fn worst_of_ten(rate_rad_per_s: impl Fn(i64) -> f64) -> [f64; 3] {
    let (mut worst_bias, mut sigma, mut worst_heading) = (0.0_f64, 0.0, 0.0_f64);
    for seed in 0..10 {
        let bias = 0.7 * DEGREE;
        let mut filter = PoseFilter::<CORE_STATES>::new(&config());
        let turned_rad = turn_slowly(&mut filter, bias, seed, &rate_rad_per_s);
        let state = filter.state();
        worst_bias = worst_bias.max((state.mean[GYRO_BIAS] - bias).abs() / DEGREE);
        sigma = state.covariance[(GYRO_BIAS, GYRO_BIAS)].sqrt() / DEGREE;
        let estimate = filter.estimate_at(ms(50 * 1_199)).unwrap();
        worst_heading = worst_heading.max(wrap_rad(estimate.pose.heading.rad() - turned_rad).abs() / DEGREE);
    }
    [worst_bias, sigma, worst_heading]
}

#[test]
fn a_rotation_below_a_count_per_window_is_not_taken_for_bias() {
    // One count of one wheel is 0.25 degrees of heading: windows of 0.2 s show none at most of these rates.
    for rate_deg_per_s in [0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0] {
        let [worst, sigma, worst_heading] = worst_of_ten(|_| rate_deg_per_s * DEGREE);
        println!("{rate_deg_per_s} degrees/s: bias {worst:.3}, sigma {sigma:.3}, heading {worst_heading:.3}");
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
        let [worst_bias, _, worst_heading] =
            worst_of_ten(|step| if step < 32 { 1.0 } else { creep_deg_per_s * DEGREE });
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
    turn_steadily(&mut filter);
    let before = *filter.state();
    assert!(before.covariance[(ROUNDING, ROUNDING)] < 0.9 * fresh_var);
    // The counters begin again, somewhere within a count.
    for step in [1_200, 1_201] {
        filter.observe(&gyro(50 * step, 0.0));
        filter.observe(&wheels(50 * step, -700.0, 700.0));
    }
    let state = filter.state();
    assert!(state.window.is_some());
    assert_eq!(state.mean[ROUNDING], 0.0);
    assert_eq!(state.covariance[(ROUNDING, ROUNDING)], fresh_var);
    assert_eq!(state.covariance[(ROUNDING, GYRO_BIAS)], 0.0);
    assert_eq!(state.covariance[(WINDOW_TURN, WINDOW_TURN)], 0.0);
}

#[test]
fn learning_starts_at_the_configured_bias() {
    let mut configured = config();
    configured.calibration.gyro_bias_rad_per_s.value = 0.03;
    let filter = PoseFilter::<CORE_STATES>::new(&configured);
    let known = filter.calibration().unwrap().gyro_bias_rad_per_s;
    assert_eq!(known.value, 0.03);
    assert_eq!(known.sigma, NOISE.gyro_bias_rad_per_s);
}

#[test]
fn a_restart_of_the_bricks_clock_forgets_when_counts_changed_by_the_old_one() {
    let mut filter = PoseFilter::<CORE_STATES>::new(&config());
    turn_steadily(&mut filter);
    assert_ne!(filter.state().tick_activity, TickActivity::default());
    filter.restart_clock();
    assert_eq!(filter.state().tick_activity, TickActivity::default());
}

//! Headings of which nothing is known, found by positions alone.

use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::CORE_STATES;
use posebridge_estimator::models::lie::Se2;
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_telemetry::{
    Body, Fix, FusionOutcome, Heading, Meters, Point2, Pose, StartPose, TimeDelta, quantities::wrap_rad,
};

use crate::support::alter::{PROMPT_CAMERA, altered_fixes, at, error_at, fixes, share_accepted, with_tag_moved};
use crate::support::filters::without_start;
use crate::support::observe::{fix, fix_of};
use crate::support::robot::{DEGREE, NOISE, config};
use crate::support::score::{Score, mean, play, score};
use crate::support::simulation::{Drive, RobotSimulation, STEP_S, drive_steps};

/// Where the robot starts is known, where it points is not: uniform on the circle.
fn heading_unknown() -> FilterConfig {
    FilterConfig {
        start: Some(StartPose {
            pose: Pose::default(),
            position_sigma_m: 1e-4,
            heading_sigma_rad: std::f64::consts::PI / 3.0_f64.sqrt(),
        }),
        ..config()
    }
}

/// Twenty seconds along a winding path, from a heading that is off by `start_rad`, seen by a camera as positions of a tag.
fn winding(start_rad: f64, tag: Point2<Body>, seed: u64) -> Drive {
    let mut world = RobotSimulation::new(seed);
    world.heading_rad = wrap_rad(start_rad);
    // The first reading of the wheels is where counting begins: before it nothing may move.
    let steps = (0..402_u32).map(|k| match k.checked_sub(2) {
        None => (0.0, 0.0),
        Some(k) => {
            let t_s = f64::from(k) * STEP_S;
            (0.2 * STEP_S, 0.3 * (0.5 * t_s).sin() * STEP_S)
        }
    });
    positions_of(tag, drive_steps(&mut world, steps, Some(PROMPT_CAMERA)))
}

/// Fixes that give the position of a tag alone.
fn positions_of(tag: Point2<Body>, drive: Drive) -> Drive {
    altered_fixes(with_tag_moved(drive, (tag.x.0, tag.y.0), TimeDelta::ZERO), |_, fix| {
        Some(Fix { heading: None, tag_in_body: tag, ..fix })
    })
}

fn mean_over(tag: Point2<Body>, runs: u32, widest_rad: f64) -> Score {
    let scores: Vec<Score> = (0..runs)
        .map(|run| {
            // Evenly from one side to the other.
            let start_rad = widest_rad * (2.0 * (f64::from(run) + 0.5) / f64::from(runs) - 1.0);
            let drive = winding(start_rad, tag, u64::from(run));
            let played = play(&drive, &heading_unknown());
            let end = at(&played, 400);
            assert_eq!(end.reset_counter, 0, "from {start_rad}: no jump is needed");
            assert!(end.validity.heading, "from {start_rad}");
            score(&drive, &played, 40)
        })
        .collect();
    mean(&scores)
}

#[test]
fn positions_alone_find_any_heading_without_a_reset() {
    let mid_axle = Point2::ORIGIN;
    let ahead = Point2::new(Meters(0.08), Meters(-0.03));
    for (tag, what) in [(mid_axle, "mid-axle"), (ahead, "8 cm ahead, 3 cm right")] {
        for widest_deg in [90.0, 180.0] {
            let mean = mean_over(tag, 60, widest_deg * DEGREE);
            println!("heading unknown within {widest_deg} degrees, tag {what}: {mean:?}");
            // From two seconds on, 0.4 m after the start.
            assert!(mean.position_rms_m < 0.004, "{mean:?}");
            assert!(mean.heading_rms_rad < 1.5 * DEGREE, "{mean:?}");
            // The band of 60 runs: chi-square with 180 degrees of freedom, 99.9 %, whose runs are correlated in themselves.
            assert!((0.67..1.39).contains(&mean.anees), "{mean:?}");
        }
    }
}

#[test]
fn a_tag_off_the_axle_determines_the_heading_even_of_a_robot_that_turns_in_place() {
    let tag = Point2::new(Meters(0.15), Meters(0.0));
    for (run, start_deg) in [-179.0, -120.0, -45.0, 60.0, 135.0, 180.0].into_iter().enumerate() {
        let mut world = RobotSimulation::new(run as u64);
        world.heading_rad = start_deg * DEGREE;
        let turning = (0..100).map(|k| (0.0, if k < 2 { 0.0 } else { 0.5 * STEP_S }));
        let drive = positions_of(tag, drive_steps(&mut world, turning, Some(PROMPT_CAMERA)));
        let played = play(&drive, &heading_unknown());
        let end = at(&played, 100);
        let error_rad = wrap_rad(end.pose.heading.rad() - drive.poses[99].2);
        let sigma_rad = end.heading_sigma_rad();
        assert!(end.validity.heading, "{start_deg}");
        assert!(error_rad.abs() < 2.0 * DEGREE, "{start_deg}: {error_rad}");
        assert!(error_rad.abs() < 4.0 * sigma_rad, "{start_deg}: {error_rad} {sigma_rad}");
    }
}

#[test]
fn a_robot_at_rest_learns_nothing_of_its_heading_from_the_noise_of_its_fixes() {
    for tag_m in [0.0, 0.1, 0.4] {
        for seed in 0..5 {
            let mut world = RobotSimulation::new(seed);
            let at_rest = drive_steps(&mut world, [(0.0, 0.0); 600], Some(PROMPT_CAMERA));
            let drive = positions_of(Point2::new(Meters(tag_m), Meters(0.0)), at_rest);
            let played = play(&drive, &without_start());
            let end = at(&played, 600);
            let sigma_rad = end.heading_sigma_rad();
            assert!(sigma_rad > 1.8, "tag {tag_m}, seed {seed}: {sigma_rad}");
            assert!(end.validity.position && !end.validity.heading);
            let used = share_accepted(&fixes(&played, &(1..600)));
            assert!(used > 0.98, "tag {tag_m}, seed {seed}: {used}");
        }
    }
}

#[test]
fn a_start_that_is_wrong_by_far_is_left_at_any_heading_uncertainty() {
    for heading_sigma_rad in [0.2, 1.8, 20.0] {
        for run in 0..10_u32 {
            let drive = winding(0.6 * f64::from(run) - 3.0, Point2::ORIGIN, u64::from(run));
            let mut config = heading_unknown();
            config.start = Some(StartPose {
                pose: Pose::new(Meters(40.0), Meters(-70.0), Heading::default()),
                position_sigma_m: 0.01,
                heading_sigma_rad,
            });
            let played = play(&drive, &config);
            let (position_m, heading_rad) = error_at(&drive, &played, 400);
            let what = format!("sigma {heading_sigma_rad}, run {run}");
            assert!(at(&played, 400).reset_counter > 0, "{what}");
            assert!(position_m < 0.02, "{what}: {position_m}");
            assert!(heading_rad < 3.0 * DEGREE, "{what}: {heading_rad}");
        }
    }
}

/// Minus twice the logarithm of the likelihood of a pose: how far it is from the start, and how far its tag from the fix.
fn cost(start: Se2, [forward_m, left_m, turn_rad]: [f64; 3], fix: &Fix) -> f64 {
    let pose = start.compose(Se2::exp([forward_m, left_m, turn_rad]));
    let tag = Se2 { x_m: fix.tag_in_body.x.0, y_m: fix.tag_in_body.y.0, heading_rad: 0.0 };
    let at = pose.compose(tag);
    let off_m = (fix.position.x.0 - at.x_m).hypot(fix.position.y.0 - at.y_m);
    (forward_m.hypot(left_m) / 0.3).powi(2) + (turn_rad / 1.8).powi(2) + (off_m / NOISE.fix_position_m).powi(2)
}

#[test]
fn an_iterated_update_ends_where_the_likelihood_is_greatest() {
    let start = Se2 { x_m: 0.3, y_m: -0.2, heading_rad: 0.4 };
    let mut config = config();
    config.start = Some(StartPose {
        pose: Pose::new(Meters(0.3), Meters(-0.2), Heading::from_rad(0.4)),
        position_sigma_m: 0.3,
        heading_sigma_rad: 1.8,
    });
    for (x_m, y_m) in [(0.9, 0.3), (-0.2, -0.1), (0.3, 0.5), (0.2, -0.7)] {
        let observed = Fix { tag_in_body: Point2::new(Meters(0.4), Meters(-0.1)), ..fix_of(x_m, y_m, None) };
        let mut filter = PoseFilter::<CORE_STATES>::new(&config);
        let record = filter.observe(&fix(0, observed));
        assert_eq!(record.outcome, FusionOutcome::Accepted, "({x_m}, {y_m})");
        let xi = start.between(filter.state().pose).log();
        let least = cost(start, xi, &observed);
        assert!((record.nis - least).abs() < 1e-6, "it is the NIS: {least}");
        let s = record.innovation_covariance;
        let determinant = s[0][0] * s[1][1] - s[0][1] * s[1][0];
        let log_likelihood = -0.5 * (record.nis + (std::f64::consts::TAU.powi(2) * determinant).ln());
        assert!((record.log_likelihood - log_likelihood).abs() < 1e-9);
        for row in 0..3 {
            for by in [-1e-3, 1e-3] {
                let mut other = xi;
                other[row] += by;
                assert!(cost(start, other, &observed) > least, "row {row}, ({x_m}, {y_m})");
            }
        }
    }
}

//! Every derivative of what the pose filter expects to observe against central differences, at states where signs, wraps and
//! levers show; and every expectation against the same geometry in other words.
//!
//! The derivatives of its motion are checked in `jacobians_motion`, those of the group beside `models::lie`.

mod motion;

use posebridge_estimator::filters::pose::state::{
    BEACONS, DELAY, MAX_BEACONS, PoseState, RANGE_STATES, TAG_FORWARD, TAG_LEFT, linearize, linearize_gyro_window,
};
use posebridge_estimator::models::lie::Se2;
use posebridge_estimator::models::planar_speeds::Acceleration;
use posebridge_estimator::motion::{GyroTurn, MotionReading, MotionTrack};
use posebridge_estimator::observations::absolute::{self, RangeBearing};
use posebridge_estimator::observations::speed::speed_changes;
use posebridge_estimator::observations::{ObservationModel, fix, gyro_window};
use posebridge_estimator::update::LinearizedMeasurement;
use posebridge_telemetry::{
    Arena, Body, Fix, Heading, Meters, Point2, Pose, SensorNoise, TimeDelta, Wall, quantities::wrap_rad,
};

use crate::support::observe::ms;
use crate::support::odd::{self, GEOMETRY, H, odd_states, with_error};

type State = PoseState<RANGE_STATES>;
type Expected<const M: usize> = LinearizedMeasurement<RANGE_STATES, M>;

const QUIET: SensorNoise = SensorNoise {
    gyro_rad_per_s: 0.01,
    fix_position_m: 0.005,
    fix_heading_rad: 0.02,
    accelerometer_m_per_s2: 0.3,
    ..SensorNoise::EXACT
};

/// Largest allowed difference between a derivative and its central difference: the rounding of numbers of some metres over H.
const NEAR: f64 = 2e-8;

/// Holds H against central differences of the innovation, which is z - h(x) and must be zero in the middle.
fn check<const M: usize>(what: &str, state: &State, model: impl Fn(&State) -> ObservationModel<M>) {
    let measure = |state: &State| -> Expected<M> { linearize(&model(state)) };
    let middle = measure(state);
    let off = middle.innovation.amax();
    assert!(off < 1e-12, "{what}: the expectation is off by {off:e}");
    for row in 0..RANGE_STATES {
        let ahead = measure(&with_error(state, row, H)).innovation;
        let behind = measure(&with_error(state, row, -H)).innovation;
        for component in 0..M {
            let numeric = wrap_rad(behind[component] - ahead[component]) / (2.0 * H);
            let analytic = middle.jacobian[(component, row)];
            assert!(
                (numeric - analytic).abs() < NEAR,
                "{what}: H({component}, {row}) is {analytic} but {numeric} by differences at {:?}",
                state.pose
            );
        }
    }
}

fn arena_from_body(pose: Se2) -> Pose<Arena> {
    Pose::new(Meters(pose.x_m), Meters(pose.y_m), Heading::from_rad(pose.heading_rad))
}

fn point<S>(x_m: f64, y_m: f64) -> Point2<S> {
    Point2::new(Meters(x_m), Meters(y_m))
}

/// A camera's fix without noise of a robot at `shown`.
fn fix_without_noise(state: &State, tag_in_body: Point2<Body>, shown: Se2) -> Fix {
    let tag = point::<Body>(tag_in_body.x.0 + state.mean[TAG_FORWARD], tag_in_body.y.0 + state.mean[TAG_LEFT]);
    Fix {
        position: arena_from_body(shown) * tag,
        heading: Some(Heading::from_rad(shown.heading_rad)),
        covariance: None,
        tag_in_body,
        reset_counter: 0,
    }
}

fn circumstances(moved_since: Se2) -> fix::FixContext {
    fix::FixContext { moved_since, ..fix::FixContext::default() }
}

/// Told places of the tag: mid-axle, ahead, behind to the left, far off to the right.
const TAGS: [(f64, f64); 4] = [(0.0, 0.0), (0.08, 0.0), (-0.03, 0.05), (0.4, -1.2)];
/// How the body moved between the instant that a fix shows and its stamp: not at all, on a curve, backwards on a curve.
const MOVED: [[f64; 3]; 3] = [[0.0; 3], [0.06, 0.0, 0.4], [-0.2, 0.0, 2.9]];

#[test]
fn a_fix_of_a_tag_off_the_axle_at_an_earlier_instant_has_the_derivatives_of_its_prediction() {
    for state in odd_states::<RANGE_STATES>() {
        for (tag, moved) in TAGS.into_iter().flat_map(|tag| MOVED.map(|moved| (tag, moved))) {
            let at = circumstances(Se2::exp(moved));
            let shown = state.pose.compose(at.moved_since.inverse());
            let fix = fix_without_noise(&state, point(tag.0, tag.1), shown);
            let noise = fix::fix_noise(&fix, &QUIET, [1.0, 1.0], &at);
            check("position", &state, |state| fix::position(state, &fix, &noise, &at));
            check("pose", &state, |state| fix::pose(state, &fix, shown.heading_rad, &noise, &at));
        }
    }
}

/// A robot that drove round curves of other speed and curvature every 50 ms, until 0 ms.
fn curved_track() -> MotionTrack {
    let mut track = MotionTrack::new(GEOMETRY, 1e6);
    let (mut left_rad, mut right_rad) = (0.0, 0.0);
    for k in -8..=0_i64 {
        let reading = MotionReading::Wheels { left_rad, right_rad };
        track.insert(ms(50 * k), &reading);
        left_rad += 0.3 + 0.05 * k as f64;
        right_rad += 0.7 - 0.04 * k as f64;
    }
    track
}

#[test]
fn a_fix_has_the_derivative_by_its_delay_along_a_curved_path() {
    let (track, config) = (curved_track(), odd::config(QUIET));
    // Whole nanoseconds, so that the rounding of stamps does not disturb.
    let h = TimeDelta::from_micros(10);
    for state in odd_states::<RANGE_STATES>() {
        for delay in [TimeDelta::from_millis(20), TimeDelta::from_micros(173_400)] {
            let moved = |delay: TimeDelta| state.motion_since(ms(0) - delay, &track, &config);
            let [forward_m, _, turn_rad] = moved(delay + h).compose(moved(delay - h).inverse()).log();
            let twice_h_s = 2.0 * h.as_secs_f64();
            let fix = fix_without_noise(&state, point(0.3, -0.2), state.pose.compose(moved(delay).inverse()));
            let measured = |delay: TimeDelta| {
                let at = fix::FixContext {
                    forward_m_per_s: forward_m / twice_h_s,
                    turn_rad_per_s: turn_rad / twice_h_s,
                    ..circumstances(moved(delay))
                };
                let noise = fix::fix_noise(&fix, &QUIET, [1.0, 1.0], &at);
                let heading_rad = fix.heading.map_or(0.0, Heading::rad);
                linearize::<RANGE_STATES, 3>(&fix::pose(&state, &fix, heading_rad, &noise, &at))
            };
            let middle = measured(delay);
            assert!(middle.innovation.amax() < 1e-12);
            assert!(middle.jacobian[(0, DELAY)].abs() > 0.2, "it does move");
            let (longer, shorter) = (measured(delay + h).innovation, measured(delay - h).innovation);
            for component in 0..3 {
                let numeric = wrap_rad(shorter[component] - longer[component]) / twice_h_s;
                let analytic = middle.jacobian[(component, DELAY)];
                assert!((numeric - analytic).abs() < 1e-6, "{component}: {analytic} but {numeric}");
            }
        }
    }
}

#[test]
fn a_compass_has_the_derivative_of_its_prediction() {
    for state in odd_states::<RANGE_STATES>() {
        let heading_rad = state.pose.heading_rad;
        check("compass", &state, |state| absolute::compass(state, heading_rad, 0.1));
    }
}

/// Places of landmarks and beacons about a body: near, far, behind, and on the seam of the bearing.
const ABOUT: [(f64, f64); 5] = [(0.3, 0.0), (2.0, -1.5), (-0.4, 3.0), (-1.0, 1e-9), (0.0, -0.7)];

#[test]
fn a_landmark_has_the_derivatives_of_its_prediction() {
    for state in odd_states::<RANGE_STATES>() {
        for (forward_m, left_m) in ABOUT {
            let landmark = arena_from_body(state.pose) * point::<Body>(forward_m, left_m);
            let measured = RangeBearing { range_m: forward_m.hypot(left_m), bearing_rad: left_m.atan2(forward_m) };
            check("landmark", &state, |state| {
                absolute::landmark(state, landmark, measured, 0.01, 0.02).expect("it is away")
            });
        }
        let here = arena_from_body(state.pose).origin();
        let measured = RangeBearing { range_m: 0.0, bearing_rad: 0.0 };
        assert!(absolute::landmark(&state, here, measured, 0.01, 0.02).is_none());
    }
}

#[test]
fn a_beacon_has_the_derivatives_of_its_prediction_offset_and_scale_included() {
    for state in odd_states::<RANGE_STATES>() {
        for (slot, (forward_m, left_m)) in [0, 3, MAX_BEACONS - 1, MAX_BEACONS, 700].into_iter().zip(ABOUT) {
            let position = arena_from_body(state.pose) * point::<Body>(forward_m, left_m);
            let (offset_m, scale) = if slot < MAX_BEACONS {
                let row = BEACONS + 2 * slot;
                (state.mean[row], state.mean[row + 1])
            } else {
                (0.0, 0.0)
            };
            let range_m = forward_m.hypot(left_m) * (1.0 + scale) + offset_m;
            check("beacon", &state, |state| {
                absolute::beacon(state, position, slot, range_m, 0.01).expect("it is away")
            });
        }
    }
}

/// Walls about a body, in its own space: right ahead, oblique on both sides, and one behind the others.
const WALLS: [[(f64, f64); 2]; 4] =
    [[(1.2, -0.5), (1.2, 0.6)], [(0.5, -1.0), (1.4, 1.1)], [(2.9, -2.0), (0.9, 1.0)], [(1.0, 0.1), (1.9, -1.0)]];

fn wall_about(pose: Se2, [from, to]: [(f64, f64); 2]) -> Wall {
    let in_arena = |(x_m, y_m)| arena_from_body(pose) * point::<Body>(x_m, y_m);
    Wall { from: in_arena(from), to: in_arena(to) }
}

/// The way ahead to a wall by a search: the body's own axis is walked until the wall is on the other side.
fn distance_to(pose: Se2, wall: &Wall) -> f64 {
    let side_of = |range_m: f64| {
        let at = arena_from_body(pose) * point::<Body>(range_m, 0.0);
        let along = (wall.to.x.0 - wall.from.x.0, wall.to.y.0 - wall.from.y.0);
        along.0 * (at.y.0 - wall.from.y.0) - along.1 * (at.x.0 - wall.from.x.0)
    };
    let (mut near, mut far) = (0.0, 10.0);
    for _ in 0..60 {
        let middle = 0.5 * (near + far);
        if side_of(middle).signum() == side_of(0.0).signum() {
            near = middle;
        } else {
            far = middle;
        }
    }
    near
}

#[test]
fn a_wall_has_the_derivatives_of_its_prediction_at_any_angle() {
    for state in odd_states::<RANGE_STATES>() {
        for ends in WALLS {
            let walls = [wall_about(state.pose, ends)];
            let range_m = distance_to(state.pose, &walls[0]);
            check("wall", &state, |state| absolute::wall(state, &walls, range_m, 0.01).expect("it is ahead"));
        }
        // Of all of them, and one behind the robot, the nearest ahead.
        let mut walls = WALLS.map(|ends| wall_about(state.pose, ends)).to_vec();
        walls.push(wall_about(state.pose, [(-0.1, -1.0), (-0.1, 1.0)]));
        let nearest_m =
            walls[..WALLS.len()].iter().map(|wall| distance_to(state.pose, wall)).fold(f64::INFINITY, f64::min);
        check("nearest wall", &state, |state| absolute::wall(state, &walls, nearest_m, 0.01).expect("they are ahead"));
    }
}

#[test]
fn a_wall_that_is_not_met_is_not_expected() {
    for state in odd_states::<RANGE_STATES>() {
        for (ends, what) in [
            ([(-1.0, -1.0), (-1.0, 1.0)], "behind"),
            ([(1.0, 0.2), (1.0, 1.0)], "to the left"),
            ([(0.5, -0.1), (3.0, 0.2)], "seven degrees: it reflects away"),
            ([(1.0, 0.0), (1.0, 0.0)], "a point"),
        ] {
            let walls = [wall_about(state.pose, ends)];
            let met = absolute::wall(&state, &walls, 1.0, 0.01);
            assert!(met.is_none(), "{what}");
        }
    }
}

#[test]
fn a_gyro_window_has_the_derivatives_of_its_prediction() {
    for state in odd_states::<RANGE_STATES>() {
        for end_rounding_rad2 in [Some(1e-6), None] {
            let window = gyro_window::GyroWindow { start: ms(1_000), until: ms(1_450), forward_m: 0.08 };
            let turn = GyroTurn { turn_rad: 0.31, squared_intervals_s2: 0.02 };
            let measure = |state: &State| {
                linearize_gyro_window(&gyro_window::measurement(state, &window, &turn, &QUIET, end_rounding_rad2))
            };
            let scalar = measure(&state);
            for row in 0..RANGE_STATES {
                let ahead = measure(&with_error(&state, row, H)).innovation;
                let behind = measure(&with_error(&state, row, -H)).innovation;
                let numeric = (behind - ahead) / (2.0 * H);
                let named = scalar.rows.iter().zip(scalar.jacobian);
                let analytic: f64 = named.filter(|(named, _)| **named == row).map(|(_, by)| by).sum();
                assert!((numeric - analytic).abs() < NEAR, "row {row}: {analytic} but {numeric}");
            }
        }
    }
}

#[test]
fn accelerations_change_the_speeds_as_their_noise_does() {
    let dt_s = 0.05;
    let driven =
        |left, right| speed_changes(Acceleration::from_wheels(left, right, &GEOMETRY), dt_s, &GEOMETRY, &QUIET);
    let (none, by_left, by_right) = (driven(0.0, 0.0), driven(1.0, 0.0), driven(0.0, 1.0));
    for (i, none) in none.into_iter().enumerate() {
        let squares = by_left[i].value.powi(2) + by_right[i].value.powi(2);
        assert!((none.variance - squares * QUIET.accelerometer_m_per_s2.powi(2)).abs() < 1e-12);
    }
    assert!((by_left[0].value - 0.5 * dt_s).abs() < 1e-15 && by_left[1].value < 0.0);
}

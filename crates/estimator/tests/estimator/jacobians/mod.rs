//! Every derivative of what the pose filter expects to observe against central differences, at states where signs, wraps and
//! levers show; and every expectation against the same geometry in other words.
//!
//! The derivatives of its motion are checked in `jacobians_motion`, those of the group beside `models::lie`.

mod motion;

use posebridge_estimator::filters::pose::context::UpdateContext;
use posebridge_estimator::filters::pose::layout::{LARGE_STATES, MAX_BEACONS, MAX_LANDMARKS};
use posebridge_estimator::filters::pose::state::{PoseState, linearize_gyro_window};
use posebridge_estimator::models::lie::Se2;
use posebridge_estimator::models::planar_speeds::Acceleration;
use posebridge_estimator::motion::{GyroTurn, MotionReading, MotionTrack};
use posebridge_estimator::observations::absolute::{self, MeasuredPoint, RangeBearing};
use posebridge_estimator::observations::fix::{FixMeasurement, fix_noise};
use posebridge_estimator::observations::sensor_frame::{Exposure, SensorFrame};
use posebridge_estimator::observations::speed::speed_changes;
use posebridge_estimator::observations::{ArenaAxis, MountingAxis, ObservationModel, PoseView, StateTerm, gyro_window};
use posebridge_estimator::update::LinearizedMeasurement;
use posebridge_telemetry::{
    Arena, Body, Fix, Heading, Meters, MountedSensor, Point2, Pose, SensorNoise, TimeDelta, Wall, quantities::wrap_rad,
};

use crate::support::observe::ms;
use crate::support::odd::{self, GEOMETRY, H, odd_states, with_error};

type State = PoseState<LARGE_STATES>;
type Expected<const M: usize> = LinearizedMeasurement<LARGE_STATES, M>;

const QUIET: SensorNoise = SensorNoise {
    gyro_rad_per_s: 0.01,
    fix_position_m: 0.005,
    fix_heading_rad: 0.02,
    accelerometer_m_per_s2: 0.3,
    ..SensorNoise::EXACT
};

/// Largest allowed difference between a derivative and its central difference: the rounding of numbers of some metres over H.
const NEAR: f64 = 2e-8;

/// Holds H against central differences of the innovation, which is z - h(x) and must be zero in the middle. At rest, so that
/// nothing depends on the delays.
fn check<const M: usize>(what: &str, state: &State, model: impl Fn(&State) -> ObservationModel<M>) {
    let layout = odd::layout::<LARGE_STATES>();
    let measure = |state: &State| -> Expected<M> { layout.linearize(&model(state)) };
    let middle = measure(state);
    let off = middle.innovation.amax();
    assert!(off < 1e-12, "{what}: the expectation is off by {off:e}");
    for row in 0..LARGE_STATES {
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

fn term(state: &State, term: StateTerm) -> f64 {
    state.view(&odd::layout::<LARGE_STATES>()).term(term)
}

fn arena_from_body(pose: Se2) -> Pose<Arena> {
    Pose::new(Meters(pose.x_m), Meters(pose.y_m), Heading::from_rad(pose.heading_rad))
}

fn point<S>(x_m: f64, y_m: f64) -> Point2<S> {
    Point2::new(Meters(x_m), Meters(y_m))
}

/// The number of the source of the fixes.
const SOURCE: usize = 1;

/// A camera's fix without noise of a robot at `shown`, but with the error that all its fixes share.
fn fix_without_noise(state: &State, tag_in_body: Point2<Body>, shown: Se2) -> Fix {
    let [forward_m, left_m] = [StateTerm::TagForward, StateTerm::TagLeft].map(|of_tag| term(state, of_tag));
    let tag = point::<Body>(tag_in_body.x.0 + forward_m, tag_in_body.y.0 + left_m);
    let seen = arena_from_body(shown) * tag;
    let [bias_x_m, bias_y_m] = ArenaAxis::ALL.map(|axis| term(state, StateTerm::FixBias(SOURCE, axis)));
    Fix {
        position: point(seen.x.0 + bias_x_m, seen.y.0 + bias_y_m),
        heading: Some(Heading::from_rad(shown.heading_rad)),
        covariance: None,
        tag_in_body,
        reset_counter: 0,
    }
}

fn measured(fix: &Fix, exposure: Exposure) -> FixMeasurement<'_> {
    let noise = fix_noise(fix, &QUIET, [1.0, 1.0], &exposure, 0.0);
    FixMeasurement { fix, noise, exposure, source: Some(SOURCE) }
}

fn moved_since(moved: [f64; 3]) -> Exposure {
    Exposure { moved_since: Se2::exp(moved), ..Exposure::default() }
}

/// Where a mounted sensor was, in other words than the filter's: the body's earlier pose, then the mounting.
fn sensor_pose(state: &State, sensor: MountedSensor, exposure: &Exposure) -> Se2 {
    let [x_m, y_m, heading_rad] = MountingAxis::ALL.map(|axis| term(state, StateTerm::Mounting(sensor, axis)));
    let body = state.pose.compose(exposure.moved_since.inverse());
    let at = arena_from_body(body) * point::<Body>(x_m, y_m);
    Se2 { x_m: at.x.0, y_m: at.y.0, heading_rad: wrap_rad(body.heading_rad + heading_rad) }
}

fn frame(state: &State, sensor: MountedSensor, exposure: &Exposure) -> SensorFrame {
    SensorFrame::of_sensor(&state.view(&odd::layout::<LARGE_STATES>()), sensor, exposure)
}

/// Told places of the tag: mid-axle, ahead, behind to the left, far off to the right.
const TAGS: [(f64, f64); 4] = [(0.0, 0.0), (0.08, 0.0), (-0.03, 0.05), (0.4, -1.2)];
/// How the body moved between the instant that a fix shows and its stamp: not at all, on a curve, backwards on a curve.
const MOVED: [[f64; 3]; 3] = [[0.0; 3], [0.06, 0.0, 0.4], [-0.2, 0.0, 2.9]];

#[test]
fn a_fix_of_a_tag_off_the_axle_at_an_earlier_instant_has_the_derivatives_of_its_prediction() {
    let layout = odd::layout::<LARGE_STATES>();
    for state in odd_states::<LARGE_STATES>() {
        for (tag, moved) in TAGS.into_iter().flat_map(|tag| MOVED.map(|moved| (tag, moved))) {
            let exposure = moved_since(moved);
            let shown = state.pose.compose(exposure.moved_since.inverse());
            let fix = fix_without_noise(&state, point(tag.0, tag.1), shown);
            let measured = measured(&fix, exposure);
            check("position", &state, |state| measured.position_model(&state.view(&layout)));
            check("pose", &state, |state| measured.pose_model(&state.view(&layout), shown.heading_rad));
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
fn an_observation_has_the_derivative_by_its_delay_along_a_curved_path() {
    let layout = odd::layout::<LARGE_STATES>();
    let mut context = UpdateContext::new(&odd::config(QUIET), LARGE_STATES);
    context.track = curved_track();
    // Whole nanoseconds, so that the rounding of stamps does not disturb.
    let h = TimeDelta::from_micros(10);
    for state in odd_states::<LARGE_STATES>() {
        for delay in [TimeDelta::from_millis(20), TimeDelta::from_micros(173_400)] {
            let moved = |delay: TimeDelta| state.motion_since(ms(0) - delay, &context);
            let [forward_m, _, turn_rad] = moved(delay + h).compose(moved(delay - h).inverse()).log();
            let twice_h_s = 2.0 * h.as_secs_f64();
            let exposure = |delay: TimeDelta| Exposure {
                moved_since: moved(delay),
                forward_m_per_s: forward_m / twice_h_s,
                turn_rad_per_s: turn_rad / twice_h_s,
            };
            let by_differences = |longer: &[f64], shorter: &[f64], found: &[f64]| {
                for ((longer, shorter), analytic) in longer.iter().zip(shorter).zip(found) {
                    let numeric = wrap_rad(shorter - longer) / twice_h_s;
                    assert!((numeric - analytic).abs() < 1e-6, "{analytic} but {numeric}");
                }
            };
            let fix = fix_without_noise(&state, point(0.3, -0.2), state.pose.compose(moved(delay).inverse()));
            let of_fix = |delay: TimeDelta| -> Expected<3> {
                let heading_rad = fix.heading.map_or(0.0, Heading::rad);
                layout.linearize(&measured(&fix, exposure(delay)).pose_model(&state.view(&layout), heading_rad))
            };
            let middle = of_fix(delay);
            assert!(middle.innovation.amax() < 1e-12);
            let row = layout.row(StateTerm::FixDelay).unwrap();
            assert!(middle.jacobian.column(row).norm() > 0.2, "it does move");
            let (longer, shorter) = (of_fix(delay + h).innovation, of_fix(delay - h).innovation);
            by_differences(longer.as_slice(), shorter.as_slice(), middle.jacobian.column(row).into_owned().as_slice());

            let sighting = RangeBearing { range_m: 2.0, bearing_rad: 0.3 };
            let landmark = MeasuredPoint::landmark(point(state.pose.x_m + 1.0, state.pose.y_m - 2.0), 1);
            let of_landmark = |delay: TimeDelta| -> Expected<2> {
                let frame = frame(&state, MountedSensor::Landmarks, &exposure(delay));
                let view = state.view(&layout);
                layout.linearize(&absolute::landmark(&view, &frame, &landmark, sighting, [0.01, 0.02]).unwrap())
            };
            let row = layout.row(StateTerm::Delay(MountedSensor::Landmarks)).unwrap();
            let (longer, shorter) = (of_landmark(delay + h).innovation, of_landmark(delay - h).innovation);
            let found = of_landmark(delay).jacobian.column(row).into_owned();
            by_differences(longer.as_slice(), shorter.as_slice(), found.as_slice());
        }
    }
}

#[test]
fn a_compass_has_the_derivative_of_its_prediction() {
    for (state, moved) in odd_states::<LARGE_STATES>().into_iter().flat_map(|state| MOVED.map(|moved| (state, moved))) {
        let exposure = moved_since(moved);
        let heading_rad = sensor_pose(&state, MountedSensor::Compass, &exposure).heading_rad;
        check("compass", &state, |state| {
            absolute::compass(&frame(state, MountedSensor::Compass, &exposure), heading_rad, 0.1)
        });
    }
}

/// Places of landmarks and beacons about a sensor: near, far, behind, and on the seam of the bearing.
const ABOUT: [(f64, f64); 5] = [(0.3, 0.0), (2.0, -1.5), (-0.4, 3.0), (-1.0, 1e-9), (0.0, -0.7)];

#[test]
fn a_landmark_has_the_derivatives_of_its_prediction() {
    let layout = odd::layout::<LARGE_STATES>();
    for (state, moved) in odd_states::<LARGE_STATES>().into_iter().flat_map(|state| MOVED.map(|moved| (state, moved))) {
        let exposure = moved_since(moved);
        let sensor = sensor_pose(&state, MountedSensor::Landmarks, &exposure);
        let of_landmark = |state: &State, landmark: &MeasuredPoint, measured: RangeBearing| {
            let frame = frame(state, MountedSensor::Landmarks, &exposure);
            absolute::landmark(&state.view(&layout), &frame, landmark, measured, [0.01, 0.02])
        };
        let [scale, offset_m] = [StateTerm::LandmarkScale, StateTerm::LandmarkOffset].map(|of| term(&state, of));
        for (slot, (forward_m, left_m)) in [0, 1, 2, MAX_LANDMARKS, 700].into_iter().zip(ABOUT) {
            let there = arena_from_body(sensor) * point::<Body>(forward_m, left_m);
            let [x_m, y_m] = ArenaAxis::ALL.map(|axis| term(&state, StateTerm::LandmarkPlace(slot, axis)));
            let landmark = MeasuredPoint::landmark(point(there.x.0 - x_m, there.y.0 - y_m), slot);
            let range_m = forward_m.hypot(left_m) * (1.0 + scale) + offset_m;
            let measured = RangeBearing { range_m, bearing_rad: left_m.atan2(forward_m) };
            check("landmark", &state, |state| of_landmark(state, &landmark, measured).expect("it is away"));
        }
        let here = MeasuredPoint::landmark(arena_from_body(sensor).origin(), MAX_LANDMARKS);
        assert!(of_landmark(&state, &here, RangeBearing { range_m: 0.0, bearing_rad: 0.0 }).is_none());
    }
}

#[test]
fn a_beacon_has_the_derivatives_of_its_prediction_offset_and_scale_included() {
    let layout = odd::layout::<LARGE_STATES>();
    for (state, moved) in odd_states::<LARGE_STATES>().into_iter().flat_map(|state| MOVED.map(|moved| (state, moved))) {
        let exposure = moved_since(moved);
        let sensor = sensor_pose(&state, MountedSensor::Beacons, &exposure);
        for (slot, (forward_m, left_m)) in [0, 3, MAX_BEACONS - 1, MAX_BEACONS, 700].into_iter().zip(ABOUT) {
            let position = arena_from_body(sensor) * point::<Body>(forward_m, left_m);
            let [scale, offset_m] =
                [StateTerm::BeaconScale(slot), StateTerm::BeaconOffset(slot)].map(|of| term(&state, of));
            let range_m = forward_m.hypot(left_m) * (1.0 + scale) + offset_m;
            let beacon = MeasuredPoint::beacon(position, slot);
            check("beacon", &state, |state| {
                let frame = frame(state, MountedSensor::Beacons, &exposure);
                absolute::beacon(&state.view(&layout), &frame, &beacon, range_m, 0.01).expect("it is away")
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
    for state in odd_states::<LARGE_STATES>() {
        let exposure = moved_since(MOVED[1]);
        let sensor = sensor_pose(&state, MountedSensor::Range, &exposure);
        let wall = |state: &State, walls: &[Wall], range_m: f64| {
            absolute::wall(&frame(state, MountedSensor::Range, &exposure), walls, range_m, 0.01)
        };
        for ends in WALLS {
            let walls = [wall_about(sensor, ends)];
            let range_m = distance_to(sensor, &walls[0]);
            check("wall", &state, |state| wall(state, &walls, range_m).expect("it is ahead"));
        }
        // Of all of them, and one behind the robot, the nearest ahead.
        let mut walls = WALLS.map(|ends| wall_about(sensor, ends)).to_vec();
        walls.push(wall_about(sensor, [(-0.1, -1.0), (-0.1, 1.0)]));
        let nearest_m = walls[..WALLS.len()].iter().map(|wall| distance_to(sensor, wall)).fold(f64::INFINITY, f64::min);
        check("nearest wall", &state, |state| wall(state, &walls, nearest_m).expect("they are ahead"));
    }
}

#[test]
fn a_wall_that_is_not_met_is_not_expected() {
    for state in odd_states::<LARGE_STATES>() {
        let frame = frame(&state, MountedSensor::Range, &Exposure::default());
        for (ends, what) in [
            ([(-1.0, -1.0), (-1.0, 1.0)], "behind"),
            ([(1.0, 0.2), (1.0, 1.0)], "to the left"),
            ([(0.5, -0.1), (3.0, 0.2)], "seven degrees: it reflects away"),
            ([(1.0, 0.0), (1.0, 0.0)], "a point"),
        ] {
            let walls = [wall_about(frame.pose, ends)];
            let met = absolute::wall(&frame, &walls, 1.0, 0.01);
            assert!(met.is_none(), "{what}");
        }
    }
}

#[test]
fn a_gyro_window_has_the_derivatives_of_its_prediction() {
    let layout = odd::layout::<LARGE_STATES>();
    for state in odd_states::<LARGE_STATES>() {
        for end_rounding_rad2 in [Some(1e-6), None] {
            let window = gyro_window::GyroWindow { start: ms(1_000), until: ms(1_450), forward_m: 0.08 };
            let turn = GyroTurn { turn_rad: 0.31, squared_intervals_s2: 0.02 };
            let measure = |state: &State| {
                let model = gyro_window::measurement(&state.view(&layout), &window, &turn, &QUIET, end_rounding_rad2);
                linearize_gyro_window(&model)
            };
            let scalar = measure(&state);
            for row in 0..LARGE_STATES {
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

//! How the pose filter's motion carries errors, against central differences of the composed motion.
//!
//! An error is what leads from one state to another, X_1^-1 X_2 in the body's space, as in docs/maths/pose.md section 1.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::pose::context::UpdateContext;
use posebridge_estimator::filters::pose::layout::{
    BACKLASH, CORE_STATES, DIFFERENCE, FORWARD, GYRO_BIAS, HEADING, LARGE_STATES, LEFT, RADIUS, ROUNDING, TRACK,
    WINDOW_TURN,
};
use posebridge_estimator::filters::pose::propagation::Transition;
use posebridge_estimator::filters::pose::state::PoseState;
use posebridge_estimator::models::differential_drive::{StepNoise, WheelTravel};
use posebridge_estimator::models::lie::Se2;
use posebridge_estimator::motion::{BacklashCrossing, MotionReading, MotionTrack};
use posebridge_telemetry::{Meters, SensorNoise};

use crate::support::observe::ms;
use crate::support::odd::{GEOMETRY, H, config, odd_states, with_error};

const TRAVELS: [WheelTravel; 4] = [
    WheelTravel { left_m: 0.02, right_m: 0.02 },
    WheelTravel { left_m: 0.02, right_m: 0.021 },
    WheelTravel { left_m: -0.05, right_m: 0.06 },
    WheelTravel { left_m: -0.2, right_m: -0.03 },
];

/// The left gear crosses a part of its play backwards, the right one all of it.
const CROSSINGS: [BacklashCrossing; 2] =
    [BacklashCrossing { share: -0.3, variance: 0.0 }, BacklashCrossing { share: 1.0, variance: 0.0 }];

/// What leads from one state to another, row by row.
fn error_between<const N: usize>(from: &PoseState<N>, to: &PoseState<N>) -> SVector<f64, N> {
    let mut error = to.mean - from.mean;
    let [forward_m, left_m, turn_rad] = from.pose.between(to.pose).log();
    error[FORWARD] = forward_m;
    error[LEFT] = left_m;
    error[HEADING] = turn_rad;
    error
}

/// How the state moves over wheel travel, in other words than the filter's: true radii and track, then an arc of the group.
fn composed<const N: usize>(
    state: &PoseState<N>,
    travel: WheelTravel,
    crossings: [BacklashCrossing; 2],
) -> PoseState<N> {
    let of = |row: usize| state.mean[row];
    let lost = |wheel: usize, radius: Meters| radius.0 * of(BACKLASH) * crossings[wheel].share;
    let left_m = (travel.left_m - lost(0, GEOMETRY.left_wheel_radius)) * (1.0 + of(RADIUS) - of(DIFFERENCE) / 2.0);
    let right_m = (travel.right_m - lost(1, GEOMETRY.right_wheel_radius)) * (1.0 + of(RADIUS) + of(DIFFERENCE) / 2.0);
    let turn_rad = (right_m - left_m) / (GEOMETRY.track_width.0 * (1.0 + of(TRACK)));
    let mut moved = *state;
    moved.pose = state.pose.compose(Se2::exp([f64::midpoint(left_m, right_m), 0.0, turn_rad]));
    if state.window.is_some() {
        moved.mean[WINDOW_TURN] += turn_rad;
    }
    moved
}

/// F by central differences of a motion.
fn numeric<const N: usize>(state: &PoseState<N>, motion: impl Fn(&PoseState<N>) -> PoseState<N>) -> SMatrix<f64, N, N> {
    let end = motion(state);
    let mut f = SMatrix::<f64, N, N>::zeros();
    for row in 0..N {
        let ahead = error_between(&end, &motion(&with_error(state, row, H)));
        let behind = error_between(&end, &motion(&with_error(state, row, -H)));
        f.set_column(row, &((ahead - behind) / (2.0 * H)));
    }
    f
}

fn assert_near<const N: usize>(found: &SMatrix<f64, N, N>, expected: &SMatrix<f64, N, N>, what: &str) {
    let worst = (found - expected).amax();
    assert!(worst < 2e-8, "{what}: off by {worst:e}\n{found}\n{expected}");
}

/// A covariance in which every pair of rows is correlated.
fn correlated<const N: usize>() -> SMatrix<f64, N, N> {
    let spread = SMatrix::<f64, N, N>::from_fn(|row, column| {
        0.1 * ((3 * row + 5 * column) as f64).sin() + if row == column { 0.2 } else { 0.0 }
    });
    spread * spread.transpose()
}

/// Without noise a step must carry a covariance by F.
fn assert_propagates<const N: usize>(transition: &Transition, f: &SMatrix<f64, N, N>, what: &str) {
    let p = correlated::<N>();
    let mut carried = p;
    transition.propagate(&mut carried, &StepNoise::default());
    assert_near(&carried, &(f * p * f.transpose()), what);
}

fn check_transition<const N: usize>() {
    for state in odd_states::<N>() {
        for travel in TRAVELS {
            for is_open in [true, false] {
                let mut state = state;
                if !is_open {
                    state.close_window();
                }
                let (transition, forward_m, turn_rad) = Transition::over_travel(travel, CROSSINGS, &state, &GEOMETRY);
                let what = format!("{travel:?} from {:?}", state.pose);
                let by_differences = numeric(&state, |state| composed(state, travel, CROSSINGS));
                assert_propagates(&transition, &by_differences, &what);
                let end = composed(&state, travel, CROSSINGS);
                let [expected_m, _, expected_rad] = state.pose.between(end.pose).log();
                assert!((forward_m - expected_m).abs() < 1e-12, "{what}");
                assert!((turn_rad - expected_rad).abs() < 1e-12, "{what}");
            }
        }
    }
}

#[test]
fn over_known_travel_errors_move_as_the_composed_motion_says() {
    check_transition::<CORE_STATES>();
    check_transition::<LARGE_STATES>();
}

#[test]
fn at_held_speeds_errors_move_as_the_composed_motion_says() {
    for state in odd_states::<CORE_STATES>() {
        for (forward_m, turn_rad) in [(0.0, 0.0), (0.05, 0.3), (-0.02, 1e-5), (0.1, -2.8)] {
            let transition = Transition::at_speeds(forward_m, turn_rad);
            let expected = numeric(&state, |state| PoseState {
                pose: state.pose.compose(Se2::exp([forward_m, 0.0, turn_rad])),
                ..*state
            });
            assert_propagates(&transition, &expected, "held speeds");
        }
    }
}

/// The derivatives of the end's error by distance and turn.
fn numeric_g<const N: usize>(state: &PoseState<N>, (forward_m, turn_rad): (f64, f64)) -> SMatrix<f64, N, 2> {
    let moved = |forward_m: f64, turn_rad: f64| {
        let mut moved = *state;
        moved.pose = state.pose.compose(Se2::exp([forward_m, 0.0, turn_rad]));
        if state.window.is_some() {
            moved.mean[WINDOW_TURN] += turn_rad;
        }
        moved
    };
    let end = moved(forward_m, turn_rad);
    let by = |along: f64, turned: f64| {
        let ahead = error_between(&end, &moved(forward_m + along, turn_rad + turned));
        let behind = error_between(&end, &moved(forward_m - along, turn_rad - turned));
        (ahead - behind) / (2.0 * H)
    };
    SMatrix::from_columns(&[by(H, 0.0), by(0.0, H)])
}

#[test]
fn a_step_carries_the_covariance_by_f_and_adds_the_noise_by_g() {
    let noise = StepNoise { forward_var_m2: 0.3, turn_var_rad2: 0.7, forward_turn_m_rad: -0.2 };
    let q = Matrix2::new(0.3, -0.2, -0.2, 0.7);
    for state in odd_states::<LARGE_STATES>() {
        for travel in TRAVELS {
            let (transition, forward_m, turn_rad) = Transition::over_travel(travel, CROSSINGS, &state, &GEOMETRY);
            let g = numeric_g(&state, (forward_m, turn_rad));
            let mut alone = SMatrix::<f64, LARGE_STATES, LARGE_STATES>::zeros();
            transition.propagate(&mut alone, &noise);
            assert_near(&alone, &(g * q * g.transpose()), "the noise alone");

            let f = numeric(&state, |state| composed(state, travel, CROSSINGS));
            let p = correlated::<LARGE_STATES>();
            let mut carried = p;
            transition.propagate(&mut carried, &noise);
            let expected = f * p * f.transpose() + g * q * g.transpose();
            assert_near(&carried, &expected, "covariance and noise");
            assert_eq!(carried, carried.transpose());
        }
    }
}

fn track_of(travel: WheelTravel) -> MotionTrack {
    let mut track = MotionTrack::new(GEOMETRY, 1e6);
    let reading = |left_rad, right_rad| MotionReading::Wheels { left_rad, right_rad };
    track.insert(ms(0), &reading(0.0, 0.0));
    let left_rad = travel.left_m / GEOMETRY.left_wheel_radius.0;
    let right_rad = travel.right_m / GEOMETRY.right_wheel_radius.0;
    track.insert(ms(100), &reading(left_rad, right_rad));
    track
}

fn advanced<const N: usize>(mut state: PoseState<N>, track: MotionTrack, config: &FilterConfig) -> PoseState<N> {
    let mut context = UpdateContext::new(config, N);
    context.track = track;
    state.advance(ms(100), &context);
    state
}

#[test]
fn the_noise_of_each_wheel_enters_pose_and_window_as_its_travel_does() {
    let config = config(SensorNoise { wheel_travel_m_per_sqrt_m: 0.01, ..SensorNoise::EXACT });
    for travel in TRAVELS {
        for mut state in odd_states::<CORE_STATES>() {
            // How noisy a step is follows from the nominal geometry.
            for row in [RADIUS, DIFFERENCE, TRACK, BACKLASH] {
                state.mean[row] = 0.0;
            }
            state.covariance = SMatrix::zeros();
            let end = advanced(state, track_of(travel), &config);
            let by_wheel = |left_m: f64, right_m: f64| {
                let other = WheelTravel { left_m: travel.left_m + left_m, right_m: travel.right_m + right_m };
                error_between(&end, &advanced(state, track_of(other), &config))
            };
            let by_left = (by_wheel(H, 0.0) - by_wheel(-H, 0.0)) / (2.0 * H);
            let by_right = (by_wheel(0.0, H) - by_wheel(0.0, -H)) / (2.0 * H);
            let g = SMatrix::<f64, CORE_STATES, 2>::from_columns(&[by_left, by_right]);
            let variances = Vector2::new(travel.left_m.abs(), travel.right_m.abs()) * 1e-4;
            let expected = g * Matrix2::from_diagonal(&variances) * g.transpose();
            assert_near(&end.covariance, &expected, &format!("{travel:?}"));
            assert!(end.covariance[(GYRO_BIAS, GYRO_BIAS)] == 0.0);
            assert!(end.covariance[(WINDOW_TURN, WINDOW_TURN)] > 0.0);
            assert!(end.covariance[(ROUNDING, ROUNDING)] == 0.0);
        }
    }
}

#[test]
fn the_variance_of_held_speeds_enters_the_pose_as_the_speeds_do() {
    let config = config(SensorNoise::EXACT);
    let context = UpdateContext::new(&config, CORE_STATES);
    for mut state in odd_states::<CORE_STATES>() {
        state.covariance = correlated();
        state.motion_evidence.may_turn = true;
        (state.forward.variance, state.turn.variance) = (0.04, 0.5);
        let moved = |start: &PoseState<CORE_STATES>| {
            let mut moved = *start;
            moved.advance(ms(250), &context);
            moved
        };
        let end = moved(&state);
        let by_speeds = |forward: f64, turn: f64| {
            let mut other = state;
            other.forward.value += forward;
            other.turn.value += turn;
            error_between(&end, &moved(&other))
        };
        let by_forward = (by_speeds(H, 0.0) - by_speeds(-H, 0.0)) / (2.0 * H);
        let by_turn = (by_speeds(0.0, H) - by_speeds(0.0, -H)) / (2.0 * H);
        assert!((by_forward.norm() - 0.25).abs() < 0.05, "it does move");
        let g = SMatrix::<f64, CORE_STATES, 2>::from_columns(&[by_forward, by_turn]);
        let f = numeric(&state, moved);
        let variances = Matrix2::from_diagonal(&Vector2::new(0.04, 0.5));
        let expected = f * state.covariance * f.transpose() + g * variances * g.transpose();
        assert_near(&end.covariance, &expected, "held speeds");
    }
}

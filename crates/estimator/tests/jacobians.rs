//! Every derivative of the pose filter against central differences, at states where signs, wraps and levers show.
//!
//! The derivatives of a step of the body itself are checked beside `models::se2`.

use nalgebra::{Matrix2, SMatrix};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::Params;
use posebridge_estimator::filters::pose::state::{
    Covariance, FORWARD, GYRO_BIAS, HEADING, Mean, N, PoseState, TURN, WINDOW_ERROR, X, Y,
};
use posebridge_estimator::models::differential_drive::{StepNoise, WheelTravel};
use posebridge_estimator::models::se2::BodyStep;
use posebridge_estimator::motion::{GyroTurn, MotionReading, MotionTrack};
use posebridge_estimator::observations::{fix, gyro_window, speed};
use posebridge_estimator::update::Measurement;
use posebridge_telemetry::{
    BrickClock, DriveGeometry, Fix, Heading, Meters, Point2, Radians, SensorNoise, Stamp,
    quantities::wrap_rad,
};

/// Wheels of unequal size, so that left and right cannot be confused.
const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(0.028),
    right_wheel_radius: Meters(0.03),
    track_width: Meters(0.11),
    tick: Radians(0.017_453_3),
};

const QUIET: SensorNoise = SensorNoise {
    wheel_travel_m_per_sqrt_m: 0.0,
    travel_m_per_sqrt_m: 0.0,
    turn_rad_per_sqrt_rad: 0.0,
    heading_rad_per_sqrt_m: 0.0,
    gyro_rad_per_s: 0.01,
    gyro_resolution_rad_per_s: 0.0,
    gyro_bias_rad_per_s: 0.0,
    gyro_bias_walk_rad_per_s_sqrt_s: 0.0,
    fix_position_m: 0.005,
    fix_heading_rad: 0.02,
    ..SensorNoise::EXACT
};

/// x, y, heading, forward speed, turn rate, gyro bias, window error: in every quadrant, at the seam of the circle, at rest,
/// backwards, and turning fast.
const STATES: [[f64; N]; 6] = [
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.3, -0.7, 0.4, 0.2, 0.0, 0.01, -0.02],
    [-2.1, 3.9, 1.9, 0.35, 2.5, -0.03, 0.05],
    [5.0, 5.0, -2.6, -0.15, -4.0, 0.002, 0.3],
    [0.1, -9.0, SEAM, 0.4, 1e-5, 0.02, 0.0],
    [-7.0, 0.2, -SEAM, 0.4, -1.2, 0.0, -0.1],
];

/// A hair before the half circle.
const SEAM: f64 = std::f64::consts::PI - 2e-7;

const H: f64 = 1e-6;

fn mean_of(state: [f64; N]) -> Mean {
    Mean::from_row_slice(&state)
}

fn ms(millis: i64) -> Stamp<BrickClock> {
    Stamp::from_millis(millis)
}

/// Holds a measurement's H against central differences of its innovation, which is z - h(x).
fn check_measurement<const M: usize>(what: &str, measure: impl Fn(&Mean) -> Measurement<N, M>) {
    for state in STATES {
        let mean = mean_of(state);
        let analytic = measure(&mean).jacobian;
        for column in 0..N {
            let mut step = Mean::zeros();
            step[column] = H;
            let ahead = measure(&(mean + step)).innovation;
            let behind = measure(&(mean - step)).innovation;
            for row in 0..M {
                let numeric = wrap_rad(behind[row] - ahead[row]) / (2.0 * H);
                assert!(
                    (numeric - analytic[(row, column)]).abs() < 1e-8,
                    "{what}: H({row}, {column}) is {} but {numeric} by differences at {state:?}",
                    analytic[(row, column)]
                );
            }
        }
    }
}

fn seen(tag_m: (f64, f64)) -> Fix {
    Fix {
        position: Point2::new(Meters(0.9), Meters(-0.3)),
        heading: Some(Heading::from_rad(0.5)),
        covariance: None,
        tag_in_body: Point2::new(Meters(tag_m.0), Meters(tag_m.1)),
        reset_counter: 0,
    }
}

#[test]
fn a_fix_of_a_tag_off_the_axle_has_the_derivatives_of_its_prediction() {
    let circumstances = fix::Circumstances {
        noise: &QUIET,
        stamp_sigma_s: 0.0,
        forward_m_per_s: 0.0,
        turn_rad_per_s: 0.0,
    };
    for tag_m in [(0.0, 0.0), (0.08, 0.0), (-0.03, 0.05), (0.4, -1.2)] {
        let seen = seen(tag_m);
        let noise = fix::noise_of(&seen, &circumstances);
        check_measurement("position", |mean| fix::position(mean, &seen, &noise));
        check_measurement("pose", |mean| fix::pose(mean, &seen, 0.5, &noise));
    }
}

#[test]
fn a_gyro_window_has_the_derivatives_of_its_prediction() {
    let window = gyro_window::GyroWindow {
        start: ms(1_000),
        until: ms(1_450),
        encoder_turn_rad: 0.3,
        encoder_forward_m: 0.08,
        moved: gyro_window::Moved::Yes,
    };
    let turn = GyroTurn {
        turn_rad: 0.31,
        squared_secs: 0.02,
    };
    check_measurement("gyro window", |mean| {
        gyro_window::measurement(mean, &window, &turn, &GEOMETRY, &QUIET)
    });
}

#[test]
fn speeds_and_rates_have_the_derivatives_of_their_predictions() {
    let step = BodyStep {
        forward_m: 0.012,
        turn_rad: -0.07,
    };
    let noise = StepNoise::default();
    check_measurement("forward", |mean| {
        speed::forward(mean, step, &noise, 0.05, &GEOMETRY)
    });
    check_measurement("turn", |mean| {
        speed::turn(mean, step, &noise, 0.05, &GEOMETRY)
    });
    check_measurement("gyro", |mean| speed::gyro(mean, 0.4, &QUIET));
}

/// A configuration in which nothing adds noise, so that what remains of P' is F P F'.
fn config(noise: SensorNoise) -> FilterConfig {
    FilterConfig {
        calibration: posebridge_telemetry::Calibration::default(),
        world: std::sync::Arc::default(),
        geometry: GEOMETRY,
        noise,
        start: None,
        params: Params {
            acceleration_m_per_s2: 0.0,
            turn_acceleration_rad_per_s2: 0.0,
            ..Params::default()
        },
    }
}

/// A state at 0 ms with a covariance in which every pair of rows is correlated.
fn state_of(mean: Mean, config: &FilterConfig) -> PoseState {
    let mut state = PoseState::initial(config);
    state.restart_window(ms(0));
    let spread = Covariance::from_fn(|row, column| {
        0.1 * ((3 * row + 5 * column) as f64).sin() + if row == column { 0.2 } else { 0.0 }
    });
    state.covariance = spread * spread.transpose();
    state.mean = mean;
    state.stamp = Some(ms(0));
    state.last_motion = Some(ms(0));
    state
}

fn track_of(travel: WheelTravel) -> MotionTrack {
    let mut track = MotionTrack::new(GEOMETRY, 1e6);
    let reading = |left_rad, right_rad| MotionReading::Wheels {
        left_rad,
        right_rad,
    };
    track.add(ms(0), &reading(0.0, 0.0));
    track.add(
        ms(100),
        &reading(
            travel.left_m / GEOMETRY.left_wheel_radius.0,
            travel.right_m / GEOMETRY.right_wheel_radius.0,
        ),
    );
    track
}

fn advanced(mut state: PoseState, track: &MotionTrack, config: &FilterConfig) -> PoseState {
    state.advance(ms(100), track, config);
    state
}

/// F by central differences of the mean.
fn numeric_jacobian(state: &PoseState, track: &MotionTrack, config: &FilterConfig) -> Covariance {
    let mut jacobian = Covariance::zeros();
    for column in 0..N {
        let mut step = Mean::zeros();
        step[column] = H;
        let moved = |sign: f64| {
            let mut start = *state;
            start.mean += step * sign;
            advanced(start, track, config).mean
        };
        let mut change = moved(1.0) - moved(-1.0);
        change[HEADING] = wrap_rad(change[HEADING]);
        jacobian.set_column(column, &(change / (2.0 * H)));
    }
    jacobian
}

fn assert_near(found: &Covariance, expected: &Covariance, what: &str) {
    let worst = (found - expected).abs().max();
    assert!(
        worst < 1e-8,
        "{what}: off by {worst:e}\n{found}\n{expected}"
    );
}

const TRAVELS: [WheelTravel; 4] = [
    WheelTravel {
        left_m: 0.0,
        right_m: 0.0,
    },
    WheelTravel {
        left_m: 0.02,
        right_m: 0.021,
    },
    WheelTravel {
        left_m: -0.05,
        right_m: 0.06,
    },
    WheelTravel {
        left_m: -0.2,
        right_m: -0.03,
    },
];

#[test]
fn over_known_travel_the_covariance_follows_the_derivative_of_the_mean() {
    let config = config(QUIET);
    for travel in TRAVELS {
        let track = track_of(travel);
        for values in STATES {
            let state = state_of(mean_of(values), &config);
            let f = numeric_jacobian(&state, &track, &config);
            let expected = f * state.covariance * f.transpose();
            let found = advanced(state, &track, &config).covariance;
            assert_near(&found, &expected, &format!("{travel:?} from {values:?}"));
        }
    }
}

#[test]
fn held_speeds_carry_their_covariance_into_the_pose() {
    let config = config(QUIET);
    let nothing_read_since = track_of(WheelTravel::default());
    for values in STATES {
        let mut state = state_of(mean_of(values), &config);
        state.stamp = Some(ms(100));
        state.last_motion = Some(ms(100));
        let moved = |mut start: PoseState| {
            start.advance(ms(350), &nothing_read_since, &config);
            start
        };
        let mut f = Covariance::zeros();
        for column in 0..N {
            let mut step = Mean::zeros();
            step[column] = H;
            let (mut ahead, mut behind) = (state, state);
            ahead.mean += step;
            behind.mean -= step;
            let mut change = moved(ahead).mean - moved(behind).mean;
            change[HEADING] = wrap_rad(change[HEADING]);
            f.set_column(column, &(change / (2.0 * H)));
        }
        assert!(f[(X, FORWARD)].hypot(f[(Y, FORWARD)]) > 0.2, "it does move");
        assert!((f[(HEADING, TURN)] - 0.25).abs() < 1e-8);
        let expected = f * state.covariance * f.transpose();
        assert_near(
            &moved(state).covariance,
            &expected,
            &format!("held speeds from {values:?}"),
        );
    }
}

#[test]
fn the_noise_of_each_wheel_enters_pose_and_window_as_its_travel_does() {
    let noise = SensorNoise {
        wheel_travel_m_per_sqrt_m: 0.01,
        ..QUIET
    };
    let config = config(noise);
    for travel in &TRAVELS[1..] {
        for values in STATES {
            let mut state = state_of(mean_of(values), &config);
            state.covariance = Covariance::zeros();
            let by_wheel = |left_m: f64, right_m: f64| {
                let track = track_of(WheelTravel {
                    left_m: travel.left_m + left_m,
                    right_m: travel.right_m + right_m,
                });
                advanced(state, &track, &config)
            };
            let mut g = SMatrix::<f64, N, 2>::zeros();
            for (wheel, (left_m, right_m)) in [(H, 0.0), (0.0, H)].into_iter().enumerate() {
                let ahead = by_wheel(left_m, right_m);
                let behind = by_wheel(-left_m, -right_m);
                let mut change = ahead.mean - behind.mean;
                change[HEADING] = wrap_rad(change[HEADING]);
                // W is the part of the heading's error that came since the window began.
                change[WINDOW_ERROR] = change[HEADING];
                g.set_column(wheel, &(change / (2.0 * H)));
            }
            let q = Matrix2::from_diagonal(&nalgebra::Vector2::new(
                1e-4 * travel.left_m.abs(),
                1e-4 * travel.right_m.abs(),
            ));
            let expected = g * q * g.transpose();
            let found = by_wheel(0.0, 0.0).covariance;
            assert_near(&found, &expected, &format!("{travel:?} from {values:?}"));
            assert!(found[(GYRO_BIAS, GYRO_BIAS)] == 0.0);
        }
    }
}

//! States of the pose filter at which signs, wraps and levers show, and errors of a state as the filter counts them.

use std::sync::Arc;

use posebridge_estimator::filters::pose::layout::{
    BACKLASH, DIFFERENCE, GYRO_BIAS, GYRO_SCALE, RADIUS, ROUNDING, StateLayout, TRACK, WINDOW_TURN,
};
use posebridge_estimator::filters::pose::state::PoseState;
use posebridge_estimator::models::lie::Se2;
use posebridge_estimator::{FilterConfig, Params};
use posebridge_telemetry::{
    ArenaMap, BeaconId, Calibration, DriveGeometry, LandmarkId, Meters, Point2, Radians, SensorNoise,
};

use super::observe::ms;

/// Wheels of unequal size, so that left and right cannot be confused.
pub(crate) const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(0.028),
    right_wheel_radius: Meters(0.03),
    track_width: Meters(0.11),
    tick: Radians(0.017_453_3),
};

/// A hair before the half circle.
const SEAM: f64 = std::f64::consts::PI - 2e-7;

/// x, y, heading, forward speed, turn rate: in every quadrant, at the seam of the circle, at rest, backwards, and turning fast.
const POSES: [[f64; 5]; 6] = [
    [0.0, 0.0, 0.0, 0.0, 0.0],
    [1.3, -0.7, 0.4, 0.2, 0.0],
    [-2.1, 3.9, 1.9, 0.35, 2.5],
    [5.0, 5.0, -2.6, -0.15, -4.0],
    [0.1, -9.0, SEAM, 0.4, 1e-5],
    [-7.0, 0.2, -SEAM, 0.4, -1.2],
];

/// The step of central differences: a millionth of a metre or radian.
pub(crate) const H: f64 = 1e-6;

/// A configuration in which nothing adds noise but what is given.
pub(crate) fn config(noise: SensorNoise) -> FilterConfig {
    FilterConfig {
        calibration: Calibration::default(),
        arena_map: Arc::default(),
        slow_sensor: posebridge_estimator::models::slow_sensor::SlowSensor::UNKNOWN,
        geometry: GEOMETRY,
        noise,
        start: None,
        params: Params { acceleration_m_per_s2: 0.0, turn_acceleration_rad_per_s2: 0.0, ..Params::default() },
    }
}

/// A configuration that leaves everything unknown that a filter can learn.
pub(crate) fn config_with_every_state(noise: SensorNoise) -> FilterConfig {
    let place = |id: u32| Point2::new(Meters(f64::from(id)), Meters(-1.0));
    FilterConfig {
        calibration: super::any::all_unknown(),
        arena_map: Arc::new(ArenaMap {
            landmarks: (0..3).map(|id| (LandmarkId(id), place(id))).collect(),
            beacons: (0..4).map(|id| (BeaconId(id), place(id))).collect(),
            walls: Vec::new(),
        }),
        noise: SensorNoise { fix_persistent_m: 0.02, landmark_place_m: 0.03, ..noise },
        ..config(noise)
    }
}

/// The layout of the states below.
pub(crate) fn layout<const N: usize>() -> StateLayout {
    StateLayout::new(&config_with_every_state(SensorNoise::EXACT), N)
}

/// The states at 0 ms, with a window that is open and constants that are far from nominal.
pub(crate) fn odd_states<const N: usize>() -> [PoseState<N>; 6] {
    POSES.map(|[x_m, y_m, heading_rad, forward, turn]| {
        let layout = layout::<N>();
        let mut state = PoseState::<N>::initial(&config_with_every_state(SensorNoise::EXACT), &layout);
        state.restart_window(ms(0));
        state.stamp = Some(ms(0));
        state.status.last_motion = Some(ms(0));
        state.pose = Se2 { x_m, y_m, heading_rad };
        state.forward.value = forward;
        state.turn.value = turn;
        let beyond_the_core = layout.priors().iter().map(|prior| (prior.row, 0.2 * (prior.row as f64).sin()));
        for (row, value) in CONSTANTS.into_iter().chain(beyond_the_core) {
            // Other values in every state.
            state.mean[row] = value * (1.0 + 0.1 * x_m);
        }
        state
    })
}

const CONSTANTS: [(usize, f64); 8] = [
    (GYRO_BIAS, 0.013),
    (WINDOW_TURN, -0.04),
    (RADIUS, 0.02),
    (DIFFERENCE, -0.03),
    (TRACK, 0.05),
    (ROUNDING, 0.002),
    (GYRO_SCALE, -0.015),
    (BACKLASH, 0.04),
];

/// The state with an error of `by` in one row: X exp(by e) for the pose's rows, a sum for the others.
pub(crate) fn with_error<const N: usize>(state: &PoseState<N>, row: usize, by: f64) -> PoseState<N> {
    let mut moved = *state;
    moved.mean[row] += by;
    moved.inject();
    moved
}

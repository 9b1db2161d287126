//! A step of the flagship's state and of what is known of wheels and gyro, without history and records around it.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::pose::motion_update::{self, ChiSquareGates, UpdateContext};
use posebridge_estimator::filters::pose::state::{CORE_STATES, PoseState};
use posebridge_estimator::motion::{GyroTrack, MotionReading, MotionTrack};
use posebridge_telemetry::{FusionOutcome, FusionRecord, ObservationKind, TimeDelta};

use super::steady::{gyro, stamp, wheels};

/// As much of the past as the filter keeps.
const KEPT: TimeDelta = TimeDelta::from_millis(3_000);

/// The state with its tracks.
pub(crate) struct FilterWithoutHistory {
    config: FilterConfig,
    gates: ChiSquareGates,
    track: MotionTrack,
    gyro: GyroTrack,
    state: PoseState<CORE_STATES>,
    record: FusionRecord,
    step: i64,
}

impl FilterWithoutHistory {
    pub(crate) fn new(config: &FilterConfig) -> Self {
        let first = wheels(0);
        Self {
            config: config.clone(),
            gates: motion_update::chi_square_gates(config),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            gyro: GyroTrack::default(),
            state: PoseState::initial(config),
            record: FusionRecord {
                sensor: first.sensor,
                kind: first.measurement.kind(),
                stamp: first.stamp,
                lag: TimeDelta::ZERO,
                outcome: FusionOutcome::Accepted,
                innovation: [0.0; 3],
                innovation_covariance: [[0.0; 3]; 3],
                nis: 0.0,
                degrees_of_freedom: 0,
                log_likelihood: 0.0,
            },
            step: 0,
        }
    }

    /// One step: the gyro speaks, then the wheels; the pose is carried on, and a gyro window closes every fourth time.
    pub(crate) fn drive_on(&mut self) {
        self.step += 1;
        let now = stamp(self.step);
        let (ObservationKind::TurnRate(rate), ObservationKind::WheelAngles { left, right }) =
            (gyro(self.step).measurement, wheels(self.step).measurement)
        else {
            return;
        };
        self.gyro.insert(now, rate.0);
        let reading = MotionReading::Wheels { left_rad: left.0, right_rad: right.0 };
        self.track.insert(now, &reading);
        let context = UpdateContext { config: &self.config, track: &self.track, gyro: &self.gyro, gates: &self.gates };
        self.state.predict_speeds_and_bias(now, &self.config);
        motion_update::update_turn_rate(&mut self.state, rate.0, &context);
        self.state.advance(now, &self.track, &self.config);
        motion_update::update_motion(&mut self.state, now, &context, &mut self.record);
        self.track.discard_before(now - KEPT);
        self.gyro.discard_before(now - KEPT);
    }
}

/// The same robot, whose wheels and track are known to half a per cent and three.
pub(crate) fn learning() -> FilterConfig {
    let known = |sigma| posebridge_telemetry::UncertainValue { value: 0.0, sigma };
    FilterConfig {
        calibration: posebridge_telemetry::Calibration {
            radius_scale: known(0.005),
            radius_difference: known(0.005),
            track_scale: known(0.03),
            ..posebridge_telemetry::Calibration::default()
        },
        ..super::robot::config()
    }
}

//! A step of the flagship's state and of what is known of wheels and gyro, without history and records around it.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::filters::pose::fuse::{self, Context, Gates};
use posebridge_estimator::filters::pose::state::{CORE, PoseState};
use posebridge_estimator::motion::{GyroTrack, MotionReading, MotionTrack};
use posebridge_telemetry::{FusionRecord, Observed, Span, Verdict};

use super::steady::{gyro, stamp, wheels};

/// As much of the past as the filter keeps.
const KEPT: Span = Span::from_millis(3_000);

/// The state with its tracks.
pub(crate) struct Bare {
    config: FilterConfig,
    gates: Gates,
    track: MotionTrack,
    gyro: GyroTrack,
    state: PoseState<CORE>,
    record: FusionRecord,
    step: i64,
}

impl Bare {
    pub(crate) fn new(config: &FilterConfig) -> Self {
        let first = wheels(0);
        Self {
            config: config.clone(),
            gates: fuse::gates_of(config),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            gyro: GyroTrack::default(),
            state: PoseState::initial(config),
            record: FusionRecord {
                sensor: first.sensor,
                kind: first.observed.kind(),
                stamp: first.stamp,
                lag: Span::ZERO,
                verdict: Verdict::Accepted,
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
        let (Observed::TurnRate(rate), Observed::WheelAngles { left, right }) =
            (gyro(self.step).observed, wheels(self.step).observed)
        else {
            return;
        };
        self.gyro.add(now, rate.0);
        let reading = MotionReading::Wheels { left_rad: left.0, right_rad: right.0 };
        self.track.add(now, &reading);
        let context = Context { config: &self.config, track: &self.track, gyro: &self.gyro, gates: &self.gates };
        self.state.age(now, &self.config);
        fuse::turn_rate(&mut self.state, rate.0, &context);
        self.state.advance(now, &self.track, &self.config);
        fuse::motion(&mut self.state, now, &context, &mut self.record);
        self.track.forget_before(now - KEPT);
        self.gyro.forget_before(now - KEPT);
    }
}

/// The same robot, whose wheels and track are known to half a per cent and three.
pub(crate) fn learning() -> FilterConfig {
    let known = |sigma| posebridge_telemetry::Known { value: 0.0, sigma };
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

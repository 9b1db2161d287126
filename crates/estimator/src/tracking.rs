//! What every pose filter keeps beside its state, and the estimate that it publishes.

use nalgebra::Matrix3;
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, MetersPerSecond, Pose, PoseCorrection, Radians, RadiansPerSecond, ResetCause,
    TimeDelta, Timestamp, Validity, quantities::wrap_rad,
};
use serde::{Deserialize, Serialize};

use crate::motion::SPEED_HOLD;

/// The last observations that were used, and the jumps that are not motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrackingStatus {
    pub last_fix: Option<Timestamp<BrickClock>>,
    pub last_motion: Option<Timestamp<BrickClock>>,
    pub reset_counter: u8,
    pub last_jump: Option<PoseCorrection>,
}

/// Pose and speeds, as published.
pub(crate) struct PublishedState {
    pub(crate) pose: Pose<Arena>,
    /// Forward speed, m/s, and turn rate, rad/s.
    pub(crate) speeds: [f64; 2],
    pub(crate) covariance: [[f64; 5]; 5],
    pub(crate) has_position: bool,
    pub(crate) has_heading: bool,
}

impl TrackingStatus {
    pub(crate) fn record_jump(&mut self, cause: ResetCause, before: Pose<Arena>, after: Pose<Arena>) {
        self.reset_counter = self.reset_counter.wrapping_add(1);
        self.last_jump = Some(PoseCorrection {
            dx_m: after.x.0 - before.x.0,
            dy_m: after.y.0 - before.y.0,
            turn: Radians(wrap_rad(after.heading.rad() - before.heading.rad())),
            cause,
        });
    }

    /// After a restart of the brick's clock no stamp holds.
    pub(crate) fn forget_stamps(&mut self) {
        self.last_fix = None;
        self.last_motion = None;
    }

    pub(crate) fn estimate(
        &self,
        stamp: Timestamp<BrickClock>,
        state: &PublishedState,
        fix_timeout_s: f64,
    ) -> Estimate {
        let fix_age = self.last_fix.map(|last| (stamp - last).max(TimeDelta::ZERO));
        let timeout = TimeDelta::from_secs_f64(fix_timeout_s);
        let estimate = Estimate {
            stamp,
            pose: state.pose,
            forward_speed: MetersPerSecond(state.speeds[0]),
            turn_rate: RadiansPerSecond(state.speeds[1]),
            covariance: state.covariance,
            validity: Validity {
                position: state.has_position,
                heading: state.has_heading,
                speeds: self.last_motion.is_some_and(|last| stamp - last <= SPEED_HOLD),
            },
            is_dead_reckoning: fix_age.is_none_or(|age| age > timeout),
            fix_age,
            reset_counter: self.reset_counter,
            last_correction: self.last_jump,
            missing: None,
        };
        // A number that is none is no pose, whatever the filter knows.
        let validity = if estimate.is_finite() { estimate.validity } else { Validity::default() };
        Estimate { validity, ..estimate }
    }
}

/// The covariance of a pose and of speeds that are independent of it, with the variances of these.
pub(crate) fn with_speed_variances(pose: &Matrix3<f64>, speeds: [f64; 2]) -> [[f64; 5]; 5] {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| match (i, j) {
            (0..3, 0..3) => pose[(i, j)],
            _ if i == j => speeds[i - 3],
            _ => 0.0,
        })
    })
}

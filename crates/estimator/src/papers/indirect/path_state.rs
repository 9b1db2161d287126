//! The state of the indirect filter at one instant, and the estimate that follows from it for that instant or a later one.

use nalgebra::{Matrix3, Vector2};
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Heading, Meters, MetersPerSecond, Pose, PoseCorrection, RadiansPerSecond, TimeDelta,
    Timestamp, Validity, estimate::row,
};

use crate::filter::FilterConfig;
use crate::models::se2::{BodyStep, StepRule, displace};
use crate::motion::SPEED_HOLD;
use crate::numerics::covariance::symmetrise;

/// Interval over which the speed is a mean; the speed may have changed by its end.
const TYPICAL_STEP_S: f64 = 0.05;

/// The state at one instant, as far as an estimate needs it.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathState {
    pub(super) pose: Pose<Arena>,
    pub(super) covariance: Matrix3<f64>,
    pub(super) forward_m_per_s: f64,
    pub(super) turn_rad_per_s: f64,
    pub(super) last_motion: Option<Timestamp<BrickClock>>,
    pub(super) has_pose: bool,
    pub(super) has_heading: bool,
    pub(super) last_fix: Option<Timestamp<BrickClock>>,
    pub(super) reset_counter: u8,
    pub(super) last_jump: Option<PoseCorrection>,
}

impl PathState {
    /// The estimate for an instant at or after the state's own: the speeds are held for a while, then the robot is at rest.
    pub(super) fn estimate(
        &self,
        config: &FilterConfig,
        at: Timestamp<BrickClock>,
        stamp: Timestamp<BrickClock>,
    ) -> Estimate {
        let held_until = self.last_motion.map_or(at, |moved| moved + SPEED_HOLD);
        let dt_s = (stamp.min(held_until) - at).as_secs_f64().max(0.0);
        let (pose, pose_covariance) = self.predict_pose(config, dt_s);
        let mut covariance = [[0.0; 5]; 5];
        for (i, values) in covariance.iter_mut().enumerate().take(3) {
            for (j, value) in values.iter_mut().enumerate().take(3) {
                *value = pose_covariance[(i, j)];
            }
        }
        let params = &config.params;
        covariance[row::FORWARD][row::FORWARD] = params.acceleration_m_per_s2.powi(2) * (dt_s + TYPICAL_STEP_S);
        covariance[row::TURN][row::TURN] = params.turn_acceleration_rad_per_s2.powi(2) * (dt_s + TYPICAL_STEP_S);
        let fix_age = self.last_fix.map(|fixed| (stamp - fixed).max(TimeDelta::ZERO));
        Estimate {
            stamp,
            pose,
            forward_speed: MetersPerSecond(self.forward_m_per_s),
            turn_rate: RadiansPerSecond(self.turn_rad_per_s),
            covariance,
            validity: Validity {
                position: self.has_pose,
                heading: self.has_heading,
                speeds: self.last_motion.is_some_and(|moved| stamp - moved <= SPEED_HOLD),
            },
            is_dead_reckoning: fix_age.is_none_or(|age| age.as_secs_f64() > params.fix_timeout_s),
            fix_age,
            reset_counter: self.reset_counter,
            last_correction: self.last_jump,
        }
    }

    /// The pose after the speeds were held for `dt_s`; they may change in that time as fast as the parameters allow.
    fn predict_pose(&self, config: &FilterConfig, dt_s: f64) -> (Pose<Arena>, Matrix3<f64>) {
        let step = BodyStep { forward_m: self.forward_m_per_s * dt_s, turn_rad: self.turn_rad_per_s * dt_s };
        let moved = displace(self.pose.heading.rad(), step, StepRule::Arc);
        let pose = Pose::new(
            Meters(self.pose.x.0 + moved.dx_m),
            Meters(self.pose.y.0 + moved.dy_m),
            Heading::from_rad(self.pose.heading.rad() + step.turn_rad),
        );
        let mut f = Matrix3::identity();
        f[(0, 2)] = moved.by_heading[0];
        f[(1, 2)] = moved.by_heading[1];
        let walked_s3 = dt_s.powi(3) / 3.0;
        let along = Vector2::from(moved.by_forward);
        let mut q = Matrix3::zeros();
        let along_m2 = config.params.acceleration_m_per_s2.powi(2) * walked_s3;
        q.fixed_view_mut::<2, 2>(0, 0).copy_from(&(along * along.transpose() * along_m2));
        q[(2, 2)] = config.params.turn_acceleration_rad_per_s2.powi(2) * walked_s3;
        let mut covariance = f * self.covariance * f.transpose() + q;
        symmetrise(&mut covariance);
        (pose, covariance)
    }
}

//! The state of the indirect filter at one instant, and the estimate that follows from it for that instant or a later one.

use nalgebra::{Matrix3, Vector2};
use posebridge_telemetry::{Arena, BrickClock, Estimate, Heading, Meters, Pose, Timestamp};
use serde::{Deserialize, Serialize};

use crate::filter::FilterConfig;
use crate::models::se2::{BodyStep, StepRule, displace};
use crate::motion::SPEED_HOLD;
use crate::numerics::covariance::symmetrise;
use crate::saved::{covariance, finite};
use crate::tracking::{PublishedState, TrackingStatus, with_speed_variances};

/// Interval over which the speed is a mean; the speed may have changed by its end.
const TYPICAL_STEP_S: f64 = 0.05;

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct PathState {
    #[serde(deserialize_with = "finite")]
    pub(super) pose: Pose<Arena>,
    #[serde(deserialize_with = "covariance")]
    pub(super) covariance: Matrix3<f64>,
    #[serde(deserialize_with = "finite")]
    pub(super) forward_m_per_s: f64,
    #[serde(deserialize_with = "finite")]
    pub(super) turn_rad_per_s: f64,
    pub(super) has_pose: bool,
    pub(super) has_heading: bool,
    pub(super) status: TrackingStatus,
}

impl PathState {
    /// The estimate for an instant at or after the state's own: the speeds are held for a while, then the robot is at rest.
    pub(super) fn estimate(
        &self,
        config: &FilterConfig,
        at: Timestamp<BrickClock>,
        stamp: Timestamp<BrickClock>,
    ) -> Estimate {
        let held_until = self.status.last_motion.map_or(at, |moved| moved + SPEED_HOLD);
        let dt_s = (stamp.min(held_until) - at).as_secs_f64().max(0.0);
        let (pose, pose_covariance) = self.predict_pose(config, dt_s);
        let params = &config.params;
        let grown_s = dt_s + TYPICAL_STEP_S;
        let accelerations = [params.acceleration_m_per_s2, params.turn_acceleration_rad_per_s2];
        let published = PublishedState {
            pose,
            speeds: [self.forward_m_per_s, self.turn_rad_per_s],
            covariance: with_speed_variances(&pose_covariance, accelerations.map(|sigma| sigma.powi(2) * grown_s)),
            has_position: self.has_pose,
            has_heading: self.has_heading,
        };
        self.status.estimate(stamp, &published, params.fix_timeout_s)
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

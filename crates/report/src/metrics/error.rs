//! The error of a pose: estimated minus true, in the arena.
//!
//! All accuracy metrics eat this one type, whether the error is that of the estimate, of the brick's own odometry or of
//! a foreign program. It holds the claimed covariance beside the error, because consistency can only be tested with both.

use posebridge_telemetry::{Arena, Estimate, Pose};

use crate::track::PoseTrack;

/// Estimated minus true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Along the arena's x, in metres.
    pub dx_m: f64,
    /// Along the arena's y, in metres.
    pub dy_m: f64,
    /// Heading the short way, in (-pi, pi]; `None` where one of the two has no heading.
    pub heading_rad: Option<f64>,
    /// The claimed covariance of x, y and heading, in m², m rad and rad²; `None` where nothing was claimed.
    pub covariance: Option<[[f64; 3]; 3]>,
}

impl PoseError {
    /// The difference of two poses, without a claim.
    pub fn between(estimated: Pose<Arena>, truth: Pose<Arena>) -> Self {
        Self {
            dx_m: estimated.x.0 - truth.x.0,
            dy_m: estimated.y.0 - truth.y.0,
            heading_rad: Some((estimated.heading - truth.heading).0),
            covariance: None,
        }
    }

    /// The error of an estimate, with the covariance that it claims. Where its heading is not valid, neither heading nor
    /// covariance are tested.
    pub fn of_estimate(estimate: &Estimate, truth: Pose<Arena>) -> Self {
        let error = Self::between(estimate.pose, truth);
        if !estimate.validity.heading {
            return Self { heading_rad: None, ..error };
        }
        let claimed = std::array::from_fn(|row| std::array::from_fn(|column| estimate.covariance[row][column]));
        Self { covariance: Some(claimed), ..error }
    }

    /// The straight distance, in metres.
    pub fn position_m(&self) -> f64 {
        self.dx_m.hypot(self.dy_m)
    }

    /// Whether position and heading are numbers; the covariance is tested on its own.
    pub fn is_finite(&self) -> bool {
        self.position_m().is_finite() && self.heading_rad.is_none_or(f64::is_finite)
    }
}

/// The errors of estimates, at their own stamps. Estimates without a valid position and instants at which the truth is
/// silent are left out.
pub fn errors_of_estimates(estimates: &[Estimate], truth: &PoseTrack) -> Vec<PoseError> {
    estimates
        .iter()
        .filter(|estimate| estimate.validity.position)
        .filter_map(|estimate| {
            let true_pose = truth.at(estimate.stamp)?;
            Some(PoseError::of_estimate(estimate, true_pose))
        })
        .collect()
}

/// The errors of a track that claims no covariance, such as the brick's own odometry, at its own stamps.
pub fn errors_of_track(track: &PoseTrack, truth: &PoseTrack) -> Vec<PoseError> {
    track.samples().iter().filter_map(|sample| Some(PoseError::between(sample.pose, truth.at(sample.time)?))).collect()
}

//! A path that was found in hindsight, asked for its pose at any instant.
//!
//! The offline smoother gives poses at the motion readings; truth and withheld fixes have stamps of their own. The pose in between is
//! on the arc through both neighbours, as the robot drives.
//!
//! # Model
//! ```text
//! T(s) = T_k exp(s log(T_k^-1 T_k+1))            s in [0, 1], the share of the time from k to k + 1
//! P(s) = (1 - s) P_k + s P_k+1                    as large as between its neighbours, not more: a gap in the motion does not show
//! ```

use posebridge_estimator::models::lie::Se2;
use posebridge_estimator::smoother::SmoothedPose;
use posebridge_telemetry::{Arena, BrickClock, Estimate, Heading, Meters, Pose, Timestamp};

use crate::track::TimedPose;

/// Smoothed poses in the order of their stamps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothedPath {
    poses: Vec<SmoothedPose>,
}

impl SmoothedPath {
    /// A path through these poses; they are sorted by stamp.
    pub fn new(mut poses: Vec<SmoothedPose>) -> Self {
        poses.sort_by_key(|pose| pose.stamp);
        Self { poses }
    }

    /// The last instant that it knows; `None` for an empty path.
    pub fn latest(&self) -> Option<Timestamp<BrickClock>> {
        Some(self.poses.last()?.stamp)
    }

    /// The estimate for an instant; `None` before the first pose and after the last.
    ///
    /// It has no speeds, and says so.
    pub fn at(&self, time: Timestamp<BrickClock>) -> Option<Estimate> {
        let after = self.poses.partition_point(|pose| pose.stamp < time);
        let later = self.poses.get(after)?;
        if later.stamp == time {
            return Some(to_estimate(later));
        }
        let earlier = self.poses.get(after.checked_sub(1)?)?;
        let whole_ns = (later.stamp - earlier.stamp).as_nanos() as f64;
        let share = (time - earlier.stamp).as_nanos() as f64 / whole_ns;
        let covariance = std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let (from, to) = (&earlier.covariance, &later.covariance);
                from[row][column] * (1.0 - share) + to[row][column] * share
            })
        });
        Some(to_estimate(&SmoothedPose {
            stamp: time,
            pose: interpolate_arc(earlier.pose, later.pose, share),
            covariance,
        }))
    }

    /// The estimates at its own stamps.
    pub fn estimates(&self) -> impl Iterator<Item = Estimate> {
        self.poses.iter().map(to_estimate)
    }

    /// The poses at its own stamps.
    pub fn poses(&self) -> impl Iterator<Item = TimedPose> {
        self.poses.iter().map(timed_pose)
    }
}

fn interpolate_arc(from: Pose<Arena>, to: Pose<Arena>, share: f64) -> Pose<Arena> {
    let (from, to) = (to_se2(from), to_se2(to));
    let reached = from.compose(Se2::exp(from.between(to).log().map(|part| part * share)));
    Pose::new(Meters(reached.x_m), Meters(reached.y_m), Heading::from_rad(reached.heading_rad))
}

fn to_se2(pose: Pose<Arena>) -> Se2 {
    Se2 { x_m: pose.x.0, y_m: pose.y.0, heading_rad: pose.heading.rad() }
}

const fn timed_pose(smoothed: &SmoothedPose) -> TimedPose {
    TimedPose { time: smoothed.stamp, pose: smoothed.pose }
}

fn to_estimate(smoothed: &SmoothedPose) -> Estimate {
    let mut covariance = [[0.0; 5]; 5];
    for (row, of_pose) in covariance.iter_mut().zip(&smoothed.covariance) {
        for (value, of_pose) in row.iter_mut().zip(of_pose) {
            *value = *of_pose;
        }
    }
    timed_pose(smoothed).with_covariance(covariance)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    /// A quarter of a circle of 1 m to the left in two seconds, from the origin to (1, 1); the variance grows from 1 to 3.
    fn quarter() -> SmoothedPath {
        let at = |millis, xy_m, heading_rad, variance| SmoothedPose {
            stamp: Timestamp::from_millis(millis),
            pose: Pose::new(Meters(xy_m), Meters(xy_m), Heading::from_rad(heading_rad)),
            covariance: [[variance, 0.1, 0.2], [0.1, variance, 0.3], [0.2, 0.3, variance]],
        };
        // Given in the wrong order.
        SmoothedPath::new(vec![at(3000, 1.0, FRAC_PI_2, 3.0), at(1000, 0.0, 0.0, 1.0)])
    }

    #[test]
    fn between_two_poses_it_is_on_the_arc_and_not_on_the_chord() {
        let third = quarter().at(Timestamp::from_millis(1500)).unwrap();
        let turned_rad = FRAC_PI_2 / 4.0;
        assert!((third.pose.x.0 - turned_rad.sin()).abs() < 1e-12);
        assert!((third.pose.y.0 - (1.0 - turned_rad.cos())).abs() < 1e-12);
        assert!((third.pose.heading.rad() - turned_rad).abs() < 1e-12);
        assert!((third.covariance[1][1] - 1.5).abs() < 1e-12);
        assert_eq!(third.covariance[3], [0.0; 5]);
        assert!(third.validity.position && third.validity.heading && !third.validity.speeds);
    }

    #[test]
    fn at_its_own_stamps_it_is_the_pose_itself_and_outside_it_is_silent() {
        let path = quarter();
        let own: Vec<Estimate> = path.estimates().collect();
        assert_eq!(path.at(Timestamp::from_millis(1000)), Some(own[0]));
        assert_eq!(path.at(Timestamp::from_millis(3000)), Some(own[1]));
        assert_eq!(own[1].covariance[0][..3], [3.0, 0.1, 0.2]);
        assert_eq!(path.at(Timestamp::from_millis(999)), None);
        assert_eq!(path.at(Timestamp::from_millis(3001)), None);
        assert_eq!(path.latest(), Some(Timestamp::from_millis(3000)));
        assert_eq!(SmoothedPath::default().at(Timestamp::ZERO), None);
    }
}

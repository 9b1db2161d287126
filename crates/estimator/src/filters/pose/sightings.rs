//! The last sightings of landmarks that the believed pose does not explain: two of them give a pose.

use nalgebra::Matrix3;
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::models::lie::Se2;
use crate::saved::{finite, not_negative};

/// Number of sightings that are kept, of different landmarks.
const KEPT: usize = 3;
/// Older ones are forgotten: the wheels may have slipped since.
const MAX_AGE: TimeDelta = TimeDelta::from_millis(5_000);
/// Two landmarks nearer to each other show no direction, m.
const MIN_BASELINE_M: f64 = 0.3;
/// The distance between two landmarks, as seen and by the map, may differ by this many sigmas.
const MAX_MISMATCH_SIGMAS: f64 = 3.5;

/// A landmark that was sighted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sighting {
    /// In the map, m.
    #[serde(deserialize_with = "finite")]
    pub landmark: [f64; 2],
    /// Where it would be if the believed pose were right, m: that does not change while the body moves, only while the pose is corrected.
    #[serde(deserialize_with = "finite")]
    pub seen: [f64; 2],
    /// Variance of each coordinate of `seen`.
    #[serde(deserialize_with = "not_negative")]
    pub variance_m2: f64,
    pub stamp: Timestamp<BrickClock>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RecentSightings {
    kept: [Option<Sighting>; KEPT],
}

impl RecentSightings {
    pub fn is_empty(&self) -> bool {
        self.kept.iter().all(Option::is_none)
    }

    /// Leaves the sightings where they are from the body while the believed pose is corrected.
    pub fn rebase(&mut self, before: Se2, after: Se2) {
        if before != after {
            for sighting in self.kept.iter_mut().flatten() {
                let [x_m, y_m] = before.point_in_body(sighting.seen[0], sighting.seen[1]);
                let moved = after.compose(Se2 { x_m, y_m, heading_rad: 0.0 });
                sighting.seen = [moved.x_m, moved.y_m];
            }
        }
    }

    /// Keeps a sighting in the place of an older one of its landmark, or of the oldest.
    pub fn push(&mut self, sighting: Sighting) {
        let same = self.kept.iter().position(|slot| slot.is_some_and(|known| known.landmark == sighting.landmark));
        let age = |slot: &Option<Sighting>| slot.map(|known| known.stamp);
        let oldest = (0..KEPT).min_by_key(|&i| age(&self.kept[i])).unwrap_or(0);
        self.kept[same.unwrap_or(oldest)] = Some(sighting);
    }

    /// The pose by a sighting and the most distant other landmark that fits it, for a body that is believed to be at `believed`; with the
    /// covariance of the pose's error in the body.
    pub fn pose_with(&self, sighting: &Sighting, believed: Se2) -> Option<(Se2, Matrix3<f64>)> {
        let others = self.kept.iter().flatten().filter(|other| {
            sighting.stamp - other.stamp <= MAX_AGE && distance_m(other.landmark, sighting.landmark) >= MIN_BASELINE_M
        });
        let fitting = others.filter(|other| {
            let mismatch_m = distance_m(other.seen, sighting.seen) - distance_m(other.landmark, sighting.landmark);
            mismatch_m.powi(2) <= MAX_MISMATCH_SIGMAS.powi(2) * (other.variance_m2 + sighting.variance_m2)
        });
        let baseline_m = |other: &Sighting| distance_m(other.landmark, sighting.landmark);
        let other = fitting.max_by(|a, b| baseline_m(a).total_cmp(&baseline_m(b)))?;
        // The motion of the plane that takes what is believed to the map. It fits the middle of both, which halves the errors.
        let direction = |[from_x, from_y]: [f64; 2], [to_x, to_y]: [f64; 2]| (to_y - from_y).atan2(to_x - from_x);
        let heading_rad = wrap_rad(direction(sighting.landmark, other.landmark) - direction(sighting.seen, other.seen));
        let middle = |a: [f64; 2], b: [f64; 2]| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let (seen, there) = (middle(sighting.seen, other.seen), middle(sighting.landmark, other.landmark));
        let (sin, cos) = heading_rad.sin_cos();
        let from_believed = Se2 {
            x_m: there[0] - (cos * seen[0] - sin * seen[1]),
            y_m: there[1] - (sin * seen[0] + cos * seen[1]),
            heading_rad,
        };
        let variance_m2 = other.variance_m2 + sighting.variance_m2;
        let heading_rad2 = variance_m2 / baseline_m(other).powi(2);
        let distance_m2 = (seen[0] - believed.x_m).powi(2) + (seen[1] - believed.y_m).powi(2);
        let position_m2 = 0.25 * variance_m2 + heading_rad2 * distance_m2;
        let covariance = Matrix3::from_diagonal(&[position_m2, position_m2, heading_rad2].into());
        Some((from_believed.compose(believed), covariance))
    }
}

fn distance_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_landmarks_give_the_pose_from_which_they_were_seen() {
        let pose = Se2 { x_m: 1.2, y_m: -0.4, heading_rad: 2.1 };
        let step = Se2::exp([0.3, 0.0, -0.5]);
        // The robot believes to be somewhere else, and moves by the same steps there.
        let believed = Se2 { x_m: -0.3, y_m: 0.8, heading_rad: -0.4 };
        let sighting = |landmark: [f64; 2], [pose, believed]: [Se2; 2], millis| {
            let [x_m, y_m] = pose.point_in_body(landmark[0], landmark[1]);
            let seen = believed.compose(Se2 { x_m, y_m, heading_rad: 0.0 });
            let stamp = Timestamp::from_millis(millis);
            Sighting { landmark, seen: [seen.x_m, seen.y_m], variance_m2: 1e-4, stamp }
        };
        let mut recent = RecentSightings::default();
        recent.push(sighting([3.0, 1.0], [pose, believed], 0));
        recent.push(sighting([0.0, 2.0], [pose, believed], 100));
        let (now, believed) = (pose.compose(step), believed.compose(step));
        let sighting = |landmark, millis| sighting(landmark, [now, believed], millis);
        let (found, covariance) = recent.pose_with(&sighting([-1.0, -2.0], 500), believed).unwrap();
        let [forward_m, left_m, turn_rad] = now.between(found).log();
        assert!(forward_m.hypot(left_m) < 1e-12 && turn_rad.abs() < 1e-12, "{found:?}");
        assert!(covariance[(0, 0)] > 1e-5 && covariance[(0, 0)] < 1e-3);
        // A misread landmark does not fit the others.
        let misread = Sighting { landmark: [5.0, 5.0], ..sighting([-1.0, -2.0], 500) };
        assert_eq!(recent.pose_with(&misread, believed), None);
        // What was seen long ago does not count.
        assert_eq!(recent.pose_with(&sighting([-1.0, -2.0], 9_000), believed), None);
    }
}

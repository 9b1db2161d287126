//! A path through time: timestamped poses and the interpolation between them.
//!
//! Truth, odometry and estimates have different timestamps; to compare two of them, one is interpolated at the other's timestamps. A
//! track has poses only between its first and last sample, and not inside a gap. It does not extrapolate, smooth or convert clocks.

use posebridge_estimator::models::lie::Se2;
use posebridge_estimator::smoother::SmoothedPose;
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Heading, Meters, MetersPerSecond, Pose, RadiansPerSecond, TimeDelta, Timestamp,
    Validity,
};

/// A pose and its timestamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    pub time: Timestamp<BrickClock>,
    pub pose: Pose<Arena>,
}

impl TimedPose {
    /// As an estimate with a covariance, rows and columns as in [`Estimate::covariance`]: valid in position and heading, without
    /// speeds, fixes and corrections.
    pub const fn with_covariance(self, covariance: [[f64; 5]; 5]) -> Estimate {
        Estimate {
            stamp: self.time,
            pose: self.pose,
            forward_speed: MetersPerSecond(0.0),
            turn_rate: RadiansPerSecond(0.0),
            covariance,
            validity: Validity { position: true, heading: true, speeds: false },
            is_dead_reckoning: false,
            fix_age: None,
            reset_counter: 0,
            last_correction: None,
            missing: None,
        }
    }

    fn is_finite(&self) -> bool {
        self.pose.x.0.is_finite() && self.pose.y.0.is_finite() && self.pose.heading.rad().is_finite()
    }
}

/// Poses sorted by timestamp, with interpolation between neighbours that are close enough in time.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseTrack {
    samples: Vec<TimedPose>,
    max_gap: TimeDelta,
    dropped: usize,
}

impl PoseTrack {
    /// Sorts the samples by timestamp. Non-finite samples are dropped and counted; of several samples with one timestamp the last one
    /// given counts, because it was computed with the most information.
    ///
    /// Samples further apart than `max_gap` form a gap without poses.
    pub fn new(samples: impl IntoIterator<Item = TimedPose>, max_gap: TimeDelta) -> Self {
        Self::sort(samples.into_iter().collect(), max_gap)
    }

    fn sort(mut samples: Vec<TimedPose>, max_gap: TimeDelta) -> Self {
        let given = samples.len();
        samples.retain(TimedPose::is_finite);
        let dropped = given - samples.len();
        samples.sort_by_key(|sample| sample.time);
        samples.dedup_by(|later, kept| {
            let same_instant = later.time == kept.time;
            if same_instant {
                *kept = *later;
            }
            same_instant
        });
        Self { samples, max_gap, dropped }
    }

    /// Sorted by timestamp; no two share one.
    pub fn samples(&self) -> &[TimedPose] {
        &self.samples
    }

    pub fn dropped(&self) -> usize {
        self.dropped
    }

    pub fn segments(&self) -> impl Iterator<Item = &[TimedPose]> {
        self.samples.chunk_by(|earlier, later| later.time - earlier.time <= self.max_gap)
    }

    /// The pose at an instant: position interpolated linearly, heading the short way.
    ///
    /// `None` before the first sample, after the last, and strictly inside a gap.
    pub fn at(&self, stamp: Timestamp<BrickClock>) -> Option<Pose<Arena>> {
        let after = self.samples.partition_point(|sample| sample.time < stamp);
        let later = self.samples.get(after)?;
        if later.time == stamp {
            return Some(later.pose);
        }
        let earlier = self.samples.get(after.checked_sub(1)?)?;
        let interval = later.time - earlier.time;
        if interval > self.max_gap {
            return None;
        }
        let fraction = (stamp - earlier.time).as_nanos() as f64 / interval.as_nanos() as f64;
        Some(interpolate(earlier.pose, later.pose, fraction))
    }
}

/// `fraction` is 0 at `from` and 1 at `to`.
fn interpolate(from: Pose<Arena>, to: Pose<Arena>, fraction: f64) -> Pose<Arena> {
    // Weights instead of from + (to - from) * fraction: the difference of two huge coordinates may overflow.
    let blend = |a: Meters, b: Meters| Meters(a.0 * (1.0 - fraction) + b.0 * fraction);
    Pose::new(blend(from.x, to.x), blend(from.y, to.y), from.heading + (to.heading - from.heading) * fraction)
}

// A path that was found in hindsight, asked for its pose at any instant.
//
// The offline smoother gives poses at the motion readings; truth and withheld fixes have stamps of their own. The pose in between is
// on the arc through both neighbours, as the robot drives.
//
// # Model
// ```text
// T(s) = T_k exp(s log(T_k^-1 T_k+1))            s in [0, 1], the share of the time from k to k + 1
// P(s) = (1 - s) P_k + s P_k+1                    as large as between its neighbours, not more: a gap in the motion does not show
// ```

/// Smoothed poses sorted by timestamp.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothedPath {
    poses: Vec<SmoothedPose>,
}

impl SmoothedPath {
    pub fn new(mut poses: Vec<SmoothedPose>) -> Self {
        poses.sort_by_key(|pose| pose.stamp);
        Self { poses }
    }

    /// Last timestamp; `None` for an empty path.
    pub fn latest(&self) -> Option<Timestamp<BrickClock>> {
        Some(self.poses.last()?.stamp)
    }

    /// The estimate at an instant; `None` before the first pose and after the last.
    ///
    /// Its speeds are marked invalid.
    pub fn at(&self, time: Timestamp<BrickClock>) -> Option<Estimate> {
        let after = self.poses.partition_point(|pose| pose.stamp < time);
        let later = self.poses.get(after)?;
        if later.stamp == time {
            return Some(to_estimate(later));
        }
        let earlier = self.poses.get(after.checked_sub(1)?)?;
        let interval_ns = (later.stamp - earlier.stamp).as_nanos() as f64;
        let share = (time - earlier.stamp).as_nanos() as f64 / interval_ns;
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

    pub fn estimates(&self) -> impl Iterator<Item = Estimate> {
        self.poses.iter().map(to_estimate)
    }

    pub fn poses(&self) -> impl Iterator<Item = TimedPose> {
        self.poses.iter().map(timed_pose)
    }
}

fn interpolate_arc(from: Pose<Arena>, to: Pose<Arena>, share: f64) -> Pose<Arena> {
    let (from, to) = (to_se2(from), to_se2(to));
    let interpolated = from.compose(Se2::exp(from.between(to).log().map(|part| part * share)));
    Pose::new(Meters(interpolated.x_m), Meters(interpolated.y_m), Heading::from_rad(interpolated.heading_rad))
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

    fn sample(millis: i64, x_m: f64, heading_rad: f64) -> TimedPose {
        TimedPose {
            time: Timestamp::from_millis(millis),
            pose: Pose::new(Meters(x_m), Meters(-x_m), Heading::from_rad(heading_rad)),
        }
    }

    fn track(samples: &[TimedPose]) -> PoseTrack {
        PoseTrack::new(samples.iter().copied(), TimeDelta::from_millis(100))
    }

    #[test]
    fn between_two_samples_the_pose_lies_on_the_line_and_turns_the_short_way() {
        let quarter = track(&[sample(0, 1.0, 0.0), sample(100, 2.0, 0.4)]).at(Timestamp::from_millis(25)).unwrap();
        assert!((quarter.x.0 - 1.25).abs() < 1e-12 && (quarter.y.0 + 1.25).abs() < 1e-12);
        assert!((quarter.heading.rad() - 0.1).abs() < 1e-12);
        let half = track(&[sample(0, -1e308, 3.0), sample(100, 1.5e308, -3.0)]).at(Timestamp::from_millis(50)).unwrap();
        assert!((half.heading.rad().abs() - std::f64::consts::PI).abs() < 1e-12 && half.x.0.is_finite());
    }

    #[test]
    fn a_track_is_silent_outside_itself_and_inside_a_gap_but_not_at_its_edges() {
        let track = track(&[sample(0, 0.0, 0.0), sample(100, 1.0, 0.0), sample(201, 2.0, 0.0)]);
        assert_eq!(track.at(Timestamp::from_millis(-1)), None);
        assert_eq!(track.at(Timestamp::from_millis(150)), None);
        assert_eq!(track.at(Timestamp::from_millis(202)), None);
        assert_eq!(track.at(Timestamp::from_millis(0)).unwrap().x, Meters(0.0));
        assert_eq!(track.at(Timestamp::from_millis(201)).unwrap().x, Meters(2.0));
        assert_eq!(track.segments().map(<[_]>::len).collect::<Vec<_>>(), [2, 1]);
    }

    #[test]
    fn samples_are_sorted_and_the_last_word_on_an_instant_stands() {
        let track = track(&[sample(50, 5.0, 0.0), sample(0, 0.0, 0.0), sample(50, 6.0, 0.0)]);
        assert_eq!(track.samples(), [sample(0, 0.0, 0.0), sample(50, 6.0, 0.0)]);
    }

    #[test]
    fn samples_that_are_not_finite_are_counted() {
        let track = track(&[sample(0, f64::NAN, 0.0), sample(1, 0.0, f64::INFINITY)]);
        assert_eq!((track.samples().len(), track.dropped()), (0, 2));
        assert_eq!(track.at(Timestamp::ZERO), None);
    }

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

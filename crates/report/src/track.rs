//! A path through time: poses with stamps, and the pose between two of them.
//!
//! Truth, odometry and estimates come at different instants; to compare them, one of them must be asked for its pose at
//! the other's stamps. A track answers only where it knows: not before its first sample, not after its last, and not
//! inside a gap. It does not extrapolate, smooth or convert clocks.

use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Meters, MetersPerSecond, Pose, RadiansPerSecond, TimeDelta, Timestamp, Validity,
};

/// A pose and the instant for which it holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// The instant.
    pub time: Timestamp<BrickClock>,
    /// Where the body was.
    pub pose: Pose<Arena>,
}

impl TimedPose {
    /// This pose as an estimate with a covariance, rows and columns as in [`Estimate::covariance`]: valid in position and heading;
    /// of speeds, fixes and jumps it says nothing.
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
        }
    }

    fn is_finite(&self) -> bool {
        self.pose.x.0.is_finite() && self.pose.y.0.is_finite() && self.pose.heading.rad().is_finite()
    }
}

/// Poses in the order of their stamps, with interpolation between neighbours that are close enough in time.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseTrack {
    samples: Vec<TimedPose>,
    max_gap: TimeDelta,
    dropped: usize,
}

impl PoseTrack {
    /// Sorts the samples by stamp. Samples that are not finite are dropped and counted; of several samples with one
    /// stamp the last one given stands, because it was computed with the most knowledge.
    ///
    /// Between two samples further apart than `max_gap` the track is silent.
    pub fn new(samples: impl IntoIterator<Item = TimedPose>, max_gap: TimeDelta) -> Self {
        let mut dropped = 0;
        let mut samples: Vec<TimedPose> = samples
            .into_iter()
            .filter(|sample| {
                let finite = sample.is_finite();
                dropped += usize::from(!finite);
                finite
            })
            .collect();
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

    /// The samples, in the order of their stamps; no two share a stamp.
    pub fn samples(&self) -> &[TimedPose] {
        &self.samples
    }

    /// How many samples were left out because they were not finite.
    pub fn dropped(&self) -> usize {
        self.dropped
    }

    /// The stretches without a gap, in order.
    pub fn segments(&self) -> impl Iterator<Item = &[TimedPose]> {
        self.samples.chunk_by(|earlier, later| later.time - earlier.time <= self.max_gap)
    }

    /// The pose at an instant: position on the straight line between the neighbours, heading the short way.
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

/// The pose at `fraction` of the way, 0 at `from` and 1 at `to`.
fn interpolate(from: Pose<Arena>, to: Pose<Arena>, fraction: f64) -> Pose<Arena> {
    // Weights instead of from + (to - from) * fraction: the difference of two huge coordinates may overflow.
    let blend = |a: Meters, b: Meters| Meters(a.0 * (1.0 - fraction) + b.0 * fraction);
    Pose::new(blend(from.x, to.x), blend(from.y, to.y), from.heading + (to.heading - from.heading) * fraction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::Heading;

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
    fn a_pose_between_two_samples_lies_on_the_straight_line() {
        let pose = track(&[sample(0, 1.0, 0.0), sample(100, 2.0, 0.4)]).at(Timestamp::from_millis(25)).unwrap();
        assert!((pose.x.0 - 1.25).abs() < 1e-12);
        assert!((pose.y.0 + 1.25).abs() < 1e-12);
        assert!((pose.heading.rad() - 0.1).abs() < 1e-12);
    }

    #[test]
    fn the_heading_turns_the_short_way_across_pi() {
        let pose = track(&[sample(0, 0.0, 3.0), sample(100, 0.0, -3.0)]).at(Timestamp::from_millis(50)).unwrap();
        assert!((pose.heading.rad().abs() - std::f64::consts::PI).abs() < 1e-12);
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

    #[test]
    fn huge_coordinates_stay_finite() {
        let pose = track(&[sample(0, -1e308, 0.0), sample(100, 1.5e308, 0.0)]).at(Timestamp::from_millis(50)).unwrap();
        assert!(pose.x.0.is_finite());
    }
}

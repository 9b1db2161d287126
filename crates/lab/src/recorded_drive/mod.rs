//! A drive of a real robot: its start, its end, and the source of both.
//!
//! A recording has no truth. What is known of its ends comes from a camera, whose fixes are then held back from the filters, or from
//! the path: a closed path ends where it began. Gets observations as they were recorded; the experiments of the lab
//! run their filters over the drive.
//!
//! # Model
//! ```text
//! mid-axle   p = z - R(th) l              z the fix, th its heading, l the tag in the body; p = z where the fix has no heading
//! start      the mean of p and th over the fixes until a wheel counts; sigma = sigma_fix / sqrt(n)
//!            without headings: th = direction from the start to the first p that is 0.2 m away, less half the wheels' turn until then
//! zero       accelerations less their mean until a wheel counts, where there are 20 of them: they have no other zero
//! end        the mean of p and th over the fixes since the wheels have stopped, else the last fix; or the start, of a closed path
//! ```
//! A drive whose first fix came while the wheels turned begins with that fix.
//!
//! # Assumptions
//! Between the start and the fix that gives the heading the robot drives an arc: the chord of an arc points along its middle.
//!
//! # Sources
//! docs/lab/square.md and docs/lab/indirect.md, "A recording".

mod observations;
mod start_and_end;
#[cfg(test)]
pub(crate) mod test_drive;

use posebridge_estimator::{Filter, FilterConfig, StartPose};
use posebridge_report::metrics::PoseError;
use posebridge_telemetry::{Arena, BrickClock, Heading, Observation, ObservationKind, Point2, Pose, Timestamp};

use self::observations::is_finite;
use self::start_and_end::{end_by_fixes, moving_interval, start_pose, zero_accelerations};
use crate::end_errors::FilteredDrive;

pub(crate) use self::observations::{fixes, mid_axle_position, moved, wheels};
pub use self::start_and_end::DriveError;

/// The reference for the end of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveEndReference {
    /// The fixes; no filter that is scored by them gets them.
    Fixes,
    /// The start: the path was closed.
    Start,
}

/// A drive.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedDrive {
    /// What was observed, in the order of the stamps; observations that are not finite are left out, accelerations have their zero.
    pub observations: Vec<Observation>,
    /// Where it begins.
    pub start: StartPose,
    /// Who knows where it ends.
    pub end_reference: DriveEndReference,
    /// When that is known.
    pub end_time: Timestamp<BrickClock>,
    /// Where it ends.
    pub end: Point2<Arena>,
    /// Where it points then, if that is known.
    pub end_heading: Option<Heading>,
}

impl RecordedDrive {
    /// Sorts what was observed and finds the ends; without `judge` the fixes are the reference if there is one.
    ///
    /// # Errors
    /// See [`DriveError`].
    pub fn new(
        observations: &[Observation],
        config: &FilterConfig,
        end_reference: Option<DriveEndReference>,
    ) -> Result<Self, DriveError> {
        let mut observations: Vec<Observation> = observations.iter().copied().filter(is_finite).collect();
        observations.sort_by_key(|observation| observation.stamp);
        let moving = moving_interval(&observations)?;
        zero_accelerations(&mut observations, moving.0);
        let has_fix = fixes(&observations).next().is_some();
        let judge = end_reference.unwrap_or(if has_fix { DriveEndReference::Fixes } else { DriveEndReference::Start });
        if judge == DriveEndReference::Fixes && !has_fix {
            return Err(DriveError::NoFix);
        }
        let start = start_pose(&mut observations, moving.0, config)?;
        let known_end = match judge {
            DriveEndReference::Fixes => end_by_fixes(&observations, moving.1),
            DriveEndReference::Start => None,
        };
        let last = observations.last().map_or(moving.1, |last| last.stamp);
        let closed = (last, start.pose.origin(), None);
        let (end_stamp, end, end_heading) = known_end.unwrap_or(closed);
        Ok(Self { observations, start, end_reference: judge, end_time: end_stamp, end, end_heading })
    }

    /// The configuration of a filter, with this drive's start.
    pub fn configure(&self, config: &FilterConfig) -> FilterConfig {
        FilterConfig { start: Some(self.start), ..config.clone() }
    }

    /// Runs a filter over the observations that it `accepts`, and compares its estimate with the end.
    pub fn run_filter(&self, filter: &mut dyn Filter, accepts: impl Fn(&ObservationKind) -> bool) -> FilteredDrive {
        let mut way_m = Vec::new();
        let until = self.observations.iter();
        for observation in until.take_while(|observation| observation.stamp <= self.end_time) {
            if !accepts(&observation.measurement) {
                continue;
            }
            filter.observe(observation);
            let latest = filter.latest_time().and_then(|at| filter.estimate_at(at));
            let Some(estimate) = latest else { continue };
            let here = (estimate.pose.x.0, estimate.pose.y.0);
            if way_m.last() != Some(&here) {
                way_m.push(here);
            }
        }
        let end = filter.estimate_at(self.end_time).map(|estimate| {
            let heading = self.end_heading.unwrap_or(estimate.pose.heading);
            let truth = Pose::new(self.end.x, self.end.y, heading);
            let error = PoseError::of_estimate(&estimate, truth);
            if self.end_heading.is_some() {
                return error;
            }
            PoseError { heading_rad: None, covariance: None, ..error }
        });
        FilteredDrive { end, track_m: way_m }
    }

    /// Where the fixes saw mid-axle, m.
    pub fn fix_positions_m(&self) -> Vec<(f64, f64)> {
        let places = fixes(&self.observations).map(|(_, fix)| mid_axle_position(fix));
        places.map(|place| (place.x.0, place.y.0)).collect()
    }

    /// Whether a sensor of this kind was heard.
    pub fn contains(&self, kind: impl Fn(&ObservationKind) -> bool) -> bool {
        self.observations.iter().any(|one| kind(&one.measurement))
    }
}

#[cfg(test)]
mod tests {
    use super::start_and_end::accelerations;
    use super::test_drive::{self, observation, wheel_angles};
    use super::*;
    use posebridge_estimator::find_filter;
    use posebridge_telemetry::{Body, Meters, MetersPerSecondSquared, RadiansPerSecond, SensorNoise};

    fn config() -> FilterConfig {
        test_drive::config(SensorNoise {
            fix_position_m: 0.01,
            fix_heading_rad: 0.02,
            wheel_travel_m_per_sqrt_m: 0.001,
            ..SensorNoise::EXACT
        })
    }

    const TAG: Point2<Body> = Point2::new(Meters(0.1), Meters(0.0));

    fn fix(millis: i64, x: f64, y: f64, heading: Option<f64>) -> Observation {
        test_drive::fix(millis, Point2::new(Meters(x), Meters(y)), heading, TAG)
    }

    /// Stands for a second, drives 1 m northwards in ten seconds, stands for a second.
    fn northwards() -> Vec<Observation> {
        let angle = |step: i64| 20.0 * (step - 10).clamp(0, 100) as f64 / 100.0;
        (0..=120).map(|step| wheel_angles(100 * step, angle(step), angle(step))).collect()
    }

    #[test]
    fn the_fixes_at_rest_give_both_ends_without_the_lever_arm() {
        let north = std::f64::consts::FRAC_PI_2;
        let mut observations = northwards();
        // Late ones come last and are put in their place; the tag is ahead of the axle.
        for (millis, y) in [(11_900, 3.11), (11_500, 3.09), (300, 2.09), (600, 2.11), (6_000, 9.0)] {
            observations.push(fix(millis, 1.0, y, Some(north)));
        }
        observations.push(fix(700, f64::NAN, 0.0, None));
        let drive = RecordedDrive::new(&observations, &config(), None).unwrap();
        assert_eq!(drive.end_reference, DriveEndReference::Fixes);
        let pose = drive.start.pose;
        assert!((pose.x.0 - 1.0).abs() < 1e-12 && (pose.y.0 - 2.0).abs() < 1e-12);
        assert!((drive.start.position_sigma_m - 0.01 / 2f64.sqrt()).abs() < 1e-12);
        assert!((drive.end.y.0 - 3.0).abs() < 1e-12, "{drive:?}");
        assert_eq!(drive.end_time.as_nanos(), 11_900_000_000);
        let config = drive.configure(&config());
        let mut filter = (find_filter("odometry").unwrap().build)(&config);
        let course =
            drive.run_filter(filter.as_mut(), |observed| matches!(observed, ObservationKind::WheelAngles { .. }));
        // The wheels are exact, and the fix at half way would have torn them away.
        assert!(course.end.unwrap().position_m() < 1e-9, "{course:?}");
        assert!((course.track_m.last().unwrap().1 - 3.0).abs() < 1e-9);
        assert_eq!(drive.fix_positions_m().len(), 5);
    }

    #[test]
    fn a_closed_path_ends_where_it_began_and_knows_no_heading() {
        let drive = RecordedDrive::new(&northwards(), &config(), None).unwrap();
        assert_eq!(
            (drive.end_reference, drive.end, drive.end_heading),
            (DriveEndReference::Start, Point2::ORIGIN, None)
        );
        let mut filter = (find_filter("odometry").unwrap().build)(&drive.configure(&config()));
        let end = drive.run_filter(filter.as_mut(), |_| true).end.unwrap();
        assert!((end.dx_m - 1.0).abs() < 1e-9, "{end:?}");
        assert_eq!((end.heading_rad, end.covariance), (None, None));
        let without_fixes = RecordedDrive::new(&northwards(), &config(), Some(DriveEndReference::Fixes));
        assert_eq!(without_fixes, Err(DriveError::NoFix));
    }

    #[test]
    fn without_headings_the_way_tells_where_the_robot_pointed() {
        // A quarter of a circle of 1 m about (0, 1), seen by a camera that knows no headings; the wheels' track is 0.2 m.
        let quarter = std::f64::consts::FRAC_PI_2;
        let mut observations = Vec::new();
        for step in 0..=100_i64 {
            let way = quarter * step as f64 / 100.0;
            observations.push(wheel_angles(100 * step, 0.9 * way / 0.05, 1.1 * way / 0.05));
            observations.push(fix(100 * step, way.sin(), 1.0 - way.cos(), None));
        }
        let drive = RecordedDrive::new(&observations, &config(), None).unwrap();
        assert!(drive.start.pose.heading.rad().abs() < 1e-9, "{drive:?}");
        assert!((0.05..0.08).contains(&drive.start.heading_sigma_rad));
        let near: Vec<Observation> =
            observations.iter().filter(|one| one.stamp.as_nanos() < 1_000_000_000).copied().collect();
        let short = RecordedDrive::new(&near, &config(), None);
        assert_eq!(short, Err(DriveError::NoHeading));
    }

    #[test]
    fn accelerations_get_their_zero_from_a_rest_that_is_long_enough() {
        let felt = |millis, left| {
            let [left, right] = [left, -0.5].map(MetersPerSecondSquared);
            observation(millis, ObservationKind::WheelAccelerations { left, right })
        };
        let with_rest = |readings: i64| {
            let mut observations = northwards();
            let at_rest = (0..readings).map(|index| felt(10 * index, 0.2 + 0.1 * (index % 2) as f64));
            observations.extend(at_rest);
            observations.push(felt(5_000, 1.0));
            let drive = RecordedDrive::new(&observations, &config(), None).unwrap();
            drive.observations.iter().rev().find_map(accelerations).unwrap()
        };
        let [left, right] = with_rest(20);
        assert!((left - 0.75).abs() < 1e-12 && right.abs() < 1e-12, "{left} {right}");
        assert_eq!(with_rest(19), [1.0, -0.5]);
    }

    #[test]
    fn a_drive_whose_first_fix_is_late_begins_with_it() {
        let mut observations = northwards();
        observations.push(fix(6_000, 0.1, 0.5, Some(0.0)));
        observations.push(fix(11_900, 0.1, 1.0, Some(0.0)));
        let drive = RecordedDrive::new(&observations, &config(), None).unwrap();
        assert_eq!(drive.observations.first().unwrap().stamp.as_nanos(), 6_000_000_000);
        assert!((drive.start.pose.y.0 - 0.5).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_drive_is_refused() {
        let rate = observation(5, ObservationKind::TurnRate(RadiansPerSecond(0.1)));
        let fail = |observations: &[Observation]| RecordedDrive::new(observations, &config(), None).unwrap_err();
        assert_eq!(fail(&[]), DriveError::NoWheels);
        assert_eq!(fail(&[rate]), DriveError::NoWheels);
        assert_eq!(
            fail(&[wheel_angles(0, 1.0, 1.0), wheel_angles(50, 1.0, 1.0)]),
            DriveError::NeverMoves { readings: 2 }
        );
        assert_eq!(fail(&[wheel_angles(0, f64::NAN, 1.0), rate]), DriveError::NoWheels);
    }
}

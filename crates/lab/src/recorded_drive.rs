//! A drive of a real robot: start, end, and the source of both.
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

use posebridge_estimator::models::differential_drive::{WheelTravel, body_step};
use posebridge_estimator::models::se2::BodyStep;
use posebridge_estimator::{Filter, FilterConfig};
use posebridge_report::metrics::PoseError;
use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Fix, Heading, Meters, Observation, ObservationKind, Point2, Pose, Radians,
    StartPose, Timestamp,
};

use super::end_errors::{FilteredDrive, TrackPoint, track_of};
use super::statistics::centroid;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveEndReference {
    /// The fixes; filters scored by them do not get them.
    Fixes,
    /// The start, for a closed path.
    Start,
}

#[derive(Clone, Debug, PartialEq)]
pub struct RecordedDrive {
    /// Sorted by timestamp; non-finite observations are omitted, accelerations are zeroed.
    pub observations: Vec<Observation>,
    pub start: StartPose,
    pub end_reference: DriveEndReference,
    pub end_time: Timestamp<BrickClock>,
    pub end: Point2<Arena>,
    pub end_heading: Option<Heading>,
}

impl RecordedDrive {
    /// Sorts the observations and finds the ends; without `end_reference` the fixes are the reference if there are any.
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
        let reference =
            end_reference.unwrap_or(if has_fix { DriveEndReference::Fixes } else { DriveEndReference::Start });
        if reference == DriveEndReference::Fixes && !has_fix {
            return Err(DriveError::NoFix);
        }
        let start = start_pose(&mut observations, moving.0, config)?;
        let known_end = match reference {
            DriveEndReference::Fixes => end_by_fixes(&observations, moving.1),
            DriveEndReference::Start => None,
        };
        let last = observations.last().map_or(moving.1, |last| last.stamp);
        let closed = (last, start.pose.origin(), None);
        let (end_stamp, end, end_heading) = known_end.unwrap_or(closed);
        Ok(Self { observations, start, end_reference: reference, end_time: end_stamp, end, end_heading })
    }

    pub fn configure(&self, config: &FilterConfig) -> FilterConfig {
        FilterConfig { start: Some(self.start), ..config.clone() }
    }

    /// Runs a filter over the observations that it `accepts`, and compares its estimate with the end.
    pub fn run_filter(&self, filter: &mut dyn Filter, accepts: impl Fn(&ObservationKind) -> bool) -> FilteredDrive {
        let until = self.observations.iter().take_while(|observation| observation.stamp <= self.end_time);
        let accepted = until.filter(|observation| accepts(&observation.measurement));
        let (_, track) = track_of(filter, accepted);
        let end = filter.estimate_at(self.end_time).map(|estimate| {
            let heading = self.end_heading.unwrap_or(estimate.pose.heading);
            let truth = Pose::new(self.end.x, self.end.y, heading);
            let error = PoseError::of_estimate(&estimate, truth);
            if self.end_heading.is_some() {
                return error;
            }
            PoseError { heading_rad: None, covariance: None, ..error }
        });
        FilteredDrive { end, track }
    }

    /// The mid-axle by each fix.
    pub fn fix_track(&self) -> Vec<TrackPoint> {
        let fixes = fixes(&self.observations).map(|(stamp, fix)| (stamp, mid_axle_position(fix)));
        fixes.map(|(stamp, at)| TrackPoint { at_s: stamp.as_secs_f64(), x_m: at.x.0, y_m: at.y.0 }).collect()
    }

    pub fn contains(&self, kind: impl Fn(&ObservationKind) -> bool) -> bool {
        self.observations.iter().any(|one| kind(&one.measurement))
    }
}

/// Mid-axle position by a fix; that of the tag if the fix has no heading.
pub(crate) fn mid_axle_position(fix: &Fix) -> Point2<Arena> {
    let Some(heading) = fix.heading else {
        return fix.position;
    };
    let turned = Pose::<Arena>::new(Meters(0.0), Meters(0.0), heading) * fix.tag_in_body;
    Point2::new(Meters(fix.position.x.0 - turned.x.0), Meters(fix.position.y.0 - turned.y.0))
}

pub(crate) fn fixes(observations: &[Observation]) -> impl Iterator<Item = (Timestamp<BrickClock>, &Fix)> {
    observations.iter().filter_map(|observation| {
        let ObservationKind::Fix(fix) = &observation.measurement else {
            return None;
        };
        Some((observation.stamp, fix))
    })
}

/// Rotations of the left and right wheel with their timestamps, in rad.
pub(crate) fn wheels(observations: &[Observation]) -> impl Iterator<Item = (Timestamp<BrickClock>, [f64; 2])> {
    observations.iter().filter_map(|observation| {
        let ObservationKind::WheelAngles { left, right } = observation.measurement else {
            return None;
        };
        Some((observation.stamp, [left.0, right.0]))
    })
}

pub(crate) fn moved(from: [f64; 2], to: [f64; 2], geometry: &DriveGeometry) -> BodyStep {
    rolled_step([0, 1].map(|side: usize| to[side] - from[side]), geometry)
}

/// Body motion when the wheels turn by these angles, left and right, rad; for rates in rad/s its speeds.
pub(crate) fn rolled_step([left, right]: [f64; 2], geometry: &DriveGeometry) -> BodyStep {
    let (left_m, right_m) = (geometry.left_wheel_radius.0 * left, geometry.right_wheel_radius.0 * right);
    body_step(WheelTravel { left_m, right_m }, geometry)
}

/// Received numbers may be non-finite; a filter would reject them one by one, the mean of a start could not.
fn is_finite(observation: &Observation) -> bool {
    match &observation.measurement {
        ObservationKind::WheelAngles { left, right } => left.0.is_finite() && right.0.is_finite(),
        ObservationKind::Fix(fix) => {
            let has_position = fix.position.x.0.is_finite() && fix.position.y.0.is_finite();
            let tag = fix.tag_in_body.x.0.is_finite() && fix.tag_in_body.y.0.is_finite();
            has_position && tag && fix.heading.is_none_or(|heading| heading.rad().is_finite())
        }
        ObservationKind::TurnRate(rate) => rate.0.is_finite(),
        ObservationKind::WheelAccelerations { left, right } => left.0.is_finite() && right.0.is_finite(),
        ObservationKind::WallRange(range) => range.0.is_finite(),
        ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. }
        | ObservationKind::Landmark { .. }
        | ObservationKind::BeaconRange { .. }
        | ObservationKind::CompassHeading(_)
        | ObservationKind::Temperature(_) => true,
    }
}

/// Minimum chord for a heading: fixes of 5 mm then determine it to two degrees.
const CHORD_M: f64 = 0.2;
/// Minimum readings at rest for a zero: a second at 20 Hz.
const MIN_REST_FIXES: usize = 20;
/// Sigma of a start that is the arena's origin by definition, m and rad.
const EXACT_START_SIGMA: f64 = 1e-4;

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DriveError {
    #[error("it holds no wheel ticks: let the robot send WHEEL_TICKS or WHEEL_DISTANCE and record it again")]
    NoWheels,
    #[error("its wheels never turn ({readings} readings): record from before the robot starts until it stands again")]
    NeverMoves { readings: usize },
    #[error(
        "it holds no fix that could be the reference: record with the camera, or drive a closed path and say `--judge start`"
    )]
    NoFix,
    #[error(
        "its fixes have no heading and the robot never gets 0.2 m away from its start: give the start in `[robot.start]`"
    )]
    NoHeading,
}

/// The last instant before the wheels turn, and the first after their last rotation.
fn moving_interval(observations: &[Observation]) -> Result<(Timestamp<BrickClock>, Timestamp<BrickClock>), DriveError> {
    let readings: Vec<_> = wheels(observations).collect();
    let (Some(first), Some(last)) = (readings.first(), readings.last()) else {
        return Err(DriveError::NoWheels);
    };
    let still = DriveError::NeverMoves { readings: readings.len() };
    let begins = readings.iter().position(|reading| reading.1 != first.1);
    let begins = begins.and_then(|index| readings.get(index.checked_sub(1)?));
    let stopped = readings.iter().rposition(|reading| reading.1 != last.1);
    let stopped = stopped.and_then(|index| readings.get(index + 1));
    match (begins, stopped) {
        (Some(begins), Some(stopped)) => Ok((begins.0, stopped.0)),
        _ => Err(still),
    }
}

/// Subtracts the mean of the accelerometers at rest, as a user would calibrate them before a drive.
fn zero_accelerations(observations: &mut [Observation], rest_until: Timestamp<BrickClock>) {
    let resting = observations.iter().filter(|one| one.stamp <= rest_until);
    let felt: Vec<[f64; 2]> = resting.filter_map(accelerations).collect();
    if felt.len() < MIN_REST_FIXES {
        return;
    }
    let mean = centroid(&felt);
    for observation in observations {
        if let ObservationKind::WheelAccelerations { left, right } = &mut observation.measurement {
            left.0 -= mean[0];
            right.0 -= mean[1];
        }
    }
}

/// Forward at the left and at the right wheel, m/s².
pub(crate) fn accelerations(observation: &Observation) -> Option<[f64; 2]> {
    let ObservationKind::WheelAccelerations { left, right } = observation.measurement else {
        return None;
    };
    Some([left.0, right.0])
}

/// Start pose; removes observations before the pose is known.
fn start_pose(
    observations: &mut Vec<Observation>,
    rest_until: Timestamp<BrickClock>,
    config: &FilterConfig,
) -> Result<StartPose, DriveError> {
    if let Some(start) = config.start {
        return Ok(start);
    }
    let Some((first, fix)) = fixes(observations).next().map(|(at, fix)| (at, *fix)) else {
        return Ok(StartPose {
            pose: Pose::new(Meters(0.0), Meters(0.0), Heading::from_rad(0.0)),
            position_sigma_m: EXACT_START_SIGMA,
            heading_sigma_rad: EXACT_START_SIGMA,
        });
    };
    let noise = &config.noise;
    let (position, heading, count) = if first > rest_until {
        observations.retain(|observation| observation.stamp >= first);
        (mid_axle_position(&fix), fix.heading, 1)
    } else {
        let resting = fixes(observations).take_while(|(at, _)| *at <= rest_until);
        mean(resting.map(|(_, fix)| fix)).ok_or(DriveError::NoFix)?
    };
    let share = (count as f64).sqrt();
    let (heading, heading_sigma_rad) = match heading {
        Some(heading) => (heading, noise.fix_heading_rad / share),
        None => heading_by_chord(observations, position, config)?,
    };
    Ok(StartPose {
        pose: Pose::new(position.x, position.y, heading),
        position_sigma_m: noise.fix_position_m / share,
        heading_sigma_rad,
    })
}

fn heading_by_chord(
    observations: &[Observation],
    start: Point2<Arena>,
    config: &FilterConfig,
) -> Result<(Heading, f64), DriveError> {
    let away = fixes(observations).find(|(_, fix)| mid_axle_position(fix).distance(start).0 >= CHORD_M);
    let (at, fix) = away.ok_or(DriveError::NoHeading)?;
    let position = mid_axle_position(fix);
    let first = wheels(observations).next().ok_or(DriveError::NoWheels)?;
    let until = wheels(observations).take_while(|(stamp, _)| *stamp <= at);
    let last = until.last().unwrap_or(first);
    let turned = moved(first.1, last.1, &config.geometry).turn_rad;
    let chord = (position.y.0 - start.y.0).atan2(position.x.0 - start.x.0);
    let length_m = position.distance(start).0;
    Ok((
        Heading::from_rad(chord) - Radians(0.5 * turned),
        config.noise.fix_position_m * std::f64::consts::SQRT_2 / length_m,
    ))
}

fn mean<'a>(fixes: impl Iterator<Item = &'a Fix>) -> Option<(Point2<Arena>, Option<Heading>, usize)> {
    let (mut x, mut y, mut count) = (0.0, 0.0, 0_usize);
    let (mut sin, mut cos, mut headings) = (0.0, 0.0, 0_usize);
    for fix in fixes {
        let position = mid_axle_position(fix);
        x += position.x.0;
        y += position.y.0;
        count += 1;
        if let Some(heading) = fix.heading {
            sin += heading.rad().sin();
            cos += heading.rad().cos();
            headings += 1;
        }
    }
    if count == 0 {
        return None;
    }
    let n = count as f64;
    let heading = (headings > 0).then(|| Heading::from_rad(sin.atan2(cos)));
    Some((Point2::new(Meters(x / n), Meters(y / n)), heading, count))
}

fn end_by_fixes(
    observations: &[Observation],
    rest_from: Timestamp<BrickClock>,
) -> Option<(Timestamp<BrickClock>, Point2<Arena>, Option<Heading>)> {
    let last = fixes(observations).last()?;
    let resting = fixes(observations).filter(|(at, _)| *at >= rest_from);
    let known = mean(resting.map(|(_, fix)| fix));
    let (position, heading) =
        known.map_or((mid_axle_position(last.1), last.1.heading), |(position, heading, _)| (position, heading));
    Some((last.0, position, heading))
}

#[cfg(test)]
mod tests {
    use posebridge_estimator::find_filter;
    use posebridge_telemetry::{Body, MetersPerSecondSquared, RadiansPerSecond, SensorId, SensorNoise};

    use super::*;
    use crate::test_support::{self, observation};

    fn config() -> FilterConfig {
        let noise = SensorNoise {
            fix_position_m: 0.01,
            fix_heading_rad: 0.02,
            wheel_travel_m_per_sqrt_m: 0.001,
            ..SensorNoise::EXACT
        };
        test_support::config([0.05; 2], 0.2, 0.01, noise)
    }

    const TAG: Point2<Body> = Point2::new(Meters(0.1), Meters(0.0));

    fn fix(millis: i64, x: f64, y: f64, heading: Option<f64>) -> Observation {
        let mut observation = test_support::fix(millis, x, y, heading);
        if let ObservationKind::Fix(fix) = &mut observation.measurement {
            fix.tag_in_body = TAG;
        }
        observation
    }

    /// Stands for a second, drives 1 m northwards in ten seconds, stands for a second.
    fn northwards() -> Vec<Observation> {
        let angle = |step: i64| 20.0 * (step - 10).clamp(0, 100) as f64 / 100.0;
        (0..=120).map(|step| test_support::wheels(100 * step, angle(step), angle(step))).collect()
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
        assert!((course.track.last().unwrap().y_m - 3.0).abs() < 1e-9);
        assert_eq!(drive.fix_track().len(), 5);
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
            let angle = quarter * step as f64 / 100.0;
            observations.push(test_support::wheels(100 * step, 0.9 * angle / 0.05, 1.1 * angle / 0.05));
            observations.push(fix(100 * step, angle.sin(), 1.0 - angle.cos(), None));
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
            observation(SensorId::WHEELS, millis, ObservationKind::WheelAccelerations { left, right })
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
        let rate = observation(SensorId::WHEELS, 5, ObservationKind::TurnRate(RadiansPerSecond(0.1)));
        let fail = |observations: &[Observation]| RecordedDrive::new(observations, &config(), None).unwrap_err();
        assert_eq!(fail(&[]), DriveError::NoWheels);
        assert_eq!(fail(&[rate]), DriveError::NoWheels);
        assert_eq!(
            fail(&[test_support::wheels(0, 1.0, 1.0), test_support::wheels(50, 1.0, 1.0)]),
            DriveError::NeverMoves { readings: 2 }
        );
        assert_eq!(fail(&[test_support::wheels(0, f64::NAN, 1.0), rate]), DriveError::NoWheels);
    }
}

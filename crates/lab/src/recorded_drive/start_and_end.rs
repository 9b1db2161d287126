//! The start and the end of a drive and the zero of its accelerometers, from its own observations; the model is that of the module
//! above.

use posebridge_estimator::{FilterConfig, StartPose};
use posebridge_telemetry::{
    Arena, BrickClock, Fix, Heading, Meters, Observation, ObservationKind, Point2, Pose, Radians, Timestamp,
};

use super::observations::{fixes, mid_axle_position, moved, wheels};

/// The chord that gives a heading is at least this long: fixes of 5 mm then determine it to two degrees.
const CHORD_M: f64 = 0.2;
/// Fewer readings at rest than this do not make a zero; a second at 20 Hz.
const MIN_REST_FIXES: usize = 20;
/// What a start is known to that is the arena's origin by definition, m and rad.
const EXACT_START_SIGMA: f64 = 1e-4;

/// Why observations are no drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DriveError {
    /// There is no reading of the wheels.
    #[error("it holds no wheel ticks: let the robot send WHEEL_TICKS or WHEEL_DISTANCE and record it again")]
    NoWheels,
    /// The wheels never turned.
    #[error("its wheels never turn ({readings} readings): record from before the robot starts until it stands again")]
    NeverMoves {
        /// Number of wheel readings.
        readings: usize,
    },
    /// The fixes are to be the reference, and there are none.
    #[error(
        "it holds no fix that could be the reference: record with the camera, or drive a closed path and say `--judge start`"
    )]
    NoFix,
    /// The robot's heading is unknown.
    #[error(
        "its fixes have no heading and the robot never gets 0.2 m away from its start: give the start in `[robot.start]`"
    )]
    NoHeading,
}

/// The last instant before the wheels turn, and the first one at which they have turned for the last time.
pub(super) fn moving_interval(
    observations: &[Observation],
) -> Result<(Timestamp<BrickClock>, Timestamp<BrickClock>), DriveError> {
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

/// What a robot's owner does before a drive: the accelerometers' readings at rest are their zero.
pub(super) fn zero_accelerations(observations: &mut [Observation], stands_until: Timestamp<BrickClock>) {
    let standing = observations.iter().filter(|one| one.stamp <= stands_until);
    let felt: Vec<[f64; 2]> = standing.filter_map(accelerations).collect();
    if felt.len() < MIN_REST_FIXES {
        return;
    }
    let n = felt.len() as f64;
    let mean = [0, 1].map(|side: usize| felt.iter().map(|felt| felt[side]).sum::<f64>() / n);
    for observation in observations {
        if let ObservationKind::WheelAccelerations { left, right } = &mut observation.measurement {
            left.0 -= mean[0];
            right.0 -= mean[1];
        }
    }
}

pub(super) fn accelerations(observation: &Observation) -> Option<[f64; 2]> {
    let ObservationKind::WheelAccelerations { left, right } = observation.measurement else {
        return None;
    };
    Some([left.0, right.0])
}

/// Where the drive begins; takes away what was observed before it was known where the robot is.
pub(super) fn start_pose(
    observations: &mut Vec<Observation>,
    stands_until: Timestamp<BrickClock>,
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
    if first > stands_until {
        observations.retain(|observation| observation.stamp >= first);
        let place = mid_axle_position(&fix);
        let (heading, heading_sigma_rad) = match fix.heading {
            Some(heading) => (heading, noise.fix_heading_rad),
            None => heading_by_chord(observations, place, config)?,
        };
        return Ok(StartPose {
            pose: Pose::new(place.x, place.y, heading),
            position_sigma_m: noise.fix_position_m,
            heading_sigma_rad,
        });
    }
    let standing = fixes(observations).take_while(|(at, _)| *at <= stands_until);
    let (place, heading, count) = mean(standing.map(|(_, fix)| fix)).ok_or(DriveError::NoFix)?;
    let share = (count as f64).sqrt();
    let (heading, heading_sigma_rad) = match heading {
        Some(heading) => (heading, noise.fix_heading_rad / share),
        None => heading_by_chord(observations, place, config)?,
    };
    Ok(StartPose {
        pose: Pose::new(place.x, place.y, heading),
        position_sigma_m: noise.fix_position_m / share,
        heading_sigma_rad,
    })
}

/// The heading at the start from where the robot is seen next, and its standard deviation.
fn heading_by_chord(
    observations: &[Observation],
    start: Point2<Arena>,
    config: &FilterConfig,
) -> Result<(Heading, f64), DriveError> {
    let away = fixes(observations).find(|(_, fix)| mid_axle_position(fix).distance(start).0 >= CHORD_M);
    let (at, fix) = away.ok_or(DriveError::NoHeading)?;
    let place = mid_axle_position(fix);
    let first = wheels(observations).next().ok_or(DriveError::NoWheels)?;
    let until = wheels(observations).take_while(|(stamp, _)| *stamp <= at);
    let last = until.last().unwrap_or(first);
    let turned = moved(first.1, last.1, &config.geometry).turn_rad;
    let chord = (place.y.0 - start.y.0).atan2(place.x.0 - start.x.0);
    let length_m = place.distance(start).0;
    Ok((
        Heading::from_rad(chord) - Radians(0.5 * turned),
        config.noise.fix_position_m * std::f64::consts::SQRT_2 / length_m,
    ))
}

/// Mean place and heading, and of how many fixes.
fn mean<'a>(fixes: impl Iterator<Item = &'a Fix>) -> Option<(Point2<Arena>, Option<Heading>, usize)> {
    let (mut x, mut y, mut count) = (0.0, 0.0, 0_usize);
    let (mut sin, mut cos, mut headings) = (0.0, 0.0, 0_usize);
    for fix in fixes {
        let place = mid_axle_position(fix);
        x += place.x.0;
        y += place.y.0;
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

/// When and where the fixes saw the robot last.
pub(super) fn end_by_fixes(
    observations: &[Observation],
    stands_from: Timestamp<BrickClock>,
) -> Option<(Timestamp<BrickClock>, Point2<Arena>, Option<Heading>)> {
    let last = fixes(observations).last()?;
    let standing = fixes(observations).filter(|(at, _)| *at >= stands_from);
    let known = mean(standing.map(|(_, fix)| fix));
    let (place, heading) =
        known.map_or((mid_axle_position(last.1), last.1.heading), |(place, heading, _)| (place, heading));
    Some((last.0, place, heading))
}

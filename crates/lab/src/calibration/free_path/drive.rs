//! Input of the calibration: wheel travel and external position fixes of a drive.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::motion::{MotionReading, MotionTrack, TravelSegment};
use posebridge_telemetry::{BrickClock, Observation, StartPose, Timestamp};

#[derive(Clone, Debug, PartialEq)]
pub struct FreePath {
    pub name: String,
    pub start: PathStart,
    /// By the nominal geometry, in time order; rest is omitted.
    pub steps: Vec<TravelStep>,
    pub fixes: Vec<PositionFix>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathStart {
    /// x, y in metres, heading in radians; a guess where the sigmas are large.
    pub pose: [f64; 3],
    pub position_sigma_m: f64,
    pub heading_sigma_rad: f64,
}

/// Wheel travel between two instants, along an arc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TravelStep {
    pub from_s: f64,
    pub until_s: f64,
    pub travel: WheelTravel,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionFix {
    /// Timestamp, by the recording's clock.
    pub at_s: f64,
    pub position_m: [f64; 2],
    /// Of each axis.
    pub sigma_m: f64,
    /// Configured position of the tag on the body: forward, left.
    pub tag_m: [f64; 2],
}

/// Fixes closer than this carry the same information: the error of the path is common to both.
const MIN_FIX_SPACING_S: f64 = 0.19;

/// Sigma of an unknown start: carries no information.
const UNKNOWN_POSITION_M: f64 = 1e3;
const UNKNOWN_HEADING_RAD: f64 = 10.0;

pub fn seconds(stamp: Timestamp<BrickClock>) -> f64 {
    stamp.as_nanos() as f64 / 1e9
}

impl FreePath {
    /// A drive from observations in any order; `config` supplies nominal geometry, start and the limits of the wheels.
    ///
    /// Unknown motion (a counter that jumped) counts as zero. Non-finite fixes, and those within a fifth of a second after another, are
    /// omitted. Without a configured start the drive begins at its first fix, with an unknown heading.
    pub fn new(
        name: &str,
        config: &FilterConfig,
        observations: &[Observation],
        fixes: impl IntoIterator<Item = PositionFix>,
    ) -> Self {
        let mut track = MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s);
        let mut stamps = Vec::new();
        for observation in observations {
            if let Some(reading) = MotionReading::from_observation(&observation.measurement).filter(is_finite) {
                track.insert(observation.stamp, &reading);
                stamps.push(observation.stamp);
            }
        }
        stamps.sort_unstable();
        stamps.dedup();
        let steps = stamps
            .windows(2)
            .filter_map(|pair| match track.segment(pair[0], pair[1]) {
                TravelSegment::Known { travel, .. } if travel != WheelTravel::default() => {
                    Some(TravelStep { from_s: seconds(pair[0]), until_s: seconds(pair[1]), travel })
                }
                TravelSegment::Known { .. } | TravelSegment::Gap { .. } | TravelSegment::BeyondData { .. } => None,
            })
            .collect();
        let fixes = downsample_fixes(fixes);
        Self { name: name.to_owned(), start: start_of(config.start, fixes.first()), steps, fixes }
    }

    pub fn length_m(&self) -> f64 {
        let lengths = self.steps.iter().map(|step| {
            let WheelTravel { left_m, right_m } = step.travel;
            (0.5 * (left_m + right_m)).abs()
        });
        lengths.sum()
    }
}

fn is_finite(reading: &MotionReading) -> bool {
    match reading {
        MotionReading::Wheels { left_rad, right_rad } => left_rad.is_finite() && right_rad.is_finite(),
        MotionReading::Velocity { forward_m_per_s, turn_rad_per_s } => {
            forward_m_per_s.is_finite() && turn_rad_per_s.is_finite()
        }
        MotionReading::Odometer(pose) => pose.x.0.is_finite() && pose.y.0.is_finite() && pose.heading.rad().is_finite(),
    }
}

fn downsample_fixes(fixes: impl IntoIterator<Item = PositionFix>) -> Vec<PositionFix> {
    let is_usable = |fix: &PositionFix| {
        let numbers = [fix.at_s, fix.position_m[0], fix.position_m[1]];
        let tag = fix.tag_m.iter().all(|m| m.is_finite());
        numbers.iter().all(|n| n.is_finite()) && tag && fix.sigma_m > 0.0 && fix.sigma_m.is_finite()
    };
    let mut fixes: Vec<PositionFix> = fixes.into_iter().filter(is_usable).collect();
    fixes.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    let mut last_s = f64::NEG_INFINITY;
    fixes.retain(|fix| {
        let is_new = fix.at_s - last_s >= MIN_FIX_SPACING_S;
        if is_new {
            last_s = fix.at_s;
        }
        is_new
    });
    fixes
}

fn start_of(known: Option<StartPose>, first: Option<&PositionFix>) -> PathStart {
    if let Some(start) = known {
        return PathStart {
            pose: [start.pose.x.0, start.pose.y.0, start.pose.heading.rad()],
            position_sigma_m: start.position_sigma_m,
            heading_sigma_rad: start.heading_sigma_rad,
        };
    }
    let [x, y] = first.map_or([0.0; 2], |fix| fix.position_m);
    PathStart { pose: [x, y, 0.0], position_sigma_m: UNKNOWN_POSITION_M, heading_sigma_rad: UNKNOWN_HEADING_RAD }
}

//! Calibrates wheels, track, tag and camera delay from any drive with external positions: from a camera, a ground truth, or a tape at a
//! few points.
//!
//! # Model
//! ```text
//! 1. sanity      wheels exchanged? half the track? counts off by a factor? Continue with the likeliest description.
//! 2. length      e_m from the length of the way over short windows: no heading takes part in it
//! 3. shape       e_b, e_d, tau, l_f, l_l and headings at the start by least squares over whitened innovations, e_m given; a heading
//!                that is roughly known pulls by (th - th_0) / sigma
//! ```
//! The order matters. In a single fit a start heading error of one degree would bias wheel size and track; the length of the path does
//! not depend on headings. So the result is not the optimum of one likelihood but of two, each insensitive to the errors of the other.
//!
//! A parameter is only estimated where its prior has a sigma, where the drive determines it better than the prior, and where it does
//! not degrade the track: on a drive that turns to one side only, unequal wheels and a wrong track look alike. Otherwise it keeps its
//! described value, the report states why, and the uncertainty of its prior enters the other parameters (Schmidt, 1966).
//!
//! # Source
//! docs/lab/calibration.md section 3.

mod hypotheses;
mod parameter_fit;
mod predict;

use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::WheelTravel;
use posebridge_estimator::motion::{MotionReading, MotionTrack, TravelSegment};
use posebridge_telemetry::{BrickClock, Calibration, Observation, StartPose, Timestamp, UncertainValue};

use self::hypotheses::test_hypotheses;
use self::parameter_fit::ParameterSolver;
use self::predict::PathPredictor;
use super::CalibrationError;

pub use self::hypotheses::{AS_GIVEN, Hypothesis, HypothesisTest, Wiring};
pub use self::predict::{
    DeadReckonedPath, DeadReckoningError, RobotParameters, dead_reckon, mean_error, start_heading,
};

/// Rounds over the second and the third step; the second round changes values by hundredths of their sigmas.
const MAX_ROUNDS: u32 = 3;

/// `config` is the robot's description with the priors.
pub fn calibrate_path(config: &FilterConfig, paths: &[FreePath]) -> Result<PathCalibration, CalibrationError> {
    check_data(paths)?;
    let before = RobotParameters::from_config(config);
    let prediction = PathPredictor { parameters: before, noise: &config.noise };
    let sanity = test_hypotheses(&prediction, paths);
    let hypothesis = sanity.as_ref().map_or(AS_GIVEN, |sanity| sanity.found);
    let paths: Vec<FreePath> = paths.iter().map(|path| path.with_hypothesis(&hypothesis)).collect();
    let mut shape = ParameterSolver::new(config, &paths, hypothesis.track_factor);
    let mut length = shape.estimate_length();
    shape.initialize_track();
    let (mut chosen, mut standings) = shape.select_unknowns(length)?;
    for _ in 1..MAX_ROUNDS {
        // The second step knows the tag and the delay only by the third.
        shape.adopt(&chosen);
        length = shape.estimate_length();
        (chosen, standings) = shape.select_unknowns(length)?;
    }
    Ok(PathCalibration { hypothesis_test: sanity, before, ..shape.report(&chosen, standings, length) })
}

fn check_data(paths: &[FreePath]) -> Result<(), CalibrationError> {
    let steps: usize = paths.iter().map(|path| path.steps.len()).sum();
    let fix_count: usize = paths.iter().map(|path| path.fixes.len()).sum();
    for (what, found, needed) in
        [("intervals in which the wheels turned", steps, 2), ("places where the robot was seen", fix_count, 3)]
    {
        if found < needed {
            return Err(CalibrationError::TooFewData { what, found, needed });
        }
    }
    Ok(())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CalibrationUnknown {
    /// e_m: relative error of the mean wheel radius.
    RadiusScale,
    /// e_b: relative error of the track width.
    TrackScale,
    /// e_d: relative difference of the radii, right minus left.
    RadiusDifference,
    /// tau: time by which a fix was valid before its timestamp, in seconds.
    FixDelay,
    /// l_f: offset of the tag from its configured position, forward, in metres.
    TagForward,
    /// l_l: the same to the left.
    TagLeft,
}

/// All, in the order in which they are tried.
pub const UNKNOWNS: [CalibrationUnknown; 6] = [
    CalibrationUnknown::RadiusScale,
    CalibrationUnknown::TrackScale,
    CalibrationUnknown::FixDelay,
    CalibrationUnknown::RadiusDifference,
    CalibrationUnknown::TagForward,
    CalibrationUnknown::TagLeft,
];

impl CalibrationUnknown {
    /// Key in `[robot.calibration]`.
    pub const fn key(self) -> &'static str {
        match self {
            Self::RadiusScale => "radius_scale",
            Self::TrackScale => "track_scale",
            Self::RadiusDifference => "radius_difference",
            Self::FixDelay => "fix_delay_s",
            Self::TagForward => "tag_forward_m",
            Self::TagLeft => "tag_left_m",
        }
    }

    pub const fn value_in(self, calibration: &mut Calibration) -> &mut UncertainValue {
        match self {
            Self::RadiusScale => &mut calibration.radius_scale,
            Self::TrackScale => &mut calibration.track_scale,
            Self::RadiusDifference => &mut calibration.radius_difference,
            Self::FixDelay => &mut calibration.fix_delay_s,
            Self::TagForward => &mut calibration.tag_forward_m,
            Self::TagLeft => &mut calibration.tag_left_m,
        }
    }

    const fn prior(self, mut calibration: Calibration) -> UncertainValue {
        *self.value_in(&mut calibration)
    }

    /// Half width of its central difference, in its own unit. The residual over the delay has kinks at the counters' readings, so its
    /// step is wide.
    const fn step(self) -> f64 {
        match self {
            Self::RadiusScale | Self::TrackScale | Self::RadiusDifference => 1e-5,
            Self::FixDelay => 1e-2,
            Self::TagForward | Self::TagLeft => 1e-4,
        }
    }

    fn apply(self, value: f64, base_track_m: f64, numbers: &mut RobotParameters) {
        match self {
            Self::RadiusScale => numbers.radius_scale = value,
            Self::TrackScale => numbers.track_width_m = base_track_m * (1.0 + value),
            Self::RadiusDifference => numbers.radius_difference = value,
            Self::FixDelay => numbers.fix_delay_s = value,
            Self::TagForward => numbers.tag_m[0] = value,
            Self::TagLeft => numbers.tag_m[1] = value,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnknownStatus {
    Estimated,
    /// Its prior has no sigma.
    Fixed,
    /// The drive determines it less well than the prior: unchanged.
    Unobservable,
    /// It cannot be separated from the track on this drive: unchanged.
    NotSeparable,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnknownEstimate {
    pub unknown: CalibrationUnknown,
    pub before: UncertainValue,
    /// Equal to `before` unless estimated.
    pub after: UncertainValue,
    pub status: UnknownStatus,
}

#[derive(Clone, Debug, PartialEq)]
pub struct PathCalibration {
    /// One per unknown, in the order of [`UNKNOWNS`]; relative to the description under [`Self::hypothesis_test`].
    pub entries: Vec<UnknownEstimate>,
    /// `None` with too few fixes.
    pub hypothesis_test: Option<HypothesisTest>,
    /// Number of windows behind the wheel size; `None` if it was not estimated from the length of the path.
    pub length_windows: Option<usize>,
    pub headings_rad: Vec<f64>,
    /// Mean squared whitened innovation: about one if the noise is as described.
    pub consistency: f64,
    pub before: RobotParameters,
    pub after: RobotParameters,
}

impl PathCalibration {
    pub fn entry(&self, unknown: CalibrationUnknown) -> UnknownEstimate {
        let index = UNKNOWNS.iter().position(|one| *one == unknown);
        self.entries[index.unwrap_or(0)]
    }

    /// The hypothesis under which the values hold.
    pub fn hypothesis(&self) -> Hypothesis {
        self.hypothesis_test.as_ref().map_or(AS_GIVEN, |sanity| sanity.found)
    }
}

// Input of the calibration: wheel travel and external position fixes of a drive.

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

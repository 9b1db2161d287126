//! The unknowns of a drive calibration, and their results.

use posebridge_telemetry::{Calibration, UncertainValue};

use super::hypotheses::{AS_GIVEN, Hypothesis, HypothesisTest};
use super::predict::RobotParameters;

/// A parameter that a drive may determine.
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

    pub const fn prior(self, calibration: &Calibration) -> UncertainValue {
        match self {
            Self::RadiusScale => calibration.radius_scale,
            Self::TrackScale => calibration.track_scale,
            Self::RadiusDifference => calibration.radius_difference,
            Self::FixDelay => calibration.fix_delay_s,
            Self::TagForward => calibration.tag_forward_m,
            Self::TagLeft => calibration.tag_left_m,
        }
    }

    /// Half width of its central difference, in its own unit. The residual over the delay has kinks at the counters' readings, so its
    /// step is wide.
    pub(super) const fn step(self) -> f64 {
        match self {
            Self::RadiusScale | Self::TrackScale | Self::RadiusDifference => 1e-5,
            Self::FixDelay => 1e-2,
            Self::TagForward | Self::TagLeft => 1e-4,
        }
    }

    pub(super) fn apply(self, value: f64, base_track_m: f64, numbers: &mut RobotParameters) {
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

/// The result for an unknown.
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

/// An unknown of the calibration before and after.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnknownEstimate {
    pub unknown: CalibrationUnknown,
    pub before: UncertainValue,
    /// Equal to `before` unless estimated.
    pub after: UncertainValue,
    pub status: UnknownStatus,
}

/// The calibration of a robot from drives.
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

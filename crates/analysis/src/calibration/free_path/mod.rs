//! Wheels, track, tag and camera delay from any drive that was watched: by a camera, by a truth, or by a tape at a few places.
//!
//! # Model
//! ```text
//! 1. sanity      wheels exchanged? half the track? counts off by a factor? The likeliest description goes on.
//! 2. length      e_m from the length of the way over short windows: no heading takes part in it
//! 3. shape       e_b, e_d, tau, l_f, l_l and headings at the start by least squares over whitened innovations, e_m given; a heading
//!                that is roughly known pulls by (th - th_0) / sigma
//! ```
//! The order matters. In one fit over everything a heading that was wrong by a degree at the start bends wheel size and track to
//! make up for it; the length of the way does not know headings. What it finds is not the optimum of one likelihood but of two, each
//! where it is blind to the other's mistakes.
//!
//! A number is only estimated where its prior has a sigma, where the drive tells more of it than the prior did, and where it does not
//! blur the track: on a drive that turns to one side only, unequal wheels and a wrong track look alike. Else it stays where the
//! description has it, the report says why, and the other numbers are as uncertain as its prior makes them (Schmidt, 1966).
//!
//! # Source
//! docs/lab/calibrate.md section 3.

mod drive;
mod length;
mod mistakes;
mod predict;
mod score;
mod shape;
mod wander;

use posebridge_estimator::FilterConfig;
use posebridge_telemetry::{Calibration, Known};

use super::CalibrationError;

pub use drive::{FreePath, PathStart, Sight, Step, seconds};
pub use mistakes::{AS_GIVEN, Hypothesis, Sanity, Wiring};
pub use predict::RobotNumbers;
pub use score::{ReckonedError, Reckoning, mean_error, reckon, starting_heading};

use mistakes::sanity;
use predict::Prediction;
use shape::Shape;

/// What a drive may tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Unknown {
    /// e_m: relative error of the mean wheel radius.
    RadiusScale,
    /// e_b: relative error of the track width.
    TrackScale,
    /// e_d: relative difference of the radii, right minus left.
    RadiusDifference,
    /// tau: how much earlier than its stamp a sight was true, in seconds.
    FixDelay,
    /// l_f: where the tag is, forward of where it is said to be, in metres.
    TagForward,
    /// l_l: the same to the left.
    TagLeft,
}

/// All of them, in the order in which they are tried.
pub const UNKNOWNS: [Unknown; 6] = [
    Unknown::RadiusScale,
    Unknown::TrackScale,
    Unknown::FixDelay,
    Unknown::RadiusDifference,
    Unknown::TagForward,
    Unknown::TagLeft,
];

impl Unknown {
    /// Its key in `[robot.calibration]`.
    #[must_use]
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

    /// What was known of it before.
    #[must_use]
    pub const fn prior(self, calibration: &Calibration) -> Known {
        match self {
            Self::RadiusScale => calibration.radius_scale,
            Self::TrackScale => calibration.track_scale,
            Self::RadiusDifference => calibration.radius_difference,
            Self::FixDelay => calibration.fix_delay_s,
            Self::TagForward => calibration.tag_forward_m,
            Self::TagLeft => calibration.tag_left_m,
        }
    }

    /// The half width of its central difference, in its own unit. A delay has kinks at the counters' readings: it wants a wide one.
    const fn step(self) -> f64 {
        match self {
            Self::RadiusScale | Self::TrackScale | Self::RadiusDifference => 1e-5,
            Self::FixDelay => 1e-2,
            Self::TagForward | Self::TagLeft => 1e-4,
        }
    }

    fn write(self, value: f64, base_track_m: f64, numbers: &mut RobotNumbers) {
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

/// What became of an unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Estimated.
    Found,
    /// Its prior has no sigma: taken as given.
    Held,
    /// The drive tells less of it than the prior: left where it was.
    Unseen,
    /// It cannot be told from the track on this drive: left where it was.
    NotSeparable,
}

/// An unknown with its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Which.
    pub unknown: Unknown,
    /// What was known before.
    pub before: Known,
    /// What is known after; equal to `before` unless found.
    pub after: Known,
    /// What became of it.
    pub standing: Standing,
}

/// What drives say about a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct PathCalibration {
    /// One per unknown, in the order of [`UNKNOWNS`]; relative to the description under [`Self::sanity`].
    pub entries: Vec<Entry>,
    /// The description against its rivals; `None` with too few sights.
    pub sanity: Option<Sanity>,
    /// How many windows the wheel size stands on; `None` if it was not taken from the length of the way.
    pub length_windows: Option<usize>,
    /// Heading at the start of each run, in radians.
    pub headings_rad: Vec<f64>,
    /// Sum of the squared whitened innovations over their number: about one if the noise is as described.
    pub consistency: f64,
    /// The robot before, as dead reckoning uses it.
    pub before: RobotNumbers,
    /// The robot after.
    pub after: RobotNumbers,
}

impl PathCalibration {
    /// What became of an unknown.
    #[must_use]
    pub fn entry(&self, unknown: Unknown) -> Entry {
        let place = UNKNOWNS.iter().position(|one| *one == unknown);
        self.entries[place.unwrap_or(0)]
    }

    /// The mistake under which the numbers hold.
    #[must_use]
    pub fn hypothesis(&self) -> Hypothesis {
        self.sanity.as_ref().map_or(AS_GIVEN, |sanity| sanity.found)
    }
}

/// Rounds over the second and the third step; the second changes by hundredths of its sigma.
const ROUNDS: u32 = 3;
/// Calibrates a robot from drives; `config` is its description with the priors.
///
/// # Errors
/// [`CalibrationError::TooLittle`] without motion or sights; [`CalibrationError::Undetermined`], [`CalibrationError::Diverged`].
pub fn calibrate_path(config: &FilterConfig, paths: &[FreePath]) -> Result<PathCalibration, CalibrationError> {
    enough(paths)?;
    let before = RobotNumbers::of(config);
    let prediction = Prediction { numbers: before, noise: &config.noise };
    let sanity = sanity(&prediction, paths);
    let hypothesis = sanity.as_ref().map_or(AS_GIVEN, |sanity| sanity.found);
    let paths: Vec<FreePath> = paths.iter().map(|path| path.under(&hypothesis)).collect();
    let mut shape = Shape::new(config, &paths, hypothesis.track_factor);
    let mut length = shape.take_length();
    shape.place_track();
    let (mut chosen, mut standings) = shape.choose(length)?;
    for _ in 1..ROUNDS {
        // The second step knows the tag and the delay only by the third.
        shape.adopt(&chosen);
        length = shape.take_length();
        (chosen, standings) = shape.choose(length)?;
    }
    Ok(shape.report(&chosen, standings, length).with(sanity, before))
}

fn enough(paths: &[FreePath]) -> Result<(), CalibrationError> {
    let steps: usize = paths.iter().map(|path| path.steps.len()).sum();
    let sights: usize = paths.iter().map(|path| path.sights.len()).sum();
    for (what, found, needed) in
        [("intervals in which the wheels turned", steps, 2), ("places where the robot was seen", sights, 3)]
    {
        if found < needed {
            return Err(CalibrationError::TooLittle { what, found, needed });
        }
    }
    Ok(())
}

impl PathCalibration {
    fn with(mut self, sanity: Option<Sanity>, before: RobotNumbers) -> Self {
        self.sanity = sanity;
        self.before = before;
        self
    }
}

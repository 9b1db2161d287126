//! The second and the third step of a calibration: the length of the path, then all parameters that its shape determines.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::{WheelTravel, step_noise};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{Calibration, SensorNoise, UncertainValue};

use super::drive::FreePath;
use super::hypotheses::{AS_GIVEN, Hypothesis, HypothesisTest, coarse_track_factor, length_factor};
use super::predict::{PathPredictor, RobotParameters, estimate_start_heading, nominal};
use crate::calibration::CalibrationError;
use crate::calibration::least_squares::{LeastSquaresFit, Residuals, fit, solution_shift};

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

/// An unknown is inseparable from the track if it increases the track's sigma by this factor.
const INSEPARABLE_FACTOR: f64 = 3.0;
/// An unknown is determined if its sigma is below this share of the prior's.
const INFORMATIVE_SHARE: f64 = 0.5;
/// A heading known better than this is not estimated: about the accuracy of a person or a tracker.
const KNOWN_HEADING_RAD: f64 = 0.02;
const HEADING_STEP_RAD: f64 = 1e-4;

/// Second and third step: selects the free unknowns and estimates them.
#[derive(Clone)]
pub(super) struct ParameterSolver<'a> {
    config: &'a FilterConfig,
    paths: &'a [FreePath],
    base_track_m: f64,
    /// As described, with the wheel size of the second step.
    parameters: RobotParameters,
    /// Result of the last round, used by the second step.
    latest: RobotParameters,
    radius_scale: Option<UncertainValue>,
    first_track_scale: f64,
    headings_rad: Vec<f64>,
    free_headings: Vec<usize>,
}

pub(super) struct ParameterFit {
    unknowns: Vec<CalibrationUnknown>,
    fit: LeastSquaresFit,
}

impl ParameterFit {
    fn value_of(&self, unknown: CalibrationUnknown) -> Option<UncertainValue> {
        let index = self.unknowns.iter().position(|one| *one == unknown)?;
        Some(UncertainValue { value: self.fit.values[index], sigma: self.fit.sigma(index) })
    }
}

impl<'a> ParameterSolver<'a> {
    pub(super) fn new(config: &'a FilterConfig, paths: &'a [FreePath], track_factor: f64) -> Self {
        let mut parameters = RobotParameters::from_config(config);
        parameters.track_width_m *= track_factor;
        let prediction = PathPredictor { parameters, noise: &config.noise };
        let is_free = |path: &FreePath| path.start.heading_sigma_rad > KNOWN_HEADING_RAD;
        let headings_rad = paths.iter().map(|path| {
            // Beyond a radian the given heading is no place to begin a descent.
            if path.start.heading_sigma_rad > 1.0 {
                estimate_start_heading(&prediction, path)
            } else {
                path.start.pose[2]
            }
        });
        Self {
            config,
            paths,
            base_track_m: config.geometry.track_width.0 * track_factor,
            latest: parameters,
            parameters,
            radius_scale: None,
            first_track_scale: config.calibration.track_scale.value,
            headings_rad: headings_rad.collect(),
            free_headings: (0..paths.len()).filter(|run| is_free(&paths[*run])).collect(),
        }
    }

    /// Finds a start value from which the descent of the track converges.
    pub(super) fn initialize_track(&mut self) {
        if self.is_fixed(CalibrationUnknown::TrackScale) {
            return;
        }
        let prediction = PathPredictor { parameters: self.parameters, noise: &self.config.noise };
        let factor = coarse_track_factor(&prediction, self.paths);
        let track_m = self.parameters.track_width_m * factor;
        self.first_track_scale = track_m / self.base_track_m - 1.0;
        self.latest.track_width_m = track_m;
    }

    pub(super) fn adopt(&mut self, chosen: &ParameterFit) {
        (self.latest, _) = self.robot(&chosen.unknowns, &chosen.fit.values);
    }

    fn is_fixed(&self, unknown: CalibrationUnknown) -> bool {
        unknown.prior(self.config.calibration).sigma <= 0.0
    }

    /// The second step; returns the number of windows behind it.
    pub(super) fn estimate_length(&mut self) -> Option<usize> {
        let prior = CalibrationUnknown::RadiusScale.prior(self.config.calibration);
        if self.is_fixed(CalibrationUnknown::RadiusScale) {
            return None;
        }
        let prediction = PathPredictor { parameters: self.latest, noise: &self.config.noise };
        let (factor, windows) = length_factor(&prediction, self.paths)?;
        let reckoned_with = 1.0 + self.latest.radius_scale;
        let sigma = factor.sigma * reckoned_with;
        if sigma > prior.sigma {
            return None;
        }
        let value = reckoned_with * factor.value - 1.0;
        self.parameters.radius_scale = value;
        self.radius_scale = Some(UncertainValue { value, sigma });
        Some(windows)
    }

    /// Adds one unknown after the other and keeps those that the drives determine.
    pub(super) fn select_unknowns(
        &self,
        length: Option<usize>,
    ) -> Result<(ParameterFit, Vec<UnknownStatus>), CalibrationError> {
        let mut chosen = self.fit(Vec::new())?;
        let mut statuses = Vec::new();
        let mut tried_beside = Vec::new();
        for unknown in UNKNOWNS {
            tried_beside.push(chosen.unknowns.len());
            statuses.push(if self.is_fixed(unknown) {
                UnknownStatus::Fixed
            } else if unknown == CalibrationUnknown::RadiusScale && length.is_some() {
                UnknownStatus::Estimated
            } else {
                self.try_unknown(unknown, &mut chosen)
            });
        }
        // Errors hide each other: over a minute unequal wheels turn the whole way, and no track seems to help until they are found.
        for ((unknown, status), beside) in UNKNOWNS.into_iter().zip(&mut statuses).zip(tried_beside) {
            if *status == UnknownStatus::Unobservable && chosen.unknowns.len() > beside {
                *status = self.try_unknown(unknown, &mut chosen);
            }
        }
        Ok((chosen, statuses))
    }

    fn try_unknown(&self, unknown: CalibrationUnknown, chosen: &mut ParameterFit) -> UnknownStatus {
        let mut free = chosen.unknowns.clone();
        free.push(unknown);
        let is_basic = matches!(unknown, CalibrationUnknown::RadiusScale | CalibrationUnknown::TrackScale);
        // If the system with it has no solution, it is not determined.
        let Ok(with) = self.fit(free) else {
            return if is_basic { UnknownStatus::Unobservable } else { UnknownStatus::NotSeparable };
        };
        let prior = unknown.prior(self.config.calibration);
        if with.value_of(unknown).is_none_or(|found| found.sigma >= INFORMATIVE_SHARE * prior.sigma) {
            return UnknownStatus::Unobservable;
        }
        let track = |fit: &ParameterFit| fit.value_of(CalibrationUnknown::TrackScale).map(|track| track.sigma);
        if let (Some(alone), Some(together)) = (track(chosen), track(&with))
            && together > INSEPARABLE_FACTOR * alone
        {
            return UnknownStatus::NotSeparable;
        }
        *chosen = with;
        UnknownStatus::Estimated
    }

    fn fit(&self, unknowns: Vec<CalibrationUnknown>) -> Result<ParameterFit, CalibrationError> {
        let start = unknowns.iter().map(|unknown| match unknown {
            CalibrationUnknown::RadiusScale => self.parameters.radius_scale,
            CalibrationUnknown::TrackScale => self.first_track_scale,
            CalibrationUnknown::RadiusDifference
            | CalibrationUnknown::FixDelay
            | CalibrationUnknown::TagForward
            | CalibrationUnknown::TagLeft => unknown.prior(self.config.calibration).value,
        });
        let headings = self.free_headings.iter().map(|run| self.headings_rad[*run]);
        let start: Vec<f64> = start.chain(headings).collect();
        let steps = self.steps(&unknowns);
        if start.is_empty() {
            return Ok(ParameterFit { fit: LeastSquaresFit::default(), unknowns });
        }
        let fit = fit(&start, &steps, |values| self.residuals(&unknowns, values))?;
        Ok(ParameterFit { unknowns, fit })
    }

    fn steps(&self, unknowns: &[CalibrationUnknown]) -> Vec<f64> {
        let unknowns = unknowns.iter().map(|unknown| unknown.step());
        let headings = self.free_headings.iter().map(|_| HEADING_STEP_RAD);
        unknowns.chain(headings).collect()
    }

    fn residuals(&self, unknowns: &[CalibrationUnknown], values: &[f64]) -> Residuals {
        let (numbers, headings) = self.robot(unknowns, values);
        let prediction = PathPredictor { parameters: numbers, noise: &self.config.noise };
        let mut all = Vec::with_capacity(self.paths.len());
        for (run, (path, heading_rad)) in self.paths.iter().zip(headings).enumerate() {
            let mut residuals = prediction.innovations(path, heading_rad);
            if self.free_headings.contains(&run) {
                let off_rad = wrap_rad(heading_rad - path.start.pose[2]);
                residuals.push([off_rad / path.start.heading_sigma_rad, 0.0]);
            }
            all.push(residuals);
        }
        all
    }

    fn robot(&self, unknowns: &[CalibrationUnknown], values: &[f64]) -> (RobotParameters, Vec<f64>) {
        let mut numbers = self.parameters;
        for (unknown, value) in unknowns.iter().zip(values) {
            unknown.apply(*value, self.base_track_m, &mut numbers);
        }
        let mut headings = self.headings_rad.clone();
        for (run, value) in self.free_headings.iter().zip(&values[unknowns.len()..]) {
            headings[*run] = *value;
        }
        (numbers, headings)
    }

    pub(super) fn report(
        &self,
        chosen: &ParameterFit,
        statuses: Vec<UnknownStatus>,
        length_windows: Option<usize>,
    ) -> PathCalibration {
        let (after, headings_rad) = self.robot(&chosen.unknowns, &chosen.fit.values);
        let by_others = self.shift_by_other_unknowns(chosen, &statuses);
        let by_wandering = self.shift_by_heading_noise(chosen);
        let looked_at = UNKNOWNS.iter().zip(statuses);
        let looked_at = looked_at.zip(by_others.into_iter().zip(by_wandering));
        let entries = looked_at.map(|((unknown, status), (by_others, by_wandering))| {
            let before = unknown.prior(self.config.calibration);
            let after = match unknown {
                CalibrationUnknown::RadiusScale => self.radius_scale.or(chosen.value_of(*unknown)),
                CalibrationUnknown::TrackScale
                | CalibrationUnknown::RadiusDifference
                | CalibrationUnknown::FixDelay
                | CalibrationUnknown::TagForward
                | CalibrationUnknown::TagLeft => chosen
                    .value_of(*unknown)
                    .map(|found| UncertainValue { sigma: found.sigma.hypot(by_others).hypot(by_wandering), ..found }),
            };
            UnknownEstimate { unknown: *unknown, before, after: after.unwrap_or(before), status }
        });
        let residuals = self.residuals(&chosen.unknowns, &chosen.fit.values);
        let all: Vec<f64> = residuals.into_iter().flatten().flatten().collect();
        PathCalibration {
            entries: entries.collect(),
            hypothesis_test: None,
            length_windows,
            headings_rad,
            consistency: all.iter().map(|r| r * r).sum::<f64>() / all.len().max(1) as f64,
            before: after,
            after,
        }
    }

    /// Change of each unknown by one sigma of the heading's random walk under the robot's noise.
    fn shift_by_heading_noise(&self, chosen: &ParameterFit) -> [f64; UNKNOWNS.len()] {
        let (unknowns, values) = (&chosen.unknowns, &chosen.fit.values);
        let (numbers, headings) = self.robot(unknowns, values);
        let (noise, track_m) = (&self.config.noise, numbers.track_width_m);
        let prediction = PathPredictor { parameters: numbers, noise };
        let here = self.residuals(unknowns, values);
        let mut disturbances = Vec::new();
        for (run, (path, heading_rad)) in self.paths.iter().zip(headings).enumerate() {
            for jump in heading_jumps(path, track_m, noise) {
                let sigma_rad = jump.var_rad2.sqrt();
                let by = |by_rad: f64| prediction.innovations(&apply_jump(path, jump, by_rad, track_m), heading_rad);
                let (above, below) = (by(HEADING_STEP_RAD), by(-HEADING_STEP_RAD));
                let mut disturbance: Residuals = here.iter().map(|run| vec![[0.0; 2]; run.len()]).collect();
                let fixes = disturbance[run].iter_mut();
                for ((change, up), down) in fixes.zip(above).zip(below) {
                    *change = [0, 1].map(|axis| sigma_rad * (up[axis] - down[axis]) / (2.0 * HEADING_STEP_RAD));
                }
                disturbances.push(disturbance);
            }
        }
        let steps = self.steps(unknowns);
        let residuals = |values: &[f64]| self.residuals(unknowns, values);
        // What could be fitted can be solved here, too.
        let moved = solution_shift(disturbances.into_iter(), values, &steps, residuals);
        let mut squares = [0.0; UNKNOWNS.len()];
        for shift in moved.unwrap_or_default() {
            for (square, unknown) in squares.iter_mut().zip(UNKNOWNS) {
                let index = unknowns.iter().position(|one| *one == unknown);
                let shift = index.and_then(|index| shift.get(index));
                *square += shift.map_or(0.0, |shift| shift * shift);
            }
        }
        squares.map(f64::sqrt)
    }

    /// Change of each unknown when a value that is fixed in the third step is wrong by its sigma: the wheel size of the second step,
    /// and the undetermined unknowns.
    fn shift_by_other_unknowns(&self, chosen: &ParameterFit, statuses: &[UnknownStatus]) -> [f64; UNKNOWNS.len()] {
        let mut others = Vec::new();
        if let Some(radius) = self.radius_scale {
            let mut other = self.clone();
            other.parameters.radius_scale += radius.sigma;
            others.push(other);
        }
        for (unknown, status) in UNKNOWNS.iter().zip(statuses) {
            if matches!(status, UnknownStatus::Unobservable | UnknownStatus::NotSeparable) {
                let prior = unknown.prior(self.config.calibration);
                let mut other = self.clone();
                let wrong = prior.value + prior.sigma;
                unknown.apply(wrong, self.base_track_m, &mut other.parameters);
                others.push(other);
            }
        }
        let mut squares = [0.0; UNKNOWNS.len()];
        for other in others {
            // Where it cannot be fitted with a wrong number there is nothing to compare.
            let Ok(moved) = other.fit(chosen.unknowns.clone()) else {
                continue;
            };
            for (square, unknown) in squares.iter_mut().zip(UNKNOWNS) {
                if let (Some(here), Some(there)) = (chosen.value_of(unknown), moved.value_of(unknown)) {
                    *square += (there.value - here.value).powi(2);
                }
            }
        }
        squares.map(f64::sqrt)
    }
}

// How far a heading that wanders moves the numbers that are looked for.
//
// # Model
// ```text
// th <- th + n        n ~ N(0, q_j)           in the j-th piece of a drive, q_j by the robot's described noise over that piece
// cov += sum_j q_j g_j g_j'                   g_j = -A^-1 J' dr/dn_j: how far the fit moves per radian
// ```
// The fit itself takes the heading for exact, which is what finds a track. Its robust covariance sees what of the residuals is left;
// but a wandering that unequal wheels explain as well leaves nothing behind, and would count as knowledge.

/// Pieces of a drive: with this number of jumps, sums over it behave like those of a random walk.
const JUMPS_PER_PATH: usize = 24;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeadingJump {
    step: usize,
    /// Variance of the heading over the piece, in rad².
    pub(super) var_rad2: f64,
}

pub(super) fn heading_jumps(path: &FreePath, track_width_m: f64, noise: &SensorNoise) -> Vec<HeadingJump> {
    let geometry = nominal(track_width_m);
    let length = path.steps.len().div_ceil(JUMPS_PER_PATH).max(1);
    let chunks = path.steps.chunks(length).enumerate();
    let jumps = chunks.map(|(chunk, steps)| {
        let vars = steps.iter().map(|step| step_noise(step.travel, &geometry, noise).turn_var_rad2);
        HeadingJump { step: chunk * length + steps.len() / 2, var_rad2: vars.sum() }
    });
    jumps.filter(|jump| jump.var_rad2 > 0.0).collect()
}

pub(super) fn apply_jump(path: &FreePath, jump: HeadingJump, by_rad: f64, track_width_m: f64) -> FreePath {
    let mut path = path.clone();
    if let Some(step) = path.steps.get_mut(jump.step) {
        let apart_m = 0.5 * by_rad * track_width_m;
        step.travel = WheelTravel { left_m: step.travel.left_m - apart_m, right_m: step.travel.right_m + apart_m };
    }
    path
}

//! Predicts the fixes of a robot with given parameters, and the innovations of the observed ones.
//!
//! # Model
//! ```text
//! s_L = s_L0 (1 + e_m - e_d/2)     s_R = s_R0 (1 + e_m + e_d/2)     b = b0 (1 + e_b)
//! d = (s_L + s_R) / 2              dth = (s_R - s_L) / b            arcs, one behind the other, from the start
//! h = p(t - tau) + R(th) (l_f, l_l)                                 where the tag is seen at the stamp t
//!
//! z = p + R(th) l + v       v ~ N(0, sigma^2 I)                     the camera
//! p <- p + d e(th) + w e(th)      w ~ N(0, k_w^2 (|s_L| + |s_R|)/4 + k_d^2 |d|)      slip along the way
//! ```
//! The heading has no noise here: the parameters explain all of its error. So a heading error after a hundred turns counts in full,
//! which determines the track; slip along the path is absorbed after a while, so that one bump does not bias the rest. The whitened
//! innovations of this Kalman filter of two states are the residuals; log S hardly depends on the unknowns and is omitted.
//!
//! # Source
//! Larsen, Hansen, Andersen and Ravn (1999), Proceedings of FUSION (calibration by innovations); docs/lab/calibration.md section 3.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::models::differential_drive::{WheelTravel, body_step, step_noise};
use posebridge_estimator::models::se2::{StepRule, displace};
use posebridge_estimator::numerics::statistics;
use posebridge_telemetry::{DriveGeometry, Meters, Radians, SensorNoise};

use super::drive::{FreePath, TravelStep};
use crate::statistics::PairedVectors;

/// Parameters of a robot: factors on nominal travel and track, camera delay and tag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotParameters {
    /// e_m.
    pub radius_scale: f64,
    /// e_d.
    pub radius_difference: f64,
    /// b.
    pub track_width_m: f64,
    /// tau.
    pub fix_delay_s: f64,
    /// Added to the tag's configured position: forward, left.
    pub tag_m: [f64; 2],
}

impl RobotParameters {
    /// The described geometry with the values of its calibration.
    pub fn from_config(config: &FilterConfig) -> Self {
        let known = &config.calibration;
        Self {
            radius_scale: known.radius_scale.value,
            radius_difference: known.radius_difference.value,
            track_width_m: config.geometry.track_width.0 * (1.0 + known.track_scale.value),
            fix_delay_s: known.fix_delay_s.value,
            tag_m: [known.tag_forward_m.value, known.tag_left_m.value],
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct PathPredictor<'a> {
    pub(super) parameters: RobotParameters,
    pub(super) noise: &'a SensorNoise,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FixHandling {
    Correct,
    CompareOnly,
}

struct PathFilter<'a> {
    robot: PathPredictor<'a>,
    geometry: DriveGeometry,
    pose: [f64; 3],
    /// xx, xy, yy in m².
    var: [f64; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PredictedTag {
    pub(super) tag_m: [f64; 2],
    /// Not wrapped.
    pub(super) heading_rad: f64,
}

impl PathPredictor<'_> {
    pub(super) fn innovations(&self, path: &FreePath, heading_rad: f64) -> Vec<[f64; 2]> {
        let mut white = Vec::with_capacity(path.fixes.len());
        self.run(path, heading_rad, FixHandling::Correct, |_, innovation| {
            white.push(innovation);
        });
        white
    }

    pub(super) fn predict_tags(&self, path: &FreePath, heading_rad: f64) -> Vec<PredictedTag> {
        let mut predicted = Vec::with_capacity(path.fixes.len());
        self.run(path, heading_rad, FixHandling::CompareOnly, |reckoned, _| {
            predicted.push(reckoned);
        });
        predicted
    }

    fn run(
        &self,
        path: &FreePath,
        heading_rad: f64,
        mode: FixHandling,
        mut on_fix: impl FnMut(PredictedTag, [f64; 2]),
    ) {
        let [x, y, _] = path.start.pose;
        let var = path.start.position_sigma_m.powi(2);
        let mut walk = PathFilter {
            robot: *self,
            geometry: nominal(self.parameters.track_width_m),
            pose: [x, y, heading_rad],
            var: [var, 0.0, var],
        };
        let mut steps = path.steps.iter();
        let mut open = steps.next().copied();
        for fix in &path.fixes {
            let until_s = fix.at_s - self.parameters.fix_delay_s;
            while let Some(step) = open {
                if step.from_s >= until_s {
                    break;
                }
                if step.until_s <= until_s {
                    walk.drive(step.travel);
                    open = steps.next().copied();
                } else {
                    open = Some(walk.drive_until(step, until_s));
                }
            }
            let tag = [0, 1].map(|axis| fix.tag_m[axis] + self.parameters.tag_m[axis]);
            let reckoned = walk.predicted_tag(tag);
            let innovation = match mode {
                FixHandling::Correct => walk.correct(reckoned.tag_m, fix.position_m, fix.sigma_m),
                FixHandling::CompareOnly => [0.0; 2],
            };
            on_fix(reckoned, innovation);
        }
    }
}

/// Only its track is used.
pub(super) const fn nominal(track_width_m: f64) -> DriveGeometry {
    DriveGeometry {
        left_wheel_radius: Meters(1.0),
        right_wheel_radius: Meters(1.0),
        track_width: Meters(track_width_m),
        tick: Radians(1.0),
    }
}

impl PathFilter<'_> {
    /// Drives a part of a step and returns its rest.
    fn drive_until(&mut self, step: TravelStep, until_s: f64) -> TravelStep {
        let share = (until_s - step.from_s) / (step.until_s - step.from_s);
        let part =
            |share: f64| WheelTravel { left_m: step.travel.left_m * share, right_m: step.travel.right_m * share };
        self.drive(part(share));
        TravelStep { from_s: until_s, until_s: step.until_s, travel: part(1.0 - share) }
    }

    fn drive(&mut self, nominal: WheelTravel) {
        let numbers = &self.robot.parameters;
        let travel = WheelTravel {
            left_m: nominal.left_m * (1.0 + numbers.radius_scale - 0.5 * numbers.radius_difference),
            right_m: nominal.right_m * (1.0 + numbers.radius_scale + 0.5 * numbers.radius_difference),
        };
        let step = body_step(travel, &self.geometry);
        let moved = displace(self.pose[2], step, StepRule::Arc);
        let slip_var = step_noise(travel, &self.geometry, self.robot.noise).forward_var_m2;
        let (sin, cos) = (self.pose[2] + 0.5 * step.turn_rad).sin_cos();
        self.pose = [self.pose[0] + moved.dx_m, self.pose[1] + moved.dy_m, self.pose[2] + step.turn_rad];
        self.var[0] += slip_var * cos * cos;
        self.var[1] += slip_var * cos * sin;
        self.var[2] += slip_var * sin * sin;
    }

    fn predicted_tag(&self, [forward_m, left_m]: [f64; 2]) -> PredictedTag {
        let [x, y, heading_rad] = self.pose;
        let (sin, cos) = heading_rad.sin_cos();
        PredictedTag { tag_m: [x + cos * forward_m - sin * left_m, y + sin * forward_m + cos * left_m], heading_rad }
    }

    /// Corrects with the two coordinates of a fix in turn and returns the whitened innovations.
    fn correct(&mut self, reckoned_m: [f64; 2], measured_m: [f64; 2], sigma_m: f64) -> [f64; 2] {
        let mut corrected_m = [0.0; 2];
        let mut white = [0.0; 2];
        for axis in 0..2 {
            let [xx, xy, yy] = self.var;
            let (to_x, to_y) = if axis == 0 { (xx, xy) } else { (xy, yy) };
            let s = if axis == 0 { xx } else { yy } + sigma_m * sigma_m;
            let nu = measured_m[axis] - reckoned_m[axis] - corrected_m[axis];
            white[axis] = nu / s.sqrt();
            corrected_m[0] += to_x / s * nu;
            corrected_m[1] += to_y / s * nu;
            self.var = [xx - to_x * to_x / s, xy - to_x * to_y / s, yy - to_y * to_y / s];
        }
        self.pose[0] += corrected_m[0];
        self.pose[1] += corrected_m[1];
        white
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeadReckoningError {
    pub rms_m: f64,
    pub max_m: f64,
    pub end_m: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct DeadReckonedPath {
    /// x, y of the predicted tag at each fix.
    pub positions_m: Vec<[f64; 2]>,
    pub error: DeadReckoningError,
}

/// The start heading of a drive by its description: as given, or the best fit if it is unknown.
pub fn start_heading(config: &FilterConfig, numbers: &RobotParameters, path: &FreePath) -> f64 {
    if path.start.heading_sigma_rad <= 1.0 {
        return path.start.pose[2];
    }
    estimate_start_heading(&predictor(config, numbers), path)
}

/// The rotation about the start, equal to the start heading, at which a drive fits its fixes best.
pub(super) fn estimate_start_heading(prediction: &PathPredictor<'_>, path: &FreePath) -> f64 {
    let reckoned = prediction.predict_tags(path, 0.0);
    let [x, y, _] = path.start.pose;
    let pairs = reckoned.iter().zip(&path.fixes).map(|(ours, fix)| [ours.tag_m, fix.position_m]);
    PairedVectors::about([[x, y]; 2], pairs).angle_rad()
}

pub fn dead_reckon(
    config: &FilterConfig,
    numbers: &RobotParameters,
    path: &FreePath,
    heading_rad: f64,
) -> DeadReckonedPath {
    let reckoned = predictor(config, numbers).predict_tags(path, heading_rad);
    let positions_m: Vec<[f64; 2]> = reckoned.iter().map(|reckoned| reckoned.tag_m).collect();
    let off = positions_m
        .iter()
        .zip(&path.fixes)
        .map(|(ours, fix)| (ours[0] - fix.position_m[0]).hypot(ours[1] - fix.position_m[1]));
    let off: Vec<f64> = off.collect();
    let error = DeadReckoningError {
        rms_m: statistics::root_mean_square(&off).unwrap_or(0.0),
        max_m: off.iter().copied().fold(0.0, f64::max),
        end_m: off.last().copied().unwrap_or(0.0),
    };
    DeadReckonedPath { positions_m, error }
}

pub fn mean_error(errors: &[DeadReckoningError]) -> DeadReckoningError {
    let mean = |of: fn(&DeadReckoningError) -> f64| statistics::mean(errors.iter().map(of)).unwrap_or(0.0);
    DeadReckoningError {
        rms_m: mean(|error| error.rms_m),
        max_m: mean(|error| error.max_m),
        end_m: mean(|error| error.end_m),
    }
}

fn predictor<'a>(config: &'a FilterConfig, numbers: &RobotParameters) -> PathPredictor<'a> {
    PathPredictor { parameters: *numbers, noise: &config.noise }
}

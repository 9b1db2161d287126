//! The TOML format of a Monte-Carlo scenario.
//!
//! A file describes the whole experiment: the numbers of sensors and motion have no defaults. What is off when missing is marked so below:
//! whole tables, and errors that are zero. A filter is told the distributions from which a run draws, unless `[profile]` says otherwise.

use std::f64::consts::FRAC_PI_2;

use serde::Deserialize;

use super::disturbances::{FixBursts, Kidnaps, Patches, SlipBursts};
use super::limits::Limits;
use super::observers::{Beacons, Compass, Landmarks, StampErrors, sigma_of_filters};
use crate::config_file::{ConfigFileError, bundle, bundled_text, from_toml};
use crate::scenario::Blackout;

/// Closer poses define no direction.
const SHORTEST_LEG_M: f64 = 1e-3;

/// Name and TOML text of every bundled scenario. Adding one: a file in `config/scenarios/accuracy/` and its name here.
pub const SCENARIOS: &[(&str, &str)] = bundle!("scenarios/accuracy":
    "camera-10hz", "camera-1hz", "outliers-3pct", "outliers-10pct", "noise-x4", "noise-quarter", "noise-x4-outliers",
    "blackout", "no-camera", "kicks", "kicks-camera-1hz", "unknown-heading", "wpilib", "paper-square",
    "gyro-scale-10hz", "gyro-scale-1hz", "mounting-landmarks", "mounting-beacons", "late-landmarks", "clock-skew",
    "landmark-map-errors", "range-share", "biased-camera", "patches-with-rests", "backlash", "outlier-burst",
    "outlier-burst-elsewhere", "outlier-burst-near", "slip-bursts-1hz", "kidnap-10hz", "kidnap-1hz", "kidnap-landmarks", "kidnap-student",
    "kidnap-landmarks-student", "kidnap-unnoticed", "kidnap-unnoticed-landmarks", "kidnap-and-burst", "global-start-landmarks",
);

/// Ten times the steps of the longest bundled drive.
pub(super) const MAX_STEPS: f64 = 100_000.0;

/// One experiment: a path, a robot drawn anew in each run, its sensors, and the configuration of the filters.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Base seed; run i derives its own from it.
    pub seed: u64,
    pub runs: u32,
    /// Time grid of all events.
    pub step_s: f64,
    /// Errors before this time do not count.
    pub score_from_s: f64,
    pub path: Course,
    pub robot: NominalRobot,
    /// Deviation of the true robot from it.
    pub errors: GeometryErrors,
    pub motion: MotionNoise,
    pub gyro: Gyro,
    pub camera: Option<Camera>,
    pub second_camera: Option<Camera>,
    pub landmarks: Option<Landmarks>,
    pub beacons: Option<Beacons>,
    pub compass: Option<Compass>,
    /// Turns that the encoders do not measure.
    pub kicks: Option<Kicks>,
    pub kidnaps: Option<Kidnaps>,
    pub slip_bursts: Option<SlipBursts>,
    pub accelerometer: Option<Accelerometer>,
    pub told: PriorSettings,
    /// Tables and keys of a robot profile that replace what a filter is told otherwise. The caller checks them.
    #[serde(default)]
    pub profile: toml::Table,
    /// What the scenario requires of the main filter.
    pub limits: Option<Limits>,
}

/// The nominal geometry of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NominalRobot {
    pub wheel_radius_m: f64,
    pub track_width_m: f64,
    /// Resolution of the encoders; rotation is rounded down to it.
    pub tick_deg: f64,
    /// Play of each wheel's gear: the encoder turns through it before the wheel follows.
    #[serde(default)]
    pub backlash_deg: f64,
}

/// Standard deviations of the relative errors of the geometry, drawn once per run.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeometryErrors {
    /// Of the mean wheel radius.
    pub radius_scale_sigma: f64,
    pub radius_difference_sigma: f64,
    pub track_scale_sigma: f64,
}

/// Slip of the wheels per square root of travel and turn.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionNoise {
    pub wheel_travel_m_per_sqrt_m: f64,
    pub turn_rad_per_sqrt_rad: f64,
}

/// Mean turn rate over the step, with bias, noise and rounding.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gyro {
    /// White noise of one observation.
    pub sigma_deg_per_s: f64,
    /// 0 for none.
    pub resolution_deg_per_s: f64,
    /// Bias at the start.
    pub bias_sigma_deg_per_s: f64,
    pub bias_walk_deg_per_s_sqrt_s: f64,
    /// Of the relative error of its rate.
    #[serde(default)]
    pub scale_sigma: f64,
}

/// Whether a camera measures the heading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraSees {
    Pose,
    Position,
}

/// Timing and noise of the overhead camera.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    pub sees: CameraSees,
    pub every_steps: u32,
    /// From a fix's timestamp to its arrival,
    pub delay_steps: u32,
    /// plus or minus up to this, uniform.
    pub delay_spread_steps: u32,
    #[serde(deserialize_with = "sigma_of_filters")]
    pub position_sigma_m: f64,
    #[serde(deserialize_with = "sigma_of_filters")]
    pub heading_sigma_deg: f64,
    /// Ratio of the true noise to the noise in the filter's configuration.
    pub true_noise_factor: f64,
    pub outliers: Option<Outliers>,
    /// An interval of timestamps without fixes, both ends included.
    pub blackout: Option<Blackout>,
    /// Of an error that all its fixes share, each axis.
    #[serde(default)]
    pub bias_sigma_m: f64,
    pub patches: Option<Patches>,
    pub bursts: Option<FixBursts>,
    #[serde(default)]
    pub stamps: StampErrors,
}

/// Probability and spread of false fixes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outliers {
    pub probability: f64,
    /// Added to x and y (metres) and to the heading (radians).
    pub sigma_m_rad: f64,
}

/// Disturbances on straight sides: the robot turns and its wheels do not measure it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kicks {
    /// Rate at which kicks begin on a side.
    pub probability_per_s: f64,
    /// Magnitude: uniform from here, either sign,
    pub least_deg: f64,
    /// to here.
    pub most_deg: f64,
    pub spread_steps: u32,
}

/// Accelerometers at both wheels: change of the wheel's speed over a step.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accelerometer {
    /// White noise of one observation.
    #[serde(deserialize_with = "sigma_of_filters")]
    pub sigma_m_per_s2: f64,
}

/// The geometry in the filter's configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PriorGeometry {
    Nominal,
    /// The true geometry of the run.
    True,
}

/// The filter's configuration besides the sensor noise.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorSettings {
    pub geometry: PriorGeometry,
    /// Error of the mean wheel radius; 0 for a fixed radius.
    pub radius_scale_sigma: f64,
    pub radius_difference_sigma: f64,
    /// Error of the track width; 0 for a fixed track.
    pub track_scale_sigma: f64,
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Noise of the heading.
    pub turn_rad_per_sqrt_rad: f64,
    /// Of x and y; the configured start is the true one.
    pub start_position_sigma_m: f64,
    pub start_heading_sigma_rad: f64,
    /// Bound of the uniform error of the configured start heading.
    pub start_heading_off_deg: f64,
    /// Without a start a filter has to find its pose.
    #[serde(default)]
    pub start_is_unknown: bool,
}

impl Scenario {
    /// Reads a scenario. An error names the line and the key that is unknown, missing, of the wrong type or out of range, or the
    /// numbers that contradict each other.
    pub fn from_toml(text: &str) -> Result<Self, ConfigFileError> {
        from_toml("scenario", text, Self::contradiction)
    }

    pub fn bundled(name: &str) -> Result<Self, ConfigFileError> {
        let known = |names| format!("{names}, or name a TOML file");
        Self::from_toml(bundled_text("accuracy scenario", SCENARIOS, name, known)?)
    }

    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// The same drives without bursts of wrong fixes.
    pub fn without_bursts(mut self) -> Self {
        for camera in [&mut self.camera, &mut self.second_camera].into_iter().flatten() {
            camera.bursts = None;
        }
        self
    }

    pub fn has_bursts(&self) -> bool {
        [&self.camera, &self.second_camera].into_iter().flatten().any(|camera| camera.bursts.is_some())
    }

    fn contradiction(&self) -> Option<String> {
        if let Course::Spline(spline) = &self.path
            && let Some(leg) = spline.leg_without_length()
        {
            return Some(format!(
                "poses_m_deg: poses {leg} and {} stand at the same place; a spline has no direction between them",
                leg + 1
            ));
        }
        let steps = self.path.steps_estimate(self.step_s);
        if !(1.0..=MAX_STEPS).contains(&steps) {
            return Some(format!(
                "[path] takes {steps:.0} steps of {} s; give a path of 1 to {MAX_STEPS:.0} steps",
                self.step_s
            ));
        }
        let (score_from_s, end_s) = (self.score_from_s, steps * self.step_s);
        if score_from_s >= end_s {
            return Some(format!("score_from_s {score_from_s} lies behind the end of [path], about {end_s:.1} s"));
        }
        for (table, camera) in [("camera", self.camera), ("second_camera", self.second_camera)] {
            if let Some(Camera { delay_steps, delay_spread_steps, .. }) = camera
                && delay_spread_steps > delay_steps
            {
                return Some(format!(
                    "[{table}] delay_spread_steps {delay_spread_steps} exceeds delay_steps {delay_steps}: a fix cannot arrive before it \
                     is made"
                ));
            }
        }
        if let Some(Kicks { least_deg, most_deg, .. }) = self.kicks
            && least_deg > most_deg
        {
            return Some(format!("[kicks] least_deg {least_deg} exceeds most_deg {most_deg}"));
        }
        if let Some(Kidnaps { least_m, most_m, least_deg, most_deg, .. }) = self.kidnaps
            && (least_m > most_m || least_deg > most_deg)
        {
            return Some(format!(
                "[kidnaps] {least_m} m to {most_m} m and {least_deg} deg to {most_deg} deg: the first of each must not be larger"
            ));
        }
        let ranges = [
            ("landmarks", self.landmarks.as_ref().map(|sensor| (sensor.range_sigma_m, sensor.range_share))),
            ("beacons", self.beacons.as_ref().map(|sensor| (sensor.range_sigma_m, sensor.range_share))),
        ];
        for (table, sensor) in ranges {
            if sensor == Some((0.0, 0.0)) {
                return Some(format!(
                    "[{table}] range_sigma_m and range_share are both 0; give one of them, filters are configured with it"
                ));
            }
        }
        None
    }
}

/// The path of a run: laps, a weave or a spline.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Course {
    /// Laps of a square with turns in place, alternately left and right, with a controller that knows the truth.
    Laps(Laps),
    /// A constant speed with a sinusoidal turn rate.
    Weave(Weave),
    /// Splines through poses, at a trapezoidal speed.
    Spline(Spline),
}

/// Laps of a square with turns in place.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Laps {
    pub laps: u32,
    pub side_m: f64,
    pub speed_m_per_s: f64,
    pub turn_rate_rad_per_s: f64,
    /// Steps over which the speed ramps up and down at the ends of each side and turn.
    pub ramp_steps: u32,
    /// Before the first lap.
    pub rest_s: f64,
    pub rest_after_side_s: f64,
    pub rest_after_turn_s: f64,
    /// After the extra turn that ends a lap.
    pub rest_after_lap_s: f64,
    /// Of the controller on a side: turn per step for each radian of heading error.
    pub heading_gain: f64,
    /// Of the controller on a side: turn per step for each metre of lateral error.
    pub lateral_gain_rad_per_m: f64,
    /// Limit of the controller's turn per step.
    pub most_turn_rad: f64,
}

/// A constant speed with the turn rate `amplitude sin(pulsation t)`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weave {
    pub duration_s: f64,
    pub speed_m_per_s: f64,
    pub turn_amplitude_rad_per_s: f64,
    pub turn_pulsation_rad_per_s: f64,
}

/// Quintic splines through poses, driven without a stop at a trapezoidal speed.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spline {
    /// (x in m, y in m, heading in degrees).
    pub poses_m_deg: [[f64; 3]; 5],
    /// Length of the tangents at both ends of a leg, relative to its straight distance.
    pub tangent_scale: f64,
    pub speed_m_per_s: f64,
    pub acceleration_m_per_s2: f64,
}

impl Course {
    /// Approximate number of steps, to be checked before anything is drawn.
    pub(super) fn steps_estimate(&self, step_s: f64) -> f64 {
        match self {
            Self::Laps(laps) => {
                let ramp_s = f64::from(laps.ramp_steps) * step_s;
                let side_s = laps.side_m / laps.speed_m_per_s + ramp_s + laps.rest_after_side_s;
                let turn_s = FRAC_PI_2 / laps.turn_rate_rad_per_s + ramp_s;
                let lap_s = 4.0 * (side_s + turn_s + laps.rest_after_turn_s) + turn_s + laps.rest_after_lap_s;
                (laps.rest_s + f64::from(laps.laps) * lap_s) / step_s
            }
            Self::Weave(weave) => weave.duration_s / step_s,
            Self::Spline(spline) => spline.duration_estimate_s() / step_s,
        }
    }
}

impl Spline {
    /// Approximate duration, from the straight distances and the lengths of the tangents.
    fn duration_estimate_s(&self) -> f64 {
        let straight_m: f64 = self.legs().map(|(from, to)| distance_m(from, to)).sum();
        let length_m = straight_m * (1.0 + self.tangent_scale);
        length_m / self.speed_m_per_s + self.speed_m_per_s / self.acceleration_m_per_s2
    }

    /// The number, from 1, of the first leg whose ends are less than a millimetre apart.
    pub(super) fn leg_without_length(&self) -> Option<usize> {
        let is_short = |(from, to)| distance_m(from, to) < SHORTEST_LEG_M;
        self.legs().position(is_short).map(|index| index + 1)
    }

    pub(super) fn legs(&self) -> impl Iterator<Item = ([f64; 3], [f64; 3])> + '_ {
        self.poses_m_deg.windows(2).map(|pair| (pair[0], pair[1]))
    }
}

pub(super) fn distance_m(from: [f64; 3], to: [f64; 3]) -> f64 {
    (to[0] - from[0]).hypot(to[1] - from[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_in_the_folder_is_bundled() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/scenarios/accuracy");
        for file in std::fs::read_dir(folder).unwrap() {
            let path = file.unwrap().path();
            let name = path.file_stem().unwrap().to_str().unwrap();
            assert!(SCENARIOS.iter().any(|(known, _)| *known == name), "{name} is not bundled");
        }
    }

    #[test]
    fn an_unknown_name_lists_the_bundled_ones() {
        let message = Scenario::bundled("camera-5hz").unwrap_err().to_string();
        assert!(message.contains("camera-5hz") && message.contains("paper-square"));
    }
}

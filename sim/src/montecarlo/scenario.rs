//! The TOML format of a Monte-Carlo scenario.
//!
//! Numbers have no defaults: a file describes the whole experiment. Only the tables `[camera]`, `[kicks]` and `[accelerometer]` are
//! optional; each is off when missing.

use std::f64::consts::FRAC_PI_2;

use serde::Deserialize;

use crate::checks;
use crate::config_file::{ConfigFileError, bundled_text, from_toml};
use crate::scenario::Blackout;

/// The kind of file in error messages.
const WHAT: &str = "scenario";
/// Closer poses define no direction.
const SHORTEST_LEG_M: f64 = 1e-3;
macro_rules! bundled {
    ($($name:literal),* $(,)?) => {
        /// Name and TOML text of every bundled scenario. Adding one: a file in `config/scenarios/accuracy/` and a line here.
        pub const SCENARIOS: &[(&str, &str)] = &[
            $(($name, include_str!(concat!("../../../config/scenarios/accuracy/", $name, ".toml")))),*
        ];
    };
}

bundled![
    "camera-10hz",
    "camera-1hz",
    "outliers-3pct",
    "outliers-10pct",
    "noise-x4",
    "noise-quarter",
    "noise-x4-outliers",
    "blackout",
    "no-camera",
    "kicks",
    "kicks-camera-1hz",
    "unknown-heading",
    "wpilib",
    "paper-square",
];

/// Ten times the steps of the longest bundled drive.
pub(super) const MAX_STEPS: f64 = 100_000.0;

/// One experiment: a path, a robot drawn anew in each run, its sensors, and the configuration of the filters.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Base seed; run i derives its own from it.
    pub seed: u64,
    #[serde(deserialize_with = "checks::runs")]
    pub runs: u32,
    /// Time grid of all events.
    #[serde(deserialize_with = "checks::positive")]
    pub step_s: f64,
    /// Errors before this time do not count.
    #[serde(deserialize_with = "checks::non_negative")]
    pub score_from_s: f64,
    pub path: Course,
    pub robot: NominalRobot,
    /// Deviation of the true robot from it.
    pub errors: GeometryErrors,
    pub motion: MotionNoise,
    pub gyro: Gyro,
    pub camera: Option<Camera>,
    /// Turns that the encoders do not measure.
    pub kicks: Option<Kicks>,
    pub accelerometer: Option<Accelerometer>,
    pub told: PriorSettings,
}

/// The nominal geometry of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NominalRobot {
    #[serde(deserialize_with = "checks::positive")]
    pub wheel_radius_m: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub track_width_m: f64,
    /// Resolution of the encoders; rotation is rounded down to it.
    #[serde(deserialize_with = "checks::positive")]
    pub tick_deg: f64,
}

/// Standard deviations of the relative errors of the geometry, drawn once per run.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GeometryErrors {
    /// Of the mean wheel radius.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_scale_sigma: f64,
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_difference_sigma: f64,
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub track_scale_sigma: f64,
}

/// Slip of the wheels per square root of travel and turn.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionNoise {
    #[serde(deserialize_with = "checks::non_negative")]
    pub wheel_travel_m_per_sqrt_m: f64,
    #[serde(deserialize_with = "checks::non_negative")]
    pub turn_rad_per_sqrt_rad: f64,
}

/// Mean turn rate over the step, with bias, noise and rounding.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gyro {
    /// White noise of one observation.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_deg_per_s: f64,
    /// 0 for none.
    #[serde(deserialize_with = "checks::non_negative")]
    pub resolution_deg_per_s: f64,
    /// Bias at the start.
    #[serde(deserialize_with = "checks::non_negative")]
    pub bias_sigma_deg_per_s: f64,
    #[serde(deserialize_with = "checks::non_negative")]
    pub bias_walk_deg_per_s_sqrt_s: f64,
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
    #[serde(deserialize_with = "checks::step_count")]
    pub every_steps: u32,
    /// From a fix's timestamp to its arrival,
    #[serde(deserialize_with = "checks::short_step_count")]
    pub delay_steps: u32,
    /// plus or minus up to this, uniform.
    #[serde(deserialize_with = "checks::short_step_count")]
    pub delay_spread_steps: u32,
    #[serde(deserialize_with = "checks::positive")]
    pub position_sigma_m: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub heading_sigma_deg: f64,
    /// Ratio of the true noise to the noise in the filter's configuration.
    #[serde(deserialize_with = "checks::non_negative")]
    pub true_noise_factor: f64,
    pub outliers: Option<Outliers>,
    /// An interval of timestamps without fixes, both ends included.
    pub blackout: Option<Blackout>,
}

/// Probability and spread of false fixes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outliers {
    #[serde(deserialize_with = "checks::probability")]
    pub probability: f64,
    /// Added to x and y (metres) and to the heading (radians).
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_m_rad: f64,
}

/// Disturbances on straight sides: the robot turns and its wheels do not measure it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kicks {
    /// Rate at which kicks begin on a side.
    #[serde(deserialize_with = "checks::probability")]
    pub probability_per_s: f64,
    /// Magnitude: uniform from here, either sign,
    #[serde(deserialize_with = "checks::non_negative")]
    pub least_deg: f64,
    /// to here.
    #[serde(deserialize_with = "checks::non_negative")]
    pub most_deg: f64,
    #[serde(deserialize_with = "checks::step_count")]
    pub spread_steps: u32,
}

/// Accelerometers at both wheels: change of the wheel's speed over a step.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accelerometer {
    /// White noise of one observation; above zero, because filters are configured with it.
    #[serde(deserialize_with = "checks::positive")]
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
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_scale_sigma: f64,
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_difference_sigma: f64,
    /// Error of the track width; 0 for a fixed track.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub track_scale_sigma: f64,
    #[serde(deserialize_with = "checks::non_negative")]
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Noise of the heading.
    #[serde(deserialize_with = "checks::non_negative")]
    pub turn_rad_per_sqrt_rad: f64,
    /// Of x and y; the configured start is the true one.
    #[serde(deserialize_with = "checks::non_negative")]
    pub start_position_sigma_m: f64,
    #[serde(deserialize_with = "checks::non_negative")]
    pub start_heading_sigma_rad: f64,
    /// Bound of the uniform error of the configured start heading.
    #[serde(deserialize_with = "checks::non_negative")]
    pub start_heading_off_deg: f64,
}

impl Scenario {
    /// Reads a scenario. An error names the line and the key that is unknown, missing, of the wrong type or out of range, or the
    /// numbers that contradict each other.
    pub fn from_toml(text: &str) -> Result<Self, ConfigFileError> {
        let scenario: Self = from_toml(WHAT, text)?;
        match scenario.contradiction() {
            None => Ok(scenario),
            Some(reason) => Err(ConfigFileError::Impossible { what: WHAT, reason }),
        }
    }

    pub fn bundled(name: &str) -> Result<Self, ConfigFileError> {
        let known = |names| format!("{names}, or name a TOML file");
        Self::from_toml(bundled_text("accuracy scenario", SCENARIOS, name, known)?)
    }

    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Numbers that contradict each other, and why.
    fn contradiction(&self) -> Option<String> {
        if let Course::Spline(spline) = &self.path {
            // A NaN is bearable nowhere.
            if !spline.poses_m_deg.iter().flatten().all(|value| value.abs() <= checks::LARGEST) {
                return Some("poses_m_deg holds a number that is not finite or too large".to_owned());
            }
            if let Some(leg) = spline.leg_without_length() {
                return Some(format!(
                    "poses_m_deg: poses {leg} and {} stand at the same place; a spline has no direction between them",
                    leg + 1
                ));
            }
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
        if let Some(Camera { delay_steps, delay_spread_steps, .. }) = self.camera
            && delay_spread_steps > delay_steps
        {
            return Some(format!(
                "[camera] delay_spread_steps {delay_spread_steps} exceeds delay_steps {delay_steps}: a fix cannot arrive before it is \
                 made"
            ));
        }
        if let Some(Kicks { least_deg, most_deg, .. }) = self.kicks
            && least_deg > most_deg
        {
            return Some(format!("[kicks] least_deg {least_deg} exceeds most_deg {most_deg}"));
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
    #[serde(deserialize_with = "checks::laps")]
    pub laps: u32,
    #[serde(deserialize_with = "checks::positive")]
    pub side_m: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub turn_rate_rad_per_s: f64,
    /// Steps over which the speed ramps up and down at the ends of each side and turn.
    #[serde(deserialize_with = "checks::short_step_count")]
    pub ramp_steps: u32,
    /// Before the first lap.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_s: f64,
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_after_side_s: f64,
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_after_turn_s: f64,
    /// After the extra turn that ends a lap.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_after_lap_s: f64,
    /// Of the controller on a side: turn per step for each radian of heading error.
    #[serde(deserialize_with = "checks::non_negative")]
    pub heading_gain: f64,
    /// Of the controller on a side: turn per step for each metre of lateral error.
    #[serde(deserialize_with = "checks::non_negative")]
    pub lateral_gain_rad_per_m: f64,
    /// Limit of the controller's turn per step.
    #[serde(deserialize_with = "checks::non_negative")]
    pub most_turn_rad: f64,
}

/// A constant speed with the turn rate `amplitude sin(pulsation t)`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weave {
    #[serde(deserialize_with = "checks::positive")]
    pub duration_s: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    #[serde(deserialize_with = "checks::finite")]
    pub turn_amplitude_rad_per_s: f64,
    #[serde(deserialize_with = "checks::finite")]
    pub turn_pulsation_rad_per_s: f64,
}

/// Quintic splines through poses, driven without a stop at a trapezoidal speed.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spline {
    /// (x in m, y in m, heading in degrees).
    pub poses_m_deg: [[f64; 3]; 5],
    /// Length of the tangents at both ends of a leg, relative to its straight distance.
    #[serde(deserialize_with = "checks::positive")]
    pub tangent_scale: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub speed_m_per_s: f64,
    #[serde(deserialize_with = "checks::positive")]
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
    fn wrong_files_are_refused_with_the_reason() {
        for (name, from, to, reason) in [
            ("camera-10hz", "step_s = 0.05", "step_s = 0", "step_s"),
            ("camera-10hz", "laps = 4", "lapse = 4", "lapse"),
            ("camera-10hz", "speed_m_per_s = 0.2", "speed_m_per_s = 1e-5", "steps"),
            ("camera-10hz", "delay_spread_steps = 1", "delay_spread_steps = 7", "before it is made"),
            ("camera-10hz", "runs = 40", "runs = 0", "runs"),
            ("camera-10hz", "from_s = 0.0 ", "from_s = 400.0 ", "score_from_s"),
            ("camera-10hz", "wheel_radius_m = 0.028", "wheel_radius_m = nan", "wheel_radius_m"),
            ("kicks", "most_deg = 8.0", "most_deg = 1.0", "exceeds most_deg"),
            ("wpilib", "[-3.0, 0.0, -90.0]", "[-3.0, inf, -90.0]", "poses_m_deg"),
            ("wpilib", "[3.0, 0.0, -90.0]", "[0.0, 0.0, 90.0]", "poses 1 and 2"),
            ("paper-square", "per_s2 = 0.05", "per_s2 = 0", "sigma_m_per_s2"),
        ] {
            let (_, text) = SCENARIOS.iter().find(|(known, _)| *known == name).unwrap();
            assert!(text.contains(from), "{name} has no `{from}`");
            let message = Scenario::from_toml(&text.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(reason), "{to}: {message}");
        }
        let message = Scenario::bundled("camera-5hz").unwrap_err().to_string();
        assert!(message.contains("camera-5hz") && message.contains("paper-square"));
    }
}

//! A Monte-Carlo scenario, as its TOML file says it.
//!
//! There are no defaults for numbers: a file is the whole experiment. Only the tables `[camera]`, `[kicks]` and
//! `[accelerometer]` may be missing, and mean that there is none.

use serde::Deserialize;

use super::bundled::SCENARIOS;
use super::course::Course;
use crate::bundled::text_of;
use crate::checks::whole;
use crate::scenario::checks;

/// Most steps of one drive; ten times the longest bundled one.
pub(super) const MAX_STEPS: f64 = 100_000.0;

/// Most runs of a scenario.
pub const MAX_RUNS: u32 = 100_000;

/// One experiment: a path, a robot drawn anew in each run, its sensors, and the configuration of the filters.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Base seed; run i draws from this and i.
    pub seed: u64,
    /// How many runs make a good mean.
    #[serde(deserialize_with = "runs")]
    pub runs: u32,
    /// The grid of all events, in seconds.
    #[serde(deserialize_with = "checks::positive")]
    pub step_s: f64,
    /// The error counts from here on, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub score_from_s: f64,
    /// What is driven.
    pub path: Course,
    /// The robot as its maker describes it.
    pub robot: NominalRobot,
    /// How far the true robot is from that.
    pub errors: GeometryErrors,
    /// The noise of its motion.
    pub motion: MotionNoise,
    /// The gyro.
    pub gyro: Gyro,
    /// The camera; none without it.
    pub camera: Option<Camera>,
    /// Kicks that the encoders do not see; none without it.
    pub kicks: Option<Kicks>,
    /// Accelerometers at both wheels; none without it.
    pub accelerometer: Option<Accelerometer>,
    /// The configuration of the filters.
    pub told: PriorSettings,
}

/// The robot as its maker describes it: the nominal geometry.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NominalRobot {
    /// Radius of both wheels, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub wheel_radius_m: f64,
    /// Distance between the wheels, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub track_width_m: f64,
    /// Wheel rotation of one count, in degrees; a wheel's rotation is floored to it.
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
    /// Of the difference of the wheels' radii.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_difference_sigma: f64,
    /// Of the track width.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub track_scale_sigma: f64,
}

/// The noise of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionNoise {
    /// Of each wheel's travel, in metres per square root of a metre.
    #[serde(deserialize_with = "checks::non_negative")]
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Of the heading, in radians per square root of a radian of turn.
    #[serde(deserialize_with = "checks::non_negative")]
    pub turn_rad_per_sqrt_rad: f64,
}

/// The gyro: mean turn rate over the step, with bias and noise, rounded.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gyro {
    /// White noise of one observation, in degrees per second.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_deg_per_s: f64,
    /// Resolution, in degrees per second; 0 for none.
    #[serde(deserialize_with = "checks::non_negative")]
    pub resolution_deg_per_s: f64,
    /// Standard deviation of the bias at the start, in degrees per second.
    #[serde(deserialize_with = "checks::non_negative")]
    pub bias_sigma_deg_per_s: f64,
    /// Random walk of the bias, in degrees per second per square root of a second.
    #[serde(deserialize_with = "checks::non_negative")]
    pub bias_walk_deg_per_s_sqrt_s: f64,
}

/// What a camera measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraSees {
    /// Position and heading.
    Pose,
    /// The position alone.
    Position,
}

/// The camera.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// What it measures.
    pub sees: CameraSees,
    /// Number of steps from one image to the next.
    #[serde(deserialize_with = "count")]
    pub every_steps: u32,
    /// Number of steps from a fix's stamp to its arrival,
    #[serde(deserialize_with = "delay")]
    pub delay_steps: u32,
    /// more or less this number, each equally likely.
    #[serde(deserialize_with = "delay")]
    pub delay_spread_steps: u32,
    /// The configured noise of x and of y, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub position_sigma_m: f64,
    /// The configured noise of the heading, in degrees.
    #[serde(deserialize_with = "checks::positive")]
    pub heading_sigma_deg: f64,
    /// The true noise as a multiple of the noise that filters are configured with.
    #[serde(deserialize_with = "checks::non_negative")]
    pub true_noise_factor: f64,
    /// Fixes that are far off; none without it.
    pub outliers: Option<Outliers>,
    /// A time without fixes; none without it.
    pub blackout: Option<Blackout>,
}

/// Fixes that are far off.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outliers {
    /// Their share.
    #[serde(deserialize_with = "checks::probability")]
    pub probability: f64,
    /// Standard deviation of what is added to x and y, in metres, and to the heading, in radians.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_m_rad: f64,
}

/// A time without fixes, by their stamps; both ends belong to it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Blackout {
    /// Its first instant, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub from_s: f64,
    /// Its last instant, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub to_s: f64,
}

/// Kicks: the robot is turned while it drives straight, and its wheels do not measure it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kicks {
    /// Probability of one to begin, per second on a side.
    #[serde(deserialize_with = "checks::probability")]
    pub probability_per_s: f64,
    /// The weakest, in degrees, either way.
    #[serde(deserialize_with = "checks::non_negative")]
    pub least_deg: f64,
    /// The strongest, in degrees, either way.
    #[serde(deserialize_with = "checks::non_negative")]
    pub most_deg: f64,
    /// Number of steps of each.
    #[serde(deserialize_with = "count")]
    pub spread_steps: u32,
}

/// Accelerometers at both wheels: change of the wheel's speed over a step.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accelerometer {
    /// White noise of one observation, in metres per second squared; above zero, because filters are configured with it.
    #[serde(deserialize_with = "checks::positive")]
    pub sigma_m_per_s2: f64,
}

/// The geometry that filters are configured with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PriorGeometry {
    /// That of `[robot]`.
    Nominal,
    /// The true one of this run.
    True,
}

/// The configuration of the filters besides the noise of the sensors.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PriorSettings {
    /// Which geometry.
    pub geometry: PriorGeometry,
    /// Standard deviation of the error of the mean wheel radius; 0 for "take it as given".
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_scale_sigma: f64,
    /// The same for the difference of the radii.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub radius_difference_sigma: f64,
    /// The same for the track width.
    #[serde(deserialize_with = "checks::relative_sigma")]
    pub track_scale_sigma: f64,
    /// Noise of each wheel's travel, in metres per square root of a metre.
    #[serde(deserialize_with = "checks::non_negative")]
    pub wheel_travel_m_per_sqrt_m: f64,
    /// Noise of the heading, in radians per square root of a radian of turn.
    #[serde(deserialize_with = "checks::non_negative")]
    pub turn_rad_per_sqrt_rad: f64,
    /// Standard deviation of the start's x and y, in metres; the configured start is the true one.
    #[serde(deserialize_with = "checks::non_negative")]
    pub start_position_sigma_m: f64,
    /// Standard deviation of the start's heading, in radians.
    #[serde(deserialize_with = "checks::non_negative")]
    pub start_heading_sigma_rad: f64,
    /// The configured heading of the start is off by up to this, either way, each equally likely, in degrees.
    #[serde(deserialize_with = "checks::non_negative")]
    pub start_heading_off_deg: f64,
}

impl Scenario {
    /// Reads a scenario.
    ///
    /// # Errors
    /// [`ScenarioError::Toml`] names the line and the key that is unknown, missing, of the wrong type or out of its range;
    /// [`ScenarioError::Impossible`] says which numbers do not go together.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        let scenario: Self = toml::from_str(text).map_err(ScenarioError::Toml)?;
        scenario.check()?;
        Ok(scenario)
    }

    /// The bundled scenario of this name.
    ///
    /// # Errors
    /// [`ScenarioError::UnknownName`] lists the names that exist.
    pub fn bundled(name: &str) -> Result<Self, ScenarioError> {
        let text =
            text_of(SCENARIOS, name).map_err(|known| ScenarioError::UnknownName { name: name.to_owned(), known })?;
        Self::from_toml(text)
    }

    /// The same scenario under another base seed.
    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    fn check(&self) -> Result<(), ScenarioError> {
        if let Course::Spline(spline) = &self.path {
            let is_bearable = |value: &f64| value.abs() <= checks::LARGEST;
            if !spline.poses_m_deg.iter().flatten().all(is_bearable) {
                return Err(impossible("poses_m_deg holds a number that is not finite or too large".to_owned()));
            }
            if let Some(leg) = spline.leg_without_length() {
                return Err(impossible(format!(
                    "poses_m_deg: poses {leg} and {} stand at the same place; a spline has no direction between them",
                    leg + 1
                )));
            }
        }
        let steps = self.path.steps_estimate(self.step_s);
        if !(1.0..=MAX_STEPS).contains(&steps) {
            return Err(impossible(format!(
                "[path] takes {steps:.0} steps of {} s; give a path of 1 to {MAX_STEPS:.0} steps",
                self.step_s
            )));
        }
        if self.score_from_s >= steps * self.step_s {
            return Err(impossible(format!(
                "score_from_s {} lies behind the end of [path], about {:.1} s",
                self.score_from_s,
                steps * self.step_s
            )));
        }
        if let Some(camera) = &self.camera
            && camera.delay_spread_steps > camera.delay_steps
        {
            return Err(impossible(format!(
                "[camera] delay_spread_steps {} exceeds delay_steps {}: a fix cannot arrive before it is made",
                camera.delay_spread_steps, camera.delay_steps
            )));
        }
        if let Some(kicks) = &self.kicks
            && kicks.least_deg > kicks.most_deg
        {
            return Err(impossible(format!(
                "[kicks] least_deg {} exceeds most_deg {}",
                kicks.least_deg, kicks.most_deg
            )));
        }
        Ok(())
    }
}

fn impossible(reason: String) -> ScenarioError {
    ScenarioError::Impossible { reason }
}

/// Why a scenario cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// The text is not TOML, a key is unknown or missing, or a value does not fit; the message shows the line and the key.
    #[error("scenario is not usable: {0}")]
    Toml(toml::de::Error),
    /// The numbers do not go together.
    #[error("scenario is not usable: {reason}")]
    Impossible {
        /// Which, and why.
        reason: String,
    },
    /// No bundled scenario is called like this.
    #[error("no accuracy scenario is called \"{name}\"; there are {known}, or name a TOML file")]
    UnknownName {
        /// The name that was asked for.
        name: String,
        /// The names that exist, joined by commas.
        known: String,
    },
}

fn runs<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 1, MAX_RUNS)
}

/// At least one.
fn count<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 1, 100_000)
}

/// Under a minute at any sensible step: all fixes on their way are kept.
fn delay<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    whole(deserializer, 0, 1_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bundled scenario with some of its text replaced.
    fn changed(name: &str, from: &str, to: &str) -> Result<Scenario, ScenarioError> {
        let (_, text) = SCENARIOS.iter().find(|(known, _)| *known == name).unwrap();
        assert!(text.contains(from), "{name} has no `{from}`");
        Scenario::from_toml(&text.replace(from, to))
    }

    #[test]
    fn every_file_in_the_folder_is_bundled() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/scenarios/accuracy");
        let files = std::fs::read_dir(folder).unwrap();
        for file in files {
            let path = file.unwrap().path();
            let name = path.file_stem().unwrap().to_str().unwrap();
            assert!(SCENARIOS.iter().any(|(known, _)| *known == name), "{name} is not bundled");
        }
    }

    #[test]
    fn wrong_files_are_refused_with_the_reason() {
        let cases = [
            ("step_s = 0.05", "step_s = 0", "step_s"),
            ("laps = 4", "lapse = 4", "lapse"),
            ("speed_m_per_s = 0.2", "speed_m_per_s = 1e-5", "steps"),
            ("delay_spread_steps = 1", "delay_spread_steps = 7", "before it is made"),
            ("runs = 40", "runs = 0", "runs"),
            ("from_s = 0.0 ", "from_s = 400.0 ", "score_from_s"),
            ("wheel_radius_m = 0.028", "wheel_radius_m = nan", "wheel_radius_m"),
        ];
        for (from, to, reason) in cases {
            let message = changed("camera-10hz", from, to).unwrap_err().to_string();
            assert!(message.contains(reason), "{to}: {message}");
        }
        let message = changed("kicks", "most_deg = 8.0", "most_deg = 1.0").unwrap_err();
        assert!(message.to_string().contains("exceeds most_deg"));
        let message = changed("wpilib", "[-3.0, 0.0, -90.0]", "[-3.0, inf, -90.0]").unwrap_err();
        assert!(message.to_string().contains("poses_m_deg"));
        let message = changed("wpilib", "[3.0, 0.0, -90.0]", "[0.0, 0.0, 90.0]").unwrap_err();
        assert!(message.to_string().contains("poses 1 and 2"), "{message}");
        let message = changed("paper-square", "per_s2 = 0.05", "per_s2 = 0").unwrap_err();
        assert!(message.to_string().contains("sigma_m_per_s2"), "{message}");
        let message = Scenario::bundled("camera-5hz").unwrap_err().to_string();
        assert!(message.contains("camera-5hz") && message.contains("paper-square"));
    }
}

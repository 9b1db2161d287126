//! The scene before a wall, as its TOML file says it.
//!
//! There are no defaults: a file is the whole experiment.

use serde::Deserialize;

use crate::scenario::checks;

/// The scene of the paper.
pub const DEFAULT_SCENE: &str = include_str!("../../../config/scenarios/lab/wall.toml");

/// Longest step or approach, in turns of the control loop.
const MOST_TURNS: f64 = 1e6;

/// A car before a wall.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WallScene {
    /// Run i draws from this and i.
    pub seed: u64,
    /// The drive.
    pub car: CarSettings,
    /// The loop on board.
    pub control: ControlSettings,
    /// The range sensor.
    pub ranger: RangerSettings,
    /// The step test.
    pub step: StepSettings,
    /// The way to the wall.
    pub approach: ApproachSettings,
    /// The controller's gains.
    pub pid: Gains,
    /// The estimator on the other side of a link.
    pub host: HostSettings,
}

/// A first-order drive.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CarSettings {
    /// The PWM that counts as the input 1.
    #[serde(deserialize_with = "checks::positive")]
    pub reference_pwm: f64,
    /// The speed at which it settles under that, in m/s.
    #[serde(deserialize_with = "checks::positive")]
    pub steady_m_per_s: f64,
    /// Time from standstill to 90 % of that, in seconds.
    #[serde(deserialize_with = "checks::positive")]
    pub rise_90_s: f64,
}

/// The loop on board.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSettings {
    /// Its mean period, in seconds.
    #[serde(deserialize_with = "checks::positive")]
    pub period_s: f64,
    /// Each period differs by up to this share, either way, each equally likely.
    #[serde(deserialize_with = "share")]
    pub period_spread: f64,
}

/// The gains of the PID controller.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// By the error, PWM per metre.
    #[serde(deserialize_with = "checks::finite")]
    pub kp_pwm_per_m: f64,
    /// By its sum, PWM per metre and second.
    #[serde(deserialize_with = "checks::finite")]
    pub ki_pwm_per_m_s: f64,
    /// By its rate, PWM per m/s.
    #[serde(deserialize_with = "checks::finite")]
    pub kd_pwm_s_per_m: f64,
}

/// The time-of-flight sensor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangerSettings {
    /// Its mean period, in seconds.
    #[serde(deserialize_with = "checks::positive")]
    pub period_s: f64,
    /// Each period differs by up to this share, either way, each equally likely.
    #[serde(deserialize_with = "share")]
    pub period_spread: f64,
    /// Standard deviation of a reading at no distance, in metres.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_m: f64,
    /// What each metre of distance adds to that, in metres.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_share: f64,
    /// Probability of no reading.
    #[serde(deserialize_with = "checks::probability")]
    pub miss_probability: f64,
}

/// The step test: full drive from rest until a reading is below the cut-off.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepSettings {
    /// The PWM of the step.
    #[serde(deserialize_with = "checks::positive")]
    pub pwm: f64,
    /// Distance at rest, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub start_m: f64,
    /// Rest before the step, in seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_s: f64,
    /// The first reading below this ends the step, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub cutoff_m: f64,
}

/// The way to the wall.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachSettings {
    /// Distance at rest, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub start_m: f64,
    /// Where to stop, in metres.
    #[serde(deserialize_with = "checks::positive")]
    pub target_m: f64,
    /// Largest PWM, either way.
    #[serde(deserialize_with = "checks::positive")]
    pub most_pwm: f64,
    /// The car stands once it is as slow after it has been faster, in m/s.
    #[serde(deserialize_with = "checks::positive")]
    pub still_m_per_s: f64,
    /// An approach that does not end by itself ends here, in seconds.
    #[serde(deserialize_with = "checks::positive")]
    pub longest_s: f64,
    /// The sum of the errors stays within this, either way, in metre-seconds.
    #[serde(deserialize_with = "checks::non_negative")]
    pub integral_most_m_s: f64,
    /// By the error, of the controller that is tuned to the car, PWM per metre.
    #[serde(deserialize_with = "checks::positive")]
    pub tuned_kp_pwm_per_m: f64,
    /// Largest PWM, either way, of the fast approaches.
    #[serde(deserialize_with = "checks::positive")]
    pub fast_pwm: f64,
}

/// The estimator on the other side of a link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HostSettings {
    /// Number of turns of the brick's loop between two reports of its command.
    #[serde(deserialize_with = "turns")]
    pub report_every: u32,
    /// An estimate that is older stops the motors, in seconds.
    #[serde(deserialize_with = "checks::positive")]
    pub stale_after_s: f64,
}

impl WallScene {
    /// Reads a scene.
    ///
    /// # Errors
    /// [`SceneError::Toml`] names the line and the key that is unknown, missing, of the wrong type or out of its range;
    /// [`SceneError::Impossible`] says which numbers do not go together.
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        let scene: Self = toml::from_str(text).map_err(SceneError::Toml)?;
        scene.check()?;
        Ok(scene)
    }

    /// The same scene under another seed.
    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    fn check(&self) -> Result<(), SceneError> {
        let (step, approach) = (&self.step, &self.approach);
        for (start, start_m, end, end_m) in [
            ("[step] start_m", step.start_m, "cutoff_m", step.cutoff_m),
            ("[approach] start_m", approach.start_m, "target_m", approach.target_m),
        ] {
            if start_m <= end_m {
                return Err(impossible(format!(
                    "{start} {start_m} is not beyond {end} {end_m}; start further from the wall"
                )));
            }
        }
        let turns = approach.longest_s / self.control.period_s;
        if turns > MOST_TURNS {
            return Err(impossible(format!(
                "[approach] longest_s {} takes {turns:.0} turns of [control] period_s {}; give at most {MOST_TURNS:.0}",
                approach.longest_s, self.control.period_s
            )));
        }
        Ok(())
    }
}

fn impossible(reason: String) -> SceneError {
    SceneError::Impossible { reason }
}

/// Why a scene cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The text is not TOML, a key is unknown or missing, or a value does not fit; the message shows the line and the key.
    #[error("scene is not usable: {0}")]
    Toml(toml::de::Error),
    /// The numbers do not go together.
    #[error("scene is not usable: {reason}")]
    Impossible {
        /// Which, and what to do.
        reason: String,
    },
}

/// At most half, so that a period stays one.
fn share<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    crate::checks::within(deserializer, 0.0, 0.5)
}

fn turns<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let turns = u32::deserialize(deserializer)?;
    if (1..=1_000).contains(&turns) {
        Ok(turns)
    } else {
        Err(serde::de::Error::custom(format!("{turns} is outside 1 to 1000; give a number in that range")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error_with(from: &str, to: &str) -> String {
        assert!(DEFAULT_SCENE.contains(from), "{from}");
        let text = DEFAULT_SCENE.replace(from, to);
        WallScene::from_toml(&text).unwrap_err().to_string()
    }

    #[test]
    fn the_default_scene_reads_and_mistakes_are_named() {
        assert!(WallScene::from_toml(DEFAULT_SCENE).is_ok());
        let message = error_with("period_spread = 0.2", "period_spread = 0.7");
        assert!(message.contains("period_spread") && message.contains("0.5"), "{message}");
        let message = error_with("cutoff_m = 0.5", "cutoff_m = 3");
        assert!(message.contains("start further"), "{message}");
        let message = error_with("longest_s = 15.0", "longest_s = 1e5");
        assert!(message.contains("longest_s"), "{message}");
        let message = error_with("report_every = 4", "report_every = 0");
        assert!(message.contains("report_every"), "{message}");
        assert!(error_with("rest_s", "rests").contains("rests"));
    }
}

//! The TOML format of the wall scene.
//!
//! Keys have no defaults: a file describes the whole experiment.

use serde::Deserialize;

use crate::checks;
use crate::config_file::{ConfigFileError, from_toml};

/// The scene of paper 3.
pub const DEFAULT_SCENE: &str = include_str!("../../../config/scenarios/lab/wall.toml");

/// The kind of file in error messages.
const WHAT: &str = "scene";
/// Control cycles of the longest step or approach.
const MOST_TURNS: f64 = 1e6;

/// Car, sensor, controller and tasks of the wall experiments.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WallScene {
    /// Base seed; run i derives its own from it.
    pub seed: u64,
    pub car: CarSettings,
    pub control: ControlSettings,
    pub ranger: RangerSettings,
    pub step: StepSettings,
    pub approach: ApproachSettings,
    pub pid: Gains,
    pub host: HostSettings,
}

/// A first-order drive.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CarSettings {
    /// The PWM that the model takes as input 1.
    #[serde(deserialize_with = "checks::positive")]
    pub reference_pwm: f64,
    /// Steady-state speed at the reference PWM.
    #[serde(deserialize_with = "checks::positive")]
    pub steady_m_per_s: f64,
    /// Time from standstill to 90 % of the steady-state speed.
    #[serde(deserialize_with = "checks::positive")]
    pub rise_90_s: f64,
}

/// Period and jitter of the control loop on board.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSettings {
    #[serde(deserialize_with = "checks::positive")]
    pub period_s: f64,
    /// Uniform relative spread of each period, either way.
    #[serde(deserialize_with = "checks::period_spread")]
    pub period_spread: f64,
}

/// The gains of the PID controller.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    #[serde(deserialize_with = "checks::finite")]
    pub kp_pwm_per_m: f64,
    #[serde(deserialize_with = "checks::finite")]
    pub ki_pwm_per_m_s: f64,
    #[serde(deserialize_with = "checks::finite")]
    pub kd_pwm_s_per_m: f64,
}

/// Period and noise of the time-of-flight sensor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangerSettings {
    #[serde(deserialize_with = "checks::positive")]
    pub period_s: f64,
    /// Uniform relative spread of each period, either way.
    #[serde(deserialize_with = "checks::period_spread")]
    pub period_spread: f64,
    /// Of a reading at distance 0.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_m: f64,
    /// Increase of sigma per metre of distance.
    #[serde(deserialize_with = "checks::non_negative")]
    pub sigma_share: f64,
    #[serde(deserialize_with = "checks::probability")]
    pub miss_probability: f64,
}

/// The step test: full drive from rest until a reading is below the cut-off.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepSettings {
    #[serde(deserialize_with = "checks::positive")]
    pub pwm: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub start_m: f64,
    #[serde(deserialize_with = "checks::non_negative")]
    pub rest_s: f64,
    /// The first reading below this ends the step.
    #[serde(deserialize_with = "checks::positive")]
    pub cutoff_m: f64,
}

/// Start, target and limits of an approach to the wall.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachSettings {
    #[serde(deserialize_with = "checks::positive")]
    pub start_m: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub target_m: f64,
    /// Absolute value.
    #[serde(deserialize_with = "checks::positive")]
    pub most_pwm: f64,
    /// The car counts as standing at or below this speed after it has been faster.
    #[serde(deserialize_with = "checks::positive")]
    pub still_m_per_s: f64,
    #[serde(deserialize_with = "checks::positive")]
    pub longest_s: f64,
    /// Limit of the integral of the error, absolute value.
    #[serde(deserialize_with = "checks::non_negative")]
    pub integral_most_m_s: f64,
    /// Proportional gain of the controller that is tuned to the car.
    #[serde(deserialize_with = "checks::positive")]
    pub tuned_kp_pwm_per_m: f64,
    /// Largest absolute PWM of the fast approaches.
    #[serde(deserialize_with = "checks::positive")]
    pub fast_pwm: f64,
}

/// The estimator on a host behind a link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HostSettings {
    /// Number of control cycles between two reports of the brick's command.
    #[serde(deserialize_with = "checks::loop_turns")]
    pub report_every: u32,
    /// The motors stop when the estimate is older.
    #[serde(deserialize_with = "checks::positive")]
    pub stale_after_s: f64,
}

impl WallScene {
    /// Reads a scene. An error names the line and the key that is unknown, missing, of the wrong type or out of range, or the numbers
    /// that contradict each other.
    pub fn from_toml(text: &str) -> Result<Self, ConfigFileError> {
        let scene: Self = from_toml(WHAT, text)?;
        match scene.contradiction() {
            None => Ok(scene),
            Some(reason) => Err(ConfigFileError::Impossible { what: WHAT, reason }),
        }
    }

    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Numbers that contradict each other, and why.
    fn contradiction(&self) -> Option<String> {
        let (step, approach) = (&self.step, &self.approach);
        for (start, start_m, end, end_m) in [
            ("[step] start_m", step.start_m, "cutoff_m", step.cutoff_m),
            ("[approach] start_m", approach.start_m, "target_m", approach.target_m),
        ] {
            if start_m <= end_m {
                return Some(format!("{start} {start_m} is not beyond {end} {end_m}; start further from the wall"));
            }
        }
        let turns = approach.longest_s / self.control.period_s;
        (turns > MOST_TURNS).then(|| {
            format!(
                "[approach] longest_s {} takes {turns:.0} turns of [control] period_s {}; give at most {MOST_TURNS:.0}",
                approach.longest_s, self.control.period_s
            )
        })
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

//! The TOML format of the wall scene. Keys have no defaults: a file describes the whole experiment.

use serde::Deserialize;

use crate::config_file::{ConfigFileError, from_toml};

/// The scene of paper 3.
pub const DEFAULT_SCENE: &str = include_str!("../../../config/scenarios/lab/wall.toml");

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

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CarSettings {
    /// The PWM that the model takes as input 1.
    pub reference_pwm: f64,
    /// Steady-state speed at the reference PWM.
    pub steady_m_per_s: f64,
    /// Time from standstill to 90 % of the steady-state speed.
    pub rise_90_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSettings {
    pub period_s: f64,
    /// Uniform relative spread of each period, either way.
    pub period_spread: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    pub kp_pwm_per_m: f64,
    pub ki_pwm_per_m_s: f64,
    pub kd_pwm_s_per_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangerSettings {
    pub period_s: f64,
    /// Uniform relative spread of each period, either way.
    pub period_spread: f64,
    /// Of a reading at distance 0.
    pub sigma_m: f64,
    /// Increase of sigma per metre of distance.
    pub sigma_share: f64,
    pub miss_probability: f64,
}

/// The step test: full drive from rest until a reading is below the cut-off.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepSettings {
    pub pwm: f64,
    pub start_m: f64,
    pub rest_s: f64,
    /// The first reading below this ends the step.
    pub cutoff_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachSettings {
    pub start_m: f64,
    pub target_m: f64,
    /// Absolute value.
    pub most_pwm: f64,
    /// The car counts as standing at or below this speed after it has been faster.
    pub still_m_per_s: f64,
    pub longest_s: f64,
    /// Limit of the integral of the error, absolute value.
    pub integral_most_m_s: f64,
    /// Proportional gain of the controller that is tuned to the car.
    pub tuned_kp_pwm_per_m: f64,
    /// Largest absolute PWM of the fast approaches.
    pub fast_pwm: f64,
}

/// The estimator on a host behind a link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HostSettings {
    /// Number of control cycles between two reports of the brick's command.
    pub report_every: u32,
    /// The motors stop when the estimate is older.
    pub stale_after_s: f64,
}

impl WallScene {
    /// Reads a scene. An error names the line and the key that is unknown, missing, of the wrong type or out of range, or the numbers
    /// that contradict each other.
    pub fn from_toml(text: &str) -> Result<Self, ConfigFileError> {
        from_toml("scene", text, Self::contradiction)
    }

    pub const fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

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

//! Simulated step tests and what is found from them.

use anyhow::{Context, Result};
use posebridge_analysis::wall::{
    GateTrial, HandStep, KalmanNoise, Said, StepFit, Validation, WallEntry, WallLog, by_hand, fit_steps, gate_trial,
    validate,
};
use posebridge_estimator::filters::range_kf::Variant;
use posebridge_estimator::models::wall_approach::WallApproach;
use posebridge_sim::wall::{StepRun, WallScene, step};

/// Readings in a line of the evaluation by hand.
pub(in crate::commands) const PIECE: usize = 5;
/// What is added to a reading to try the gate, m.
const ADDED_M: [f64; 4] = [0.1, 0.2, 0.4, 0.8];
/// The process sigmas that are compared, m: the paper's three and the noise of its readings.
const PROCESS_M: [f64; 4] = [0.01, 0.02, 0.05, 0.5];

/// The step tests of a scene.
pub(super) struct Steps {
    /// The drive as the scene has it.
    pub(super) truth: WallApproach,
    /// The first step.
    pub(super) first: StepRun,
    /// Its readings and inputs.
    pub(super) log: WallLog,
    /// By hand, of each step that could be evaluated.
    pub(super) by_hand: Vec<HandStep>,
    /// From the first step alone.
    pub(super) one: StepFit,
    /// From all steps.
    pub(super) all: StepFit,
    /// The filter on the first step's readings.
    pub(super) validations: Vec<Validated>,
    /// Readings made wrong on purpose.
    pub(super) gate: Vec<GateTrial>,
}

/// The filter on the readings of a step, with a process sigma.
pub(super) struct Validated {
    pub(super) process_m: f64,
    pub(super) variant: Variant,
    pub(super) found: Validation,
}

/// Drives and evaluates so many steps.
pub(super) fn steps(scene: &WallScene, count: u32) -> Result<Steps> {
    let runs: Vec<StepRun> = (0..count).map(|run| step(scene, run)).collect();
    let logs: Vec<WallLog> = runs.iter().map(|run| log_of(scene, run)).collect();
    let first = runs.into_iter().next().context("there is no step")?;
    let log = logs.first().cloned().unwrap_or_default();
    let one = fit_steps(std::slice::from_ref(&log)).context("evaluating the first step")?;
    let all = fit_steps(&logs).context("evaluating the steps")?;
    let trials = |added_m: &f64| {
        let middle = log.readings().count() * 2 / 3;
        let how = (all.model(), KalmanNoise::PAPER, Variant::Paper);
        gate_trial(&log, how, (middle, *added_m))
    };
    let validations = PROCESS_M.iter().flat_map(|&process_m| {
        let (log, model) = (&log, all.model());
        [Variant::Paper, Variant::Corrected].map(|variant| Validated {
            process_m,
            variant,
            found: validate(log, model, KalmanNoise { process_m, ..KalmanNoise::PAPER }, variant),
        })
    });
    Ok(Steps {
        truth: WallApproach::from_step_test(scene.car.steady_m_per_s, scene.car.rise_90_s),
        first,
        validations: validations.collect(),
        gate: ADDED_M.iter().filter_map(trials).collect(),
        by_hand: logs.iter().filter_map(|log| by_hand(log, PIECE).ok()).collect(),
        one,
        all,
        log,
    })
}

/// Inputs count from the PWM that the scene calls 1.
pub(in crate::commands) fn log_of(scene: &WallScene, run: &StepRun) -> WallLog {
    let inputs = run
        .commands
        .iter()
        .map(|command| WallEntry { at_s: command.at_s, said: Said::Input(command.pwm / scene.car.reference_pwm) });
    let readings =
        run.readings.iter().map(|reading| WallEntry { at_s: reading.at_s, said: Said::Range(reading.range_m) });
    WallLog::new(inputs.chain(readings).collect())
}

//! The step tests of the simulated car, and what follows from them.

use anyhow::{Context, Result};
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_lab::wall::{
    GateTrial, KalmanNoise, ManualStepFit, PIECE, StepFit, Validation, WallEntry, WallLog, WallReading, fit_by_hand,
    fit_steps, gate_trial, validate_model,
};
use posebridge_sim::wall::{StepRun, WallScene, simulate_step};

/// Errors added to a reading to test the gate.
const ADDED_M: [f64; 4] = [0.1, 0.2, 0.4, 0.8];
/// Compared process sigmas: the paper's three and the noise of its readings.
const PROCESS_M: [f64; 4] = [0.01, 0.02, 0.05, 0.5];

pub(super) struct StepResults {
    pub(super) truth: WallApproachModel,
    pub(super) first: StepRun,
    pub(super) log: WallLog,
    pub(super) by_hand: Vec<ManualStepFit>,
    pub(super) one: StepFit,
    pub(super) all: StepFit,
    pub(super) validations: Vec<ValidationCase>,
    pub(super) gate: Vec<GateTrial>,
}

pub(super) struct ValidationCase {
    pub(super) process_m: f64,
    pub(super) variant: RangeFilterVariant,
    pub(super) validation: Validation,
}

pub(super) fn steps(scene: &WallScene, count: u32) -> Result<StepResults> {
    let runs: Vec<StepRun> = (0..count).map(|run| simulate_step(scene, run)).collect();
    let logs: Vec<WallLog> = runs.iter().map(|run| log_of(scene, run)).collect();
    let first = runs.into_iter().next().context("there is no step")?;
    let log = logs.first().cloned().unwrap_or_default();
    let one = fit_steps(std::slice::from_ref(&log)).context("evaluating the first step")?;
    let all = fit_steps(&logs).context("evaluating the steps")?;
    let trials = |added_m: &f64| {
        let middle = log.readings().count() * 2 / 3;
        gate_trial(&log, all.model(), KalmanNoise::PAPER, RangeFilterVariant::Paper, middle, *added_m)
    };
    let validations = PROCESS_M.iter().flat_map(|&process_m| {
        let (log, model) = (&log, all.model());
        [RangeFilterVariant::Paper, RangeFilterVariant::Corrected].map(|variant| ValidationCase {
            process_m,
            variant,
            validation: validate_model(log, model, KalmanNoise { process_m, ..KalmanNoise::PAPER }, variant),
        })
    });
    Ok(StepResults {
        truth: WallApproachModel::from_step_test(scene.car.steady_m_per_s, scene.car.rise_90_s),
        first,
        validations: validations.collect(),
        gate: ADDED_M.iter().filter_map(trials).collect(),
        by_hand: logs.iter().filter_map(|log| fit_by_hand(log, PIECE).ok()).collect(),
        one,
        all,
        log,
    })
}

/// Inputs are relative to the scene's reference PWM.
pub(in crate::lab) fn log_of(scene: &WallScene, run: &StepRun) -> WallLog {
    let inputs = run.commands.iter().map(|command| WallEntry {
        at_s: command.at_s,
        reading: WallReading::Input(command.pwm / scene.car.reference_pwm),
    });
    let readings = run
        .readings
        .iter()
        .map(|reading| WallEntry { at_s: reading.at_s, reading: WallReading::Range(reading.range_m) });
    WallLog::new(inputs.chain(readings).collect())
}

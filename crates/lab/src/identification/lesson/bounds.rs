//! Whether the bounds hold: how often the final value is within 95 %, over many runs, if the dynamics are known, taken for known,
//! or identified.

use super::super::expectation::{ExpectedDynamics, StepDirection};
use super::super::prediction::{BOUND_RATE, predict_once};
use super::super::sensor_kind::{RunSimilarity, SensorKind};
use super::super::simulated::{SimulatedSensor, step_input};
use super::super::step::{ModelOrder, StepOptions, identify_step};
use super::section::{LessonSection, header};

const TAU_S: f64 = 5.0;
const SIGMA_K: f64 = 0.1;
const PERIOD_S: f64 = 0.25;
const DIPPED_S: f64 = 5.0;
/// The step that the sensor is identified by is small, the one that it is used for is large: what is not known about tau then counts.
const IDENTIFICATION_STEP: (f64, f64) = (20.0, 18.0);
const PREDICTED_STEP: (f64, f64) = (20.0, 4.0);
/// Seconds after the step at which the bound is looked at: half a time constant, one, and two.
const CHECKED_AT_S: [f64; 3] = [2.5, 5.0, 10.0];
/// What is known about the dynamics.
const METHODS: [&str; 3] = ["known", "taken_for_known", "identified"];

/// What one run has shown: for each instant and method whether the final value was within the bound; `None` where there was no bound.
pub type BoundRun = [[Option<bool>; 3]; 3];

/// Identifies the sensor by one noisy step and predicts the end of another.
pub fn bound_run(seed: u64) -> BoundRun {
    let sensor = SimulatedSensor::first_order(TAU_S, SIGMA_K, PERIOD_S);
    let count = |until_s: f64| (until_s / PERIOD_S) as usize + 1;
    let teaching = sensor.run(
        seed.wrapping_mul(2),
        count(40.0),
        step_input(IDENTIFICATION_STEP.0, IDENTIFICATION_STEP.1, DIPPED_S),
    );
    let options = StepOptions { order: ModelOrder::Fixed(1), ..StepOptions::with_sigma(SIGMA_K) };
    let identified = identify_step(&teaching, &options).ok();
    let found_s = identified.as_ref().and_then(|found| Some(found.lags().first()?.time_constant_s));
    let kind = identified.and_then(|found| SensorKind::from_runs(&[found], RunSimilarity::SameDynamics).ok());
    let expectations = [
        ExpectedDynamics::known(&[(TAU_S, 1.0)]),
        found_s.and_then(|tau_s| ExpectedDynamics::known(&[(tau_s, 1.0)])),
        kind.and_then(|kind| kind.expectation(StepDirection::Down)),
    ];
    let samples = sensor.run(
        seed.wrapping_mul(2).wrapping_add(1),
        count(DIPPED_S + CHECKED_AT_S[2]),
        step_input(PREDICTED_STEP.0, PREDICTED_STEP.1, DIPPED_S),
    );
    CHECKED_AT_S.map(|since_s| {
        let so_far = samples.get(..count(DIPPED_S + since_s)).unwrap_or_default();
        expectations.each_ref().map(|expectation| {
            let (low, high) = predict_once(so_far, SIGMA_K, expectation.as_ref()?)?.bound();
            Some(low <= PREDICTED_STEP.1 && PREDICTED_STEP.1 <= high)
        })
    })
}

/// How often bounds held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoundTally {
    /// Runs with a bound.
    pub runs: u32,
    /// Of these, runs whose bound contained the final value.
    pub inside: u32,
}

impl BoundTally {
    /// The share of bounds that held; `None` without runs.
    pub fn rate(&self) -> Option<f64> {
        (self.runs > 0).then(|| f64::from(self.inside) / f64::from(self.runs))
    }
}

/// The section from all runs.
pub fn bounds_section(runs: &[BoundRun]) -> LessonSection {
    let count = runs.len().max(1) as f64;
    // Two standard deviations of a share of this number of runs.
    let half = 1.96 * (BOUND_RATE * (1.0 - BOUND_RATE) / count).sqrt();
    let mut section = LessonSection {
        name: "bounds",
        title: "Do the bounds hold?".to_owned(),
        paragraphs: vec![format!(
            "{} runs. The sensor (5 s) is identified by a step of 2 K with a noise of 0.1 K, and then used for a step of 16 K. The 95 % bound should contain the end in 95 % of the runs, give or take \
             {:.1} %. Taken for known, the identified time constant gives bounds that are too narrow; with what the identification says about its own error they hold.",
            runs.len(),
            100.0 * half
        )],
        header: header(&[
            "time constants since the step",
            "known",
            "identified, taken for known",
            "identified, with its sigma",
        ]),
        ..LessonSection::default()
    };
    for (at, since_s) in CHECKED_AT_S.into_iter().enumerate() {
        let time_constants = since_s / TAU_S;
        let mut cells = vec![format!("{time_constants}")];
        for (method, name) in METHODS.into_iter().enumerate() {
            let answers = runs.iter().filter_map(|run| run[at][method]);
            let tally = answers.fold(BoundTally::default(), |tally, held| BoundTally {
                runs: tally.runs + 1,
                inside: tally.inside + u32::from(held),
            });
            let cell = tally.rate().map_or_else(String::new, |rate| format!("{:.1} %", 100.0 * rate));
            cells.push(cell);
            section.record_value(format!("{name}_rate_at_{time_constants}"), tally.rate());
        }
        section.rows.push(cells);
    }
    section.record_value("half_width", half);
    section
}

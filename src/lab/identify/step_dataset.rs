//! The steps that are looked at.

use posebridge_lab::identification::{Sampling, StepOptions, TimedSample};

/// What is looked at.
pub(super) struct StepDataset {
    /// For people.
    pub(super) source: String,
    /// The sensor.
    pub(super) sensor: String,
    /// Its unit; empty where it is not known.
    pub(super) unit: &'static str,
    /// That of its gain; empty where it is not known.
    pub(super) gain_unit: &'static str,
    /// The steps.
    pub(super) runs: Vec<StepRun>,
}

/// One step.
#[derive(Clone)]
pub(super) struct StepRun {
    pub(super) name: String,
    /// In seconds after the first sample.
    pub(super) samples: Vec<TimedSample>,
    pub(super) options: StepOptions,
    pub(super) sampling: Sampling,
    /// Of a simulated sensor.
    pub(super) truth: Option<StepTruth>,
}

/// What is true of a simulated sensor.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StepTruth {
    pub(super) gain: f64,
    pub(super) delay_s: f64,
    /// Time constants in seconds with their shares, the fastest first.
    pub(super) lags: Vec<(f64, f64)>,
}

//! Figures, metrics and tables from outside: whole documents over any run, statistics over seeded draws, tables letter by letter.

mod charts;
mod consistency;
mod metrics;
mod sample_run;
mod tables;

use posebridge_telemetry::{FusionOutcome, FusionRecord, SensorId, TimeDelta, Timestamp};

/// A record of two degrees of freedom.
fn record(sensor: SensorId, outcome: FusionOutcome, nis: f64) -> FusionRecord {
    FusionRecord {
        sensor,
        kind: "fix",
        stamp: Timestamp::ZERO,
        lag: TimeDelta::ZERO,
        outcome,
        innovation: [0.0; 3],
        innovation_covariance: [[0.0; 3]; 3],
        nis,
        degrees_of_freedom: 2,
        log_likelihood: 0.0,
    }
}

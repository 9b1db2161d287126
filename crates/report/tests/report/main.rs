//! Figures, metrics and tables from outside: whole documents over any run, statistics over seeded draws, tables letter by letter.

mod charts;
mod consistency;
mod metrics;
mod sample_run;
mod setup_checklist;
mod tables;

use posebridge_telemetry::{FusionOutcome, FusionRecord, SensorId, Timestamp};

/// A record of two degrees of freedom.
fn record(sensor: SensorId, outcome: FusionOutcome, nis: f64) -> FusionRecord {
    FusionRecord { nis, degrees_of_freedom: 2, ..FusionRecord::new(sensor, "fix", Timestamp::ZERO, outcome) }
}

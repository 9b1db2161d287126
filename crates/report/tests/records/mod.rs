//! What a filter told of one observation, as the tables and the metrics take it.

use posebridge_telemetry::{FusionOutcome, FusionRecord, SensorId, TimeDelta, Timestamp};

/// A record of two degrees of freedom.
pub(crate) fn record(sensor: SensorId, verdict: FusionOutcome, nis: f64) -> FusionRecord {
    FusionRecord {
        sensor,
        kind: "fix",
        stamp: Timestamp::ZERO,
        lag: TimeDelta::ZERO,
        outcome: verdict,
        innovation: [0.0; 3],
        innovation_covariance: [[0.0; 3]; 3],
        nis,
        degrees_of_freedom: 2,
        log_likelihood: 0.0,
    }
}

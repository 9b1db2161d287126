//! One run, one file: its rows in, its observations out.

use posebridge_recording::dataset::DatasetRun;
use posebridge_telemetry::ObservationKind;

use super::inline::{parse, try_load};

/// Loads the one run of a descriptor from `data.csv`.
pub(crate) fn load_rows(rest: &str, rows: &str) -> DatasetRun {
    try_load(&parse(rest), "only", &[("data.csv", rows)]).unwrap_or_else(|error| panic!("{error}"))
}

/// The stamps in nanoseconds and what was observed then.
pub(crate) fn observation_kinds(run: &DatasetRun) -> Vec<(i64, ObservationKind)> {
    let observations = run.observations.iter().map(|timed| timed.observation);
    observations.map(|observation| (observation.stamp.as_nanos(), observation.measurement)).collect()
}

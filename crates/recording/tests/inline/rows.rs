//! One run, one file: its rows in, its observations out.

use posebridge_recording::dataset::Run;
use posebridge_telemetry::Observed;

use super::inline::{parse, try_load};

/// Loads the one run of a descriptor from `data.csv`.
pub(crate) fn load_rows(rest: &str, rows: &str) -> Run {
    try_load(&parse(rest), "only", &[("data.csv", rows)]).unwrap_or_else(|error| panic!("{error}"))
}

/// The stamps in nanoseconds and what was observed then.
pub(crate) fn observed(run: &Run) -> Vec<(i64, Observed)> {
    let observations = run.observations.iter().map(|timed| timed.observation);
    observations.map(|observation| (observation.stamp.as_nanos(), observation.observed)).collect()
}

//! Descriptors: what the runs of a foreign recording hold, by kind of observation.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Result;
use posebridge_recording::dataset::TimedObservation;
use posebridge_telemetry::{BrickClock, TimeDelta, Timestamp};

use crate::flags::DataFlags;
use crate::tools::dataset::DataSet;

/// One run.
pub(super) struct RunFacts {
    /// Its name.
    pub(super) name: String,
    /// By kind and sensor.
    pub(super) observations: Vec<(String, Series)>,
    /// Poses of an instrument of its own.
    pub(super) truth: usize,
    /// Fixes that are kept from the filter.
    pub(super) withheld: usize,
    /// Rows that could not be used, by reason.
    pub(super) bad_rows: Vec<(&'static str, u64)>,
}

/// Observations of one kind and sensor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Series {
    /// How many.
    pub(super) count: u64,
    /// Stamp of the first.
    pub(super) first: Timestamp<BrickClock>,
    /// Stamp of the last.
    pub(super) last: Timestamp<BrickClock>,
    /// The longest time between two of them.
    pub(super) longest_gap: TimeDelta,
}

impl Series {
    /// Observations per second; `None` of fewer than two.
    pub(super) fn rate_hz(&self) -> Option<f64> {
        let elapsed_s = (self.last - self.first).as_secs_f64();
        (self.count > 1 && elapsed_s > 0.0).then(|| (self.count - 1) as f64 / elapsed_s)
    }
}

/// Inspects the runs of a descriptor that the flags choose.
///
/// # Errors
/// As loading them.
pub(super) fn inspect(path: &Path, flags: &DataFlags) -> Result<Vec<RunFacts>> {
    let data = DataSet::open(path, flags)?;
    let runs = data.runs.iter().map(|name| {
        let run = data.load(name, flags)?.run;
        let counts = run.bad_rows.counts.iter();
        Ok(RunFacts {
            name: name.clone(),
            observations: series_of(&run.observations),
            truth: run.truth.len(),
            withheld: run.withheld.len(),
            bad_rows: counts.map(|(reason, count)| (reason.name(), *count as u64)).collect(),
        })
    });
    runs.collect()
}

fn series_of(observations: &[TimedObservation]) -> Vec<(String, Series)> {
    let mut series: BTreeMap<String, Series> = BTreeMap::new();
    for timed in observations {
        let observation = &timed.observation;
        let (kind, sensor) = (observation.measurement.kind(), observation.sensor);
        let name = if sensor.name() == kind { kind.to_owned() } else { format!("{kind} ({} {sensor})", sensor.name()) };
        let stamp = observation.stamp;
        let one =
            series.entry(name).or_insert(Series { count: 0, first: stamp, last: stamp, longest_gap: TimeDelta::ZERO });
        one.count += 1;
        one.longest_gap = one.longest_gap.max(stamp - one.last);
        one.last = one.last.max(stamp);
    }
    series.into_iter().collect()
}

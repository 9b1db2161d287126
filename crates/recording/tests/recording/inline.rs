//! Descriptors and files written inside the tests.

use std::path::Path;

use posebridge_recording::dataset::{DatasetRun, Descriptor, LoadError, LoadOptions, load};
use posebridge_telemetry::{DriveGeometry, Meters, ObservationKind, Radians};

/// Wheels of 10 cm and 5 cm radius, half a metre apart, a tick of 0.1 rad: numbers that are easy to follow.
pub(crate) const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(0.1),
    right_wheel_radius: Meters(0.05),
    track_width: Meters(0.5),
    tick: Radians(0.1),
};

/// The keys that every descriptor has, with one run and one file `data.csv` whose first column is the time.
pub(crate) fn descriptor_text(rest: &str) -> String {
    format!(
        r#"
name = "inline"
source = "written by hand"
licence = "none"
default_run = "only"

[[runs]]
name = "only"

[files.data]
path = "data.csv"
time = {{ column = 0 }}
{rest}"#
    )
}

pub(crate) fn parse(rest: &str) -> Descriptor {
    Descriptor::from_toml(&descriptor_text(rest)).unwrap_or_else(|error| panic!("{error}"))
}

pub(crate) fn try_load(descriptor: &Descriptor, run: &str, files: &[(&str, &str)]) -> Result<DatasetRun, LoadError> {
    let mut open = |path: &Path| {
        let found = files.iter().find(|(name, _)| Path::new(name) == path);
        let missing = || std::io::Error::from(std::io::ErrorKind::NotFound);
        found.map(|(_, text)| text.as_bytes().to_vec()).ok_or_else(missing)
    };
    let options = LoadOptions { run, geometry: GEOMETRY, use_every: None };
    load(descriptor, options, &mut open)
}

/// Loads the one run of a descriptor from `data.csv`.
pub(crate) fn load_rows(rest: &str, rows: &str) -> DatasetRun {
    try_load(&parse(rest), "only", &[("data.csv", rows)]).unwrap_or_else(|error| panic!("{error}"))
}

/// The stamps in nanoseconds and what was observed then.
pub(crate) fn observation_kinds(run: &DatasetRun) -> Vec<(i64, ObservationKind)> {
    let observations = run.observations.iter().map(|timed| timed.observation);
    observations.map(|observation| (observation.stamp.as_nanos(), observation.measurement)).collect()
}

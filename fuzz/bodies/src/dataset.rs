//! Loads a descriptor whose one file is in memory.

use std::io::Cursor;
use std::path::Path;

use posebridge_recording::dataset::{DatasetRun, Descriptor, LoadError, LoadOptions, load};
use posebridge_telemetry::{DriveGeometry, Meters, Radians, Wiring};

const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(1.0),
    right_wheel_radius: Meters(1.0),
    track_width: Meters(1.0),
    tick: Radians(1.0),
};

/// The text of the descriptor is the program's own, whatever the file is.
///
/// # Panics
/// The descriptor is refused.
pub(crate) fn load_file(descriptor: &str, run: &str, file: &[u8]) -> Result<DatasetRun, LoadError> {
    let descriptor = match Descriptor::from_toml(descriptor) {
        Ok(descriptor) => descriptor,
        Err(error) => panic!("{error} in {descriptor}"),
    };
    let options = LoadOptions { run, geometry: GEOMETRY, wiring: Wiring::default(), use_every: None };
    load(&descriptor, options, &mut |_: &Path| Ok(Box::new(Cursor::new(file.to_vec()))))
}

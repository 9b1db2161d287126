//! Detection of tags in drawn pictures.
#![expect(clippy::unwrap_used, reason = "helpers outside the test functions may fail loudly as well")]

/// A file and what the foreign program decodes from it.
macro_rules! recorded {
    ($name:literal, $kind:literal) => {
        (
            include_bytes!(concat!("../data/recorded/", $name, ".", $kind)).as_slice(),
            include_bytes!(concat!("../data/recorded/", $name, ".grey")).as_slice(),
        )
    };
}

mod avi;
mod calibration;
mod corner_accuracy;
mod detection;
mod drawing;
mod floor;
mod picture_times;
mod recorded;
mod still;
mod stream;
mod y4m;

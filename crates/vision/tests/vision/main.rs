//! Detection of tags in drawn pictures.
#![expect(clippy::unwrap_used, reason = "helpers outside the test functions may fail loudly as well")]

mod calibration;
mod corner_accuracy;
mod detection;
mod drawing;
mod floor;
mod stream;

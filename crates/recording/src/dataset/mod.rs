//! Foreign recordings: CSV-like files, converted to our units, coordinate frames and times.
//!
//! A [`Descriptor`] (`config/recordings/*.toml`, docs/recordings.md) gives the meaning of each column of each file;
//! [`load`] reads one run into a [`DatasetRun`]. The caller opens the files. Bad rows are counted and named, never
//! fatal. This module filters and resamples nothing; the descriptor's `[robot]` table is passed on unread.

mod bad_rows;
mod column;
mod decimal;
mod descriptor;
mod error;
mod geodetic;
mod load;
mod run;
mod schema;
mod start;
mod streams;
mod table;

pub use bad_rows::{BadRow, BadRowReason, BadRows};
pub use descriptor::{Descriptor, DescriptorError};
pub use error::LoadError;
pub use load::{LoadOptions, load};
pub use run::{DatasetRun, StartPose, TimedObservation, TruthPose, WithheldFix};

//! Foreign recordings: CSV-like files, converted to our units, coordinate frames and times.
//!
//! A [`Descriptor`] (`config/recordings/*.toml`, docs/recordings.md) defines the meaning of each column of each file; [`load`] reads
//! one run into a [`DatasetRun`]. The caller opens the files. Bad rows are counted and listed, never fatal. This module filters and
//! resamples nothing; the descriptor's `[robot]` table is passed on unread.

mod column;
mod decimal_time;
mod descriptor;
mod load;
mod observation_list;
mod run;
mod schema;
mod streams;
mod table;

pub use descriptor::{Descriptor, DescriptorError};
pub use load::{LoadOptions, OpenFile, load};
pub use observation_list::{ObservationList, TimedObservation};
pub use run::{BadRow, BadRowReason, BadRows, DatasetRun, LoadError, TruthPose, WithheldFix};

//! Foreign recordings: CSV-like files of other people, brought into our units, spaces and times.
//!
//! A [`Descriptor`] (`config/recordings/*.toml`, docs/recordings.md) says which column of which file means what;
//! [`load`] reads one run into a [`Run`]. The caller opens the files. Rows that make no sense are counted and named,
//! never fatal. This module filters nothing, resamples nothing and knows no robot: the descriptor's `[robot]` table is
//! handed on as it stands.

mod bad_rows;
mod column;
mod decimal;
mod descriptor;
mod geodetic;
mod load;
mod run;
mod schema;
mod start;
mod streams;
mod table;

pub use bad_rows::{BadRow, BadRows, Reason};
pub use descriptor::{Descriptor, DescriptorError};
pub use load::{LoadError, LoadOptions, load};
pub use run::{Run, StartPose, Timed, TruthPose, Withheld};

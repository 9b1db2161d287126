//! Samples of one sensor from a table (*.csv): a column with the time and one with the value.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_lab::identification::{TimedSample, sorted_by_time};

use crate::console::print_line;
use crate::tools::csv_table::CsvTable;
use crate::tools::dataset::report_skipped;

/// Flags that choose the columns of a table.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct SampleColumns {
    /// Column of a table (*.csv) with the time [default: the first].
    #[arg(long, value_name = "NAME")]
    pub time_column: Option<String>,
    /// Unit of that column [default: s].
    #[arg(long, value_enum)]
    pub time_unit: Option<TimeUnit>,
    /// Column of the table with the value [default: the second].
    #[arg(long, value_name = "NAME")]
    pub value_column: Option<String>,
}

/// The unit of a column of times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
}

impl TimeUnit {
    const fn seconds(self) -> f64 {
        match self {
            Self::S => 1.0,
            Self::Ms => 1e-3,
            Self::Us => 1e-6,
        }
    }
}

/// A table of samples.
pub(super) struct SampleTable {
    /// Name of the column with the values.
    pub(super) value_column: String,
    /// In the order of time.
    pub(super) samples: Vec<TimedSample>,
}

impl SampleColumns {
    pub(super) const fn is_default(&self) -> bool {
        self.time_column.is_none() && self.time_unit.is_none() && self.value_column.is_none()
    }

    /// Says which rows were out of order or left out.
    pub(super) fn read(&self, path: &Path) -> Result<SampleTable> {
        let listing = CsvTable::read(path)?;
        let column = |requested: &Option<String>, position: usize, flag: &str| {
            let named = requested.clone().or_else(|| listing.columns().get(position).map(str::to_owned));
            named.with_context(|| format!("`{}` has no column for {flag}", path.display()))
        };
        let time = column(&self.time_column, 0, "--time-column")?;
        let value_column = column(&self.value_column, 1, "--value-column")?;
        let unit_s = self.time_unit.unwrap_or(TimeUnit::S).seconds();
        let samples: Vec<TimedSample> = listing
            .rows()
            .map(|row| Ok(TimedSample { at_s: row.number(&time)? * unit_s, value: row.number(&value_column)? }))
            .collect::<Result<_>>()?;
        let name = path.display().to_string();
        let ordered = sorted_by_time(&samples);
        if samples.windows(2).any(|pair| pair[1].at_s < pair[0].at_s) {
            print_line(&format!(
                "{name}: some of its rows are earlier than the row before; all were put into the order of `{time}`"
            ));
        }
        report_skipped(&name, samples.len() - ordered.len());
        Ok(SampleTable { value_column, samples: ordered })
    }
}

//! The results of a run as CSV: one wide file per stream, for spreadsheets, pandas and PlotJuggler.
//!
//! Takes the station's events with their times; the caller opens an output for each stream. Nothing is rounded: every number reads back
//! unchanged. A missing value is an empty field.
//!
//! # Model
//! ```text
//! estimates.csv      the filter's estimates, with covariance                  t_s: the brick's clock
//! fusion.csv         the outcome of each observation: innovation, S, NIS
//! <kind>.csv         the observations of a kind: wheel_angles, fix, ..
//! clock.csv          alignments of the brick's clock
//! temperature.csv    live thermometers; the observations of recorded ones are in temperature_observations.csv
//! links.csv          health of the links, once per second                      host_s: since the session began
//! sources.csv        counters of each sender
//! events.csv         everything else, in words
//! ```
//! The first five end in the column `robot`: its name, else `link/system/component`.
//!
//! Names of columns end in their unit, SI throughout. Positions and headings are in the arena, counter-clockwise
//! positive.
//!
//! # Sources
//! RFC 4180 for the quoting of texts.

mod rows;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::Write;

use posebridge_telemetry::{Event, HostClock, Timestamp};

use crate::robot_names::RobotNames;
use rows::CsvRow;

/// Opens a stream by its name, without file extension.
type OpenFile<'o, W> = dyn FnMut(&str) -> std::io::Result<W> + 'o;

/// Writes events to their streams; a stream without events is never opened.
pub struct CsvWriter<'o, W: Write> {
    open: Box<OpenFile<'o, W>>,
    files: BTreeMap<&'static str, (::csv::Writer<W>, u64)>,
    names: RobotNames,
}

impl<'o, W: Write> CsvWriter<'o, W> {
    pub fn new(open: impl FnMut(&str) -> std::io::Result<W> + 'o) -> Self {
        Self { open: Box::new(open), files: BTreeMap::new(), names: RobotNames::default() }
    }

    pub fn record(&mut self, now: Timestamp<HostClock>, event: &Event) -> std::io::Result<()> {
        self.names.observe(event);
        for row in rows::rows(now, event) {
            self.write(row)?;
        }
        Ok(())
    }

    /// Ends all streams and returns their names and line counts, headers excluded.
    pub fn finish(self) -> std::io::Result<Vec<(String, u64)>> {
        let mut lines = Vec::new();
        for (name, (mut out, count)) in self.files {
            out.flush()?;
            lines.push((name.to_owned(), count));
        }
        Ok(lines)
    }

    fn write(&mut self, mut row: CsvRow) -> std::io::Result<()> {
        row.columns.extend(row.robot.map(|robot| ("robot", self.names.label(robot).into())));
        let (out, count) = match self.files.entry(row.stream) {
            Entry::Occupied(file) => file.into_mut(),
            Entry::Vacant(entry) => {
                let mut out = ::csv::Writer::from_writer((self.open)(row.stream)?);
                out.write_record(row.columns.iter().map(|(name, _)| *name))?;
                entry.insert((out, 0))
            }
        };
        out.write_record(row.columns.iter().map(|(_, field)| &field.0))?;
        *count += 1;
        Ok(())
    }
}

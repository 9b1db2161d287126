//! Columns of a recording's files that its descriptor does not name: the motor's PWM, and another program's filter.
//!
//! The descriptor's text gets two streams more, bound to the file of the run's range readings; everything else (units, stamps, bad
//! rows) stays with the reader of recordings.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_telemetry::SensorId;

use super::motor_column::MotorColumn;

/// Sensor id of another program's filtered distance, unused in the bundled descriptors.
pub(super) const FOREIGN_FILTER: SensorId = SensorId(250);

/// No header is longer.
const MAX_HEADER_BYTES: u64 = 1 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ExtraColumn<'a> {
    Command(&'a MotorColumn),
    Filtered(&'a str),
}

/// Adds a stream for a run to the descriptor's text; `None` if the run has no stream of ranges.
pub(super) fn with_extra(text: &str, run: &str, extra: ExtraColumn<'_>) -> Result<Option<String>> {
    let table: toml::Table = text.parse().context("reading the descriptor again")?;
    let Some(stream) = range_stream(&table, run) else {
        return Ok(None);
    };
    let mut added = toml::Table::new();
    for (key, value) in [("file", stream.get("file")), ("stamp_shift_s", stream.get("stamp_shift_s"))] {
        if let Some(value) = value {
            added.insert(key.to_owned(), value.clone());
        }
    }
    added.insert("runs".to_owned(), vec![run].into());
    let key = match extra {
        ExtraColumn::Command(column) => {
            added.insert("left".to_owned(), column_of(&column.left, &[]));
            added.insert("right".to_owned(), column_of(&column.right, &[]));
            "body_velocity"
        }
        ExtraColumn::Filtered(column) => {
            let range = stream.get("range").and_then(toml::Value::as_table);
            let keep = ["unit", "scale"].map(|key| {
                let value = range.and_then(|range| range.get(key));
                value.map(|value| (key, value.clone()))
            });
            let keep: Vec<(&str, toml::Value)> = keep.into_iter().flatten().collect();
            added.insert("range".to_owned(), column_of(column, &keep));
            added.insert("sensor".to_owned(), i64::from(FOREIGN_FILTER.0).into());
            "wall_range"
        }
    };
    let mut more = toml::Table::new();
    more.insert(key.to_owned(), vec![added].into());
    Ok(Some(format!("{text}\n{more}")))
}

fn range_stream<'t>(table: &'t toml::Table, run: &str) -> Option<&'t toml::Table> {
    let streams = table.get("wall_range").and_then(toml::Value::as_array);
    streams.into_iter().flatten().filter_map(toml::Value::as_table).find(|stream| is_in(stream, run))
}

/// The columns of the file that holds a run's ranges.
#[derive(Default)]
pub(super) struct RunColumns {
    pub(super) names: Vec<String>,
    /// Times and distances.
    used: Vec<String>,
}

impl RunColumns {
    pub(super) fn used_names(&self) -> Vec<&str> {
        self.used.iter().map(String::as_str).collect()
    }
}

/// From the last header line of the file; `None` where the descriptor or the file does not have one.
pub(super) fn columns_of_run(text: &str, run: &str, root: &Path) -> Option<RunColumns> {
    let table: toml::Table = text.parse().ok()?;
    let stream = range_stream(&table, run)?;
    let file = table.get("files")?.get(stream.get("file")?.as_str()?)?;
    let mut path = file.get("path")?.as_str()?.to_owned();
    let runs = table.get("runs").and_then(toml::Value::as_array);
    let of_run = runs.into_iter().flatten().find(|one| one.get("name").and_then(toml::Value::as_str) == Some(run));
    let values = of_run.and_then(|one| one.get("values")).and_then(toml::Value::as_table);
    for (key, value) in values.into_iter().flatten() {
        path = path.replace(&format!("{{{key}}}"), value.as_str()?);
    }
    let header_lines = usize::try_from(file.get("header_lines")?.as_integer()?).ok()?;
    let mut beginning = Vec::new();
    File::open(root.join(path)).ok()?.take(MAX_HEADER_BYTES).read_to_end(&mut beginning).ok()?;
    let contents = String::from_utf8_lossy(&beginning);
    let header = contents.trim_start_matches('\u{feff}').lines().nth(header_lines.checked_sub(1)?)?;
    let names = header.split([',', ';', '\t']).map(|name| name.trim().trim_matches('"').to_owned());
    let column = |of: Option<&toml::Value>| Some(of?.get("column")?.as_str()?.to_owned());
    let used = [column(file.get("time")), column(stream.get("range"))];
    Some(RunColumns { names: names.collect(), used: used.into_iter().flatten().collect() })
}

fn column_of(column: &str, more: &[(&str, toml::Value)]) -> toml::Value {
    let mut entry = toml::Table::new();
    entry.insert("column".to_owned(), column.into());
    for (key, value) in more {
        entry.insert((*key).to_owned(), value.clone());
    }
    entry.into()
}

fn is_in(stream: &toml::Table, run: &str) -> bool {
    let runs = stream.get("runs").and_then(toml::Value::as_array);
    runs.is_none_or(|runs| {
        let prefixes = runs.iter().filter_map(toml::Value::as_str);
        prefixes.into_iter().any(|prefix| run.starts_with(prefix))
    })
}

#[cfg(test)]
mod tests {
    use posebridge_recording::dataset::Descriptor;

    use super::*;

    const TEXT: &str = include_str!("../../../../config/recordings/tof-wall.toml");

    #[test]
    fn the_descriptor_still_reads_with_more_columns() {
        for extra in [ExtraColumn::Command(&MotorColumn::one("pwm")), ExtraColumn::Filtered("kf \"mm\"")] {
            let more = with_extra(TEXT, "robotC-20250325", extra).unwrap().unwrap();
            assert!(Descriptor::from_toml(&more).is_ok(), "{more}");
        }
        let other = TEXT.replace("wall_range]]", "compass]]");
        assert_eq!(with_extra(&other, "x", ExtraColumn::Command(&MotorColumn::one("pwm"))).unwrap(), None);
    }
}

//! Columns of a recording's files that its descriptor does not name: the motor's PWM, and another program's filter.
//!
//! The descriptor's text gets two streams more, bound to the file of the run's range readings; everything else (units, stamps, bad
//! rows) stays with the reader of recordings.

use anyhow::{Context, Result};
use posebridge_telemetry::SensorId;

/// The sensor of another program's filtered distance; no descriptor of ours uses it.
pub(super) const FOREIGN_FILTER: SensorId = SensorId(250);
/// One in a column of PWM is this much input: 80 is full drive, as in the paper.
const PER_PWM: f64 = 1.0 / 80.0;

/// A stream that is laid on top.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ExtraColumn<'a> {
    /// The PWM, in this column.
    Command(&'a str),
    /// A filtered distance, in this column.
    Filtered(&'a str),
}

/// The descriptor's text with one more stream for a run; `None` if the run has no stream of ranges.
pub(super) fn with_extra(text: &str, run: &str, extra: ExtraColumn<'_>) -> Result<Option<String>> {
    let table: toml::Table = text.parse().context("reading the descriptor again")?;
    let streams = table.get("wall_range").and_then(toml::Value::as_array);
    let of_run = streams.into_iter().flatten().filter_map(toml::Value::as_table).find(|stream| is_in(stream, run));
    let Some(stream) = of_run else {
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
            let place = column_of(column, &[("scale", PER_PWM.into())]);
            added.insert("left".to_owned(), place.clone());
            added.insert("right".to_owned(), place);
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

fn column_of(column: &str, more: &[(&str, toml::Value)]) -> toml::Value {
    let mut place = toml::Table::new();
    place.insert("column".to_owned(), column.into());
    for (key, value) in more {
        place.insert((*key).to_owned(), value.clone());
    }
    place.into()
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
    use super::*;
    use posebridge_recording::dataset::Descriptor;

    const TEXT: &str = include_str!("../../../../config/recordings/tof-wall.toml");

    #[test]
    fn the_descriptor_still_reads_with_more_columns() {
        for extra in [ExtraColumn::Command("pwm"), ExtraColumn::Filtered("kf \"mm\"")] {
            let more = with_extra(TEXT, "robotC-20250325", extra).unwrap().unwrap();
            assert!(Descriptor::from_toml(&more).is_ok(), "{more}");
        }
        let other = TEXT.replace("wall_range]]", "compass]]");
        assert_eq!(with_extra(&other, "x", ExtraColumn::Command("pwm")).unwrap(), None);
    }
}

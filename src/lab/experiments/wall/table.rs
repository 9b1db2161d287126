//! A plain table of an approach: a column of times, one of distances, and the motors' if there is one.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_lab::wall::{WallEntry, WallReading};

use super::motor_column::{MotorColumn, find_motor_column};
use crate::tools::csv_table::CsvTable;

pub(super) struct ApproachTable {
    pub(super) columns: Vec<String>,
    pub(super) ranges: Vec<WallEntry>,
    pub(super) motor: Option<MotorColumn>,
    /// As in the file.
    pub(super) inputs: Vec<WallEntry>,
}

const TIMES: [&str; 8] = ["time", "timestamp", "timestamps", "t", "elapsed", "millis", "clock", "stamp"];
const DISTANCES: [&str; 9] = ["distance", "dist", "range", "tof", "ultrasonic", "sonar", "wall", "z", "front"];

/// Reads a table with column names in its first line. Readings of zero, and repetitions of the last one, are no readings.
pub(super) fn read_table(path: &Path, command_column: Option<&str>) -> Result<ApproachTable> {
    let table = CsvTable::read(path)?;
    let name = path.display();
    let columns: Vec<String> = table.columns().iter().map(str::to_owned).collect();
    let (time, in_seconds) = find(&columns, &TIMES, &[("ms", 1e-3), ("us", 1e-6), ("s", 1.0)])
        .with_context(|| format!("`{name}` has no column of times; name one time_s or time_ms"))?;
    let (distance, in_metres) =
        find(&columns, &DISTANCES, &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)]).with_context(|| {
            format!("`{name}` has no column of distances; name one distance_mm, distance_cm or distance_m")
        })?;
    let motor = match command_column {
        Some(column) => {
            ensure!(table.has(column), "`{name}` has no column `{column}`; it has: {}", columns.join(", "));
            Some(MotorColumn::one(column))
        }
        None => find_motor_column(&columns, &[&time, &distance]),
    };
    let rows = table.rows().map(|row| {
        let commanded = motor
            .as_ref()
            .map(|motor| Ok::<_, anyhow::Error>(f64::midpoint(row.number(&motor.left)?, row.number(&motor.right)?)));
        Ok((row.number(&time)?, row.number(&distance)?, commanded.transpose()?))
    });
    let rows: Vec<(f64, f64, Option<f64>)> = rows.collect::<Result<_>>()?;
    let Some((first, ..)) = rows.first().copied() else { bail!("`{name}` has no rows") };
    let in_seconds = in_seconds.unwrap_or_else(|| time_unit(&rows));
    let most = rows.iter().map(|(_, distance, _)| *distance).fold(0.0, f64::max);
    let in_metres = match in_metres {
        Some(unit) => unit,
        None if most <= 10.0 => 1.0,
        None => bail!(
            "`{name}`: the unit of `{distance}` is not known; name it {distance}_mm, {distance}_cm or {distance}_m"
        ),
    };
    let at_s = |time: f64| in_seconds * (time - first);
    let mut ranges = Vec::new();
    let mut last = f64::NAN;
    for (time, distance, _) in &rows {
        if *distance > 0.0 && *distance != last {
            ranges.push(WallEntry { at_s: at_s(*time), reading: WallReading::Range(in_metres * distance) });
        }
        last = *distance;
    }
    let inputs = rows
        .iter()
        .filter_map(|(time, _, input)| Some(WallEntry { at_s: at_s(*time), reading: WallReading::Input((*input)?) }));
    Ok(ApproachTable { inputs: inputs.collect(), columns, ranges, motor })
}

/// A loop of a robot takes less than a second: longer steps are milliseconds, very long ones microseconds.
fn time_unit(rows: &[(f64, f64, Option<f64>)]) -> f64 {
    let span = rows.last().map_or(0.0, |last| last.0) - rows.first().map_or(0.0, |first| first.0);
    let step = span / rows.len().max(2) as f64;
    if step > 1000.0 {
        1e-6
    } else if step > 1.0 {
        1e-3
    } else {
        1.0
    }
}

/// The column with one of these names, and what its unit is worth if the name ends with one.
fn find(columns: &[String], names: &[&str], units: &[(&str, f64)]) -> Option<(String, Option<f64>)> {
    let plain =
        |column: &str| -> String { column.to_lowercase().chars().filter(char::is_ascii_alphanumeric).collect() };
    names.iter().find_map(|name| {
        columns.iter().find_map(|column| {
            let plain = plain(column);
            let rest = plain.strip_prefix(name)?;
            if rest.is_empty() {
                return Some((column.clone(), None));
            }
            let unit = units.iter().find(|(unit, _)| rest == *unit)?;
            Some((column.clone(), Some(unit.1)))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<ApproachTable> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        std::fs::write(&path, text).unwrap();
        read_table(&path, None)
    }

    #[test]
    fn units_come_with_the_names_and_held_readings_count_once() {
        let table = read("t_ms,tof_cm,left_pwm,right_pwm\n1000,100,0,0\n1020,100,60,80\n1100,98,60,80\n1200,0,60,80\n")
            .unwrap();
        let ranges: Vec<(f64, WallReading)> = table.ranges.iter().map(|one| (one.at_s, one.reading)).collect();
        assert_eq!(ranges, [(0.0, WallReading::Range(1.0)), (0.1, WallReading::Range(0.98))]);
        assert_eq!(table.inputs[1].reading, WallReading::Input(70.0));
        let plain = read("Time,Distance\n10,2.0\n10.1,1.9\n").unwrap();
        assert!((plain.ranges[1].at_s - 0.1).abs() < 1e-9 && plain.motor.is_none());
        let unknown = read("time,distance\n0,200\n").err().unwrap().to_string();
        assert!(unknown.contains("distance_mm"), "{unknown}");
        assert!(read("time,temperature\n0,20\n").err().unwrap().to_string().contains("distance"));
    }
}

//! The simulator's truth as CSV: written by `posebridge sim --truth`, read by `posebridge replay --truth`.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use posebridge_report::{PoseTrack, TimedPose};
use posebridge_sim::TruthSample;
use posebridge_telemetry::{Heading, Meters, Pose, Timestamp};

use super::csv_table::CsvTable;
use crate::station::event_collector::MAX_INTERPOLATION_GAP;

/// The first line.
const HEADER: &str = "brick_micros,x_m,y_m,heading_rad,odometry_x_m,odometry_y_m,odometry_heading_rad,cross_track_m";

/// The truth as text.
pub fn write(samples: &[TruthSample]) -> String {
    let mut text = String::from(HEADER);
    text.push('\n');
    for sample in samples {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{}",
            sample.brick_time.as_micros(),
            sample.pose.x.0,
            sample.pose.y.0,
            sample.pose.heading.rad(),
            sample.odometry.x.0,
            sample.odometry.y.0,
            sample.odometry.heading.rad(),
            sample.cross_track_m,
        );
    }
    text
}

/// The true track of a file.
///
/// # Errors
/// It cannot be read, or is not what [`write()`] makes; the message names line and column.
pub fn open(path: &Path) -> Result<PoseTrack> {
    let table = CsvTable::read(path).context("reading the truth")?;
    ensure!(
        table.columns().iter().eq(HEADER.split(',')),
        "`{}` is no truth file; its first line must be `{HEADER}`",
        path.display()
    );
    let samples = table.rows().map(|row| {
        Ok(TimedPose {
            time: Timestamp::from_micros(row.number("brick_micros")? as i64),
            pose: Pose::new(
                Meters(row.number("x_m")?),
                Meters(row.number("y_m")?),
                Heading::from_rad(row.number("heading_rad")?),
            ),
        })
    });
    Ok(PoseTrack::new(samples.collect::<Result<Vec<_>>>()?, MAX_INTERPOLATION_GAP))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_file_is_refused_with_line_and_column() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        for (text, expected) in [
            ("t_s,x_m\n".to_owned(), "truth.csv` is no truth file; its first line must be `brick_micros,x_m"),
            (format!("{HEADER}\n0,0,0,0,0,0,0,0\n1,0,far,0\n"), "truth.csv` line 3: `far` in column `y_m`"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = format!("{:#}", open(&path).unwrap_err());
            assert!(error.contains(expected), "{error}");
        }
    }
}

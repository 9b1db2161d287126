//! The simulator's truth as CSV: written by `posebridge sim --truth`, read by `posebridge replay --truth`.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail};
use posebridge_report::{PoseTrack, TimedPose};
use posebridge_sim::TruthSample;
use posebridge_telemetry::{Heading, Meters, Pose, Timestamp};

use crate::station::event_collector::MAX_INTERPOLATION_GAP;

/// The first line.
const HEADER: &str = "brick_micros,x_m,y_m,heading_rad,odometry_x_m,odometry_y_m,odometry_heading_rad,cross_track_m";

/// The truth as text.
#[must_use]
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
/// It cannot be read, or as [`read`] says.
pub fn open(path: &Path) -> Result<PoseTrack> {
    let name = path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("reading the truth `{name}`"))?;
    read(&text).with_context(|| format!("truth `{name}`"))
}

/// The true track.
///
/// # Errors
/// The text is not what [`write()`] makes; the message names the line.
pub fn read(text: &str) -> Result<PoseTrack> {
    let mut lines = text.lines().enumerate();
    match lines.next() {
        Some((_, header)) if header.trim() == HEADER => {}
        _ => bail!("line 1: this is no truth file; it must begin with `{HEADER}`"),
    }
    let mut samples = Vec::new();
    for (index, line) in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |column: usize| -> Result<f64> {
            let field = fields.get(column).copied().unwrap_or_default();
            field.trim().parse().with_context(|| format!("line {}: `{field}` is no number", index + 1))
        };
        samples.push(TimedPose {
            time: Timestamp::from_micros(number(0)? as i64),
            pose: Pose::new(Meters(number(1)?), Meters(number(2)?), Heading::from_rad(number(3)?)),
        });
    }
    Ok(PoseTrack::new(samples, MAX_INTERPOLATION_GAP))
}

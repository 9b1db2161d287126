//! The files that a replay leaves: events and a picture.

use std::fs::File;
use std::io::{BufWriter, Write as _};

use anyhow::{Context, Result};
use posebridge_report::{FIGURES, PoseTrack, RunLayers};

use super::args::ReplayArgs;
use crate::station::event_collector::EventCollector;

/// Writes what still waits: a writer that is dropped tells nobody that the disk is full.
pub(super) fn finish_events(mut events: BufWriter<File>) -> Result<()> {
    events.flush().context("writing the events")
}

/// Truth, odometry and smoothed path go with the estimates of the collector.
pub(super) fn write_charts(
    args: &ReplayArgs,
    title: &str,
    collector: &EventCollector,
    (truth, odometry, smoothed): (Option<&PoseTrack>, Option<&PoseTrack>, Option<&PoseTrack>),
) -> Result<()> {
    let (Some(path), Some(figure)) = (&args.figure, FIGURES.first()) else {
        return Ok(());
    };
    let layers = RunLayers {
        title,
        truth,
        odometry,
        estimates: collector.estimates.items(),
        fixes: collector.fixes.items(),
        smoothed,
        ..RunLayers::default()
    };
    std::fs::write(path, (figure.render)(&layers)).with_context(|| format!("writing `{}`", path.display()))
}

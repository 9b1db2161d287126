//! The files that a replay leaves: events and a picture.

use std::fs::File;
use std::io::{BufWriter, Write as _};

use anyhow::{Context, Result};
use posebridge_report::{FIGURES, PoseTrack, RunLayers};

use super::args::ReplayArgs;
use crate::station::event_collector::EventCollector;

/// Writes what still waits: a writer that is dropped does not report that the disk is full.
pub(super) fn finish_events(mut events: BufWriter<File>) -> Result<()> {
    events.flush().context("writing the events")
}

/// What is drawn beside the estimates.
#[derive(Clone, Copy, Default)]
pub(super) struct ReferenceTracks<'a> {
    pub(super) truth: Option<&'a PoseTrack>,
    pub(super) odometry: Option<&'a PoseTrack>,
    pub(super) smoothed: Option<&'a PoseTrack>,
}

/// Draws the estimates of a collector and these tracks.
pub(super) fn write_charts(
    args: &ReplayArgs,
    title: &str,
    collector: &EventCollector,
    tracks: ReferenceTracks<'_>,
) -> Result<()> {
    let (Some(path), Some(figure)) = (&args.figure, FIGURES.first()) else {
        return Ok(());
    };
    let ReferenceTracks { truth, odometry, smoothed } = tracks;
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

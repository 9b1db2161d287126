//! The end of a run: a table of who was how far off, and two pictures.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_analysis::metrics::{PathError, errors_of_estimates, errors_of_track, path_error, summarise};
use posebridge_analysis::report::{run_table, source_table};
use posebridge_analysis::{ErrorSummary, FIGURES, RunLayers, RunRow, TimedPose, Track};
use posebridge_sim::{Simulation, Steering, TruthSample};
use posebridge_telemetry::{Arena, Point2};

use super::links;
use crate::collect::{Collector, LONGEST_GAP};

/// What the simulator alone knows.
pub struct Truth {
    /// Where the robot was.
    pub track: Track,
    /// Where the brick alone believed it was.
    pub odometry: Track,
    /// Where it should have been.
    pub path: Vec<Point2<Arena>>,
    /// How far from the path it drove.
    pub path_error: PathError,
    /// By what it steered.
    pub steering: Steering,
}

impl Truth {
    /// The truth of a simulation.
    #[must_use]
    pub fn of(simulation: &Simulation) -> Self {
        let samples = simulation.truth();
        let positions: Vec<Point2<Arena>> = samples.iter().map(|sample| sample.pose.origin()).collect();
        let track = |pose: fn(&TruthSample) -> posebridge_telemetry::Pose<Arena>| {
            Track::new(samples.iter().map(|sample| TimedPose { stamp: sample.brick, pose: pose(sample) }), LONGEST_GAP)
        };
        Self {
            track: track(|sample| sample.pose),
            odometry: track(|sample| sample.odometry),
            path: simulation.path().to_vec(),
            path_error: path_error(&positions, simulation.path()),
            steering: simulation.scenario().steering,
        }
    }
}

/// Errors of the estimate and of the brick's own odometry.
#[must_use]
pub fn errors(collector: &Collector, truth: &Truth) -> (ErrorSummary, ErrorSummary) {
    let estimate = summarise(&errors_of_estimates(collector.estimates.items(), &truth.track));
    let odometry = summarise(&errors_of_track(&truth.odometry, &truth.track));
    (estimate, odometry)
}

/// The table of a run whose truth is known; `other` is the same world steered the other way.
#[must_use]
pub fn table(collector: &Collector, truth: &Truth, other: Option<&Truth>) -> String {
    let (estimate, odometry) = errors(collector, truth);
    let mut text = run_table(&[
        RunRow { name: "brick's own odometry", errors: &odometry },
        RunRow { name: "estimate", errors: &estimate },
    ]);
    // Writing to a String cannot fail.
    let _ = writeln!(text, "\npath error when steering by     rms mm    max mm");
    for run in other.into_iter().chain([truth]) {
        let name = match run.steering {
            Steering::Odometry => "the brick's own odometry",
            Steering::Estimate => "the estimate",
        };
        let millimetres = |metres: Option<f64>| metres.map_or_else(|| "-".to_owned(), |m| format!("{:.1}", m * 1e3));
        let PathError { rms_m, max_m, .. } = run.path_error;
        let _ = writeln!(text, "  {name:<28} {:>8}  {:>8}", millimetres(rms_m), millimetres(max_m));
    }
    text
}

/// How the observations of each sensor fared.
#[must_use]
pub fn sources(collector: &Collector) -> String {
    source_table(&collector.sources)
}

/// How the links did.
#[must_use]
pub fn links(collector: &Collector) -> String {
    links::tables(collector.links.iter())
}

/// Draws every figure into a folder and says where.
///
/// # Errors
/// A file cannot be written.
pub fn draw(folder: &Path, title: &str, collector: &Collector, truth: Option<&Truth>) -> Result<Vec<PathBuf>> {
    let layers = RunLayers {
        title,
        ideal: truth.map_or(&[], |truth| &truth.path),
        truth: truth.map(|truth| &truth.track),
        odometry: truth.map(|truth| &truth.odometry),
        estimates: collector.estimates.items(),
        fixes: collector.fixes.items(),
        ..RunLayers::default()
    };
    let mut drawn = Vec::new();
    for figure in FIGURES {
        let path = folder.join(format!("{}.svg", figure.name));
        std::fs::write(&path, (figure.render)(&layers)).with_context(|| format!("writing `{}`", path.display()))?;
        drawn.push(path);
    }
    Ok(drawn)
}

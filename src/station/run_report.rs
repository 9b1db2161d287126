//! The end of a run: a table of who was how far off, and two pictures.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_report::metrics::{PathError, errors_of_estimates, errors_of_track, path_error, summarise};
use posebridge_report::tables::{run_table, source_table};
use posebridge_report::{ErrorSummary, FIGURES, PoseTrack, RunLayers, RunRow, TimedPose};
use posebridge_sim::{Simulation, Steering, TruthSample};
use posebridge_telemetry::{Arena, Point2};

use super::event_collector::{EventCollector, MAX_INTERPOLATION_GAP};
use super::link_report;

/// What the simulator alone knows.
pub struct SimulationTruth {
    /// Where the robot was.
    pub track: PoseTrack,
    /// The path by the brick's own odometry.
    pub odometry: PoseTrack,
    /// Where it should have been.
    pub path: Vec<Point2<Arena>>,
    /// How far from the path it drove.
    pub path_error: PathError,
    /// By what it steered.
    pub steering: Steering,
}

impl SimulationTruth {
    /// The truth of a simulation.
    pub fn from_simulation(simulation: &Simulation) -> Self {
        let samples = simulation.truth();
        let positions: Vec<Point2<Arena>> = samples.iter().map(|sample| sample.pose.origin()).collect();
        let track = |pose: fn(&TruthSample) -> posebridge_telemetry::Pose<Arena>| {
            PoseTrack::new(
                samples.iter().map(|sample| TimedPose { time: sample.brick_time, pose: pose(sample) }),
                MAX_INTERPOLATION_GAP,
            )
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
pub fn errors(collector: &EventCollector, truth: &SimulationTruth) -> (ErrorSummary, ErrorSummary) {
    let estimate = summarise(&errors_of_estimates(collector.estimates.items(), &truth.track));
    let odometry = summarise(&errors_of_track(&truth.odometry, &truth.track));
    (estimate, odometry)
}

/// The table of a run whose truth is known; `other` is the same world steered the other way.
pub fn table(collector: &EventCollector, truth: &SimulationTruth, other: Option<&SimulationTruth>) -> String {
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
pub fn sources(collector: &EventCollector) -> String {
    source_table(&collector.sources)
}

/// How the links did.
pub fn links(collector: &EventCollector) -> String {
    link_report::tables(collector.links.iter())
}

/// Draws every figure into a folder and says where.
///
/// # Errors
/// A file cannot be written.
pub fn draw(
    folder: &Path,
    title: &str,
    collector: &EventCollector,
    truth: Option<&SimulationTruth>,
) -> Result<Vec<PathBuf>> {
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

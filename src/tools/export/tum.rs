//! Trajectories for evo: truth and estimate at the same stamps, where there is truth.

use anyhow::{Context, Result, ensure};
use posebridge_recording::tum;
use posebridge_report::TimedPose;
use posebridge_telemetry::TimeDelta;

use super::args::ExportArgs;
use super::engine::ExportedRun;
use super::output_files::print_written;
use crate::console::print_line;

/// The last digit of a stamp in such a file.
const TIME_RESOLUTION: TimeDelta = TimeDelta::from_micros(1);

/// Writes `estimate.tum`, and `truth.tum` where there is truth.
///
/// # Errors
/// There is nothing to write, or it cannot be written.
pub(super) fn write(args: &ExportArgs, made: &ExportedRun) -> Result<()> {
    let (estimate, truth) = trajectories(made);
    ensure!(
        !estimate.is_empty(),
        "there is no valid estimate{} to write",
        if made.truth.is_some() { " where there is truth" } else { "" }
    );
    write_one(args, "estimate", &estimate)?;
    if let Some(truth) = truth {
        return write_one(args, "truth", &truth);
    }
    print_line("there is no truth: `estimate.tum` stands alone; give --truth");
    Ok(())
}

/// Estimates and truth, pair by pair.
fn trajectories(made: &ExportedRun) -> (Vec<TimedPose>, Option<Vec<TimedPose>>) {
    if let Some(pairs) = &made.pairs {
        let at = |stamp, pose| TimedPose { time: stamp, pose };
        let estimate = pairs.iter().map(|pair| at(pair.time, pair.estimated));
        let truth = pairs.iter().map(|pair| at(pair.time, pair.expected));
        return (with_unique_times(estimate), Some(with_unique_times(truth)));
    }
    let estimates = made.estimates.iter().copied();
    let Some(truth) = &made.truth else {
        return (with_unique_times(estimates), None);
    };
    let pairs = estimates.filter_map(|estimate| {
        let stamp = estimate.time;
        let pose = truth.at(stamp)?;
        Some((estimate, TimedPose { time: stamp, pose }))
    });
    // Both have the same stamps in the same order, and so they have them afterwards.
    let (estimates, truth): (Vec<TimedPose>, Vec<TimedPose>) = pairs.unzip();
    (with_unique_times(estimates.into_iter()), Some(with_unique_times(truth.into_iter())))
}

/// The poses in the order of their stamps, at least a microsecond apart, because tools pair poses by their stamps. A late fix makes a
/// second estimate for an instant; it counts for the score as it does in a replay.
fn with_unique_times(poses: impl Iterator<Item = TimedPose>) -> Vec<TimedPose> {
    let mut poses: Vec<TimedPose> = poses.collect();
    poses.sort_by_key(|one| one.time);
    let mut free = None;
    for one in &mut poses {
        one.time = free.map_or(one.time, |free| one.time.max(free));
        free = Some(one.time + TIME_RESOLUTION);
    }
    poses
}

fn write_one(args: &ExportArgs, name: &str, poses: &[TimedPose]) -> Result<()> {
    let path = args.out.join(format!("{name}.tum"));
    let text: String = poses.iter().map(|one| tum::format_line(one.time, one.pose)).collect();
    std::fs::write(&path, text).with_context(|| format!("writing `{}`", path.display()))?;
    print_written(&path, poses.len() as u64, "poses");
    Ok(())
}

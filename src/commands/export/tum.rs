//! Trajectories for evo: truth and estimate at the same stamps, where there is truth.

use anyhow::{Context, Result, ensure};
use posebridge_analysis::TimedPose;
use posebridge_recording::tum;
use posebridge_telemetry::Span;

use super::engine::Made;
use super::{ExportArgs, tell};
use crate::stderr::say;

/// The last digit of a stamp in such a file.
const LAST_DIGIT: Span = Span::from_micros(1);

/// Writes `estimate.tum`, and `truth.tum` where there is truth.
///
/// # Errors
/// There is nothing to write, or it cannot be written.
pub(super) fn write(args: &ExportArgs, made: &Made) -> Result<()> {
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
    say("there is no truth: `estimate.tum` stands alone; give --truth");
    Ok(())
}

/// Estimates and truth, pair by pair.
fn trajectories(made: &Made) -> (Vec<TimedPose>, Option<Vec<TimedPose>>) {
    if let Some(pairs) = &made.pairs {
        let at = |stamp, pose| TimedPose { stamp, pose };
        let estimate = pairs.iter().map(|pair| at(pair.stamp, pair.believed));
        let truth = pairs.iter().map(|pair| at(pair.stamp, pair.expected));
        return (each_with_a_stamp_of_its_own(estimate), Some(each_with_a_stamp_of_its_own(truth)));
    }
    let estimates = made.estimates.iter().copied();
    let Some(truth) = &made.truth else {
        return (each_with_a_stamp_of_its_own(estimates), None);
    };
    let pairs = estimates.filter_map(|estimate| {
        let stamp = estimate.stamp;
        let pose = truth.at(stamp)?;
        Some((estimate, TimedPose { stamp, pose }))
    });
    // Both have the same stamps in the same order, and so they have them afterwards.
    let (estimates, truth): (Vec<TimedPose>, Vec<TimedPose>) = pairs.unzip();
    (each_with_a_stamp_of_its_own(estimates.into_iter()), Some(each_with_a_stamp_of_its_own(truth.into_iter())))
}

/// The poses in the order of their stamps, at least a microsecond apart, because tools pair poses by their stamps. A late fix makes a
/// second estimate for an instant; it counts for the score as it does in a replay.
fn each_with_a_stamp_of_its_own(poses: impl Iterator<Item = TimedPose>) -> Vec<TimedPose> {
    let mut poses: Vec<TimedPose> = poses.collect();
    poses.sort_by_key(|one| one.stamp);
    let mut free = None;
    for one in &mut poses {
        one.stamp = free.map_or(one.stamp, |free| one.stamp.max(free));
        free = Some(one.stamp + LAST_DIGIT);
    }
    poses
}

fn write_one(args: &ExportArgs, name: &str, poses: &[TimedPose]) -> Result<()> {
    let path = args.out.join(format!("{name}.tum"));
    let text: String = poses.iter().map(|one| tum::line(one.stamp, one.pose)).collect();
    std::fs::write(&path, text).with_context(|| format!("writing `{}`", path.display()))?;
    tell(&path, poses.len() as u64, "poses");
    Ok(())
}

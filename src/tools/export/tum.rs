//! Trajectories for evo: truth and estimate at the same stamps, where there is truth.

use anyhow::{Context, Result, bail};
use posebridge_recording::tum;
use posebridge_report::TimedPose;
use posebridge_telemetry::TimeDelta;

use super::args::ExportArgs;
use super::engine::{ExportedRun, RobotPoses};
use super::output_files::print_written;
use crate::console::print_line;
use crate::station::per_robot::file_parts;

/// The last digit of a stamp in such a file.
const TIME_RESOLUTION: TimeDelta = TimeDelta::from_micros(1);

/// Writes `estimate.tum`, and `truth.tum` where there is truth; of several robots `estimate-NAME.tum` and `truth-NAME.tum` each.
///
/// # Errors
/// There is nothing to write, or it cannot be written.
pub(super) fn write(args: &ExportArgs, made: &ExportedRun) -> Result<()> {
    if let Some(pairs) = &made.pairs {
        let at = |time, pose| TimedPose { time, pose };
        write_one(args, "estimate", &with_unique_times(pairs.iter().map(|pair| at(pair.time, pair.estimated))))?;
        return write_one(args, "truth", &with_unique_times(pairs.iter().map(|pair| at(pair.time, pair.expected))));
    }
    let labels = made.robots.iter().map(|robot| robot.label.as_deref().unwrap_or_default());
    for (robot, part) in made.robots.iter().zip(file_parts(labels)) {
        write_robot(args, robot, &part)?;
    }
    Ok(())
}

/// `part` stands for the robot in file names, where there are several.
fn write_robot(args: &ExportArgs, robot: &RobotPoses, part: &str) -> Result<()> {
    let suffix = robot.label.as_ref().map_or_else(String::new, |_| format!("-{part}"));
    let (estimate, truth) = trajectories(robot);
    if estimate.is_empty() {
        let place = if robot.truth.is_some() { " where there is truth" } else { "" };
        match &robot.label {
            // The others have theirs.
            Some(label) => print_line(&format!("there is no valid estimate of {label}{place} to write")),
            None => bail!("there is no valid estimate{place} to write"),
        }
        return Ok(());
    }
    write_one(args, &format!("estimate{suffix}"), &estimate)?;
    if let Some(truth) = truth {
        return write_one(args, &format!("truth{suffix}"), &truth);
    }
    print_line(&format!("there is no truth: `estimate{suffix}.tum` stands alone; give --truth"));
    Ok(())
}

/// Estimates and truth, pair by pair.
fn trajectories(robot: &RobotPoses) -> (Vec<TimedPose>, Option<Vec<TimedPose>>) {
    let estimates = robot.estimates.iter().copied();
    let Some(truth) = &robot.truth else {
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

//! The start pose of a run, if the descriptor takes it from the files.
//!
//! The start is the last true pose or fix before the first observation. If there is none, it is the first one after it,
//! and the observations before it are dropped, because the start already contains their motion.

use posebridge_telemetry::{Arena, BrickClock, Meters, Point2, Pose, Timestamp};

use super::descriptor::RunStart;
use super::run::{DatasetRun, StartPose, WithheldFix};
use super::schema::StartSource;

/// Sets the start of `run`; `fixes` are all of its fixes, used or not.
pub(super) fn set_start_pose(run: &mut DatasetRun, start: Option<RunStart>, fixes: &[WithheldFix]) {
    match start {
        None => {}
        Some(RunStart::Pose(pose)) => run.start = Some(pose),
        Some(RunStart::Source { source, position_sigma_m, heading_sigma_rad }) => {
            let poses = match source {
                StartSource::Truth => truth_poses(run),
                StartSource::Fixes => fixes.iter().filter_map(pose_from_fix).collect(),
            };
            let Some((stamp, pose)) = first_pose(run, &poses) else {
                return;
            };
            run.start = Some(StartPose { pose, position_sigma_m, heading_sigma_rad });
            run.observations.retain(|timed| timed.observation.stamp >= stamp);
            run.withheld.retain(|withheld| withheld.time >= stamp);
        }
    }
}

type TimestampedPose = (Timestamp<BrickClock>, Pose<Arena>);

fn truth_poses(run: &DatasetRun) -> Vec<TimestampedPose> {
    let poses = run.truth.iter();
    poses
        .filter_map(|truth| {
            let heading = truth.heading?;
            let pose = Pose::new(truth.position.x, truth.position.y, heading);
            Some((truth.time, pose))
        })
        .collect()
}

/// The body's pose behind a fix with a heading: the tag's lever arm taken off.
fn pose_from_fix(fix: &WithheldFix) -> Option<TimestampedPose> {
    let WithheldFix { time: stamp, fix } = fix;
    let heading = fix.heading?;
    let turn = Pose::<Arena>::new(Meters(0.0), Meters(0.0), heading);
    let arm: Point2<Arena> = turn * fix.tag_in_body;
    let (x, y) = (fix.position.x - arm.x, fix.position.y - arm.y);
    Some((*stamp, Pose::new(x, y, heading)))
}

fn first_pose(run: &DatasetRun, poses: &[TimestampedPose]) -> Option<TimestampedPose> {
    let stamps = run.observations.iter().map(|timed| timed.observation.stamp);
    let first = stamps.min()?;
    let before = poses.iter().rev().find(|(stamp, _)| *stamp <= first);
    before.or_else(|| poses.first()).copied()
}

//! Where a run starts, when the descriptor leaves it to the files.
//!
//! The start holds at the last true pose or fix before the first observation, or, if there is none, at the first one
//! after it; then the observations from before it are left out, because the start already contains their motion.

use posebridge_telemetry::{Arena, BrickClock, Meters, Point2, Pose, Stamp};

use super::descriptor::Start;
use super::run::{Run, StartPose, Withheld};
use super::schema::StartSource;

/// Sets the start of `run`; `fixes` are all of its fixes, used or not.
pub(super) fn place(run: &mut Run, start: Option<Start>, fixes: &[Withheld]) {
    match start {
        None => {}
        Some(Start::Given(pose)) => run.start = Some(pose),
        Some(Start::From { source, position_sigma_m, heading_sigma_rad }) => {
            let poses = match source {
                StartSource::Truth => true_poses(run),
                StartSource::Fixes => fixes.iter().filter_map(pose_of_fix).collect(),
            };
            let Some((stamp, pose)) = anchor(run, &poses) else {
                return;
            };
            run.start = Some(StartPose { pose, position_sigma_m, heading_sigma_rad });
            run.observations.retain(|timed| timed.observation.stamp >= stamp);
            run.withheld.retain(|withheld| withheld.stamp >= stamp);
        }
    }
}

type StampedPose = (Stamp<BrickClock>, Pose<Arena>);

fn true_poses(run: &Run) -> Vec<StampedPose> {
    let poses = run.truth.iter();
    poses
        .filter_map(|truth| {
            let heading = truth.heading?;
            let pose = Pose::new(truth.position.x, truth.position.y, heading);
            Some((truth.stamp, pose))
        })
        .collect()
}

/// The body's pose behind a fix with a heading: the tag's lever arm taken off.
fn pose_of_fix(fix: &Withheld) -> Option<StampedPose> {
    let Withheld { stamp, fix } = fix;
    let heading = fix.heading?;
    let turn = Pose::<Arena>::new(Meters(0.0), Meters(0.0), heading);
    let arm: Point2<Arena> = turn * fix.tag_in_body;
    let (x, y) = (fix.position.x - arm.x, fix.position.y - arm.y);
    Some((*stamp, Pose::new(x, y, heading)))
}

fn anchor(run: &Run, poses: &[StampedPose]) -> Option<StampedPose> {
    let stamps = run.observations.iter().map(|timed| timed.observation.stamp);
    let first = stamps.min()?;
    let before = poses.iter().rev().find(|(stamp, _)| *stamp <= first);
    before.or_else(|| poses.first()).copied()
}

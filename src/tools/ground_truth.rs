//! What is known of a robot's recorded run besides what the engine makes of it: where the robot was, and where its own odometry placed it.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_recording::container::{self, TruthSample};
use posebridge_report::{PoseTrack, TimedPose};
use posebridge_telemetry::RobotId;

use super::truth_file;
use crate::station::event_collector::MAX_INTERPOLATION_GAP;

/// Where the robot was, and where its own odometry placed it, as far as the recording or a file beside it contains them.
#[derive(Debug, Default)]
pub struct GroundTruth {
    /// The truth of a simulated run.
    pub truth: Option<PoseTrack>,
    /// The brick's own dead reckoning.
    pub odometry: Option<PoseTrack>,
}

impl GroundTruth {
    /// The truth in a file; nothing if there is none.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn from_file(truth: Option<&Path>) -> Result<Self> {
        Ok(Self { truth: truth.map(truth_file::open).transpose()?, odometry: None })
    }

    /// The truth in a file, else that of one robot in the recording of this name and these bytes; empty if it contains none of that robot.
    ///
    /// `None` is the robot whose samples name none; where all name one, the robot with the lowest id. `Some` is that robot, and where no
    /// sample names a robot, the only simulated one: programs that served one robot wrote no more. Then it answers for any robot, and a
    /// caller that asks for several has to know which of them was simulated.
    ///
    /// # Errors
    /// The file cannot be read, or the recorded truth is damaged.
    pub fn load(name: &str, recording: &[u8], truth: Option<&Path>, robot: Option<RobotId>) -> Result<Self> {
        if truth.is_some() {
            return Self::from_file(truth);
        }
        let samples = container::read_truth(recording)
            .with_context(|| format!("the truth in `{name}`; give another with --truth"))?;
        let samples = samples_of(robot, samples);
        if samples.is_empty() {
            return Ok(Self::default());
        }
        let of_truth = samples.iter().map(|sample| TimedPose { time: sample.time, pose: sample.pose });
        let believed =
            samples.iter().filter_map(|sample| Some(TimedPose { time: sample.time, pose: sample.odometry? }));
        let odometry = PoseTrack::new(believed, MAX_INTERPOLATION_GAP);
        Ok(Self {
            truth: Some(PoseTrack::new(of_truth, MAX_INTERPOLATION_GAP)),
            odometry: (!odometry.samples().is_empty()).then_some(odometry),
        })
    }
}

/// The samples of one robot; see [`GroundTruth::load`].
fn samples_of(robot: Option<RobotId>, mut samples: Vec<TruthSample>) -> Vec<TruthSample> {
    let is_named = |sample: &TruthSample| sample.robot.is_some();
    let wanted = match robot {
        None if samples.iter().all(is_named) => samples.iter().filter_map(|sample| sample.robot).min(),
        Some(_) if !samples.iter().any(is_named) => None,
        None | Some(_) => robot,
    };
    samples.retain(|sample| sample.robot == wanted);
    samples
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, Heading, LinkId, Meters, Pose, Timestamp};

    fn id(system: u8) -> RobotId {
        RobotId { link: LinkId(0), address: Address::new(system, 1) }
    }

    /// A second apart, each as far east as its place in the list.
    fn samples(robots: &[Option<RobotId>]) -> Vec<TruthSample> {
        let sample = |(place, robot): (i32, &Option<RobotId>)| TruthSample {
            robot: *robot,
            time: Timestamp::from_millis(1_000 * i64::from(place)),
            pose: Pose::new(Meters(f64::from(place)), Meters(0.0), Heading::default()),
            odometry: None,
        };
        (0..).zip(robots).map(sample).collect()
    }

    fn positions_of(robot: Option<RobotId>, robots: &[Option<RobotId>]) -> Vec<f64> {
        samples_of(robot, samples(robots)).iter().map(|sample| sample.pose.x.0).collect()
    }

    #[test]
    fn the_truth_is_that_of_one_robot() {
        let two = [Some(id(2)), Some(id(1)), Some(id(2))];
        assert_eq!(positions_of(None, &two), [1.0]);
        assert_eq!(positions_of(Some(id(2)), &two), [0.0, 2.0]);
        assert_eq!(positions_of(Some(id(3)), &two), [] as [f64; 0]);
    }

    #[test]
    fn samples_that_name_no_robot_answer_for_any_robot_unless_others_name_one() {
        assert_eq!(positions_of(Some(id(2)), &[None, None]), [0.0, 1.0]);
        let mixed = [Some(id(1)), None];
        assert_eq!(positions_of(None, &mixed), [1.0]);
        assert_eq!(positions_of(Some(id(2)), &mixed), [] as [f64; 0]);
    }
}

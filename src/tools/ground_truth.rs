//! What is known of a recorded run besides what the engine makes of it: where the robot was, and where it believed to be.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_recording::container;
use posebridge_report::{PoseTrack, TimedPose};

use super::truth_file;
use crate::station::event_collector::MAX_INTERPOLATION_GAP;

/// Where the robot was, and where it believed to be, as far as the recording or a file beside it tells.
#[derive(Debug, Default)]
pub struct GroundTruth {
    /// The truth of a simulated run.
    pub truth: Option<PoseTrack>,
    /// The brick's own dead reckoning.
    pub odometry: Option<PoseTrack>,
}

impl GroundTruth {
    /// What a file tells; nothing if there is none.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn from_file(truth: Option<&Path>) -> Result<Self> {
        Ok(Self { truth: truth.map(truth_file::open).transpose()?, odometry: None })
    }

    /// What a file tells, else what the recording of this name and these bytes does.
    ///
    /// # Errors
    /// The file cannot be read, or the recorded truth is damaged.
    pub fn load(name: &str, recording: &[u8], truth: Option<&Path>) -> Result<Self> {
        if truth.is_some() {
            return Self::from_file(truth);
        }
        let samples = container::read_truth(recording)
            .with_context(|| format!("the truth in `{name}`; give another with --truth"))?;
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

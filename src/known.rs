//! What is known of a recorded run besides what the engine makes of it: where the robot was, and where it believed to be.

use std::path::Path;

use anyhow::{Context, Result};
use posebridge_analysis::{TimedPose, Track};
use posebridge_recording::container;

use crate::collect::LONGEST_GAP;
use crate::truth_file;

/// Where the robot was, and where it believed to be, as far as the recording or a file beside it tells.
#[derive(Debug, Default)]
pub struct Known {
    /// The truth of a simulated run.
    pub truth: Option<Track>,
    /// The brick's own dead reckoning.
    pub odometry: Option<Track>,
}

impl Known {
    /// What a file tells; nothing if there is none.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of_file(truth: Option<&Path>) -> Result<Self> {
        Ok(Self { truth: truth.map(truth_file::open).transpose()?, odometry: None })
    }

    /// What a file tells, else what the recording of this name and these bytes does.
    ///
    /// # Errors
    /// The file cannot be read, or the recorded truth is damaged.
    pub fn of(name: &str, recording: &[u8], truth: Option<&Path>) -> Result<Self> {
        if truth.is_some() {
            return Self::of_file(truth);
        }
        let samples =
            container::truth(recording).with_context(|| format!("the truth in `{name}`; give another with --truth"))?;
        if samples.is_empty() {
            return Ok(Self::default());
        }
        let of_truth = samples.iter().map(|sample| TimedPose { stamp: sample.stamp, pose: sample.pose });
        let believed =
            samples.iter().filter_map(|sample| Some(TimedPose { stamp: sample.stamp, pose: sample.odometry? }));
        let odometry = Track::new(believed, LONGEST_GAP);
        Ok(Self {
            truth: Some(Track::new(of_truth, LONGEST_GAP)),
            odometry: (!odometry.samples().is_empty()).then_some(odometry),
        })
    }
}

//! What a person changes about what the pose filter knows: nothing more about the place, nothing more about the robot, or no further.
//!
//! # Model
//! The constants are the rows of the calibration but the gyro's bias, which walks. Frozen they are taken as given: their rows and
//! columns of the covariance become zero, so that no update moves them and no step wears them, exactly as with a configured sigma of
//! zero. Their variances are kept aside and come back when they are learned again; what they had in common with other rows is lost.
//!
//! # Source
//! docs/maths/pose.md section 8.

use nalgebra::SVector;
use posebridge_telemetry::Learning;

use super::state::{FORWARD, GYRO_BIAS, HEADING, LEFT, Located, PoseState, Refused, constants_of, gyro_bias_prior};
use crate::filters::FilterConfig;
use crate::models::lie::Se2;

/// What a person changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Revision {
    /// Where the robot is, is not known any more.
    Pose,
    /// Whether the constants are learned.
    Learning(Learning),
    /// What was learned is forgotten.
    Calibration,
}

impl<const N: usize> PoseState<N> {
    pub(super) fn revise(&mut self, revision: Revision, config: &FilterConfig) {
        match revision {
            Revision::Pose => self.forget_pose(),
            Revision::Learning(Learning::Frozen) => self.freeze(config),
            Revision::Learning(Learning::Free) => self.thaw(),
            Revision::Calibration => self.forget_calibration(config),
        }
    }

    /// As at power-up: the pose counts from here, and the next fix says where that is.
    fn forget_pose(&mut self) {
        let before = self.arena_pose();
        self.forget_rows(&[FORWARD, LEFT, HEADING]);
        self.pose = Se2::default();
        self.close_window();
        self.located = Located::No;
        self.last_fix = None;
        self.refused = Refused::default();
        self.count_jump_from(before);
    }

    fn freeze(&mut self, config: &FilterConfig) {
        if self.frozen.is_some() {
            return;
        }
        let mut variances = SVector::zeros();
        for (row, _) in constants_of(&config.calibration).filter(|(row, _)| *row < N) {
            variances[row] = self.covariance[(row, row)];
            self.forget_rows(&[row]);
        }
        self.frozen = Some(variances);
    }

    fn thaw(&mut self) {
        if let Some(variances) = self.frozen.take() {
            for (row, variance) in variances.iter().enumerate() {
                self.covariance[(row, row)] += variance;
            }
        }
    }

    fn forget_calibration(&mut self, config: &FilterConfig) {
        let was_frozen = self.frozen.take().is_some();
        self.set_row(GYRO_BIAS, gyro_bias_prior(config));
        for (row, known) in constants_of(&config.calibration) {
            self.set_row(row, known);
        }
        if was_frozen {
            self.freeze(config);
        }
    }
}

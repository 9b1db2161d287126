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
use posebridge_telemetry::OnlineCalibration;

use super::state::{
    FORWARD, GYRO_BIAS, HEADING, LEFT, PoseState, PositionState, RejectedFixes, calibration_rows, gyro_bias_prior,
};
use crate::filter::FilterConfig;
use crate::models::lie::Se2;

/// What a person changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StateCommand {
    /// Where the robot is, is not known any more.
    ResetPose,
    /// Whether the constants are learned.
    SetOnlineCalibration(OnlineCalibration),
    /// What was learned is forgotten.
    ResetCalibration,
}

impl<const N: usize> PoseState<N> {
    pub(super) fn apply_command(&mut self, revision: StateCommand, config: &FilterConfig) {
        match revision {
            StateCommand::ResetPose => self.reset_pose(),
            StateCommand::SetOnlineCalibration(OnlineCalibration::Frozen) => self.freeze_calibration(config),
            StateCommand::SetOnlineCalibration(OnlineCalibration::Enabled) => self.resume_calibration(),
            StateCommand::ResetCalibration => self.reset_calibration(config),
        }
    }

    /// As at power-up: the pose counts from here, and the next fix says where that is.
    fn reset_pose(&mut self) {
        let before = self.arena_pose();
        self.clear_rows(&[FORWARD, LEFT, HEADING]);
        self.pose = Se2::default();
        self.close_window();
        self.position_state = PositionState::Unknown;
        self.last_fix = None;
        self.rejected_fixes = RejectedFixes::default();
        self.record_correction_from(before);
    }

    fn freeze_calibration(&mut self, config: &FilterConfig) {
        if self.frozen_variances.is_some() {
            return;
        }
        let mut variances = SVector::zeros();
        for (row, _) in calibration_rows(&config.calibration).filter(|(row, _)| *row < N) {
            variances[row] = self.covariance[(row, row)];
            self.clear_rows(&[row]);
        }
        self.frozen_variances = Some(variances);
    }

    fn resume_calibration(&mut self) {
        if let Some(variances) = self.frozen_variances.take() {
            for (row, variance) in variances.iter().enumerate() {
                self.covariance[(row, row)] += variance;
            }
        }
    }

    fn reset_calibration(&mut self, config: &FilterConfig) {
        let was_frozen = self.frozen_variances.take().is_some();
        self.set_row(GYRO_BIAS, gyro_bias_prior(config));
        for (row, known) in calibration_rows(&config.calibration) {
            self.set_row(row, known);
        }
        if was_frozen {
            self.freeze_calibration(config);
        }
    }
}

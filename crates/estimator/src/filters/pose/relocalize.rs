//! Initialisation of the pose filter by a fix, and the operator's commands.
//!
//! With H_x the derivatives of a fix's prediction by the pose's rows and H_o those by all others (delay, tag):
//! ```text
//! 0 = H_x xi + H_o o + n       xi = A o - H_x^-1 n        A = -H_x^-1 H_o
//! cov(xi, o) = A P_o           P_xi = A P_o A' + H_x^-1 R H_x^-T
//! ```
//! A heading that the fix does not contain is uniform on the circle. Left-invariant, the robot that turns about its tag
//! goes along a straight line in xi, so that this expresses exactly what is known.
//!
//! Source: docs/maths/pose.md section 4.

use std::f64::consts::PI;

use nalgebra::{Matrix3, SMatrix, SVector};
use posebridge_telemetry::{FusionOutcome, Heading, Meters, OnlineCalibration, Point2, ResetCause, StartPose};
use serde::{Deserialize, Serialize};

use super::context::UpdateContext;
use super::layout::{FORWARD, GYRO_BIAS, HEADING, LEFT, StateLayout};
use super::state::{PoseState, StateView, arena_pose, constant_rows};
use crate::filter::FilterConfig;
use crate::models::lie::Se2;
use crate::observations::fix::{self, FixMeasurement};
use crate::observations::{ObservationModel, PoseView, StateTerm};
use crate::update::LinearizedMeasurement;

/// Variance of an unknown heading, uniform on the circle, rad².
const ANY_HEADING_RAD2: f64 = PI * PI / 3.0;

/// Moves the estimate to a fix, the first or another; counts as a reset and stores the jump.
pub(super) fn reset_to_fix<const N: usize>(
    state: &mut PoseState<N>,
    measured: &FixMeasurement<'_>,
    layout: &StateLayout,
) -> FusionOutcome {
    let before = state.arena_pose();
    let cause = if state.is_located { ResetCause::Relocated } else { ResetCause::Located };
    // Without a heading in the fix the heading may be as wrong as the position was: it is estimated from scratch.
    if initialize_from_fix(state, measured, layout) == FusionOutcome::Malformed {
        return FusionOutcome::Malformed;
    }
    state.status.record_jump(cause, before, state.arena_pose());
    FusionOutcome::PoseReset
}

/// Takes the pose from a fix, for the tag's estimated position in the body and the instant of the exposure.
pub(super) fn initialize_from_fix<const N: usize>(
    state: &mut PoseState<N>,
    measured: &FixMeasurement<'_>,
    layout: &StateLayout,
) -> FusionOutcome {
    let (pose, model) = pose_of_fix(&state.view(layout), measured);
    state.initialize_pose(&StartPose { pose: arena_pose(pose), position_sigma_m: 0.0, heading_sigma_rad: 0.0 });
    state.pose = pose;
    set_covariance_from_fix(state, &layout.linearize(&model))
}

/// The pose that a fix speaks for, and the fix's model there. Without a heading the pose has that of the state, with the variance of
/// an unknown one.
pub(super) fn pose_of_fix<const N: usize>(
    view: &StateView<'_, N>,
    measured: &FixMeasurement<'_>,
) -> (Se2, ObservationModel<3>) {
    let fix = measured.fix;
    let moved = measured.exposure.moved_since;
    let shown_rad = fix.heading.map_or(view.pose().heading_rad - moved.heading_rad, Heading::rad);
    let mut corrected = *fix;
    let [x_m, y_m] = measured.unbiased_position(view);
    corrected.position = Point2::new(Meters(x_m), Meters(y_m));
    corrected.tag_in_body.x += Meters(view.term(StateTerm::TagForward));
    corrected.tag_in_body.y += Meters(view.term(StateTerm::TagLeft));
    let shown = fix::mid_axle(&corrected, shown_rad);
    let shown = Se2 { x_m: shown.x.0, y_m: shown.y.0, heading_rad: shown.heading.rad() };
    let pose = shown.compose(moved);
    let mut measured = *measured;
    if fix.heading.is_none() {
        measured.noise.heading_rad2 = ANY_HEADING_RAD2;
    }
    (pose, measured.pose_model(&view.at(pose), shown_rad))
}

/// The covariance of a pose that was taken from a fix, in the body, with the constants as certain.
pub(super) fn covariance_of_fix(model: &ObservationModel<3>) -> Option<Matrix3<f64>> {
    let by_pose = Matrix3::from_fn(|i, j| [model.rows[i].forward, model.rows[i].left, model.rows[i].heading][j]);
    let inverse = by_pose.try_inverse()?;
    Some(inverse * model.noise * inverse.transpose())
}

/// Sets the pose's covariance from the fix alone, with the resulting correlation with delay and tag.
fn set_covariance_from_fix<const N: usize>(
    state: &mut PoseState<N>,
    measurement: &LinearizedMeasurement<N, 3>,
) -> FusionOutcome {
    let by_pose = measurement.jacobian.fixed_view::<3, 3>(0, 0).into_owned();
    let Some(inverse) = by_pose.try_inverse() else {
        return FusionOutcome::Malformed;
    };
    // The pose's rows and columns are zero since it was placed, so that only the others enter.
    let by_others: SMatrix<f64, 3, N> = -inverse * measurement.jacobian;
    let cross = by_others * state.covariance;
    let of_pose = cross * by_others.transpose() + inverse * measurement.noise * inverse.transpose();
    for row in 0..3 {
        for column in 3..N {
            state.covariance[(row, column)] = cross[(row, column)];
            state.covariance[(column, row)] = cross[(row, column)];
        }
        for column in 0..=row {
            state.covariance[(row, column)] = of_pose[(row, column)];
            state.covariance[(column, row)] = of_pose[(row, column)];
        }
    }
    FusionOutcome::Accepted
}

// Commands of the operator: reset the pose, reset the calibration, freeze it.
//
// The constants are the rows of the calibration but the gyro's bias, which walks. Frozen they are taken as given: their rows and
// columns of the covariance become zero, so that no update moves them and no step wears them, exactly as with a configured sigma of
// zero. Their variances are kept aside and come back when they are learned again; what they had in common with other rows is lost.
// Source: docs/maths/pose.md section 8.

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum StateCommand {
    SetPose(StartPose),
    /// The pose is unknown until the next fix.
    ResetPose,
    SetOnlineCalibration(OnlineCalibration),
    /// Restart from the prior.
    ResetCalibration,
}

impl<const N: usize> PoseState<N> {
    pub(super) fn apply_command(&mut self, revision: StateCommand, context: &UpdateContext) {
        let (config, layout) = (&context.config, &context.layout);
        match revision {
            StateCommand::SetPose(start) => {
                let before = self.arena_pose();
                self.initialize_pose(&start);
                self.status.record_jump(ResetCause::Given, before, self.arena_pose());
            }
            StateCommand::ResetPose => self.reset_pose(),
            StateCommand::SetOnlineCalibration(OnlineCalibration::Frozen) => self.freeze_calibration(config, layout),
            StateCommand::SetOnlineCalibration(OnlineCalibration::Enabled) => self.resume_calibration(),
            StateCommand::ResetCalibration => self.reset_calibration(config, layout),
        }
    }

    /// As at power-up: the pose is relative to here until the next fix.
    fn reset_pose(&mut self) {
        let before = self.arena_pose();
        self.clear_rows(&[FORWARD, LEFT, HEADING]);
        self.pose = Se2::default();
        self.close_window();
        self.is_located = false;
        self.status.last_fix = None;
        self.forget_alternatives();
        self.status.record_jump(ResetCause::Discarded, before, self.arena_pose());
    }

    fn freeze_calibration(&mut self, config: &FilterConfig, layout: &StateLayout) {
        if self.frozen_variances.is_some() {
            return;
        }
        let mut variances = SVector::zeros();
        for (row, _) in constant_rows(&config.calibration, layout) {
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

    fn reset_calibration(&mut self, config: &FilterConfig, layout: &StateLayout) {
        let was_frozen = self.frozen_variances.take().is_some();
        self.set_row(GYRO_BIAS, config.gyro_bias_prior());
        for (row, known) in constant_rows(&config.calibration, layout) {
            self.set_row(row, known);
        }
        if was_frozen {
            self.freeze_calibration(config, layout);
        }
    }
}

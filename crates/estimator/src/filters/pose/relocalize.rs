//! Initialisation and relocalisation of the pose filter: by the first fix, or after the gate has rejected fixes for too
//! long.
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

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{FusionOutcome, FusionRecord, Heading, Meters, OnlineCalibration, Point2, StartPose};

use super::context::UpdateContext;
use super::layout::{FORWARD, GYRO_BIAS, HEADING, LEFT, StateLayout};
use super::state::{PoseState, RejectedFixes, constant_rows};
use crate::filter::FilterConfig;
use crate::models::lie::Se2;
use crate::observations::fix::{self, FixMeasurement};
use crate::observations::{PoseView, StateTerm};
use crate::params::Params;
use crate::update::LinearizedMeasurement;

/// Refused fixes agree with each other when their innovations differ by less than this many standard deviations.
const AGREEMENT_SIGMAS: f64 = 5.0;
/// Variance of an unknown heading, uniform on the circle, rad².
const ANY_HEADING_RAD2: f64 = PI * PI / 3.0;

/// Counts a rejected fix; the body has turned by `turned_since_rad` since its instant. True when enough rejected fixes
/// agree with each other for long enough that the estimate must be wrong.
pub(super) fn reject_fix<const N: usize>(
    state: &mut PoseState<N>,
    record: &FusionRecord,
    turned_since_rad: f64,
    params: &Params,
) -> bool {
    // In the arena, where fixes that stay at one place agree although the robot turns.
    let (sin, cos) = (state.pose.heading_rad - turned_since_rad).sin_cos();
    let [forward_m, left_m, _] = record.innovation;
    let innovation_m = [cos * forward_m - sin * left_m, sin * forward_m + cos * left_m];
    let last = state.rejected_fixes.innovation_m;
    let sigma_m = (record.innovation_covariance[0][0] + record.innovation_covariance[1][1]).max(0.0).sqrt();
    let apart_m = (innovation_m[0] - last[0]).hypot(innovation_m[1] - last[1]);
    let agrees = state.rejected_fixes.count == 0 || apart_m < AGREEMENT_SIGMAS * sigma_m;
    if !agrees {
        state.rejected_fixes = RejectedFixes::default();
    }
    state.rejected_fixes.count = state.rejected_fixes.count.saturating_add(1);
    state.rejected_fixes.since = state.rejected_fixes.since.or(state.stamp);
    state.rejected_fixes.innovation_m = innovation_m;
    let lasted_s = match (state.rejected_fixes.since, state.stamp) {
        (Some(since), Some(stamp)) => (stamp - since).as_secs_f64(),
        _ => 0.0,
    };
    lasted_s >= params.reset_after_s && f64::from(state.rejected_fixes.count) >= params.reset_after_fixes
}

/// Moves the estimate to a fix; counts as a reset and stores the jump.
pub(super) fn reset_to_fix<const N: usize>(
    state: &mut PoseState<N>,
    measured: &FixMeasurement<'_>,
    layout: &StateLayout,
) -> FusionOutcome {
    let before = state.arena_pose();
    // Without a heading in the fix the heading may be as wrong as the position was: it is estimated from scratch.
    if initialize_from_fix(state, measured, layout) == FusionOutcome::Malformed {
        return FusionOutcome::Malformed;
    }
    state.status.record_jump(before, state.arena_pose());
    FusionOutcome::PoseReset
}

/// Takes the pose from a fix, for the tag's estimated position in the body and the instant of the exposure.
pub(super) fn initialize_from_fix<const N: usize>(
    state: &mut PoseState<N>,
    measured: &FixMeasurement<'_>,
    layout: &StateLayout,
) -> FusionOutcome {
    let fix = measured.fix;
    let moved = measured.exposure.moved_since;
    let shown_rad = fix.heading.map_or(state.pose.heading_rad - moved.heading_rad, Heading::rad);
    let mut corrected = *fix;
    let [x_m, y_m] = measured.unbiased_position(&state.view(layout));
    corrected.position = Point2::new(Meters(x_m), Meters(y_m));
    corrected.tag_in_body.x += Meters(state.view(layout).term(StateTerm::TagForward));
    corrected.tag_in_body.y += Meters(state.view(layout).term(StateTerm::TagLeft));
    state.initialize_pose(&StartPose {
        pose: fix::mid_axle(&corrected, shown_rad),
        position_sigma_m: 0.0,
        heading_sigma_rad: 0.0,
    });
    state.pose = state.pose.compose(moved);
    let mut measured = *measured;
    if fix.heading.is_none() {
        measured.noise.heading_rad2 = ANY_HEADING_RAD2;
    }
    let model = measured.pose_model(&state.view(layout), shown_rad);
    set_covariance_from_fix(state, &layout.linearize(&model))
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

#[derive(Clone, Copy, Debug, PartialEq)]
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
                self.status.record_jump(before, self.arena_pose());
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
        self.rejected_fixes = RejectedFixes::default();
        self.status.record_jump(before, self.arena_pose());
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

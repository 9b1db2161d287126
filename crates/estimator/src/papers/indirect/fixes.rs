//! Fixes against the nominal path, and the poses at which it is put down.

use posebridge_telemetry::{
    Arena, BrickClock, Fix, FusionOutcome, FusionRecord, Pose, Timestamp, quantities::wrap_rad,
};

use super::error_state::{DISTANCE, HEADING, N, X, Y, clear_row};
use super::nominal_path::NominalPath;
use crate::filter::StartPose;
use crate::fusion_records::write_innovation;
use crate::numerics::chi_square::chi_square_quantile;
use crate::observations::fix::{FixContext, FixNoise, fix_noise, mid_axle};
use crate::papers::arena_fix::{position_in_arena, with_heading};
use crate::update::{LinearizedMeasurement, apply_measurement};
use crate::validation::{self, RESTART_HEADING_SIGMA_RAD, RESTART_POSITION_SIGMA_M};

/// Heading of a robot whose first fix had none: uniform on the circle, rad².
const UNKNOWN_HEADING_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

impl NominalPath {
    /// Uses a fix against the path as it is, however late the fix came.
    pub(super) fn use_fix(&mut self, record: &mut FusionRecord, fix: &Fix, stamp_sigma_s: f64) -> FusionOutcome {
        let noise = self.fix_noise(fix, stamp_sigma_s);
        // dz - H e: paper 4's linearisation about the nominal path.
        let path = [self.x_m, self.y_m, self.end.angle_rad];
        let (dz, jacobian) = position_in_arena(path, [X, Y, HEADING], fix);
        let position =
            LinearizedMeasurement { innovation: dz - jacobian * self.errors, jacobian, noise: noise.position };
        let verdict = if let Some(heading) = fix.heading {
            let turn_rad = wrap_rad(heading.rad() - self.end.angle_rad - self.errors[HEADING]);
            let full = with_heading(&position, HEADING, turn_rad, noise.heading_rad2);
            self.apply_measurement(record, &full)
        } else {
            self.apply_measurement(record, &position)
        };
        self.apply_feedback();
        verdict
    }

    fn apply_measurement<const M: usize>(
        &mut self,
        record: &mut FusionRecord,
        measurement: &LinearizedMeasurement<N, M>,
    ) -> FusionOutcome {
        let s = measurement.innovation_covariance(&self.covariance);
        if !write_innovation(record, &measurement.innovation, &s) {
            return FusionOutcome::Malformed;
        }
        if record.nis > chi_square_quantile(M as u64, self.config.params.gate_probability) {
            return FusionOutcome::Gated;
        }
        if apply_measurement(&mut self.errors, &mut self.covariance, measurement) {
            FusionOutcome::Accepted
        } else {
            FusionOutcome::Malformed
        }
    }

    fn fix_noise(&self, fix: &Fix, stamp_sigma_s: f64) -> FixNoise {
        let circumstances = FixContext {
            stamp_sigma_s,
            forward_m_per_s: self.forward_m_per_s,
            turn_rad_per_s: self.turn_rad_per_s,
            ..FixContext::default()
        };
        fix_noise(fix, &self.config.noise, [1.0, 1.0], &circumstances)
    }

    pub(super) fn record_fix_time(&mut self, stamp: Timestamp<BrickClock>) {
        self.last_fix = self.last_fix.max(Some(stamp));
    }

    /// The robot is where a fix sees it: the first fix, or the one that ends a long disagreement.
    pub(super) fn initialize_from_fix(&mut self, fix: &Fix) {
        let noise = self.fix_noise(fix, 0.0);
        let before = self.pose();
        let (heading_rad, heading_rad2) = match fix.heading {
            Some(heading) => (heading.rad(), noise.heading_rad2),
            None if self.is_placed => (before.heading.rad(), self.covariance[(HEADING, HEADING)]),
            None => (before.heading.rad(), UNKNOWN_HEADING_RAD2),
        };
        self.relocate(&mid_axle(fix, heading_rad));
        for (i, row) in [X, Y].into_iter().enumerate() {
            for (j, column) in [X, Y].into_iter().enumerate() {
                self.covariance[(row, column)] = noise.position[(i, j)];
            }
        }
        self.covariance[(HEADING, HEADING)] = heading_rad2;
        self.record_correction(before);
    }

    /// The robot is where a person says.
    pub(super) fn set_pose(&mut self, start: &StartPose) {
        let before = self.pose();
        self.reset_to(start);
        self.record_correction(before);
    }

    pub(super) fn reset_to(&mut self, start: &StartPose) {
        self.relocate(&start.pose);
        for row in [X, Y] {
            self.covariance[(row, row)] = start.position_sigma_m.powi(2);
        }
        self.covariance[(HEADING, HEADING)] = start.heading_sigma_rad.powi(2);
    }

    /// The path jumps; the instruments, which stood for the old heading, begin anew.
    fn relocate(&mut self, pose: &Pose<Arena>) {
        self.x_m = pose.x.0;
        self.y_m = pose.y.0;
        self.end.angle_rad = pose.heading.rad();
        self.debounced_angle_rad = self.end.angle_rad;
        self.previous = None;
        for row in [X, Y, HEADING, DISTANCE] {
            clear_row(&mut self.errors, &mut self.covariance, row);
        }
        self.reset_instruments();
        self.is_placed = true;
    }

    fn record_correction(&mut self, before: Pose<Arena>) {
        self.reset_counter = self.reset_counter.wrapping_add(1);
        self.last_jump = Some(validation::correction_between(before, self.pose()));
    }

    /// Nothing that was stamped holds any longer, and the robot may have been carried.
    pub(super) fn restart_clock(&mut self) {
        self.reset_instruments();
        self.stamp = None;
        self.previous = None;
        self.last_motion = None;
        self.last_fix = None;
        self.forward_m_per_s = 0.0;
        self.turn_rad_per_s = 0.0;
        for (row, sigma) in
            [(X, RESTART_POSITION_SIGMA_M), (Y, RESTART_POSITION_SIGMA_M), (HEADING, RESTART_HEADING_SIGMA_RAD)]
        {
            self.covariance[(row, row)] += sigma * sigma;
        }
    }
}

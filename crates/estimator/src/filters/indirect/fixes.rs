//! Fixes against the nominal path, and the poses at which it is put down.

use posebridge_telemetry::{Arena, BrickClock, Fix, FusionRecord, Pose, Stamp, Verdict, quantities::wrap_rad};

use super::error_state::{DISTANCE, HEADING, N, X, Y, clear_row};
use super::nominal::Path;
use crate::filters::StartPose;
use crate::filters::intake::{self, RESTART_HEADING_RAD, RESTART_POSITION_M};
use crate::filters::records::write_innovation;
use crate::gate::chi_square_quantile;
use crate::observations::fix::{Circumstances, FixNoise, mid_axle, noise_of, position_in_arena, with_heading};
use crate::update::{Measurement, apply};

/// Heading of a robot whose first fix had none: uniform on the circle, rad².
const UNKNOWN_HEADING_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

impl Path {
    /// Uses a fix against the path as it is, however late the fix came.
    pub(super) fn use_fix(&mut self, record: &mut FusionRecord, fix: &Fix, stamp_sigma_s: f64) -> Verdict {
        let noise = self.noise_of(fix, stamp_sigma_s);
        // dz - H e: paper 4's linearisation about the nominal path.
        let path = [self.x_m, self.y_m, self.end.angle_rad];
        let (dz, jacobian) = position_in_arena(path, [X, Y, HEADING], fix);
        let position = Measurement { innovation: dz - jacobian * self.errors, jacobian, noise: noise.position };
        let verdict = if let Some(heading) = fix.heading {
            let turn_rad = wrap_rad(heading.rad() - self.end.angle_rad - self.errors[HEADING]);
            let full = with_heading(&position, HEADING, (turn_rad, noise.heading_rad2));
            self.fuse(record, &full)
        } else {
            self.fuse(record, &position)
        };
        self.feed_back();
        verdict
    }

    fn fuse<const M: usize>(&mut self, record: &mut FusionRecord, measurement: &Measurement<N, M>) -> Verdict {
        let s = measurement.innovation_covariance(&self.covariance);
        if !write_innovation(record, &measurement.innovation, &s) {
            return Verdict::Malformed;
        }
        if record.nis > chi_square_quantile(M as u8, self.config.params.gate_probability) {
            return Verdict::Gated;
        }
        if apply(&mut self.errors, &mut self.covariance, measurement) { Verdict::Accepted } else { Verdict::Malformed }
    }

    fn noise_of(&self, fix: &Fix, stamp_sigma_s: f64) -> FixNoise {
        let circumstances = Circumstances {
            stamp_sigma_s,
            forward_m_per_s: self.forward_m_per_s,
            turn_rad_per_s: self.turn_rad_per_s,
            ..Circumstances::default()
        };
        noise_of(fix, &self.config.noise, [1.0, 1.0], &circumstances)
    }

    pub(super) fn note_fix(&mut self, stamp: Stamp<BrickClock>) {
        self.fixed = self.fixed.max(Some(stamp));
    }

    /// The robot is where a fix sees it: the first fix, or the one that ends a long disagreement.
    pub(super) fn place(&mut self, fix: &Fix) {
        let noise = self.noise_of(fix, 0.0);
        let before = self.pose();
        let (heading_rad, heading_rad2) = match fix.heading {
            Some(heading) => (heading.rad(), noise.heading_rad2),
            None if self.is_placed => (before.heading.rad(), self.covariance[(HEADING, HEADING)]),
            None => (before.heading.rad(), UNKNOWN_HEADING_RAD2),
        };
        self.move_to(&mid_axle(fix, heading_rad));
        for (i, row) in [X, Y].into_iter().enumerate() {
            for (j, column) in [X, Y].into_iter().enumerate() {
                self.covariance[(row, column)] = noise.position[(i, j)];
            }
        }
        self.covariance[(HEADING, HEADING)] = heading_rad2;
        self.count_jump(before);
    }

    /// The robot is where a person says.
    pub(super) fn set(&mut self, start: &StartPose) {
        let before = self.pose();
        self.put(start);
        self.count_jump(before);
    }

    pub(super) fn put(&mut self, start: &StartPose) {
        self.move_to(&start.pose);
        for row in [X, Y] {
            self.covariance[(row, row)] = start.position_sigma_m.powi(2);
        }
        self.covariance[(HEADING, HEADING)] = start.heading_sigma_rad.powi(2);
    }

    /// The path jumps; the instruments, which stood for the old heading, begin anew.
    fn move_to(&mut self, pose: &Pose<Arena>) {
        self.x_m = pose.x.0;
        self.y_m = pose.y.0;
        self.end.angle_rad = pose.heading.rad();
        self.settled_rad = self.end.angle_rad;
        self.before = None;
        for row in [X, Y, HEADING, DISTANCE] {
            clear_row(&mut self.errors, &mut self.covariance, row);
        }
        self.forget_instruments();
        self.is_placed = true;
    }

    fn count_jump(&mut self, before: Pose<Arena>) {
        self.reset_counter = self.reset_counter.wrapping_add(1);
        self.last_jump = Some(intake::jump_between(before, self.pose()));
    }

    /// Nothing that was stamped holds any longer, and the robot may have been carried.
    pub(super) fn restart_clock(&mut self) {
        self.forget_instruments();
        self.stamp = None;
        self.before = None;
        self.moved = None;
        self.fixed = None;
        self.forward_m_per_s = 0.0;
        self.turn_rad_per_s = 0.0;
        for (row, sigma) in [(X, RESTART_POSITION_M), (Y, RESTART_POSITION_M), (HEADING, RESTART_HEADING_RAD)] {
            self.covariance[(row, row)] += sigma * sigma;
        }
    }
}

//! The state of the pose filter and how it moves.
//!
//! # Model
//! ```text
//! x = [x, y, th, v, w, b_g, W]'       7 x 1: m, m, rad, m/s, rad/s, rad/s, rad
//! known travel    pose as models::se2, noise of the turn on th and, the same noise, on W
//! unknown travel  pose by v and w; v and w walk at random
//! b_g             walks at random
//! ```
//! # Source
//! docs/maths/pose.md sections 1 to 3.

use nalgebra::{Matrix2, SMatrix, SVector};
use posebridge_telemetry::{
    Arena, BrickClock, Heading, Meters, Pose, PoseJump, Span, Stamp, quantities::wrap_rad,
};

use crate::filters::intake::{RESTART_HEADING_RAD, RESTART_POSITION_M, jump_between};
use crate::filters::{FilterConfig, StartPose};
use crate::models::differential_drive::{WheelTravel, body_step, step_noise};
use crate::models::se2::{BodyStep, StepRule, displace};
use crate::motion::{Leg, MotionTrack};
use crate::observations::gyro_window::{GyroWindow, Moved};

/// Number of states.
pub const N: usize = 7;
/// x in the arena, m.
pub const X: usize = 0;
/// y in the arena, m.
pub const Y: usize = 1;
/// Heading, rad, wrapped.
pub const HEADING: usize = 2;
/// Forward speed, m/s.
pub const FORWARD: usize = 3;
/// Turn rate, rad/s.
pub const TURN: usize = 4;
/// Gyro bias, rad/s.
pub const GYRO_BIAS: usize = 5;
/// Sum of the encoder heading's errors since the gyro window began, rad.
pub const WINDOW_ERROR: usize = 6;

/// Mean of the state.
pub type Mean = SVector<f64, N>;
/// Covariance of the state.
pub type Covariance = SMatrix<f64, N, N>;

/// Speeds are held no longer than this after the last motion observation.
const HOLD: Span = Span::from_millis(500);
/// What a robot may do while nothing tells of its motion: it walks at random with this speed, m/s per sqrt(s). A LEGO robot's
/// walking pace.
const UNSEEN_M_PER_SQRT_S: f64 = 0.3;
/// The same for its heading, rad per sqrt(s).
const UNSEEN_RAD_PER_SQRT_S: f64 = 1.0;

/// How far the filter knows where in the arena it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Located {
    /// Nothing absolute is known; x, y and heading count from where the robot was switched on.
    No,
    /// One position is known, the heading not yet: x and y are right at the anchor, the path since is turned by an unknown angle.
    Anchored {
        /// Where in the filter's own plane the anchor lies, m.
        x_m: f64,
        /// See `x_m`.
        y_m: f64,
    },
    /// Position and heading are known.
    Yes,
}

/// Fixes refused in a row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Refused {
    /// How many.
    pub count: u32,
    /// The stamp of the first of them.
    pub since: Option<Stamp<BrickClock>>,
    /// Innovation of the last of them, m.
    pub innovation_m: [f64; 2],
}

/// Everything that a replay must restore.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseState {
    /// For which instant it holds; `None` before the first observation.
    pub stamp: Option<Stamp<BrickClock>>,
    /// The mean.
    pub mean: Mean,
    /// The covariance.
    pub covariance: Covariance,
    /// The gyro window that is open, if any.
    pub window: Option<GyroWindow>,
    /// How far it is located.
    pub located: Located,
    /// The stamp of the last fix that was used.
    pub last_fix: Option<Stamp<BrickClock>>,
    /// The stamp of the last motion observation.
    pub last_motion: Option<Stamp<BrickClock>>,
    /// Fixes refused since the last one that was used.
    pub refused: Refused,
    /// Counts jumps that are not motion.
    pub reset_counter: u8,
    /// The last of them.
    pub last_jump: Option<PoseJump>,
}

impl PoseState {
    /// The state before any observation.
    #[must_use]
    pub fn initial(config: &FilterConfig) -> Self {
        let mut state = Self {
            stamp: None,
            mean: Mean::zeros(),
            covariance: Covariance::zeros(),
            window: None,
            located: Located::No,
            last_fix: None,
            last_motion: None,
            refused: Refused::default(),
            reset_counter: 0,
            last_jump: None,
        };
        // At power-up a robot stands, so far as anybody knows: 0.1 m/s and 1 rad/s are generous.
        state.covariance[(FORWARD, FORWARD)] = 0.01;
        state.covariance[(TURN, TURN)] = 1.0;
        state.covariance[(GYRO_BIAS, GYRO_BIAS)] = config.noise.gyro_bias_rad_per_s.powi(2);
        if let Some(start) = &config.start {
            state.place(start);
        }
        state
    }

    /// Where the robot is believed to be.
    #[must_use]
    pub fn pose(&self) -> Pose<Arena> {
        Pose::new(
            Meters(self.mean[X]),
            Meters(self.mean[Y]),
            Heading::from_rad(self.mean[HEADING]),
        )
    }

    /// Puts the robot somewhere; counted as a jump that is not motion.
    pub fn jump_to(&mut self, start: &StartPose) {
        let before = self.pose();
        self.place(start);
        self.count_jump_from(before);
    }

    /// Counts a jump that is not motion, from `before` to the pose that is now believed.
    pub fn count_jump_from(&mut self, before: Pose<Arena>) {
        self.reset_counter = self.reset_counter.wrapping_add(1);
        self.last_jump = Some(jump_between(before, self.pose()));
    }

    /// The brick was switched off and on: its speeds and its gyro's bias are as unknown as in the `fresh` state, and it may have
    /// been carried a little.
    pub fn restart_clock(&mut self, fresh: &Self) {
        for row in [FORWARD, TURN, GYRO_BIAS] {
            self.forget_rows(&[row]);
            self.mean[row] = fresh.mean[row];
            self.covariance[(row, row)] = fresh.covariance[(row, row)];
        }
        self.covariance[(X, X)] += RESTART_POSITION_M.powi(2);
        self.covariance[(Y, Y)] += RESTART_POSITION_M.powi(2);
        self.covariance[(HEADING, HEADING)] += RESTART_HEADING_RAD.powi(2);
        self.close_window();
        self.stamp = None;
        self.last_fix = None;
        self.last_motion = None;
        self.refused = Refused::default();
    }

    /// Puts the robot somewhere; what was known about its pose is forgotten.
    pub fn place(&mut self, start: &StartPose) {
        self.forget_rows(&[X, Y, HEADING, WINDOW_ERROR]);
        self.mean[X] = start.pose.x.0;
        self.mean[Y] = start.pose.y.0;
        self.mean[HEADING] = start.pose.heading.rad();
        self.mean[WINDOW_ERROR] = 0.0;
        self.covariance[(X, X)] = start.position_sigma_m.powi(2);
        self.covariance[(Y, Y)] = start.position_sigma_m.powi(2);
        self.covariance[(HEADING, HEADING)] = start.heading_sigma_rad.powi(2);
        self.window = None;
        self.located = Located::Yes;
        self.refused = Refused::default();
    }

    /// Makes rows certain and independent of all others.
    pub fn forget_rows(&mut self, rows: &[usize]) {
        for &row in rows {
            self.covariance.row_mut(row).fill(0.0);
            self.covariance.column_mut(row).fill(0.0);
        }
    }

    /// Closes the gyro window; the next one begins at the same instant.
    pub fn restart_window(&mut self, at: Stamp<BrickClock>) {
        self.close_window();
        self.window = Some(GyroWindow::starting(at));
    }

    fn close_window(&mut self) {
        self.forget_rows(&[WINDOW_ERROR]);
        self.mean[WINDOW_ERROR] = 0.0;
        self.window = None;
    }

    /// Carries the state forward to `to`: by the known travel as far as it reaches, then by the held speeds.
    pub fn advance(&mut self, to: Stamp<BrickClock>, track: &MotionTrack, config: &FilterConfig) {
        let Some(from) = self.stamp else {
            self.stamp = Some(to);
            return;
        };
        if to <= from {
            return;
        }
        let mut at = from;
        while at < to {
            at = match track.leg(at, to) {
                Leg::Known {
                    until,
                    travel,
                    path_var_m2,
                } => {
                    self.move_by_travel(travel, until, config);
                    self.covariance[(X, X)] += path_var_m2;
                    self.covariance[(Y, Y)] += path_var_m2;
                    until
                }
                Leg::Gap { until } => {
                    // What the gyro says about a window means nothing without the encoders' turn over all of it.
                    self.close_window();
                    self.move_unseen(at, until, config);
                    until
                }
                Leg::Ahead { until } => {
                    self.move_unseen(at, until, config);
                    until
                }
            };
        }
        let dt_s = (to - from).as_secs_f64();
        let walk = config.noise.gyro_bias_walk_rad_per_s_sqrt_s;
        self.covariance[(FORWARD, FORWARD)] += config.params.acceleration_m_per_s2.powi(2) * dt_s;
        self.covariance[(TURN, TURN)] += config.params.turn_acceleration_rad_per_s2.powi(2) * dt_s;
        self.covariance[(GYRO_BIAS, GYRO_BIAS)] += walk * walk * dt_s;
        self.mean[HEADING] = wrap_rad(self.mean[HEADING]);
        crate::update::symmetrise(&mut self.covariance);
        self.stamp = Some(to);
    }

    fn move_by_travel(
        &mut self,
        travel: WheelTravel,
        to: Stamp<BrickClock>,
        config: &FilterConfig,
    ) {
        let step = body_step(travel, &config.geometry);
        let noise = step_noise(travel, &config.geometry, &config.noise);
        let moved = displace(self.mean[HEADING], step, StepRule::Arc);
        let mut by_state = Covariance::identity();
        by_state[(X, HEADING)] = moved.by_heading[0];
        by_state[(Y, HEADING)] = moved.by_heading[1];
        let mut by_noise = SMatrix::<f64, N, 2>::zeros();
        for (row, axis) in [(X, 0), (Y, 1)] {
            by_noise[(row, 0)] = moved.by_forward[axis];
            by_noise[(row, 1)] = moved.by_turn[axis];
        }
        by_noise[(HEADING, 1)] = 1.0;
        // Without an open window nobody asks for the sum of the errors.
        by_noise[(WINDOW_ERROR, 1)] = if self.window.is_some() { 1.0 } else { 0.0 };
        let q = Matrix2::new(
            noise.forward_var_m2,
            noise.forward_turn_m_rad,
            noise.forward_turn_m_rad,
            noise.turn_var_rad2,
        );
        self.covariance =
            by_state * self.covariance * by_state.transpose() + by_noise * q * by_noise.transpose();
        self.mean[X] += moved.dx_m;
        self.mean[Y] += moved.dy_m;
        self.mean[HEADING] += step.turn_rad;
        if let Some(window) = &mut self.window {
            window.encoder_turn_rad += step.turn_rad;
            window.encoder_forward_m += step.forward_m;
            window.until = to;
            if travel.left_m != 0.0 || travel.right_m != 0.0 {
                window.moved = Moved::Yes;
            }
        }
    }

    fn move_unseen(
        &mut self,
        from: Stamp<BrickClock>,
        to: Stamp<BrickClock>,
        config: &FilterConfig,
    ) {
        let held_to = self
            .last_motion
            .map_or(from, |last| (last + HOLD).clamp(from, to));
        let held_s = (held_to - from).as_secs_f64();
        if held_s > 0.0 {
            self.move_by_speeds(held_s, config);
        }
        let unseen_s = (to - held_to).as_secs_f64();
        self.covariance[(X, X)] += UNSEEN_M_PER_SQRT_S.powi(2) * unseen_s;
        self.covariance[(Y, Y)] += UNSEEN_M_PER_SQRT_S.powi(2) * unseen_s;
        self.covariance[(HEADING, HEADING)] += UNSEEN_RAD_PER_SQRT_S.powi(2) * unseen_s;
    }

    fn move_by_speeds(&mut self, dt_s: f64, config: &FilterConfig) {
        let step = BodyStep {
            forward_m: self.mean[FORWARD] * dt_s,
            turn_rad: self.mean[TURN] * dt_s,
        };
        let moved = displace(self.mean[HEADING], step, StepRule::Arc);
        let mut by_state = Covariance::identity();
        for (row, axis) in [(X, 0), (Y, 1)] {
            by_state[(row, HEADING)] = moved.by_heading[axis];
            by_state[(row, FORWARD)] = moved.by_forward[axis] * dt_s;
            by_state[(row, TURN)] = moved.by_turn[axis] * dt_s;
        }
        by_state[(HEADING, TURN)] = dt_s;
        self.covariance = by_state * self.covariance * by_state.transpose();
        // Integrated random walks of the speeds: variance a² dt³ / 3.
        let cubed = dt_s.powi(3) / 3.0;
        let along = config.params.acceleration_m_per_s2.powi(2) * cubed;
        let (sin, cos) = self.mean[HEADING].sin_cos();
        self.covariance[(X, X)] += along * cos * cos;
        self.covariance[(Y, Y)] += along * sin * sin;
        self.covariance[(X, Y)] += along * sin * cos;
        self.covariance[(Y, X)] += along * sin * cos;
        self.covariance[(HEADING, HEADING)] +=
            config.params.turn_acceleration_rad_per_s2.powi(2) * cubed;
        self.mean[X] += moved.dx_m;
        self.mean[Y] += moved.dy_m;
        self.mean[HEADING] += step.turn_rad;
    }
}

//! How the state of the pose filter moves: by the known travel of the wheels, else by the held speeds.
//!
//! ```text
//! X <- X exp((d, 0), dth)               d, dth from the wheels with the learned radii and track
//! xi <- Ad(step^-1) xi + G (d, dth)'s errors            psi <- psi + dth
//! ```
//! The errors' motion does not depend on where the robot is or points: therefore the filter works with an unknown
//! heading.
//!
//! Source: docs/maths/pose.md section 2; Barrau and Bonnabel (2017).

use nalgebra::{Matrix3, SMatrix};
use posebridge_telemetry::{BrickClock, DriveGeometry, TimeDelta, Timestamp};

use super::context::UpdateContext;
use super::layout::{BACKLASH, DIFFERENCE, FORWARD, GYRO_BIAS, HEADING, LEFT, RADIUS, TRACK, WINDOW_TURN};
use super::recovery::BodyMotion;
use super::state::PoseState;
use crate::filter::FilterConfig;
use crate::models::differential_drive::{StepNoise, WheelTravel, calibrated_step, step_noise};
use crate::models::lie::{ArcStep, Se2};
use crate::models::se2::BodyStep;
use crate::motion::{BacklashCrossing, SPEED_HOLD, TravelSegment, UNOBSERVED_M_PER_SQRT_S, UNOBSERVED_RAD_PER_SQRT_S};

/// Accelerations measured longer ago than this do not predict the speeds.
const ACCELERATION_HOLD: TimeDelta = TimeDelta::from_millis(200);
/// How a delay changes, s per sqrt(s): quartz clocks run apart by up to 100 us in a second.
const DELAY_WALK_S_PER_SQRT_S: f64 = 3e-4;
/// The path that counts for a robot whose motion is not observed: a slow walk.
const UNSEEN_PATH_M_PER_S: f64 = 0.1;
/// Speeds at an earlier instant are means over this interval around it: two readings of a 20 Hz brick.
const SPEED_WINDOW: TimeDelta = TimeDelta::from_millis(100);

/// The propagation of errors over a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    pub step: ArcStep,
    /// Derivatives by the errors of mean radius, of the difference of radii and of the track, and by the backlash.
    pub turn_by_constants: [f64; 4],
    /// By the same; the track's error does not change the distance.
    pub forward_by_constants: [f64; 4],
    /// 1 if the turn counts for an open gyro window, else 0: only then the turn since its start is a state.
    pub window_share: f64,
}

impl Transition {
    /// A step over known travel with the learned radii, track and backlash: its distance, its turn, and what they depend on.
    /// `crossings` are those of the left and the right gear.
    pub fn over_travel<const N: usize>(
        travel: WheelTravel,
        crossings: [BacklashCrossing; 2],
        state: &PoseState<N>,
        geometry: &DriveGeometry,
    ) -> (Self, f64, f64) {
        let scales = [RADIUS, DIFFERENCE, TRACK].map(|row| state.mean[row]);
        let [left, right] = wheel_radii_m(geometry);
        let by_backlash = [left * crossings[0].share, right * crossings[1].share];
        let backlash_rad = state.mean[BACKLASH];
        let travel = WheelTravel {
            left_m: travel.left_m - backlash_rad * by_backlash[0],
            right_m: travel.right_m - backlash_rad * by_backlash[1],
        };
        let moved = calibrated_step(travel, geometry, scales);
        let lost = WheelTravel { left_m: -by_backlash[0], right_m: -by_backlash[1] };
        let crossed = calibrated_step(lost, geometry, scales).step;
        let with_backlash = |[mean, difference, track]: [f64; 3], backlash: f64| [mean, difference, track, backlash];
        let BodyStep { forward_m, turn_rad } = moved.step;
        let transition = Self {
            step: ArcStep::new(forward_m, turn_rad),
            forward_by_constants: with_backlash(moved.forward_by_scales, crossed.forward_m),
            turn_by_constants: with_backlash(moved.turn_by_scales, crossed.turn_rad),
            window_share: state.window.map_or(0.0, |_| 1.0),
        };
        (transition, forward_m, turn_rad)
    }

    /// A step at held speeds.
    pub fn at_speeds(forward_m: f64, turn_rad: f64) -> Self {
        Self {
            step: ArcStep::new(forward_m, turn_rad),
            forward_by_constants: [0.0; 4],
            turn_by_constants: [0.0; 4],
            window_share: 0.0,
        }
    }

    /// Propagates errors, given row by row, into the [`MOVED_ROWS`].
    #[inline]
    fn propagate_error(&self, error: impl Fn(usize) -> f64) -> [f64; 4] {
        let step = &self.step;
        let (mean, difference, backlash) = (error(RADIUS), error(DIFFERENCE), error(BACKLASH));
        let by_forward = &self.forward_by_constants;
        let along = mean * by_forward[0] + difference * by_forward[1] + backlash * by_forward[3];
        let by_turn = &self.turn_by_constants;
        let turned = mean * by_turn[0] + difference * by_turn[1] + error(TRACK) * by_turn[2] + backlash * by_turn[3];
        let heading = error(HEADING);
        let x = error(FORWARD) - heading * step.motion.y_m;
        let y = error(LEFT) + heading * step.motion.x_m;
        [
            x * step.cos + y * step.sin + along * step.by_forward[0] + turned * step.by_turn[0],
            y * step.cos - x * step.sin + along * step.by_forward[1] + turned * step.by_turn[1],
            heading + turned,
            error(WINDOW_TURN) + turned * self.window_share,
        ]
    }

    /// P <- F P F' + G q G'. Only `MOVED_ROWS` and their columns change: F P is formed for these, and of its
    /// product with F' only the block where they meet. A row of P is read as the column that it equals, which lies in
    /// one piece in memory.
    pub fn propagate<const N: usize>(&self, p: &mut SMatrix<f64, N, N>, noise: &StepNoise) {
        let mut rows = [[0.0; N]; 4];
        for i in 0..N {
            let moved = self.propagate_error(|row| p[(i, row)]);
            for (row, moved) in rows.iter_mut().zip(moved) {
                row[i] = moved;
            }
        }
        let q = self.noise(noise);
        for (&row, values) in MOVED_ROWS.iter().zip(&rows) {
            p.column_mut(row).copy_from_slice(values);
            for column in 0..N {
                p[(row, column)] = values[column];
            }
        }
        for (i, &row) in MOVED_ROWS.iter().enumerate() {
            let meeting = self.propagate_error(|column| rows[i][column]);
            for (j, &column) in MOVED_ROWS.iter().enumerate().take(i + 1) {
                let value = meeting[j] + q[i][j];
                p[(row, column)] = value;
                p[(column, row)] = value;
            }
        }
    }

    /// G q G' in the rows that move.
    fn noise(&self, noise: &StepNoise) -> [[f64; 4]; 4] {
        let step = &self.step;
        let along = [step.by_forward[0], step.by_forward[1], 0.0, 0.0];
        let turned = [step.by_turn[0], step.by_turn[1], 1.0, self.window_share];
        let mut q = [[0.0; 4]; 4];
        for (i, row) in q.iter_mut().enumerate() {
            let by_forward = noise.forward_var_m2 * along[i] + noise.forward_turn_m_rad * turned[i];
            let by_turn = noise.forward_turn_m_rad * along[i] + noise.turn_var_rad2 * turned[i];
            for (j, value) in row.iter_mut().enumerate() {
                *value = by_forward * along[j] + by_turn * turned[j];
            }
        }
        q
    }
}

/// Nominal, left first.
const fn wheel_radii_m(geometry: &DriveGeometry) -> [f64; 2] {
    [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0]
}

const MOVED_ROWS: [usize; 4] = [FORWARD, LEFT, HEADING, WINDOW_TURN];

impl<const N: usize> PoseState<N> {
    /// Propagates the state to `to`: by the known travel as far as it reaches, then by the held speeds.
    pub fn advance(&mut self, to: Timestamp<BrickClock>, context: &UpdateContext) {
        let config = &context.config;
        let Some(from) = self.stamp else {
            self.stamp = Some(to);
            self.predict_speeds_and_bias(to, context);
            return;
        };
        if to <= from {
            return;
        }
        let mut at = from;
        while at < to {
            at = match context.track.segment(at, to) {
                TravelSegment::Known { until, travel, crossings, path_var_m2 } => {
                    self.move_by_travel(travel, crossings, (at, until), context);
                    self.inflate_pose_covariance(path_var_m2, 0.0);
                    until
                }
                TravelSegment::Gap { until } => {
                    // The gyro readings of a window mean nothing without the encoders' turn over all of it.
                    self.close_window();
                    self.move_unobserved(at, until, config);
                    until
                }
                TravelSegment::BeyondData { until } => {
                    self.move_unobserved(at, until, config);
                    until
                }
            };
        }
        self.predict_speeds_and_bias(to, context);
        self.stamp = Some(to);
    }

    /// Ages speeds, gyro bias and delays up to an instant, which may lie ahead of the pose's.
    pub fn predict_speeds_and_bias(&mut self, to: Timestamp<BrickClock>, context: &UpdateContext) {
        let config = &context.config;
        let from = self.speeds_predicted_to.unwrap_or(to);
        self.speeds_predicted_to = Some(from.max(to));
        let dt_s = (to - from).as_secs_f64();
        if dt_s <= 0.0 {
            return;
        }
        // While accelerations are measured, the speeds do not walk.
        let walks_from = self.last_acceleration.map_or(from, |last| from.max(last + ACCELERATION_HOLD));
        let walked_s = (to - walks_from).as_secs_f64().max(0.0);
        self.forward.variance += config.params.acceleration_m_per_s2.powi(2) * walked_s;
        self.turn.variance += config.params.turn_acceleration_rad_per_s2.powi(2) * walked_s;
        let walk = config.noise.gyro_bias_walk_rad_per_s_sqrt_s;
        self.covariance[(GYRO_BIAS, GYRO_BIAS)] += walk * walk * dt_s;
        for &row in context.layout.delay_rows() {
            // A delay that was given for certain stays so.
            if self.covariance[(row, row)] > 0.0 {
                self.covariance[(row, row)] += DELAY_WALK_S_PER_SQRT_S.powi(2) * dt_s;
            }
        }
    }

    fn move_by_travel(
        &mut self,
        travel: WheelTravel,
        crossings: [BacklashCrossing; 2],
        (from, to): (Timestamp<BrickClock>, Timestamp<BrickClock>),
        context: &UpdateContext,
    ) {
        let config = &context.config;
        let moved = travel.left_m != 0.0 || travel.right_m != 0.0;
        if let Some(window) = &mut self.window {
            window.until = to;
        }
        if !moved {
            return;
        }
        let (transition, forward_m, turn_rad) = Transition::over_travel(travel, crossings, self, &config.geometry);
        let moving_s = (to - from).as_secs_f64();
        let backlash_rad2 = self.mean[BACKLASH].powi(2) + self.covariance[(BACKLASH, BACKLASH)];
        let radii_m = wheel_radii_m(&config.geometry);
        let unknown_m2 = [0, 1].map(|wheel| radii_m[wheel].powi(2) * backlash_rad2 * crossings[wheel].variance);
        let noise = step_noise(travel, &config.geometry, &config.noise)
            .with_time(moving_s, &config.noise)
            .with_wheel_variances(unknown_m2, &config.geometry);
        self.wheel_path_m += travel.left_m.abs().max(travel.right_m.abs());
        transition.propagate(&mut self.covariance, &noise);
        self.pose = self.pose.compose(transition.step.motion);
        self.add_scale_noise(forward_m, to, config);
        self.decay_fix_biases(forward_m, context);
        if let Some(window) = &mut self.window {
            window.forward_m += forward_m;
            self.mean[WINDOW_TURN] += turn_rad;
        }
    }

    /// Tyres and tracks wear with the path; added only while fixes observe the scales.
    fn add_scale_noise(&mut self, forward_m: f64, at: Timestamp<BrickClock>, config: &FilterConfig) {
        let timeout_s = config.params.fix_timeout_s;
        let has_recent_fix = self.status.last_fix.is_some_and(|last| (at - last).as_secs_f64() <= timeout_s);
        let walk_var = config.params.wear_per_sqrt_m.powi(2) * forward_m.abs();
        if !has_recent_fix || walk_var <= 0.0 {
            return;
        }
        for row in [RADIUS, DIFFERENCE, TRACK] {
            // A row that was given for certain stays so.
            if self.covariance[(row, row)] > 0.0 {
                self.covariance[(row, row)] += walk_var;
            }
        }
    }

    /// The errors that the fixes of a source share change with the path, and not with time: a robot at rest learns nothing new
    /// of them however often it is seen.
    ///
    /// ```text
    /// b <- k b      P_bb <- k^2 P_bb + (1 - k^2) sigma^2      k = exp(-d / L)
    /// ```
    fn decay_fix_biases(&mut self, forward_m: f64, context: &UpdateContext) {
        let rows = context.layout.fix_bias_rows();
        if rows.is_empty() {
            return;
        }
        let noise = &context.config.noise;
        let keep = (-forward_m.abs() / noise.fix_persistence_m).exp();
        for row in rows {
            self.mean[row] *= keep;
            for column in 0..N {
                self.covariance[(row, column)] *= keep;
                self.covariance[(column, row)] *= keep;
            }
            self.covariance[(row, row)] += (1.0 - keep * keep) * noise.fix_persistent_m.powi(2);
        }
    }

    fn move_unobserved(&mut self, from: Timestamp<BrickClock>, to: Timestamp<BrickClock>, config: &FilterConfig) {
        // A camera that sees a robot before it is heard must not make the heading of its start less certain.
        if !self.motion_evidence.may_turn {
            self.inflate_pose_covariance(UNOBSERVED_M_PER_SQRT_S.powi(2) * (to - from).as_secs_f64(), 0.0);
            return;
        }
        let last = self.status.last_motion.unwrap_or(from);
        let held_to = (last + SPEED_HOLD).clamp(from, to);
        if held_to > from {
            self.move_by_speeds((from - last).as_secs_f64().max(0.0), (held_to - last).as_secs_f64(), config);
        }
        let unseen_s = (to - held_to).as_secs_f64();
        // For all that is known it may have driven.
        self.wheel_path_m += UNSEEN_PATH_M_PER_S * unseen_s;
        self.inflate_pose_covariance(
            UNOBSERVED_M_PER_SQRT_S.powi(2) * unseen_s,
            UNOBSERVED_RAD_PER_SQRT_S.powi(2) * unseen_s,
        );
    }

    /// Moves by the held speeds; both ends are in seconds after the last motion observation. The speeds' errors are
    /// constant, so the variance grows with the square of the time, and by their integrated random walk with its
    /// cube.
    fn move_by_speeds(&mut self, start_s: f64, end_s: f64, config: &FilterConfig) {
        let dt_s = end_s - start_s;
        let transition = Transition::at_speeds(self.forward.value * dt_s, self.turn.value * dt_s);
        let squared = end_s * end_s - start_s * start_s;
        let cubed = (end_s.powi(3) - start_s.powi(3)) / 3.0;
        let acceleration = config.params.acceleration_m_per_s2.powi(2);
        let turn_acceleration = config.params.turn_acceleration_rad_per_s2.powi(2);
        let noise = StepNoise {
            forward_var_m2: self.forward.variance * squared + acceleration * cubed,
            turn_var_rad2: self.turn.variance * squared + turn_acceleration * cubed,
            forward_turn_m_rad: 0.0,
        };
        transition.propagate(&mut self.covariance, &noise);
        self.pose = self.pose.compose(transition.step.motion);
        self.wheel_path_m += self.forward.value.abs() * dt_s;
    }

    /// The body's motion from `from` until now, as far as it is known.
    pub fn motion_since(&self, from: Timestamp<BrickClock>, context: &UpdateContext) -> Se2 {
        self.stamp.map_or_else(Se2::default, |now| self.motion_between(from, now, context))
    }

    /// The body's motion between two instants, as far as it is known, with what is learned by now.
    pub fn motion_between(
        &self,
        from: Timestamp<BrickClock>,
        until: Timestamp<BrickClock>,
        context: &UpdateContext,
    ) -> Se2 {
        let mut moved = Se2::default();
        let mut at = from;
        while at < until {
            at = match context.track.segment(at, until) {
                TravelSegment::Known { until, travel, crossings, .. } => {
                    let (transition, ..) = Transition::over_travel(travel, crossings, self, &context.config.geometry);
                    moved = moved.compose(transition.step.motion);
                    until
                }
                TravelSegment::Gap { until } | TravelSegment::BeyondData { until } => {
                    let dt_s = (until - at).as_secs_f64();
                    let step = [self.forward.value * dt_s, 0.0, self.turn.value * dt_s];
                    moved = moved.compose(Se2::exp(step));
                    until
                }
            };
        }
        moved
    }

    /// The body's motion since an instant that is earlier by `delay`; for one that is later, back to it at the held speeds.
    pub fn motion_over_delay(&self, delay: TimeDelta, context: &UpdateContext) -> Se2 {
        if delay > TimeDelta::ZERO {
            return self.motion_since(self.stamp.unwrap_or(Timestamp::ZERO) - delay, context);
        }
        let ahead_s = -delay.as_secs_f64();
        Se2::exp([-self.forward.value * ahead_s, 0.0, -self.turn.value * ahead_s])
    }

    /// The body's motion from `from` until now with its noise, as of one arc: an alternative to the pose needs no better.
    pub fn noisy_motion_since(&self, from: Timestamp<BrickClock>, context: &UpdateContext) -> BodyMotion {
        let moved = self.motion_since(from, context);
        let [forward_m, _, turn_rad] = moved.log();
        let config = &context.config;
        let half_turn_m = 0.5 * turn_rad * config.geometry.track_width.0;
        let travel = WheelTravel { left_m: forward_m - half_turn_m, right_m: forward_m + half_turn_m };
        let duration_s = self.stamp.map_or(0.0, |now| (now - from).as_secs_f64());
        let noise = step_noise(travel, &config.geometry, &config.noise).with_time(duration_s, &config.noise);
        let q = Transition::at_speeds(forward_m, turn_rad).noise(&noise);
        BodyMotion { moved, noise: Matrix3::from_fn(|i, j| q[i][j]) }
    }

    /// Forward speed and turn rate around an instant: from the wheels where there are readings, else the held ones.
    pub fn speeds_near(&self, shown: Timestamp<BrickClock>, context: &UpdateContext) -> (f64, f64) {
        let from = shown - TimeDelta::from_secs_f64(0.5 * SPEED_WINDOW.as_secs_f64());
        let earlier = self.motion_since(from, context);
        let until = from + SPEED_WINDOW;
        let later = self.motion_since(until, context);
        let covered_s = self.stamp.map_or(0.0, |now| (now.min(until) - from).as_secs_f64());
        if covered_s < 0.5 * SPEED_WINDOW.as_secs_f64() {
            return (self.forward.value, self.turn.value);
        }
        let [forward_m, _, turn_rad] = earlier.compose(later.inverse()).log();
        (forward_m / covered_s, turn_rad / covered_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filters::pose::layout::CORE_STATES;

    #[test]
    fn speeds_that_are_not_felt_any_longer_walk_as_far_in_parts_as_in_one() {
        let ms = Timestamp::from_millis;
        let config = crate::filter::tests::config();
        let context = UpdateContext::new(&config, CORE_STATES);
        let mut at_once = PoseState::<CORE_STATES>::initial(&config, &context.layout);
        at_once.predict_speeds_and_bias(ms(0), &context);
        at_once.last_acceleration = Some(ms(0));
        let mut parts = at_once;
        at_once.predict_speeds_and_bias(ms(300), &context);
        for millis in [50, 150, 190, 230, 300] {
            parts.predict_speeds_and_bias(ms(millis), &context);
        }
        // For 0.2 s they are felt, and for 0.1 s the speed walks at 1 m/s per root of a second.
        assert!((at_once.forward.variance - 0.01 - 0.1).abs() < 1e-12);
        assert!((parts.forward.variance - at_once.forward.variance).abs() < 1e-12);
        assert!((parts.turn.variance - at_once.turn.variance).abs() < 1e-12);
    }
}

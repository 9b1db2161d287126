//! The nominal path with its errors: propagation, measurements against it, and the resulting pose.

use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{
    Arena, BrickClock, Fix, FusionOutcome, FusionRecord, Heading, Meters, Pose, ResetCause, StartPose, Timestamp,
    UncertainValue,
};
use serde::{Deserialize, Serialize};

use super::error_state::{
    ACCELERATED_ANGLE, ACCELERATED_DISTANCE, ACCELERATED_SPEED, ACCELERATED_TURN, Covariance, DISTANCE, ErrorState,
    FORWARD_BIAS, GYRO_ANGLE, GYRO_BIAS, GeometryScales, HEADING, RADIUS_DIFFERENCE, RADIUS_SCALE, SampleIntervals,
    TRACK_SCALE, TURN_BIAS, X, Y, clear_row, nominal_step, process_noise, start_row, transition,
};
use super::instruments::{AccelerometerIntegral, GyroAngle};
use super::path_state::PathState;
use crate::filter::FilterConfig;
use crate::models::differential_drive::WheelTravel;
use crate::models::planar_speeds::Acceleration;
use crate::motion::{MotionTrack, TravelSegment};
use crate::numerics::chi_square::{ChiSquareGates, chi_square_gates};
use crate::numerics::covariance::symmetrise;
use crate::observations::fix::{FixNoise, fix_noise, mid_axle};
use crate::observations::sensor_frame::Exposure;
use crate::papers::rows::{self, position_in_arena};
use crate::saved::{covariance, finite};
use crate::tracking::TrackingStatus;
use crate::update::{LinearizedMeasurement, ScalarMeasurement, use_scalar};
use crate::validation::{RESTART_HEADING_SIGMA_RAD, RESTART_POSITION_SIGMA_M, add_innovation};

/// Remaining bias of an accelerometer that was set to zero at rest: a hundredth of g.
const ACCELEROMETER_BIAS_M_PER_S2: f64 = 0.1;
/// Sigma of the initial speed of the accelerometers' sums: a LEGO wheel's count in 50 ms is 0.01 m/s.
const START_SPEED_M_PER_S: f64 = 0.02;
/// The same for the turn rate: the difference of two such wheels over a track of a decimetre.
const START_TURN_RAD_PER_S: f64 = 0.2;
/// A heading with a larger variance is not published as valid.
const USABLE_HEADING_RAD2: f64 = 0.25;
/// Largest scale that feedback may give to the geometry; a wheel of this robot cannot have more.
const LARGEST_SCALE: f64 = 0.5;
/// The least rounding of a path that does not come from counts, rad² and m².
const LEAST_ROUNDING: f64 = 1e-10;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CorrectionMode {
    /// They are added to the output only, as in the paper's equations.
    FeedForward,
    /// They correct the nominal path, which therefore stays close to the truth.
    Feedback,
}

/// A place on the nominal path; the angle is not wrapped.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct PathPoint {
    #[serde(deserialize_with = "finite")]
    pub(super) angle_rad: f64,
    #[serde(deserialize_with = "finite")]
    pub(super) distance_m: f64,
}

pub(super) struct NominalPath {
    pub(super) config: FilterConfig,
    gates: ChiSquareGates,
    pub(super) correction: CorrectionMode,
    pub(super) x_m: f64,
    pub(super) y_m: f64,
    pub(super) end: PathPoint,
    /// The angle without the jitter of the counts.
    pub(super) debounced_angle_rad: f64,
    /// The beginning of the last step.
    pub(super) previous: Option<(Timestamp<BrickClock>, PathPoint)>,
    pub(super) stamp: Option<Timestamp<BrickClock>>,
    pub(super) scales: GeometryScales,
    pub(super) errors: ErrorState,
    pub(super) covariance: Covariance,
    pub(super) gyro: GyroAngle,
    pub(super) accelerometers: AccelerometerIntegral,
    pub(super) forward_m_per_s: f64,
    pub(super) turn_rad_per_s: f64,
    pub(super) has_pose: bool,
    pub(super) status: TrackingStatus,
}

/// A path without its configuration.
#[derive(Serialize, Deserialize)]
pub(super) struct SavedPath {
    #[serde(deserialize_with = "finite")]
    x_m: f64,
    #[serde(deserialize_with = "finite")]
    y_m: f64,
    end: PathPoint,
    #[serde(deserialize_with = "finite")]
    debounced_angle_rad: f64,
    previous: Option<(Timestamp<BrickClock>, PathPoint)>,
    stamp: Option<Timestamp<BrickClock>>,
    #[serde(deserialize_with = "finite")]
    scales: GeometryScales,
    #[serde(deserialize_with = "finite")]
    errors: ErrorState,
    #[serde(deserialize_with = "covariance")]
    covariance: Covariance,
    gyro: GyroAngle,
    accelerometers: AccelerometerIntegral,
    #[serde(deserialize_with = "finite")]
    forward_m_per_s: f64,
    #[serde(deserialize_with = "finite")]
    turn_rad_per_s: f64,
    has_pose: bool,
    status: TrackingStatus,
}

impl NominalPath {
    pub(super) const fn save(&self) -> SavedPath {
        SavedPath {
            x_m: self.x_m,
            y_m: self.y_m,
            end: self.end,
            debounced_angle_rad: self.debounced_angle_rad,
            previous: self.previous,
            stamp: self.stamp,
            scales: self.scales,
            errors: self.errors,
            covariance: self.covariance,
            gyro: self.gyro,
            accelerometers: self.accelerometers,
            forward_m_per_s: self.forward_m_per_s,
            turn_rad_per_s: self.turn_rad_per_s,
            has_pose: self.has_pose,
            status: self.status,
        }
    }

    /// This path with what another one of the same configuration has become.
    #[must_use]
    pub(super) fn with_saved(&self, saved: &SavedPath) -> Self {
        Self {
            config: self.config.clone(),
            gates: self.gates,
            correction: self.correction,
            x_m: saved.x_m,
            y_m: saved.y_m,
            end: saved.end,
            debounced_angle_rad: saved.debounced_angle_rad,
            previous: saved.previous,
            stamp: saved.stamp,
            scales: saved.scales,
            errors: saved.errors,
            covariance: saved.covariance,
            gyro: saved.gyro,
            accelerometers: saved.accelerometers,
            forward_m_per_s: saved.forward_m_per_s,
            turn_rad_per_s: saved.turn_rad_per_s,
            has_pose: saved.has_pose,
            status: saved.status,
        }
    }

    pub(super) fn new(config: &FilterConfig, correction: CorrectionMode) -> Self {
        let known = &config.calibration;
        let mut path = Self {
            config: config.clone(),
            gates: chi_square_gates(config.params.gate_probability),
            correction,
            x_m: 0.0,
            y_m: 0.0,
            end: PathPoint::default(),
            debounced_angle_rad: 0.0,
            previous: None,
            stamp: None,
            scales: [known.radius_scale.value, known.radius_difference.value, known.track_scale.value],
            errors: ErrorState::zeros(),
            covariance: Covariance::zeros(),
            gyro: GyroAngle::default(),
            accelerometers: AccelerometerIntegral::default(),
            forward_m_per_s: 0.0,
            turn_rad_per_s: 0.0,
            has_pose: false,
            status: TrackingStatus::default(),
        };
        path.errors[GYRO_BIAS] = known.gyro_bias_rad_per_s.value;
        let b = config.geometry.track_width.0;
        for (row, sigma) in [
            (RADIUS_SCALE, known.radius_scale.sigma),
            (RADIUS_DIFFERENCE, known.radius_difference.sigma),
            (TRACK_SCALE, known.track_scale.sigma),
            (GYRO_BIAS, known.gyro_bias_rad_per_s.sigma.max(config.noise.gyro_bias_rad_per_s)),
            (FORWARD_BIAS, ACCELEROMETER_BIAS_M_PER_S2 * std::f64::consts::FRAC_1_SQRT_2),
            (TURN_BIAS, ACCELEROMETER_BIAS_M_PER_S2 * std::f64::consts::SQRT_2 / b),
        ] {
            path.covariance[(row, row)] = sigma * sigma;
        }
        if let Some(start) = &config.start {
            path.reset_to(start);
        }
        path
    }

    /// A learned constant, in the nominal geometry and still an error of it together, and its standard deviation.
    pub(super) fn calibration_value(&self, row: usize) -> UncertainValue {
        let used = match row {
            RADIUS_SCALE => self.scales[0],
            RADIUS_DIFFERENCE => self.scales[1],
            TRACK_SCALE => self.scales[2],
            _ => 0.0,
        };
        UncertainValue { value: used + self.errors[row], sigma: self.covariance[(row, row)].max(0.0).sqrt() }
    }

    /// Places the path here at this instant, without motion.
    pub(super) fn start_at(&mut self, stamp: Timestamp<BrickClock>) {
        self.stamp = Some(stamp);
        self.previous = None;
    }

    /// Advances along the wheels' motion up to their latest reading.
    pub(super) fn advance(&mut self, track: &MotionTrack, to: Timestamp<BrickClock>) {
        let Some(mut from) = self.stamp else {
            self.start_at(to);
            return;
        };
        if from < to {
            self.previous = Some((from, self.end));
        }
        let began = self.end;
        let (start, length_s) = (from, (to - from).as_secs_f64());
        while from < to {
            let until = match track.segment(from, to) {
                TravelSegment::Known { until, travel, path_var_m2, .. } => {
                    self.step((until - from).as_secs_f64(), travel, path_var_m2);
                    until
                }
                TravelSegment::Gap { until } | TravelSegment::BeyondData { until } => until,
            };
            from = until;
        }
        self.stamp = Some(to);
        if start < to {
            self.forward_m_per_s = (self.end.distance_m - began.distance_m) / length_s;
            self.turn_rad_per_s = (self.end.angle_rad - began.angle_rad) / length_s;
            self.status.last_motion = Some(to);
        }
        self.drop_silent_instruments(to);
    }

    fn step(&mut self, dt_s: f64, travel: WheelTravel, path_var_m2: f64) {
        let nominal = nominal_step(self.end.angle_rad, travel, &self.scales, &self.config.geometry, &self.config.noise);
        let settled_rad = self.debounce_angle(self.end.angle_rad + nominal.step.turn_rad);
        let (geometry, noise) = (&self.config.geometry, &self.config.noise);
        let track_width_m = geometry.track_width.0;
        let mut nominal = nominal.with_turn(settled_rad, &self.scales, track_width_m);
        nominal.path_var_m2 = path_var_m2;
        let elapsed = SampleIntervals {
            dt_s,
            gyro_s2: self.gyro.timing.take_squared_intervals_s2(),
            accelerometer_s2: self.accelerometers.timing.take_squared_intervals_s2(),
        };
        let f = transition(&nominal, dt_s);
        let q = process_noise(&nominal, &elapsed, geometry, noise);
        // Paper 4, equations 21 and 22.
        self.errors = f * self.errors;
        self.covariance = f * self.covariance * f.transpose() + q;
        symmetrise(&mut self.covariance);
        self.x_m += nominal.displacement.dx_m;
        self.y_m += nominal.displacement.dy_m;
        self.end.angle_rad += nominal.step.turn_rad;
        self.end.distance_m += nominal.step.forward_m;
    }

    /// The angle after hysteresis of one count of either wheel: it follows only what has turned for certain.
    fn debounce_angle(&mut self, angle_rad: f64) -> f64 {
        let play_rad = (6.0 * self.rounding().angle_rad2).sqrt();
        let before_rad = self.debounced_angle_rad;
        self.debounced_angle_rad = before_rad.max(angle_rad - play_rad).min(angle_rad + play_rad);
        self.debounced_angle_rad - before_rad
    }

    /// Moves over an interval without known motion: the wheels' counters jumped.
    pub(super) fn advance_unobserved(&mut self, to: Timestamp<BrickClock>) {
        let dt_s = self.stamp.map_or(0.0, |from| (to - from).as_secs_f64());
        let driven_m2 = (self.forward_m_per_s * dt_s).powi(2);
        let turned_rad2 = (self.turn_rad_per_s * dt_s).powi(2);
        self.covariance[(X, X)] += driven_m2;
        self.covariance[(Y, Y)] += driven_m2;
        self.covariance[(HEADING, HEADING)] += turned_rad2;
        self.reset_instruments();
        self.start_at(to);
    }

    /// Accelerations at the left and at the right wheel.
    pub(super) fn add_accelerations(
        &mut self,
        stamp: Timestamp<BrickClock>,
        left: f64,
        right: f64,
    ) -> Result<(), FusionOutcome> {
        let body = Acceleration::from_wheels(left, right, &self.config.geometry);
        self.accelerometers.integrate(stamp, body.forward_m_per_s2, body.turn_rad_per_s2)
    }

    /// Compares the instruments with the path, where their sums end within its last step.
    pub(super) fn compare_instruments(&mut self, record: &mut FusionRecord) {
        if let Some(mark) = self.gyro.timing.pending_comparison().and_then(|at| self.point_at(at)) {
            self.compare_gyro(record, mark);
        }
        if let Some(mark) = self.accelerometers.timing.pending_comparison().and_then(|at| self.point_at(at)) {
            self.compare_accelerometers(record, mark);
        }
        self.apply_feedback();
    }

    fn compare_gyro(&mut self, record: &mut FusionRecord, mark: PathPoint) {
        let rounding = self.rounding();
        if self.gyro.timing.is_tracked {
            let dz = self.gyro.angle_rad - mark.angle_rad;
            self.apply_difference(record, dz, HEADING, GYRO_ANGLE, rounding.angle_rad2);
        } else {
            self.gyro.angle_rad = mark.angle_rad;
            start_row(&mut self.errors, &mut self.covariance, GYRO_ANGLE, HEADING, rounding.angle_rad2);
            self.gyro.timing.is_tracked = true;
        }
        self.gyro.timing.is_compared = true;
    }

    fn compare_accelerometers(&mut self, record: &mut FusionRecord, mark: PathPoint) {
        let rounding = self.rounding();
        if self.accelerometers.timing.is_tracked {
            let dz = self.accelerometers.angle_rad - mark.angle_rad;
            self.apply_difference(record, dz, HEADING, ACCELERATED_ANGLE, rounding.angle_rad2);
            let dz = self.accelerometers.distance_m - mark.distance_m;
            self.apply_difference(record, dz, DISTANCE, ACCELERATED_DISTANCE, rounding.distance_m2);
        } else {
            self.start_accelerometers(mark, &rounding);
        }
        self.accelerometers.timing.is_compared = true;
    }

    fn start_accelerometers(&mut self, mark: PathPoint, rounding: &RoundingNoise) {
        let sums = &mut self.accelerometers;
        sums.angle_rad = mark.angle_rad;
        sums.distance_m = mark.distance_m;
        sums.speed_m_per_s = self.forward_m_per_s;
        sums.turn_rad_per_s = self.turn_rad_per_s;
        sums.timing.is_tracked = true;
        for (row, path, variance) in
            [(ACCELERATED_ANGLE, HEADING, rounding.angle_rad2), (ACCELERATED_DISTANCE, DISTANCE, rounding.distance_m2)]
        {
            start_row(&mut self.errors, &mut self.covariance, row, path, variance);
        }
        for (row, sigma) in [(ACCELERATED_SPEED, START_SPEED_M_PER_S), (ACCELERATED_TURN, START_TURN_RAD_PER_S)] {
            clear_row(&mut self.errors, &mut self.covariance, row);
            self.covariance[(row, row)] = sigma * sigma;
        }
    }

    /// dz = error of the path + error of the instrument + rounding.
    fn apply_difference(&mut self, record: &mut FusionRecord, dz: f64, path: usize, instrument: usize, variance: f64) {
        let scalar = ScalarMeasurement {
            innovation: dz - self.errors[path] - self.errors[instrument],
            rows: [path, instrument],
            jacobian: [1.0, 1.0],
            variance,
        };
        // The paper has no gate here: what the wheels do not feel must not be refused.
        let outcome = use_scalar(&mut self.errors, &mut self.covariance, &scalar, f64::INFINITY);
        add_innovation(record, scalar.innovation, &outcome);
    }
}

/// Variance of the rounding of the wheels' counts, each uniform within one count.
#[derive(Clone, Copy, Debug)]
struct RoundingNoise {
    angle_rad2: f64,
    distance_m2: f64,
}

impl NominalPath {
    fn rounding(&self) -> RoundingNoise {
        let geometry = &self.config.geometry;
        let radius_m = 0.5 * (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0);
        let count_m2 = (radius_m * geometry.tick.0).powi(2) / 12.0;
        RoundingNoise {
            angle_rad2: (2.0 * count_m2 / geometry.track_width.0.powi(2)).max(LEAST_ROUNDING),
            distance_m2: (0.5 * count_m2).max(LEAST_ROUNDING),
        }
    }

    /// The path at an instant of its last step; `None` for other instants.
    fn point_at(&self, at: Timestamp<BrickClock>) -> Option<PathPoint> {
        let end = self.stamp?;
        if at == end {
            return Some(self.end);
        }
        let (start, mark) = self.previous?;
        if at < start || at > end {
            return None;
        }
        let share = (at - start).as_secs_f64() / (end - start).as_secs_f64();
        Some(PathPoint {
            angle_rad: mark.angle_rad + share * (self.end.angle_rad - mark.angle_rad),
            distance_m: mark.distance_m + share * (self.end.distance_m - mark.distance_m),
        })
    }

    /// Feedback: moves the estimated errors of path and geometry into them.
    pub(super) fn apply_feedback(&mut self) {
        if self.correction == CorrectionMode::FeedForward {
            return;
        }
        self.x_m += self.errors[X];
        self.y_m += self.errors[Y];
        let (turned_rad, driven_m) = (self.errors[HEADING], self.errors[DISTANCE]);
        self.debounced_angle_rad += turned_rad;
        for mark in self.previous.iter_mut().map(|(_, mark)| mark).chain([&mut self.end]) {
            mark.angle_rad += turned_rad;
            mark.distance_m += driven_m;
        }
        for (scale, row) in self.scales.iter_mut().zip([RADIUS_SCALE, RADIUS_DIFFERENCE, TRACK_SCALE]) {
            *scale = (*scale + self.errors[row]).clamp(-LARGEST_SCALE, LARGEST_SCALE);
        }
        for row in [X, Y, HEADING, DISTANCE, RADIUS_SCALE, RADIUS_DIFFERENCE, TRACK_SCALE] {
            self.errors[row] = 0.0;
        }
    }

    /// Stops tracking an instrument that is silent, because its errors would grow without bound.
    fn drop_silent_instruments(&mut self, at: Timestamp<BrickClock>) {
        if self.gyro.timing.is_silent_at(at) {
            self.gyro.timing.is_tracked = false;
        }
        if self.accelerometers.timing.is_silent_at(at) {
            self.accelerometers.timing.is_tracked = false;
        }
        self.clear_untracked();
    }

    pub(super) fn reset_instruments(&mut self) {
        self.gyro = GyroAngle::default();
        self.accelerometers = AccelerometerIntegral::default();
        self.clear_untracked();
    }

    fn clear_untracked(&mut self) {
        let of_gyro: &[usize] = &[GYRO_ANGLE];
        let of_accelerometers: &[usize] =
            &[ACCELERATED_DISTANCE, ACCELERATED_SPEED, ACCELERATED_ANGLE, ACCELERATED_TURN];
        for (timing, rows) in [(&self.gyro.timing, of_gyro), (&self.accelerometers.timing, of_accelerometers)] {
            if !timing.is_tracked {
                for &row in rows {
                    clear_row(&mut self.errors, &mut self.covariance, row);
                }
            }
        }
    }

    /// The corrected pose: the path plus its errors.
    pub(super) fn pose(&self) -> Pose<Arena> {
        Pose::new(
            Meters(self.x_m + self.errors[X]),
            Meters(self.y_m + self.errors[Y]),
            Heading::from_rad(self.end.angle_rad + self.errors[HEADING]),
        )
    }

    pub(super) fn path_state(&self) -> PathState {
        let heading_rad2 = self.covariance[(HEADING, HEADING)];
        PathState {
            pose: self.pose(),
            covariance: self.covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            forward_m_per_s: self.forward_m_per_s,
            turn_rad_per_s: self.turn_rad_per_s,
            has_pose: self.has_pose,
            has_heading: self.has_pose && heading_rad2 < USABLE_HEADING_RAD2,
            status: self.status,
        }
    }
}

// Fixes against the nominal path, and relocation of the path.

/// Heading of a robot whose first fix had none: uniform on the circle, rad².
const UNKNOWN_HEADING_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

impl NominalPath {
    /// Uses a fix against the path as it is, however late the fix came.
    pub(super) fn use_fix(&mut self, record: &mut FusionRecord, fix: &Fix, stamp_sigma_s: f64) -> FusionOutcome {
        let noise = self.fix_noise(fix, stamp_sigma_s);
        // dz - H e: paper 4's linearisation about the nominal path.
        let path = [self.x_m, self.y_m, self.end.angle_rad];
        let (dz, jacobian) = position_in_arena(path, fix);
        let position =
            LinearizedMeasurement { innovation: dz - jacobian * self.errors, jacobian, noise: noise.position };
        let heading = fix.heading.map(|heading| {
            let turn_rad = wrap_rad(heading.rad() - self.end.angle_rad - self.errors[HEADING]);
            (turn_rad, noise.heading_rad2)
        });
        let (errors, covariance) = (&mut self.errors, &mut self.covariance);
        let verdict = rows::gate_and_apply_fix(errors, covariance, &position, heading, &self.gates, record);
        self.apply_feedback();
        verdict
    }

    fn fix_noise(&self, fix: &Fix, stamp_sigma_s: f64) -> FixNoise {
        let exposure = Exposure::at_speeds(self.forward_m_per_s, self.turn_rad_per_s);
        fix_noise(fix, &self.config.noise, [1.0, 1.0], &exposure, stamp_sigma_s)
    }

    /// Places the robot at a fix: the first one, or the one that ends a long disagreement.
    pub(super) fn initialize_from_fix(&mut self, fix: &Fix) {
        let noise = self.fix_noise(fix, 0.0);
        let before = self.pose();
        let cause = if self.has_pose { ResetCause::Relocated } else { ResetCause::Located };
        let (heading_rad, heading_rad2) = match fix.heading {
            Some(heading) => (heading.rad(), noise.heading_rad2),
            None if self.has_pose => (before.heading.rad(), self.covariance[(HEADING, HEADING)]),
            None => (before.heading.rad(), UNKNOWN_HEADING_RAD2),
        };
        self.relocate(&mid_axle(fix, heading_rad));
        for (i, row) in [X, Y].into_iter().enumerate() {
            for (j, column) in [X, Y].into_iter().enumerate() {
                self.covariance[(row, column)] = noise.position[(i, j)];
            }
        }
        self.covariance[(HEADING, HEADING)] = heading_rad2;
        self.status.record_jump(cause, before, self.pose());
    }

    pub(super) fn set_pose(&mut self, start: &StartPose) {
        let before = self.pose();
        self.reset_to(start);
        self.status.record_jump(ResetCause::Given, before, self.pose());
    }

    pub(super) fn reset_to(&mut self, start: &StartPose) {
        self.relocate(&start.pose);
        for row in [X, Y] {
            self.covariance[(row, row)] = start.position_sigma_m.powi(2);
        }
        self.covariance[(HEADING, HEADING)] = start.heading_sigma_rad.powi(2);
    }

    /// Moves the path to a pose and restarts the instruments, which refer to the old heading.
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
        self.has_pose = true;
    }

    /// After a restart of the brick no timestamp holds, and the robot may have been carried.
    pub(super) fn restart_clock(&mut self) {
        self.reset_instruments();
        self.stamp = None;
        self.previous = None;
        self.status.forget_stamps();
        self.forward_m_per_s = 0.0;
        self.turn_rad_per_s = 0.0;
        for (row, sigma) in
            [(X, RESTART_POSITION_SIGMA_M), (Y, RESTART_POSITION_SIGMA_M), (HEADING, RESTART_HEADING_SIGMA_RAD)]
        {
            self.covariance[(row, row)] += sigma * sigma;
        }
    }
}

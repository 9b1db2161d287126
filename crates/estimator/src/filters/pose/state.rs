//! The state of the pose filter: mean, covariance, and what a replay must restore.
//!
//! ```text
//! X    pose of the body in the arena, an element of SE(2); its error is left-invariant: X_true = X exp(xi), xi in the body
//! xi   rows 0 to 2: forward m, left m, turn rad
//! b_g  gyro bias                                            psi  turn since the gyro window began, by the encoders
//! eps  rounding of the encoders' heading where the gyro window began
//! e_m, e_d, e_b  relative errors of mean radius, of the radii against each other, of the track
//! tau, l_x, l_y  delay of the fixes, tag against the fix's own lever (only where they are estimated)
//! o_i, s_i       offset and scale of the ranges to beacon i, and of those to landmarks (only where they are estimated)
//! v, w           forward speed and turn rate, beside the others: they predict, they never move the pose over known travel
//! ```
//! Source: docs/maths/pose.md section 1.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{
    Arena, BrickClock, Calibration, Heading, Meters, Pose, StartPose, TimeDelta, Timestamp, UncertainValue,
};

use super::noise_scales::{NoiseScales, ObserverFrames};
use crate::filter::FilterConfig;
use crate::models::lie::Se2;
use crate::observations::gyro_window::{GyroWindow, GyroWindowModel, rounding_variance};
use crate::observations::speed::Speed;
use crate::observations::{ObservationModel, PoseView, StateTerm};
use crate::tracking::TrackingStatus;
use crate::update::{LinearizedMeasurement, ScalarMeasurement};
use crate::validation::{RESTART_HEADING_SIGMA_RAD, RESTART_POSITION_SIGMA_M};

// Rows, in the order of the module's head; `StateTerm` has the units.

pub const FORWARD: usize = 0;
pub const LEFT: usize = 1;
pub const HEADING: usize = 2;
pub const GYRO_BIAS: usize = 3;
pub const WINDOW_TURN: usize = 4;
pub const RADIUS: usize = 5;
pub const DIFFERENCE: usize = 6;
pub const TRACK: usize = 7;
pub const ROUNDING: usize = 8;
/// Number of states of a robot whose fixes have no unknown delay and whose tag is where they say.
pub const CORE_STATES: usize = 9;
pub const DELAY: usize = 9;
pub const TAG_FORWARD: usize = 10;
pub const TAG_LEFT: usize = 11;
/// Number of states when delay or lever arm are estimated.
pub const CAMERA_STATES: usize = 12;
/// First row of the beacons: an offset and a scale for each.
pub const BEACONS: usize = 12;
/// Most beacons with an offset and a scale of their own; ranges to further ones are used as measured.
pub const MAX_BEACONS: usize = 8;
/// Offset of the ranges to landmarks, m: they are all measured by the robot's own camera.
pub const LANDMARK_OFFSET: usize = BEACONS + 2 * MAX_BEACONS;
pub const LANDMARK_SCALE: usize = LANDMARK_OFFSET + 1;
/// Number of states when the offsets and scales of ranges are estimated.
pub const RANGE_STATES: usize = LANDMARK_OFFSET + 2;

/// A heading is published as known once its sigma is below this, rad: a third of a right angle.
const HEADING_KNOWN_SIGMA_RAD: f64 = 0.5;

/// Covariance of the pose's error in the body: forward m, left m, turn rad.
pub(super) type PoseBlock = [[f64; 3]; 3];

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RejectedFixes {
    pub count: u32,
    /// The stamp of the first of them.
    pub since: Option<Timestamp<BrickClock>>,
    /// Innovation of the last of them, in the arena.
    pub innovation_m: [f64; 2],
}

/// When the encoder counts changed, and the intervals between: distinguishes a robot at rest from one that creeps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TickActivity {
    /// The last reading with a changed count.
    pub changed_at: Option<Timestamp<BrickClock>>,
    /// The intervals between the last changes.
    pub recent_intervals: [TimeDelta; 3],
}

impl TickActivity {
    /// A count changed between the previous reading and this one.
    pub fn record_change(&mut self, stamp: Timestamp<BrickClock>) {
        if let Some(last) = self.changed_at {
            self.recent_intervals = [stamp - last, self.recent_intervals[0], self.recent_intervals[1]];
        }
        self.changed_at = Some(stamp);
    }

    /// Whether the robot rested: no count changed for more than twice the last three intervals between changes. One
    /// that slows down has longer and longer intervals before one is twice as long as all of these.
    pub fn is_stationary(&self, from: Timestamp<BrickClock>, until: Timestamp<BrickClock>) -> bool {
        let longest = self.recent_intervals.into_iter().max().unwrap_or(TimeDelta::ZERO);
        longest > TimeDelta::ZERO
            && self.changed_at.is_some_and(|last| last <= from && until - last > longest + longest)
    }
}

/// Everything that a replay must restore.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseState<const N: usize> {
    /// The instant for which it holds; `None` before the first observation.
    pub stamp: Option<Timestamp<BrickClock>>,
    /// The instant to which speeds and gyro bias are predicted; may be ahead of the pose.
    pub speeds_predicted_to: Option<Timestamp<BrickClock>>,
    pub pose: Se2,
    /// The other states, each in its row; the pose's rows are zero between updates.
    pub mean: SVector<f64, N>,
    pub covariance: SMatrix<f64, N, N>,
    /// Kept outside the covariance matrix: speeds predict, and wheels and gyro observe them.
    pub forward: Speed,
    pub turn: Speed,
    pub window: Option<GyroWindow>,
    /// By an absolute observation or a start; until then the pose is relative to where the robot was switched on.
    pub is_located: bool,
    pub status: TrackingStatus,
    pub tick_activity: TickActivity,
    /// The latest instant for which wheel slip was detected.
    pub slipped_at: Option<Timestamp<BrickClock>>,
    pub last_acceleration: Option<Timestamp<BrickClock>>,
    /// Since the last fix that was used.
    pub rejected_fixes: RejectedFixes,
    pub noise_scales: NoiseScales,
    pub observer_frames: ObserverFrames,
    /// While the constants are frozen: their variances before, each in its row; those of the covariance are zero
    /// meanwhile.
    pub frozen_variances: Option<SVector<f64, N>>,
}

impl<const N: usize> PoseState<N> {
    pub fn initial(config: &FilterConfig) -> Self {
        let mut state = Self {
            stamp: None,
            speeds_predicted_to: None,
            pose: Se2::default(),
            mean: SVector::zeros(),
            covariance: SMatrix::zeros(),
            // At power-up a robot is assumed to be at rest: 0.1 m/s and 1 rad/s are generous.
            forward: Speed { value: 0.0, variance: 0.01 },
            turn: Speed { value: 0.0, variance: 1.0 },
            window: None,
            is_located: false,
            status: TrackingStatus::default(),
            tick_activity: TickActivity::default(),
            slipped_at: None,
            last_acceleration: None,
            rejected_fixes: RejectedFixes::default(),
            noise_scales: NoiseScales::default(),
            observer_frames: ObserverFrames::default(),
            frozen_variances: None,
        };
        state.set_row(GYRO_BIAS, config.gyro_bias_prior());
        state.reset_rounding(rounding_variance(&config.geometry));
        for (row, known) in calibration_rows(&config.calibration) {
            state.set_row(row, known);
        }
        if let Some(start) = &config.start {
            state.initialize_pose(start);
        }
        state
    }

    /// A state with another number of rows: copies all but mean and covariance, which are zero.
    pub(super) fn resized<const M: usize>(other: &PoseState<M>) -> Self {
        Self {
            stamp: other.stamp,
            speeds_predicted_to: other.speeds_predicted_to,
            pose: other.pose,
            mean: SVector::zeros(),
            covariance: SMatrix::zeros(),
            forward: other.forward,
            turn: other.turn,
            window: other.window,
            is_located: other.is_located,
            status: other.status,
            tick_activity: other.tick_activity,
            slipped_at: other.slipped_at,
            last_acceleration: other.last_acceleration,
            rejected_fixes: other.rejected_fixes,
            noise_scales: other.noise_scales,
            observer_frames: other.observer_frames,
            // They have rows of their own; a resize begins with the learned constants.
            frozen_variances: None,
        }
    }

    /// This state after a rejection in `tried`, which was predicted to the observation's instant. The prediction is
    /// dropped, because two steps would round differently from one.
    pub(super) fn after_rejection(&self, tried: &Self) -> Self {
        Self {
            rejected_fixes: tried.rejected_fixes,
            noise_scales: tried.noise_scales,
            observer_frames: tried.observer_frames,
            ..*self
        }
    }

    /// Sets a row, independent of all others; ignores rows that this state does not have.
    pub(super) fn set_row(&mut self, row: usize, known: UncertainValue) {
        if row < N {
            self.clear_rows(&[row]);
            self.mean[row] = known.value;
            self.covariance[(row, row)] = known.sigma.powi(2);
        }
    }

    pub fn arena_pose(&self) -> Pose<Arena> {
        arena_pose(self.pose)
    }

    /// Moves the error that the last update wrote into the pose's rows into the pose.
    pub fn inject(&mut self) {
        let correction = [self.mean[FORWARD], self.mean[LEFT], self.mean[HEADING]];
        self.pose = self.pose.compose(Se2::exp(correction));
        self.mean[FORWARD] = 0.0;
        self.mean[LEFT] = 0.0;
        self.mean[HEADING] = 0.0;
    }

    /// Whether a heading with this variance is known in the arena.
    pub(super) fn is_heading_known_at(&self, heading_rad2: f64) -> bool {
        self.is_located && heading_rad2 < HEADING_KNOWN_SIGMA_RAD.powi(2)
    }

    /// After a restart of the brick: speeds and gyro bias are as unknown as in `fresh`; the learned constants stay.
    pub fn restart_clock(&mut self, fresh: &Self) {
        self.clear_rows(&[GYRO_BIAS]);
        self.mean[GYRO_BIAS] = fresh.mean[GYRO_BIAS];
        self.covariance[(GYRO_BIAS, GYRO_BIAS)] = fresh.covariance[(GYRO_BIAS, GYRO_BIAS)];
        self.forward = fresh.forward;
        self.turn = fresh.turn;
        self.inflate_pose_covariance(RESTART_POSITION_SIGMA_M.powi(2), RESTART_HEADING_SIGMA_RAD.powi(2));
        self.close_window();
        self.stamp = None;
        self.speeds_predicted_to = None;
        self.status.forget_stamps();
        self.tick_activity = TickActivity::default();
        self.last_acceleration = None;
        self.rejected_fixes = RejectedFixes::default();
    }

    pub fn inflate_pose_covariance(&mut self, position_m2: f64, heading_rad2: f64) {
        self.covariance[(FORWARD, FORWARD)] += position_m2;
        self.covariance[(LEFT, LEFT)] += position_m2;
        self.covariance[(HEADING, HEADING)] += heading_rad2;
    }

    pub fn initialize_pose(&mut self, start: &StartPose) {
        self.clear_rows(&[FORWARD, LEFT, HEADING]);
        self.pose = Se2 { x_m: start.pose.x.0, y_m: start.pose.y.0, heading_rad: wrap_rad(start.pose.heading.rad()) };
        self.inflate_pose_covariance(start.position_sigma_m.powi(2), start.heading_sigma_rad.powi(2));
        self.close_window();
        self.is_located = true;
        self.rejected_fixes = RejectedFixes::default();
    }

    /// Makes rows certain and independent of all others.
    pub fn clear_rows(&mut self, rows: &[usize]) {
        for &row in rows {
            self.covariance.row_mut(row).fill(0.0);
            self.covariance.column_mut(row).fill(0.0);
        }
    }

    /// Closes the gyro window; the next one begins at the same instant.
    pub fn restart_window(&mut self, at: Timestamp<BrickClock>) {
        self.close_window();
        self.window = Some(GyroWindow::starting(at));
    }

    /// The rounding is unknown within its bound.
    pub fn reset_rounding(&mut self, variance_rad2: f64) {
        self.clear_rows(&[ROUNDING]);
        self.mean[ROUNDING] = 0.0;
        self.covariance[(ROUNDING, ROUNDING)] = variance_rad2;
    }

    pub fn close_window(&mut self) {
        self.clear_rows(&[WINDOW_TURN]);
        self.mean[WINDOW_TURN] = 0.0;
        self.window = None;
    }

    pub fn published_covariance(&self) -> [[f64; 5]; 5] {
        self.covariance_in_arena(self.pose.heading_rad, &self.pose_covariance())
    }

    /// The covariance of the pose's error, in the body's frame.
    pub(super) fn pose_covariance(&self) -> PoseBlock {
        let rows = [FORWARD, LEFT, HEADING];
        rows.map(|row| rows.map(|column| self.covariance[(row, column)]))
    }

    /// The covariance of pose and speeds in the arena, for this heading and pose error.
    pub(super) fn covariance_in_arena(&self, heading_rad: f64, p: &PoseBlock) -> [[f64; 5]; 5] {
        let (sin, cos) = heading_rad.sin_cos();
        let [[ff, fl, fh], [_, ll, lh], [_, _, hh]] = *p;
        let mut published = [[0.0; 5]; 5];
        published[0][0] = cos * cos * ff - 2.0 * sin * cos * fl + sin * sin * ll;
        published[1][1] = sin * sin * ff + 2.0 * sin * cos * fl + cos * cos * ll;
        published[0][1] = sin * cos * (ff - ll) + (cos * cos - sin * sin) * fl;
        published[0][2] = cos * fh - sin * lh;
        published[1][2] = sin * fh + cos * lh;
        published[2][2] = hh;
        published[1][0] = published[0][1];
        published[2][0] = published[0][2];
        published[2][1] = published[1][2];
        published[3][3] = self.forward.variance;
        published[4][4] = self.turn.variance;
        published
    }

    /// The variance of a row; while the constants are frozen, their variance before.
    fn variance(&self, row: usize) -> f64 {
        let frozen = self.frozen_variances.map_or(0.0, |variances| variances[row]);
        self.covariance[(row, row)].max(frozen)
    }

    /// The learned constants; those that are no states of this filter come from `prior`.
    pub fn calibration(&self, prior: &Calibration) -> Calibration {
        let known = |row: usize, prior: UncertainValue| {
            if row < N {
                UncertainValue { value: self.mean[row], sigma: self.variance(row).max(0.0).sqrt() }
            } else {
                prior
            }
        };
        Calibration {
            radius_scale: known(RADIUS, prior.radius_scale),
            radius_difference: known(DIFFERENCE, prior.radius_difference),
            track_scale: known(TRACK, prior.track_scale),
            gyro_bias_rad_per_s: known(GYRO_BIAS, prior.gyro_bias_rad_per_s),
            fix_delay_s: known(DELAY, prior.fix_delay_s),
            tag_forward_m: known(TAG_FORWARD, prior.tag_forward_m),
            tag_left_m: known(TAG_LEFT, prior.tag_left_m),
            landmark_offset_m: known(LANDMARK_OFFSET, prior.landmark_offset_m),
            landmark_scale: known(LANDMARK_SCALE, prior.landmark_scale),
            ..*prior
        }
    }
}

pub(super) fn arena_pose(pose: Se2) -> Pose<Arena> {
    let heading = Heading::from_rad(pose.heading_rad);
    Pose::new(Meters(pose.x_m), Meters(pose.y_m), heading)
}

/// The constants of a calibration with their rows.
pub(super) fn calibration_rows(calibration: &Calibration) -> impl Iterator<Item = (usize, UncertainValue)> {
    let of_beacons = (0..MAX_BEACONS).flat_map(|slot| {
        [(BEACONS + 2 * slot, calibration.beacon_offset_m), (BEACONS + 2 * slot + 1, calibration.beacon_scale)]
    });
    [
        (RADIUS, calibration.radius_scale),
        (DIFFERENCE, calibration.radius_difference),
        (TRACK, calibration.track_scale),
        (DELAY, calibration.fix_delay_s),
        (TAG_FORWARD, calibration.tag_forward_m),
        (TAG_LEFT, calibration.tag_left_m),
        (LANDMARK_OFFSET, calibration.landmark_offset_m),
        (LANDMARK_SCALE, calibration.landmark_scale),
    ]
    .into_iter()
    .chain(of_beacons)
}

// Named states and their columns; nothing else knows both.

/// The column of a named state in the largest state vector; `None` for a beacon beyond the limit.
const fn column(term: StateTerm) -> Option<usize> {
    match term {
        StateTerm::GyroBias => Some(GYRO_BIAS),
        StateTerm::WindowTurn => Some(WINDOW_TURN),
        StateTerm::HeadingRounding => Some(ROUNDING),
        StateTerm::FixDelay => Some(DELAY),
        StateTerm::TagForward => Some(TAG_FORWARD),
        StateTerm::TagLeft => Some(TAG_LEFT),
        StateTerm::BeaconOffset(slot) if slot < MAX_BEACONS => Some(BEACONS + 2 * slot),
        StateTerm::BeaconScale(slot) if slot < MAX_BEACONS => Some(BEACONS + 2 * slot + 1),
        StateTerm::BeaconOffset(_) | StateTerm::BeaconScale(_) => None,
        StateTerm::LandmarkOffset => Some(LANDMARK_OFFSET),
        StateTerm::LandmarkScale => Some(LANDMARK_SCALE),
    }
}

impl<const N: usize> PoseView for PoseState<N> {
    fn pose(&self) -> Se2 {
        self.pose
    }

    fn term(&self, term: StateTerm) -> f64 {
        column(term).filter(|column| *column < N).map_or(0.0, |column| self.mean[column])
    }
}

/// H over the filter's columns; states that this filter does not have are left out.
pub fn linearize<const N: usize, const M: usize>(model: &ObservationModel<M>) -> LinearizedMeasurement<N, M> {
    let mut jacobian = SMatrix::<f64, M, N>::zeros();
    for (index, row) in model.rows.iter().enumerate() {
        jacobian[(index, FORWARD)] = row.forward;
        jacobian[(index, LEFT)] = row.left;
        jacobian[(index, HEADING)] = row.heading;
        for (term, derivative) in row.terms.into_iter().flatten() {
            if let Some(column) = column(term).filter(|column| *column < N) {
                jacobian[(index, column)] = derivative;
            }
        }
    }
    LinearizedMeasurement { innovation: model.innovation, jacobian, noise: model.noise }
}

/// A gyro window over the columns, which every variant of the filter has.
pub const fn linearize_gyro_window(model: &GyroWindowModel) -> ScalarMeasurement<3> {
    ScalarMeasurement {
        innovation: model.innovation,
        rows: [WINDOW_TURN, GYRO_BIAS, ROUNDING],
        jacobian: [1.0, model.by_gyro_bias, model.by_rounding],
        variance: model.variance,
    }
}

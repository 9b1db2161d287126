//! The state of the pose filter: mean, covariance, and what a replay must restore.
//!
//! ```text
//! X    pose of the body in the arena, an element of SE(2); its error is left-invariant: X_true = X exp(xi), xi in the body
//! xi   rows 0 to 2: forward m, left m, turn rad
//! b_g  gyro bias                                            psi  turn since the gyro window began, by the encoders
//! eps  rounding of the encoders' heading where the gyro window began
//! e_m, e_d, e_b  relative errors of mean radius, of the radii against each other, of the track
//! e_g  relative error of the gyro's rate                 beta  play between encoders and wheels
//! ..   what the configuration leaves unknown besides: delays, mountings, offsets, shared errors (see layout.rs)
//! v, w           forward speed and turn rate, beside the others: they predict, they never move the pose over known travel
//! ```
//! Source: docs/maths/pose.md section 1.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{
    Arena, BrickClock, Calibration, Heading, Meters, Pose, ResetCause, StartPose, TimeDelta, Timestamp, UncertainValue,
};
use serde::{Deserialize, Serialize};

use super::layout::{
    BACKLASH, DIFFERENCE, FORWARD, GYRO_BIAS, GYRO_SCALE, HEADING, LEFT, MAX_BEACONS, RADIUS, ROUNDING, StateLayout,
    TRACK, WINDOW_TURN, calibration_field,
};
use super::noise_scales::{NoiseScales, ObserverFrames};
use super::recovery::{Alternative, AlternativeBank};
use super::sightings::RecentSightings;
use crate::filter::FilterConfig;
use crate::models::lie::Se2;
use crate::observations::gyro_window::{GyroWindow, GyroWindowModel, rounding_variance};
use crate::observations::speed::Speed;
use crate::observations::{PoseView, StateTerm};
use crate::saved::{covariance, finite, not_negative};
use crate::tracking::TrackingStatus;
use crate::update::ScalarMeasurement;
use crate::validation::{RESTART_HEADING_SIGMA_RAD, RESTART_POSITION_SIGMA_M};

/// A heading is published as known once its sigma is below this, rad: a third of a right angle.
const HEADING_KNOWN_SIGMA_RAD: f64 = 0.5;

/// Covariance of the pose's error in the body: forward m, left m, turn rad.
pub(super) type PoseBlock = [[f64; 3]; 3];

/// When the encoder counts changed, and the intervals between: distinguishes a robot at rest from one that creeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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

/// Gyro windows one after the other in which gyro and wheels contradict each other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Slip {
    /// The end of the last one.
    pub until: Timestamp<BrickClock>,
    /// By how much the gyro turned more than the wheels in all of them, beyond chance, rad.
    #[serde(deserialize_with = "finite")]
    pub turned_rad: f64,
    /// Whether both wheels stood all the time.
    pub wheels_stood: bool,
}

/// What says that the robot moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionEvidence {
    /// A motion reading was ever used: from then on others know a pose of this robot.
    pub has_been_heard: bool,
    /// A sensor of its own was heard since it was switched on. Before that it does not turn.
    pub may_turn: bool,
}

/// Everything that a replay must restore.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseState<const N: usize> {
    /// The instant for which it holds; `None` before the first observation.
    pub stamp: Option<Timestamp<BrickClock>>,
    /// The instant to which speeds and gyro bias are predicted; may be ahead of the pose.
    pub speeds_predicted_to: Option<Timestamp<BrickClock>>,
    pub pose: Se2,
    /// The other states, each in its row; the pose's rows are zero between updates.
    #[serde(deserialize_with = "finite")]
    pub mean: SVector<f64, N>,
    #[serde(deserialize_with = "covariance")]
    pub covariance: SMatrix<f64, N, N>,
    /// Kept outside the covariance matrix: speeds predict, and wheels and gyro observe them.
    pub forward: Speed,
    pub turn: Speed,
    pub window: Option<GyroWindow>,
    /// By an absolute observation or a start; until then the pose is relative to where the robot was switched on.
    pub is_located: bool,
    pub status: TrackingStatus,
    pub motion_evidence: MotionEvidence,
    pub tick_activity: TickActivity,
    /// The latest slip of the wheels.
    pub slip: Option<Slip>,
    pub last_acceleration: Option<Timestamp<BrickClock>>,
    /// The path of the faster wheel since power-up.
    #[serde(deserialize_with = "not_negative")]
    pub wheel_path_m: f64,
    /// The latest instant at which the robot was carried: its gyro turned while its wheels stood.
    pub carried_at: Option<Timestamp<BrickClock>>,
    /// Whether the last gyro reading turned while the wheels stood.
    pub turned_at_rest: bool,
    pub alternatives: AlternativeBank,
    pub sightings: RecentSightings,
    pub noise_scales: NoiseScales,
    pub observer_frames: ObserverFrames,
    /// While the constants are frozen: their variances before, each in its row; those of the covariance are zero
    /// meanwhile.
    #[serde(deserialize_with = "finite")]
    pub frozen_variances: Option<SVector<f64, N>>,
}

impl<const N: usize> PoseState<N> {
    pub fn initial(config: &FilterConfig, layout: &StateLayout) -> Self {
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
            motion_evidence: MotionEvidence::default(),
            tick_activity: TickActivity::default(),
            slip: None,
            last_acceleration: None,
            wheel_path_m: 0.0,
            carried_at: None,
            turned_at_rest: false,
            alternatives: AlternativeBank::default(),
            sightings: RecentSightings::default(),
            noise_scales: NoiseScales::default(),
            observer_frames: ObserverFrames::default(),
            frozen_variances: None,
        };
        state.set_row(GYRO_BIAS, config.gyro_bias_prior());
        state.reset_rounding(rounding_variance(&config.geometry));
        for (row, known) in constant_rows(&config.calibration, layout) {
            state.set_row(row, known);
        }
        for prior in layout.priors() {
            state.set_row(prior.row, prior.known);
        }
        if let Some(start) = &config.start {
            state.initialize_pose(start);
        }
        state
    }

    /// This state after a rejection in `tried`, which was predicted to the observation's instant. The prediction is
    /// dropped, because two steps would round differently from one.
    pub(super) fn after_rejection(&self, tried: &Self) -> Self {
        Self {
            carried_at: tried.carried_at,
            alternatives: tried.alternatives,
            sightings: tried.sightings,
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

    /// This state with names for its rows.
    pub const fn view<'a>(&'a self, layout: &'a StateLayout) -> StateView<'a, N> {
        StateView { mean: &self.mean, pose: self.pose, layout }
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
        self.motion_evidence.may_turn = false;
        self.tick_activity = TickActivity::default();
        self.last_acceleration = None;
        self.forget_alternatives();
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
        self.forget_alternatives();
    }

    /// The pose was set, or its clock: what spoke against the last one says nothing of this one.
    pub fn forget_alternatives(&mut self) {
        self.alternatives.clear();
        self.sightings = RecentSightings::default();
        self.carried_at = None;
    }

    /// The robot is carried: what was seen before, and what is seen in the hands of a person, says nothing of where it will stand.
    pub(super) fn note_carried(&mut self, stamp: Timestamp<BrickClock>) {
        self.carried_at = Some(stamp);
        self.alternatives.clear();
        self.sightings = RecentSightings::default();
    }

    /// Makes an alternative to the pose `believed` the pose; counts as a reset and stores the jump. The constants stay.
    pub(super) fn adopt(&mut self, alternative: &Alternative, believed: Se2) {
        let before = self.arena_pose();
        let was_located = self.is_located;
        let carried_at = self.carried_at;
        self.initialize_pose(&StartPose {
            pose: arena_pose(alternative.pose(believed)),
            position_sigma_m: 0.0,
            heading_sigma_rad: 0.0,
        });
        // It may be a fault: until the pose has proved right for a while, another alternative may win as fast.
        self.carried_at = carried_at;
        for (i, row) in [FORWARD, LEFT, HEADING].into_iter().enumerate() {
            for (j, column) in [FORWARD, LEFT, HEADING].into_iter().enumerate() {
                self.covariance[(row, column)] = alternative.covariance()[(i, j)];
            }
        }
        let cause = if was_located { ResetCause::Relocated } else { ResetCause::Located };
        self.status.record_jump(cause, before, self.arena_pose());
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

    /// The learned constants; those that are no states of this filter come from `prior`. Those of the beacons are the means of
    /// all, each with the weight of its variance, and with the sigma of a beacon about the mean.
    pub fn calibration(&self, prior: &Calibration, layout: &StateLayout) -> Calibration {
        let mut learned = *prior;
        let known = |row: usize| UncertainValue { value: self.mean[row], sigma: self.variance(row).max(0.0).sqrt() };
        for (term, row) in constant_terms(layout) {
            if let Some(field) = calibration_field(&mut learned, term) {
                *field = known(row);
            }
        }
        for (field, term) in [
            (&mut learned.beacon_offset_m, StateTerm::BeaconOffset as fn(usize) -> StateTerm),
            (&mut learned.beacon_scale, StateTerm::BeaconScale),
        ] {
            let rows = (0..MAX_BEACONS).filter_map(|slot| layout.row(term(slot)));
            if let Some(mean) = weighted_mean(rows.map(known)) {
                *field = mean;
            }
        }
        [learned.radius_scale, learned.radius_difference, learned.track_scale] = [RADIUS, DIFFERENCE, TRACK].map(known);
        learned
    }
}

/// The mean of numbers by their variances, and the sigma of any one of them about it; `None` where none has a variance.
fn weighted_mean(numbers: impl Iterator<Item = UncertainValue>) -> Option<UncertainValue> {
    let mut sums = [0.0; 4];
    for number in numbers.filter(|number| number.sigma > 0.0) {
        let weight = number.sigma.powi(-2);
        let terms = [weight, weight * number.value, weight * number.value.powi(2), 1.0];
        sums = std::array::from_fn(|i| sums[i] + terms[i]);
    }
    let [weight, weighted, squared, count] = sums;
    let mean = weighted / weight;
    let spread = (squared / weight - mean * mean).max(0.0);
    (weight > 0.0).then(|| UncertainValue { value: mean, sigma: (count / weight + spread).sqrt() })
}

pub(super) fn arena_pose(pose: Se2) -> Pose<Arena> {
    let heading = Heading::from_rad(pose.heading_rad);
    Pose::new(Meters(pose.x_m), Meters(pose.y_m), heading)
}

/// The named constants of a calibration that are states, with their rows, but for those of the beacons.
fn constant_terms(layout: &StateLayout) -> impl Iterator<Item = (StateTerm, usize)> {
    let of_layout = layout.priors().iter().map(|prior| (prior.term, prior.row));
    let is_single =
        |(term, _): &(StateTerm, usize)| !matches!(term, StateTerm::BeaconOffset(_) | StateTerm::BeaconScale(_));
    [(StateTerm::GyroBias, GYRO_BIAS), (StateTerm::GyroScale, GYRO_SCALE), (StateTerm::Backlash, BACKLASH)]
        .into_iter()
        .chain(of_layout.filter(is_single))
}

/// The priors of the constants with their rows, but for the gyro's bias, which walks.
pub(super) fn constant_rows(
    calibration: &Calibration,
    layout: &StateLayout,
) -> impl Iterator<Item = (usize, UncertainValue)> {
    let mut with_fields = *calibration;
    let of_layout = layout.priors().iter();
    let of_layout = of_layout.filter(move |prior| calibration_field(&mut with_fields, prior.term).is_some());
    [
        (RADIUS, calibration.radius_scale),
        (DIFFERENCE, calibration.radius_difference),
        (TRACK, calibration.track_scale),
        (GYRO_SCALE, calibration.gyro_scale),
        (BACKLASH, calibration.backlash_rad),
    ]
    .into_iter()
    .chain(of_layout.map(|prior| (prior.row, prior.known)))
}

/// What observation models see of a state.
#[derive(Clone, Copy, Debug)]
pub struct StateView<'a, const N: usize> {
    mean: &'a SVector<f64, N>,
    pose: Se2,
    layout: &'a StateLayout,
}

impl<'a, const N: usize> StateView<'a, N> {
    pub const fn new(mean: &'a SVector<f64, N>, pose: Se2, layout: &'a StateLayout) -> Self {
        Self { mean, pose, layout }
    }

    /// The same constants at another pose.
    pub const fn at(self, pose: Se2) -> Self {
        Self { pose, ..self }
    }
}

impl<const N: usize> PoseView for StateView<'_, N> {
    fn pose(&self) -> Se2 {
        self.pose
    }

    fn term(&self, term: StateTerm) -> f64 {
        self.layout.row(term).map_or(0.0, |row| self.mean[row])
    }
}

/// A gyro window over the columns, which every variant of the filter has.
pub const fn linearize_gyro_window(model: &GyroWindowModel) -> ScalarMeasurement<4> {
    ScalarMeasurement {
        innovation: model.innovation,
        rows: [WINDOW_TURN, GYRO_BIAS, ROUNDING, GYRO_SCALE],
        jacobian: [model.by_turn, model.by_gyro_bias, model.by_rounding, model.by_gyro_scale],
        variance: model.variance,
    }
}

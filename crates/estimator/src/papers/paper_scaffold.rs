//! The scaffold of the filters of paper 1: everything but their equations.
//!
//! Observations are used when they come: each moves the state to its own instant, if that is ahead, and is then
//! applied; a late one is applied to the present state, or rejected where it would make an interval negative. Speeds
//! are held for 0.5 s, accelerations for 0.3 s; behind that the pose stays and only the variance grows. Over a gap of
//! the wheels of more than 0.3 s the robot is taken to have driven at the counters' mean speeds. A history answers for
//! earlier instants, as they were estimated then.
//!
//! Source: docs/lab/square.md section M1.

use std::collections::BTreeMap;

use posebridge_telemetry::estimate::row;
use posebridge_telemetry::{
    Arena, BrickClock, Calibration, DriveGeometry, Estimate, Fix, FusionOutcome, FusionRecord, Heading, Meters,
    Observation, ObservationKind, Pose, ResetCause, SensorId, StartPose, TimeDelta, Timestamp,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::filter::{Filter, FilterConfig};
use crate::models::differential_drive::{WheelTravel, body_step};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean};
use crate::models::se2::BodyStep;
use crate::motion::{SPEED_HOLD, TimeSeries};
use crate::numerics::chi_square::chi_square_gates;
use crate::observations::fix::{fix_noise, mid_axle};
use crate::observations::sensor_frame::Exposure;
use crate::saved::{self, Numbers, RestoreError};
use crate::tracking::{PublishedState, TrackingStatus};
use crate::validation::{self, reject_repeated};

/// Accelerations are held for the longest interval that is no gap.
const ACCELERATION_HOLD: TimeDelta = MAX_STEP;

/// The state at one instant, with everything that a prediction from it needs.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct FilterSnapshot<M> {
    stamp: Option<Timestamp<BrickClock>>,
    filter: M,
    acceleration: Option<(Timestamp<BrickClock>, Acceleration)>,
    status: TrackingStatus,
    /// The pose was given, by the configuration, a person or a fix.
    has_pose: bool,
}

impl<M> FilterSnapshot<M> {
    fn map<T>(self, change: impl FnOnce(M) -> T) -> FilterSnapshot<T> {
        let Self { stamp, filter, acceleration, status, has_pose } = self;
        FilterSnapshot { stamp, filter: change(filter), acceleration, status, has_pose }
    }
}

impl<M: SampledFilter> FilterSnapshot<M> {
    fn advance_to(&mut self, stamp: Timestamp<BrickClock>, context: &SampledContext) {
        let Some(from) = self.stamp.filter(|from| *from < stamp) else {
            self.stamp = self.stamp.or(Some(stamp));
            return;
        };
        // Before the first reading of the wheels nothing is stale yet.
        let held_until = self.status.last_motion.unwrap_or(from) + SPEED_HOLD;
        let moving_until = held_until.clamp(from, stamp);
        let (felt, felt_until) = self
            .acceleration
            .map_or_else(|| (Acceleration::default(), from), |(felt_at, felt)| (felt, felt_at + ACCELERATION_HOLD));
        let changing_until = felt_until.clamp(from, moving_until);
        if changing_until > from {
            let dt_s = (changing_until - from).as_secs_f64();
            self.filter.predict(dt_s, felt, context);
        }
        if moving_until > changing_until {
            let dt_s = (moving_until - changing_until).as_secs_f64();
            self.filter.predict(dt_s, Acceleration::default(), context);
        }
        if stamp > moving_until {
            self.filter.predict_unobserved((stamp - moving_until).as_secs_f64(), context);
        }
        self.stamp = Some(stamp);
    }

    /// Predicts over the rest of a gap at the mean speeds by the counters.
    fn bridge_gap(&mut self, step: &WheelStep, stamp: Timestamp<BrickClock>, context: &SampledContext) {
        let Some(from) = self.stamp.filter(|from| *from < stamp) else {
            return;
        };
        let body = step.body_step(&context.config.geometry);
        let gap_s = step.interval.as_secs_f64();
        let left_s = (stamp - from).as_secs_f64();
        let share = left_s / gap_s;
        // In which order distance and turn came is unknown: the direction of the way is uniform within the turn.
        let path_m2 = share * (body.forward_m * body.turn_rad).powi(2) / 12.0;
        let speeds = [body.forward_m / gap_s, body.turn_rad / gap_s];
        self.filter.bridge_gap(speeds, path_m2, context);
        self.filter.predict(left_s, Acceleration::default(), context);
        self.stamp = Some(stamp);
    }
}

pub(super) struct OnArrivalFilter<M> {
    context: SampledContext,
    /// The last reading of both counters, rad.
    last_wheels: Option<(Timestamp<BrickClock>, [f64; 2])>,
    last_gyro: Option<Timestamp<BrickClock>>,
    last_acceleration: Option<Timestamp<BrickClock>>,
    last_compass: Option<Timestamp<BrickClock>>,
    last_fixes: BTreeMap<SensorId, Timestamp<BrickClock>>,
    current: FilterSnapshot<M>,
    /// The state after each instant within the history.
    history: TimeSeries<FilterSnapshot<M>>,
}

/// A filter of a paper without its configuration; `S` is the part of its equations that changes.
#[derive(Serialize, Deserialize)]
#[serde(bound(serialize = "S: Serialize", deserialize = "S: Deserialize<'de>"))]
struct SavedOnArrival<S> {
    last_wheels: Option<(Timestamp<BrickClock>, [f64; 2])>,
    last_gyro: Option<Timestamp<BrickClock>>,
    last_acceleration: Option<Timestamp<BrickClock>>,
    last_compass: Option<Timestamp<BrickClock>>,
    last_fixes: BTreeMap<SensorId, Timestamp<BrickClock>>,
    current: FilterSnapshot<S>,
    history: TimeSeries<FilterSnapshot<S>>,
}

impl<M: SampledFilter> OnArrivalFilter<M> {
    /// Starts at the configured pose, or at the arena's origin.
    pub(super) fn new(mut maths: M, config: &FilterConfig) -> Self {
        if let Some(start) = &config.start {
            maths.initialize_pose(start);
        }
        let first = FilterSnapshot {
            stamp: None,
            filter: maths,
            acceleration: None,
            status: TrackingStatus::default(),
            has_pose: config.start.is_some(),
        };
        Self {
            context: SampledContext { config: config.clone(), gates: chi_square_gates(config.params.gate_probability) },
            last_wheels: None,
            last_gyro: None,
            last_acceleration: None,
            last_compass: None,
            last_fixes: BTreeMap::new(),
            current: first,
            history: TimeSeries::default(),
        }
    }

    /// Stores a state: one for each instant, for the length of the history.
    fn save(&mut self, next: FilterSnapshot<M>) {
        self.current = next;
        if let Some(stamp) = next.stamp {
            let length = TimeDelta::from_secs_f64(self.context.config.params.history_s);
            self.history.push(stamp, next, length);
        }
    }

    fn restart_history(&mut self, next: FilterSnapshot<M>) {
        self.history = TimeSeries::default();
        self.save(next);
    }

    fn observe_valid(&mut self, observation: &Observation, record: &mut FusionRecord) -> FusionOutcome {
        let stamp = observation.stamp;
        let uses = |extra| self.current.filter.uses(extra);
        if let ObservationKind::WheelAngles { left, right } = observation.measurement {
            self.observe_wheels(stamp, [left.0, right.0], record)
        } else if let ObservationKind::TurnRate(rate) = observation.measurement
            && uses(OptionalSensor::Gyro)
        {
            self.observe_gyro(stamp, rate.0, record)
        } else if let ObservationKind::WheelAccelerations { left, right } = observation.measurement
            && uses(OptionalSensor::Accelerometers)
        {
            self.observe_accelerations(stamp, Acceleration::from_wheels(left.0, right.0, &self.context.config.geometry))
        } else if let ObservationKind::Fix(fix) = observation.measurement
            && uses(OptionalSensor::Camera)
        {
            self.observe_fix(observation, &fix, record)
        } else if let ObservationKind::CompassHeading(heading) = observation.measurement
            && uses(OptionalSensor::Compass)
        {
            self.observe_compass(stamp, heading.rad(), record)
        } else {
            FusionOutcome::Unused
        }
    }

    fn observe_wheels(
        &mut self,
        stamp: Timestamp<BrickClock>,
        angles_rad: [f64; 2],
        record: &mut FusionRecord,
    ) -> FusionOutcome {
        let before = self.last_wheels;
        if let Some(verdict) = reject_repeated(before.map(|(stamp, _)| stamp), stamp) {
            return verdict;
        }
        self.last_wheels = Some((stamp, angles_rad));
        let step = before.map(|(before_stamp, before_rad)| WheelStep {
            interval: stamp - before_stamp,
            left_rad: angles_rad[0] - before_rad[0],
            right_rad: angles_rad[1] - before_rad[1],
        });
        let mut next = self.current;
        let verdict = if let Some(step) = step.filter(|step| step.is_possible(&self.context.config)) {
            if step.is_gap() {
                next.bridge_gap(&step, stamp, &self.context);
            } else {
                next.advance_to(stamp, &self.context);
            }
            next.filter.use_wheels(&step, &self.context, record)
        } else {
            next.advance_to(stamp, &self.context);
            next.filter.rebase_wheels(&self.context);
            if step.is_none() { FusionOutcome::Accepted } else { FusionOutcome::Rebased }
        };
        next.status.last_motion = next.status.last_motion.max(Some(stamp));
        self.save(next);
        verdict
    }

    fn observe_gyro(
        &mut self,
        stamp: Timestamp<BrickClock>,
        rate_rad_per_s: f64,
        record: &mut FusionRecord,
    ) -> FusionOutcome {
        if let Some(verdict) = reject_repeated(self.last_gyro, stamp) {
            return verdict;
        }
        let interval = self.last_gyro.map(|before| stamp - before);
        self.last_gyro = Some(stamp);
        let mut next = self.current;
        next.advance_to(stamp, &self.context);
        let short = interval.filter(|interval| *interval <= MAX_STEP);
        let verdict = if let Some(interval) = short {
            let dt_s = interval.as_secs_f64();
            next.filter.use_gyro(&GyroStep { rate_rad_per_s, dt_s }, &self.context, record)
        } else {
            next.filter.rebase_gyro();
            FusionOutcome::Accepted
        };
        self.save(next);
        verdict
    }

    fn observe_accelerations(&mut self, stamp: Timestamp<BrickClock>, felt: Acceleration) -> FusionOutcome {
        if let Some(verdict) = reject_repeated(self.last_acceleration, stamp) {
            return verdict;
        }
        self.last_acceleration = Some(stamp);
        let mut next = self.current;
        next.advance_to(stamp, &self.context);
        next.acceleration = Some((stamp, felt));
        self.save(next);
        FusionOutcome::Accepted
    }

    fn observe_compass(
        &mut self,
        stamp: Timestamp<BrickClock>,
        heading_rad: f64,
        record: &mut FusionRecord,
    ) -> FusionOutcome {
        if let Some(verdict) = reject_repeated(self.last_compass, stamp) {
            return verdict;
        }
        if !self.current.has_pose {
            return FusionOutcome::Unused;
        }
        self.last_compass = Some(stamp);
        let mut next = self.current;
        next.advance_to(stamp, &self.context);
        let verdict = next.filter.use_compass(heading_rad, &self.context, record);
        if verdict == FusionOutcome::Accepted {
            self.save(next);
        }
        verdict
    }

    fn observe_fix(&mut self, observation: &Observation, fix: &Fix, record: &mut FusionRecord) -> FusionOutcome {
        let before = self.last_fixes.get(&observation.sensor).copied();
        if let Some(verdict) = reject_repeated(before, observation.stamp) {
            return verdict;
        }
        let mut next = self.current;
        next.advance_to(observation.stamp, &self.context);
        let before_reset = next.filter;
        let verdict = if next.has_pose {
            let stamp = observation.stamp;
            let step = FixStep { fix: *fix, stamp, stamp_sigma_s: observation.stamp_sigma.as_secs_f64() };
            next.filter.use_fix(&step, &self.context, record)
        } else {
            initialize_from_fix(&mut next.filter, fix, &self.context)
        };
        if verdict == FusionOutcome::Gated {
            self.current.filter.keep_rejection(&next.filter);
        }
        if matches!(verdict, FusionOutcome::Accepted | FusionOutcome::PoseReset) {
            if verdict == FusionOutcome::PoseReset {
                let [from, to] =
                    [before_reset, next.filter].map(|filter| pose_of(&filter.gaussian_state(&self.context).mean));
                let cause = if next.has_pose { ResetCause::Relocated } else { ResetCause::Located };
                next.status.record_jump(cause, from, to);
            }
            next.has_pose = true;
            next.status.last_fix = next.status.last_fix.max(Some(observation.stamp));
            self.last_fixes.insert(observation.sensor, observation.stamp);
            self.save(next);
        }
        verdict
    }
}

/// Places a robot without a pose; needs a fix with a heading.
fn initialize_from_fix(maths: &mut impl SampledFilter, fix: &Fix, context: &SampledContext) -> FusionOutcome {
    let Some(heading) = fix.heading else {
        return FusionOutcome::Unused;
    };
    let noise = fix_noise(fix, &context.config.noise, [1.0, 1.0], &Exposure::default(), 0.0);
    maths.initialize_pose(&StartPose {
        pose: mid_axle(fix, heading.rad()),
        position_sigma_m: (0.5 * noise.position.trace()).sqrt(),
        heading_sigma_rad: noise.heading_rad2.sqrt(),
    });
    FusionOutcome::PoseReset
}

fn pose_of(mean: &Mean) -> Pose<Arena> {
    Pose::new(Meters(mean[row::X]), Meters(mean[row::Y]), Heading::from_rad(mean[row::HEADING]))
}

impl<M: SampledFilter> Filter for OnArrivalFilter<M> {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let history_s = self.context.config.params.history_s;
        validation::observe_if_valid(observation, self.latest_time(), history_s, |record| {
            record.outcome = self.observe_valid(observation, record);
        })
    }

    fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        if !validation::is_valid_start(start) {
            return FusionOutcome::Malformed;
        }
        let mut next = self.current;
        let before = pose_of(&next.filter.gaussian_state(&self.context).mean);
        next.filter.initialize_pose(start);
        next.has_pose = true;
        next.status.record_jump(ResetCause::Given, before, start.pose);
        self.restart_history(next);
        FusionOutcome::PoseReset
    }

    fn save(&self) -> Vec<u8> {
        let Self { context: _, last_wheels, last_gyro, last_acceleration, last_compass, last_fixes, current, history } =
            self;
        let save = |snapshot: &FilterSnapshot<M>| snapshot.map(|filter| filter.saved());
        saved::to_bytes(&SavedOnArrival {
            last_wheels: *last_wheels,
            last_gyro: *last_gyro,
            last_acceleration: *last_acceleration,
            last_compass: *last_compass,
            last_fixes: last_fixes.clone(),
            current: save(current),
            history: history.map(save),
        })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
        let saved: SavedOnArrival<M::Saved> = saved::from_bytes(saved)?;
        (saved.last_wheels.is_none_or(|(_, angles)| angles.are_finite()))
            .then_some(())
            .ok_or(RestoreError::Implausible("its wheels' angles are not finite"))?;
        let constants = self.current.filter;
        let restore = |snapshot: FilterSnapshot<M::Saved>| snapshot.map(|filter| constants.with_saved(filter));
        self.current = restore(saved.current);
        self.history = saved.history.map(|snapshot| restore(*snapshot));
        self.last_wheels = saved.last_wheels;
        self.last_gyro = saved.last_gyro;
        self.last_acceleration = saved.last_acceleration;
        self.last_compass = saved.last_compass;
        self.last_fixes = saved.last_fixes;
        Ok(())
    }

    fn restart_clock(&mut self) {
        let mut next = FilterSnapshot { stamp: None, acceleration: None, ..self.current };
        next.status.forget_stamps();
        let position_m = validation::RESTART_POSITION_SIGMA_M;
        let heading_rad = validation::RESTART_HEADING_SIGMA_RAD;
        next.filter.reset_speeds(position_m, heading_rad, &self.context);
        self.last_wheels = None;
        self.last_gyro = None;
        self.last_acceleration = None;
        self.last_compass = None;
        self.last_fixes.clear();
        self.restart_history(next);
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.current.stamp
    }

    fn calibration(&self) -> Option<Calibration> {
        self.current.filter.calibration(&self.context.config.calibration)
    }

    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        let (_, mut at) = *self.history.last_at_or_before(stamp)?;
        at.advance_to(stamp, &self.context);
        let state = at.filter.gaussian_state(&self.context);
        let published = PublishedState {
            pose: pose_of(&state.mean),
            speeds: [state.mean[row::FORWARD], state.mean[row::TURN]],
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| state.covariance[(i, j)])),
            has_position: at.has_pose,
            has_heading: at.has_pose,
        };
        Some(at.status.estimate(stamp, &published, self.context.config.params.fix_timeout_s))
    }
}

// The interface to one filter's equations.

pub(super) struct SampledContext {
    pub(super) config: FilterConfig,
    /// With one, two and three degrees of freedom.
    pub(super) gates: [f64; 3],
}

/// Sensors besides the wheels that some of the filters use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OptionalSensor {
    Gyro,
    Accelerometers,
    Camera,
    Compass,
}

/// Pose and speeds with their covariance, rows as [`row`], SI units, heading not wrapped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GaussianState {
    pub(super) mean: Mean,
    pub(super) covariance: Covariance,
}

/// The equations of one filter.
pub(super) trait SampledFilter: Copy + Send {
    /// What changes, without the constants of the filter.
    type Saved: Copy + Serialize + DeserializeOwned;

    fn saved(&self) -> Self::Saved;

    /// The constants of this filter with what has changed in another one.
    #[must_use]
    fn with_saved(&self, saved: Self::Saved) -> Self;

    /// Whether it uses a sensor besides the wheels.
    fn uses(&self, extra: OptionalSensor) -> bool;

    fn gaussian_state(&self, context: &SampledContext) -> GaussianState;

    /// The configured calibration with what the filter has learned; `None` where it learns nothing.
    fn calibration(&self, configured: &Calibration) -> Option<Calibration> {
        let _ = configured;
        None
    }

    /// Moves the pose to a start; the estimate of the speeds stays.
    fn initialize_pose(&mut self, start: &StartPose);

    /// Forgets the speeds, and adds these standard deviations to the pose, in m and rad.
    fn reset_speeds(&mut self, position_m: f64, heading_rad: f64, context: &SampledContext);

    fn predict(&mut self, dt_s: f64, felt: Acceleration, context: &SampledContext);

    fn predict_unobserved(&mut self, dt_s: f64, context: &SampledContext);

    /// Uses these speeds (m/s, rad/s) for the next prediction, over a gap whose path has the variance `path_m2` per axis.
    fn bridge_gap(&mut self, speeds: [f64; 2], path_m2: f64, context: &SampledContext);

    /// Rebases the counters: the wheels' motion up to here is what was predicted.
    fn rebase_wheels(&mut self, context: &SampledContext) {
        let _ = context;
    }

    fn rebase_gyro(&mut self) {}

    fn use_wheels(&mut self, step: &WheelStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome;

    fn use_gyro(&mut self, step: &GyroStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let _ = (step, context, record);
        FusionOutcome::Unused
    }

    /// Uses a fix: `Accepted`, `Gated`, or `PoseReset` where it moved the pose after a long disagreement.
    fn use_fix(&mut self, fix: &FixStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let _ = (fix, context, record);
        FusionOutcome::Unused
    }

    /// Remembers the fix that another copy of the filter, moved to the fix's own instant, has rejected.
    fn keep_rejection(&mut self, rejecting: &Self) {
        let _ = rejecting;
    }

    /// Uses a heading of a compass, in rad.
    fn use_compass(&mut self, measured_rad: f64, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome {
        let _ = (measured_rad, context, record);
        FusionOutcome::Unused
    }
}

/// A fix whose stamp may be off by `stamp_sigma_s`.
#[derive(Clone, Copy, Debug)]
pub(super) struct FixStep {
    pub(super) fix: Fix,
    pub(super) stamp: Timestamp<BrickClock>,
    pub(super) stamp_sigma_s: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct GyroStep {
    /// Mean turn rate, bias included.
    pub(super) rate_rad_per_s: f64,
    pub(super) dt_s: f64,
}

// The travel between two neighbouring readings of the wheels' counters, in the order in which they come.

/// A longer interval between two readings is a gap: five lost readings in a row at the papers' 20 Hz are still bridged.
pub(super) const MAX_STEP: TimeDelta = TimeDelta::from_millis(300);

/// The wheels' rotation between two readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WheelStep {
    /// More than zero.
    pub(super) interval: TimeDelta,
    pub(super) left_rad: f64,
    pub(super) right_rad: f64,
}

impl WheelStep {
    /// Distance and turn that go with the rotation.
    pub(super) fn body_step(&self, geometry: &DriveGeometry) -> BodyStep {
        body_step(WheelTravel::from_rotation(self.left_rad, self.right_rad, geometry), geometry)
    }

    /// Whether wheels turn that fast; else the counters were zeroed or have leapt. Two counts of slack: quantisation
    /// alone must never look like a jump.
    fn is_possible(&self, config: &FilterConfig) -> bool {
        let limit_rad = config.params.max_wheel_rad_per_s * self.interval.as_secs_f64() + 2.0 * config.geometry.tick.0;
        self.left_rad.abs() <= limit_rad && self.right_rad.abs() <= limit_rad
    }

    /// Whether the interval is so long that its mean speed is no speed.
    pub(super) fn is_gap(&self) -> bool {
        self.interval > MAX_STEP
    }
}

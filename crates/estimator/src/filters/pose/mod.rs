//! The flagship: an EKF with pose, speeds and gyro bias that applies every observation at its own time.
//!
//! The filter keeps what it was told for a few seconds, with the state after each. A late observation is put where it belongs,
//! the state before it is restored and what came after is applied again: exactly what would have happened had it come in time.
//! The order of arrival does not matter, bit for bit, as long as nothing is older than the history.
//!
//! Source: docs/maths/pose.md.

pub mod fuse;
pub mod state;

use std::collections::VecDeque;

use posebridge_telemetry::{
    BrickClock, Estimate, Fix, FusionRecord, Heading, Meters, MetersPerSecond, Observation,
    Observed, Pose, PoseJump, Radians, RadiansPerSecond, Span, Stamp, Validity, Verdict,
    quantities::wrap_rad,
};

use self::fuse::Context;
use self::state::{FORWARD, HEADING, Located, PoseState, TURN, X, Y};
use super::{Filter, FilterConfig, StartPose};
use crate::motion::{Added, GyroTrack, MotionReading, MotionTrack};

/// A stamp further ahead than this is damage, not the future.
const FURTHEST_AHEAD: Span = Span::from_millis(3_600_000);
/// After the brick's clock restarted the robot may have been carried: sigma of its position, m, and heading, rad.
const RESTART_POSITION_M: f64 = 0.1;
const RESTART_HEADING_RAD: f64 = 0.3;
/// Speeds are stale when no motion was observed for this long.
const SPEEDS_VALID: Span = Span::from_millis(500);

/// What stands in the history.
#[derive(Clone, Copy, Debug)]
enum Action {
    SetPose(StartPose),
    TurnRate(f64),
    Motion,
    Fix(Fix, Span),
}

impl Action {
    /// Order among observations of one instant, so that the order of arrival does not matter.
    const fn rank(&self) -> u8 {
        match self {
            Self::SetPose(_) => 0,
            Self::TurnRate(_) => 1,
            Self::Motion => 2,
            Self::Fix(..) => 3,
        }
    }
}

#[derive(Clone, Debug)]
struct Entry {
    stamp: Stamp<BrickClock>,
    action: Action,
    sensor: u8,
    /// The state after this entry.
    after: PoseState,
}

/// The flagship filter.
pub struct PoseFilter {
    config: FilterConfig,
    track: MotionTrack,
    gyro: GyroTrack,
    gates: fuse::Gates,
    /// The state before the first entry.
    base: PoseState,
    /// By stamp, then rank, then sensor.
    entries: VecDeque<Entry>,
}

impl PoseFilter {
    /// A filter that has seen nothing yet.
    #[must_use]
    pub fn new(config: &FilterConfig) -> Self {
        Self {
            config: *config,
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            gyro: GyroTrack::default(),
            gates: fuse::gates_of(config),
            base: PoseState::initial(config),
            entries: VecDeque::new(),
        }
    }

    /// The state after the last entry.
    #[must_use]
    pub fn state(&self) -> &PoseState {
        self.entries.back().map_or(&self.base, |entry| &entry.after)
    }

    /// Why an observation cannot be used whatever the state, if so.
    fn refuse_outright(&self, observation: &Observation) -> Option<Verdict> {
        if !is_finite(&observation.observed) || observation.stamp_sigma < Span::ZERO {
            return Some(Verdict::Malformed);
        }
        if self
            .latest()
            .is_some_and(|latest| observation.stamp - latest > FURTHEST_AHEAD)
        {
            return Some(Verdict::Malformed);
        }
        // The base is the state at the horizon: what is older than it has nowhere to go.
        self.base
            .stamp
            .filter(|oldest| observation.stamp < *oldest)
            .map(|_| Verdict::TooOld)
    }

    /// Puts an entry where it belongs and applies again whatever it changes.
    fn insert(
        &mut self,
        entry: Entry,
        changed_after: Option<Stamp<BrickClock>>,
        record: &mut FusionRecord,
    ) {
        let key = (entry.stamp, entry.action.rank(), entry.sensor);
        let index = self
            .entries
            .partition_point(|other| (other.stamp, other.action.rank(), other.sensor) <= key);
        self.entries.insert(index, entry);
        let first_changed = changed_after.map_or(index, |after| {
            self.entries.partition_point(|other| other.stamp <= after)
        });
        self.apply_from(first_changed.min(index), Some((index, record)));
        self.forget();
    }

    fn apply_from(&mut self, first: usize, mut recorded: Option<(usize, &mut FusionRecord)>) {
        let before = first.checked_sub(1).and_then(|i| self.entries.get(i));
        let mut state = before.map_or(self.base, |entry| entry.after);
        let context = Context {
            config: &self.config,
            track: &self.track,
            gyro: &self.gyro,
            gates: &self.gates,
        };
        for (index, entry) in self.entries.iter_mut().enumerate().skip(first) {
            state.advance(entry.stamp, context.track, context.config);
            match (&mut recorded, entry.action) {
                (Some((wanted, record)), action) if *wanted == index => {
                    act(&mut state, entry.stamp, action, &context, record);
                }
                (_, action) => {
                    act(
                        &mut state,
                        entry.stamp,
                        action,
                        &context,
                        &mut scratch_record(entry.stamp),
                    );
                }
            }
            entry.after = state;
        }
    }

    fn forget(&mut self) {
        let Some(latest) = self.latest() else { return };
        let horizon = latest - Span::from_secs_f64(self.config.params.history_s);
        while self
            .entries
            .front()
            .is_some_and(|entry| entry.stamp < horizon)
        {
            if let Some(entry) = self.entries.pop_front() {
                self.base = entry.after;
            }
        }
        if let Some(oldest) = self.base.stamp {
            // The open gyro window may reach back behind the history.
            let needed = self
                .base
                .window
                .map_or(oldest, |window| window.start.min(oldest));
            self.track.forget_before(oldest);
            self.gyro.forget_before(needed);
        }
    }

    fn take(&mut self, observation: &Observation, record: &mut FusionRecord) {
        let (action, changed_after) = match observation.observed {
            Observed::TurnRate(rate) => match self.gyro.add(observation.stamp, rate.0) {
                Added::After(before) => (Action::TurnRate(rate.0), before),
                other => return record.verdict = verdict_of(other),
            },
            Observed::Fix(fix) => (
                Action::Fix(fix, observation.stamp_sigma),
                Some(observation.stamp),
            ),
            observed => match motion_reading(&observed) {
                Some(reading) => match self.track.add(observation.stamp, &reading) {
                    Added::After(before) => (Action::Motion, before),
                    Added::Rebased => {
                        record.verdict = Verdict::Rebased;
                        (Action::Motion, None)
                    }
                    other => return record.verdict = verdict_of(other),
                },
                None => return record.verdict = Verdict::Unused,
            },
        };
        let entry = Entry {
            stamp: observation.stamp,
            action,
            sensor: observation.sensor.0,
            after: self.base,
        };
        self.insert(entry, changed_after, record);
    }
}

impl Filter for PoseFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let lag = self.latest().map_or(Span::ZERO, |latest| {
            (latest - observation.stamp).max(Span::ZERO)
        });
        let mut record = bare_record(observation, lag, Verdict::Accepted);
        match self.refuse_outright(observation) {
            Some(verdict) => record.verdict = verdict,
            None => self.take(observation, &mut record),
        }
        record
    }

    fn set_pose(&mut self, start: &StartPose) {
        match self.latest() {
            None => {
                self.base.place(start);
                self.base.reset_counter = self.base.reset_counter.wrapping_add(1);
            }
            Some(stamp) => {
                let entry = Entry {
                    stamp,
                    action: Action::SetPose(*start),
                    sensor: 0,
                    after: self.base,
                };
                self.insert(entry, None, &mut scratch_record(stamp));
            }
        }
    }

    fn restart_clock(&mut self) {
        let mut state = *self.state();
        state.stamp = None;
        state.last_fix = None;
        state.last_motion = None;
        state.mean[FORWARD] = 0.0;
        state.mean[TURN] = 0.0;
        state.forget_rows(&[FORWARD, TURN]);
        let fresh = PoseState::initial(&self.config);
        state.covariance[(FORWARD, FORWARD)] = fresh.covariance[(FORWARD, FORWARD)];
        state.covariance[(TURN, TURN)] = fresh.covariance[(TURN, TURN)];
        state.covariance[(X, X)] += RESTART_POSITION_M.powi(2);
        state.covariance[(Y, Y)] += RESTART_POSITION_M.powi(2);
        state.covariance[(HEADING, HEADING)] += RESTART_HEADING_RAD.powi(2);
        state.forget_rows(&[state::WINDOW_ERROR]);
        state.mean[state::WINDOW_ERROR] = 0.0;
        state.window = None;
        self.base = state;
        self.entries.clear();
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.gyro = GyroTrack::default();
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.state().stamp
    }

    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        let index = self.entries.partition_point(|entry| entry.stamp <= stamp);
        let from = index
            .checked_sub(1)
            .and_then(|i| self.entries.get(i))
            .map_or(&self.base, |entry| &entry.after);
        from.stamp?;
        let mut state = *from;
        let context = Context {
            config: &self.config,
            track: &self.track,
            gyro: &self.gyro,
            gates: &self.gates,
        };
        state.advance(stamp, context.track, context.config);
        // The open window is used for the outside only; inside it stays open until it is full.
        fuse::use_gyro_window(&mut state, &context);
        Some(published(&state, stamp, &self.config))
    }
}

fn act(
    state: &mut PoseState,
    stamp: Stamp<BrickClock>,
    action: Action,
    context: &Context<'_>,
    record: &mut FusionRecord,
) {
    match action {
        Action::TurnRate(rate) => fuse::turn_rate(state, rate, context),
        Action::Motion => fuse::motion(state, stamp, context),
        Action::Fix(fix, stamp_sigma) => fuse::fix(state, &fix, stamp_sigma, context, record),
        Action::SetPose(start) => {
            let before = state.mean;
            state.place(&start);
            state.reset_counter = state.reset_counter.wrapping_add(1);
            state.last_jump = Some(PoseJump {
                dx_m: state.mean[X] - before[X],
                dy_m: state.mean[Y] - before[Y],
                turn: Radians(wrap_rad(state.mean[HEADING] - before[HEADING])),
            });
        }
    }
}

fn published(state: &PoseState, stamp: Stamp<BrickClock>, config: &FilterConfig) -> Estimate {
    let fix_age = state.last_fix.map(|last| (stamp - last).max(Span::ZERO));
    let timeout = Span::from_secs_f64(config.params.fix_timeout_s);
    Estimate {
        stamp,
        pose: Pose::new(
            Meters(state.mean[X]),
            Meters(state.mean[Y]),
            Heading::from_rad(state.mean[HEADING]),
        ),
        forward_speed: MetersPerSecond(state.mean[FORWARD]),
        turn_rate: RadiansPerSecond(state.mean[TURN]),
        covariance: fuse::published_covariance(&state.covariance),
        validity: Validity {
            position: state.located != Located::No,
            heading: state.located == Located::Yes,
            speeds: state
                .last_motion
                .is_some_and(|last| stamp - last <= SPEEDS_VALID),
        },
        is_dead_reckoning: fix_age.is_none_or(|age| age > timeout),
        fix_age,
        reset_counter: state.reset_counter,
        last_jump: state.last_jump,
    }
}

/// What a motion observation says, or `None` for the other kinds.
#[must_use]
pub(crate) fn motion_reading(observed: &Observed) -> Option<MotionReading> {
    match *observed {
        Observed::WheelAngles { left, right } => Some(MotionReading::Wheels {
            left_rad: left.0,
            right_rad: right.0,
        }),
        Observed::OdometerPose(pose) => Some(MotionReading::Odometer(pose)),
        Observed::BodyVelocity { forward, turn } => Some(MotionReading::Velocity {
            forward_m_per_s: forward.0,
            turn_rad_per_s: turn.0,
        }),
        Observed::TurnRate(_)
        | Observed::WheelAccelerations { .. }
        | Observed::Fix(_)
        | Observed::Landmark { .. }
        | Observed::BeaconRange { .. }
        | Observed::WallRange(_)
        | Observed::CompassHeading(_)
        | Observed::Temperature(_) => None,
    }
}

/// Larger numbers than this are damage: no arena, wheel or rate of ours comes near, and their squares must stay finite.
const LARGEST: f64 = 1e9;

/// Whether every number of an observation is one that arithmetic can bear.
#[must_use]
pub(crate) fn is_finite(observed: &Observed) -> bool {
    let bearable = |values: &[f64]| values.iter().all(|value| value.abs() <= LARGEST);
    match *observed {
        Observed::WheelAngles { left, right } => bearable(&[left.0, right.0]),
        Observed::OdometerPose(pose) => bearable(&[pose.x.0, pose.y.0, pose.heading.rad()]),
        Observed::BodyVelocity { forward, turn } => bearable(&[forward.0, turn.0]),
        Observed::TurnRate(rate) => bearable(&[rate.0]),
        Observed::WheelAccelerations { left, right } => bearable(&[left.0, right.0]),
        Observed::Fix(fix) => is_finite_fix(&fix),
        Observed::Landmark { range, bearing, .. } => {
            bearable(&[range.0, bearing.0]) && range.0 >= 0.0
        }
        Observed::BeaconRange { range, .. } | Observed::WallRange(range) => {
            bearable(&[range.0]) && range.0 >= 0.0
        }
        Observed::CompassHeading(heading) => bearable(&[heading.rad()]),
        Observed::Temperature(temperature) => bearable(&[temperature.0]),
    }
}

fn is_finite_fix(fix: &Fix) -> bool {
    let bearable = |value: f64| value.abs() <= LARGEST;
    let heading = fix.heading.is_none_or(|heading| bearable(heading.rad()));
    let covariance = fix.covariance.is_none_or(|own| {
        let determinant = own.xx_m2 * own.yy_m2 - own.xy_m2 * own.xy_m2;
        let heading = own.heading_rad2 > 0.0;
        bearable(own.xx_m2)
            && bearable(own.yy_m2)
            && bearable(own.xy_m2)
            && own.xx_m2 > 0.0
            && determinant > 0.0
            && heading
    });
    bearable(fix.position.x.0)
        && bearable(fix.position.y.0)
        && bearable(fix.tag_in_body.x.0)
        && bearable(fix.tag_in_body.y.0)
        && heading
        && covariance
}

/// A record of an observation for which nothing was predicted.
#[must_use]
pub(crate) fn bare_record(observation: &Observation, lag: Span, verdict: Verdict) -> FusionRecord {
    FusionRecord {
        sensor: observation.sensor,
        kind: observation.observed.kind(),
        stamp: observation.stamp,
        lag,
        verdict,
        innovation: [0.0; 3],
        innovation_covariance: [[0.0; 3]; 3],
        nis: 0.0,
        degrees_of_freedom: 0,
        log_likelihood: 0.0,
    }
}

/// A record that nobody reads: an entry that is applied again was reported when it came.
fn scratch_record(stamp: Stamp<BrickClock>) -> FusionRecord {
    FusionRecord {
        sensor: posebridge_telemetry::SensorId(0),
        kind: "",
        stamp,
        lag: Span::ZERO,
        verdict: Verdict::Accepted,
        innovation: [0.0; 3],
        innovation_covariance: [[0.0; 3]; 3],
        nis: 0.0,
        degrees_of_freedom: 0,
        log_likelihood: 0.0,
    }
}

fn verdict_of(added: Added) -> Verdict {
    match added {
        Added::After(_) => Verdict::Accepted,
        Added::Rebased => Verdict::Rebased,
        Added::Outranked => Verdict::Unused,
        Added::Duplicate => Verdict::Malformed,
        Added::TooOld => Verdict::TooOld,
    }
}

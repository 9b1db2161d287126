//! The flagship: an EKF with pose, speeds and gyro bias that applies every observation at its own time.
//!
//! The filter keeps what it was told for a few seconds, with the state after each. A late observation is put where it belongs,
//! the state before it is restored and what came after is applied again: exactly what would have happened had it come in time.
//! The order of arrival does not matter, bit for bit, as long as nothing is older than the history.
//!
//! Source: docs/maths/pose.md.

pub mod fuse;
mod history;
mod iterate;
pub mod motion;
pub mod observer_spaces;
mod placing;
mod revise;
pub mod scales;
mod sight;
pub mod smooth;
pub mod state;

use std::cmp::Ordering;
use std::collections::VecDeque;

use posebridge_telemetry::{
    BrickClock, Calibration, Estimate, FusionRecord, Known, MetersPerSecond, Observation, Observed,
    RadiansPerSecond, SensorId, Span, Stamp, Validity, Verdict,
};

use self::fuse::{Context, Gates};
use self::history::{Action, Entry, Told};
use self::revise::Revision;
use self::state::{CORE, Located, PoseState, WITH_CAMERA, WITH_RANGES};
use super::{Adjustment, Filter, FilterConfig, StartPose, intake};
use crate::motion::{Added, GyroTrack, MotionReading, MotionTrack, count_before};
use crate::observations::accelerometer::Accelerations;
use crate::params::Params;

/// No hole in a sensor's readings is waited for longer than this before what lies in it is forgotten.
const LONGEST_HOLE: Span = Span::from_millis(10_000);
/// Speeds are stale when no motion was observed for this long.
const SPEEDS_VALID: Span = Span::from_millis(500);

/// Builds the flagship with as many states as the configuration asks for.
#[must_use]
pub fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let calibration = &config.calibration;
    let is_asked = |known: Known| known.sigma > 0.0 || known.value != 0.0;
    let camera = [
        calibration.fix_delay_s,
        calibration.tag_forward_m,
        calibration.tag_left_m,
    ];
    let ranges = [
        calibration.beacon_offset_m,
        calibration.beacon_scale,
        calibration.landmark_offset_m,
        calibration.landmark_scale,
    ];
    if ranges.into_iter().any(is_asked) {
        Box::new(PoseFilter::<WITH_RANGES>::new(config))
    } else if camera.into_iter().any(is_asked) {
        Box::new(PoseFilter::<WITH_CAMERA>::new(config))
    } else {
        Box::new(PoseFilter::<CORE>::new(config))
    }
}

/// The flagship filter with N states, see [`state`].
pub struct PoseFilter<const N: usize> {
    config: FilterConfig,
    track: MotionTrack,
    gyro: GyroTrack,
    gates: Gates,
    /// The state before the first entry.
    base: PoseState<N>,
    /// In the order of [`Told::order`].
    entries: VecDeque<Entry<N>>,
    /// Up to which instant the slip that was noticed has been told.
    slip_told: Option<Stamp<BrickClock>>,
}

impl<const N: usize> PoseFilter<N> {
    /// A filter that has seen nothing yet.
    #[must_use]
    pub fn new(config: &FilterConfig) -> Self {
        Self {
            config: config.clone(),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            gyro: GyroTrack::default(),
            gates: fuse::gates_of(config),
            base: PoseState::initial(config),
            entries: VecDeque::new(),
            slip_told: None,
        }
    }

    /// Says on the record of a motion that was used if slip was noticed since the last one that said so. A fix may have noticed it, or an
    /// observation that came late: what is told first after it tells it.
    fn tell_slip(&mut self, record: &mut FusionRecord, observed: &Observed) {
        let slipped_at = self.state().slipped_at;
        if record.verdict == Verdict::Accepted
            && MotionReading::of(observed).is_some()
            && slipped_at > self.slip_told
        {
            record.verdict = Verdict::Slip;
            self.slip_told = slipped_at;
        }
    }

    /// The state after the last entry.
    #[must_use]
    pub fn state(&self) -> &PoseState<N> {
        self.entries.back().map_or(&self.base, |entry| &entry.after)
    }

    /// Puts an entry where it belongs and applies again whatever it changes: everything after `changed_after`.
    fn insert(
        &mut self,
        entry: Entry<N>,
        changed_after: Option<Stamp<BrickClock>>,
        record: &mut FusionRecord,
    ) {
        let index = count_before(&self.entries, |other| {
            other.told.order(&entry.told) != Ordering::Greater
        });
        self.entries.insert(index, entry);
        let first_changed = changed_after.map_or(index, |after| {
            count_before(&self.entries, |other| other.told.stamp <= after)
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
            let mut scratch = scratch_record(&entry.told);
            let record = match &mut recorded {
                Some((wanted, record)) if *wanted == index => &mut **record,
                _ => &mut scratch,
            };
            // The state is large: it is kept aside only where it may be wanted back.
            let aside = matches!(entry.told.action, Action::Sight(..)).then_some(state);
            act(&mut state, &entry.told, &context, record);
            if let Some(before) = aside.filter(|_| entry.is_without_effect(record.verdict)) {
                // Not even the way to its instant is kept: two steps would round otherwise than one.
                state = PoseState {
                    refused: state.refused,
                    scales: state.scales,
                    spaces: state.spaces,
                    ..before
                };
            }
            entry.after = state;
        }
    }

    /// Up to where nothing can change when only observations from `horizon` on are accepted. One of them changes what was
    /// interpolated since the reading before it, so each sensor's last reading up to the horizon is where its past is settled.
    fn settled_at(&self, horizon: Stamp<BrickClock>) -> Stamp<BrickClock> {
        [
            self.track.last_until(horizon),
            self.gyro.last_until(horizon),
        ]
        .into_iter()
        .flatten()
        .fold(horizon, Stamp::min)
        .max(horizon - LONGEST_HOLE)
    }

    fn forget(&mut self) {
        let Some(latest) = self.latest() else { return };
        let settled = self.settled_at(latest - Span::from_secs_f64(self.config.params.history_s));
        while self
            .entries
            .front()
            .is_some_and(|entry| entry.told.stamp < settled)
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
            // A late camera shows what was before that.
            self.track.forget_before(oldest - sight::FURTHEST_BACK);
            self.gyro.forget_before(needed);
        }
    }

    fn take(&mut self, observation: &Observation, record: &mut FusionRecord) {
        let Some(action) = action_of(observation) else {
            record.verdict = Verdict::Unused;
            return;
        };
        match action {
            Action::Sight(..)
            | Action::Accelerations(_)
            | Action::SetPose(_)
            | Action::Revise(_) => {
                self.take_once(observation, action, record);
            }
            Action::TurnRate(rate) => {
                let added = self.gyro.add(observation.stamp, rate);
                self.take_motion(observation, action, added, record);
            }
            Action::Motion => {
                if let Some(reading) = MotionReading::of(&observation.observed) {
                    let added = self.track.add(observation.stamp, &reading);
                    self.take_motion(observation, action, added, record);
                }
            }
        }
    }

    fn take_once(&mut self, observation: &Observation, action: Action, record: &mut FusionRecord) {
        let entry = self.entry(observation, action);
        // In the order of time: behind the first that is older there is no other of this instant.
        let is_repeated = self
            .entries
            .iter()
            .rev()
            .map(|other| &other.told)
            .take_while(|other| other.stamp >= observation.stamp)
            .any(|other| other.repeats(&entry.told));
        if is_repeated {
            record.verdict = Verdict::Malformed;
            return;
        }
        self.insert(entry, Some(observation.stamp), record);
    }

    fn take_motion(
        &mut self,
        observation: &Observation,
        action: Action,
        added: Added,
        record: &mut FusionRecord,
    ) {
        record.verdict = intake::verdict_of(added);
        let changed_after = match added {
            Added::After(before) => before,
            Added::Rebased(before) => Some(before),
            Added::Outranked | Added::Duplicate | Added::TooOld => return,
        };
        self.insert(self.entry(observation, action), changed_after, record);
    }

    /// What a person says holds after all that was observed; before the first observation there is nothing to be after.
    fn take_word(&mut self, action: Action) {
        let Some(stamp) = self.latest() else {
            match action {
                Action::SetPose(start) => self.base.jump_to(&start),
                Action::Revise(revision) => self.base.revise(revision, &self.config),
                Action::TurnRate(_)
                | Action::Accelerations(_)
                | Action::Motion
                | Action::Sight(..) => {}
            }
            return;
        };
        let told = Told {
            stamp,
            sensor: SensorId(0),
            action,
        };
        let entry = Entry {
            told,
            after: self.base,
        };
        self.insert(entry, None, &mut scratch_record(&told));
    }

    /// All tunables are read where they are used, but for two that something was made of.
    fn set_params(&mut self, params: &Params) {
        self.config.params = *params;
        self.gates = fuse::gates_of(&self.config);
        self.track
            .set_max_wheel_rad_per_s(params.max_wheel_rad_per_s);
    }

    fn entry(&self, observation: &Observation, action: Action) -> Entry<N> {
        Entry {
            told: Told {
                stamp: observation.stamp,
                sensor: observation.sensor,
                action,
            },
            after: *self.state(),
        }
    }
}

impl<const N: usize> Filter for PoseFilter<N> {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let latest = self.latest();
        let lag = intake::lag_of(observation, latest);
        let mut record = intake::bare_record(observation, lag, Verdict::Accepted);
        let refused = intake::refuse_outright(observation, latest, self.config.params.history_s);
        if let Some(verdict) = refused {
            record.verdict = verdict;
        } else {
            self.take(observation, &mut record);
            self.tell_slip(&mut record, &observation.observed);
        }
        record
    }

    fn set_pose(&mut self, start: &StartPose) -> Verdict {
        if !intake::is_usable(start) {
            return Verdict::Malformed;
        }
        self.take_word(Action::SetPose(*start));
        Verdict::ResetTo
    }

    fn adjust(&mut self, adjustment: &Adjustment) -> Verdict {
        match adjustment {
            Adjustment::Params(params) => self.set_params(params),
            Adjustment::ForgetPose => self.take_word(Action::Revise(Revision::Pose)),
            Adjustment::Learning(learning) => {
                self.take_word(Action::Revise(Revision::Learning(*learning)));
            }
            Adjustment::ForgetCalibration => {
                self.take_word(Action::Revise(Revision::Calibration));
            }
        }
        Verdict::Accepted
    }

    fn restart_clock(&mut self) {
        let mut state = *self.state();
        state.restart_clock(&PoseState::initial(&self.config));
        // The stamps of before mean nothing.
        state.slipped_at = None;
        self.slip_told = None;
        self.base = state;
        self.entries.clear();
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.gyro = GyroTrack::default();
    }

    fn calibration(&self) -> Option<Calibration> {
        Some(self.state().calibration(&self.config.calibration))
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.entries
            .back()
            .map(|entry| entry.told.stamp)
            .or(self.base.stamp)
    }

    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        let index = count_before(&self.entries, |entry| entry.told.stamp <= stamp);
        let from = index
            .checked_sub(1)
            .and_then(|i| self.entries.get(i))
            .map_or(&self.base, |entry| &entry.after);
        from.stamp.filter(|known_from| *known_from <= stamp)?;
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

/// What an observation does to the filter; `None` for a kind that it has no use for.
fn action_of(observation: &Observation) -> Option<Action> {
    match observation.observed {
        Observed::Fix(_)
        | Observed::Landmark { .. }
        | Observed::BeaconRange { .. }
        | Observed::WallRange(_)
        | Observed::CompassHeading(_) => {
            Some(Action::Sight(observation.observed, observation.stamp_sigma))
        }
        Observed::WheelAccelerations { left, right } => {
            Some(Action::Accelerations(Accelerations {
                left_m_per_s2: left.0,
                right_m_per_s2: right.0,
            }))
        }
        Observed::TurnRate(rate) => Some(Action::TurnRate(rate.0)),
        Observed::WheelAngles { .. }
        | Observed::OdometerPose(_)
        | Observed::BodyVelocity { .. } => Some(Action::Motion),
        Observed::Temperature(_) => None,
    }
}

fn act<const N: usize>(
    state: &mut PoseState<N>,
    told: &Told,
    context: &Context<'_>,
    record: &mut FusionRecord,
) {
    let stamp = told.stamp;
    match told.action {
        // These tell of speeds alone: the pose goes on when the wheels have told how.
        Action::TurnRate(_) | Action::Accelerations(_) => {
            state.stamp = state.stamp.or(Some(stamp));
            state.age(stamp, context.config);
        }
        Action::Motion | Action::Sight(..) | Action::SetPose(_) | Action::Revise(_) => {
            state.advance(stamp, context.track, context.config);
        }
    }
    match told.action {
        Action::TurnRate(rate) => fuse::turn_rate(state, rate, context),
        Action::Accelerations(felt) => fuse::accelerations(state, felt, stamp, context),
        Action::Motion => fuse::motion(state, stamp, context, record),
        Action::Sight(seen, sigma) => sight::sight(state, &seen, sigma, context, record),
        Action::SetPose(start) => state.jump_to(&start),
        Action::Revise(revision) => state.revise(revision, context.config),
    }
}

fn published<const N: usize>(
    state: &PoseState<N>,
    stamp: Stamp<BrickClock>,
    config: &FilterConfig,
) -> Estimate {
    let fix_age = state.last_fix.map(|last| (stamp - last).max(Span::ZERO));
    let timeout = Span::from_secs_f64(config.params.fix_timeout_s);
    Estimate {
        stamp,
        pose: state.arena_pose(),
        forward_speed: MetersPerSecond(state.forward.value),
        turn_rate: RadiansPerSecond(state.turn.value),
        covariance: state.published_covariance(),
        validity: Validity {
            position: state.located != Located::No,
            heading: state.knows_heading(),
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

/// A record that nobody reads: an entry that is applied again was reported when it came. Its sensor says whose noise is learned.
const fn scratch_record(told: &Told) -> FusionRecord {
    intake::blank_record(told.sensor, told.stamp)
}

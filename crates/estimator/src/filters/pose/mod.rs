//! The flagship: an EKF with pose, speeds and gyro bias that applies every observation at its own time.
//!
//! The filter keeps what it was told for a few seconds, with the state after each. A late observation is put where it belongs,
//! the state before it is restored and what came after is applied again: exactly what would have happened had it come in time.
//! The order of arrival does not matter, bit for bit, as long as nothing is older than the history.
//!
//! Source: docs/maths/pose.md.

mod abreast;
mod entries;
pub mod fuse;
mod history;
mod iterate;
pub mod motion;
pub mod observer_spaces;
mod outlook;
mod placing;
mod revise;
pub mod scales;
mod sight;
pub mod smooth;
pub mod state;

use std::cmp::Ordering;

use posebridge_telemetry::{
    BrickClock, Calibration, Estimate, FusionRecord, Known, Observation, Observed, SensorId, Span, Stamp, Verdict,
};

use self::entries::{Applied, Entries};
use self::fuse::{Context, Gates};
use self::history::{Action, Told};
use self::revise::Revision;
use self::state::{CORE, PoseState, WITH_CAMERA, WITH_RANGES};
use super::{Adjustment, Filter, FilterConfig, StartPose, intake};
use crate::motion::{Added, GyroTrack, MotionReading, MotionTrack, count_before};
use crate::observations::accelerometer::Accelerations;
use crate::params::Params;

/// No hole in a sensor's readings is waited for longer than this before what lies in it is forgotten.
const LONGEST_HOLE: Span = Span::from_millis(10_000);

/// Builds the flagship with as many states as the configuration asks for.
#[must_use]
pub fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let calibration = &config.calibration;
    let is_asked = |known: Known| known.sigma > 0.0 || known.value != 0.0;
    let camera = [calibration.fix_delay_s, calibration.tag_forward_m, calibration.tag_left_m];
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
    /// In the order of [`Told::order`].
    entries: Entries<N>,
    /// The last entry was applied by the tunables that hold.
    is_last_current: bool,
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
            entries: Entries::new(PoseState::initial(config)),
            is_last_current: false,
            slip_told: None,
        }
    }

    /// Says on the record of a motion that was used if slip was noticed since the last one that said so. A fix may have noticed it, or an
    /// observation that came late: what is told first after it tells it.
    fn tell_slip(&mut self, record: &mut FusionRecord, observed: &Observed) {
        let slipped_at = self.state().slipped_at;
        if record.verdict == Verdict::Accepted && MotionReading::of(observed).is_some() && slipped_at > self.slip_told {
            record.verdict = Verdict::Slip;
            self.slip_told = slipped_at;
        }
    }

    /// The state after the last entry.
    #[must_use]
    pub fn state(&self) -> &PoseState<N> {
        self.entries.last()
    }

    /// Puts what was told where it belongs and applies again whatever it changes: everything after `changed_after`.
    fn insert(&mut self, told: Told, changed_after: Option<Stamp<BrickClock>>, record: &mut FusionRecord) {
        let entries = self.entries.told();
        let index = count_before(entries, |other| other.order(&told) != Ordering::Greater);
        let first_changed = changed_after.map_or(index, |after| count_before(entries, |other| other.stamp <= after));
        let first = first_changed.min(index);
        if first == index && self.is_abreast_of_last(&told, index, changed_after) {
            self.insert_abreast(told, index, record);
        } else {
            self.entries.insert(index, told);
            self.apply_from(first, (index, record));
        }
        self.forget();
    }

    fn context(&self) -> Context<'_> {
        Context { config: &self.config, track: &self.track, gyro: &self.gyro, gates: &self.gates }
    }

    fn apply_from(&mut self, first: usize, (wanted, recorded): (usize, &mut FusionRecord)) {
        let context = Context { config: &self.config, track: &self.track, gyro: &self.gyro, gates: &self.gates };
        for index in first..self.entries.len() {
            let entry = self.entries.apply(index);
            if index == wanted {
                apply(entry, &context, recorded);
            } else {
                let mut scratch = scratch_record(entry.told);
                apply(entry, &context, &mut scratch);
            }
        }
        self.is_last_current = true;
    }

    /// Up to where nothing can change when only observations from `horizon` on are accepted. One of them changes what was
    /// interpolated since the reading before it, so each sensor's last reading up to the horizon is where its past is settled.
    fn settled_at(&self, horizon: Stamp<BrickClock>) -> Stamp<BrickClock> {
        [self.track.last_of_old(horizon), self.gyro.last_of_old(horizon)]
            .into_iter()
            .flatten()
            .fold(horizon, Stamp::min)
            .max(horizon - LONGEST_HOLE)
    }

    fn forget(&mut self) {
        let Some(latest) = self.latest() else { return };
        let horizon = latest - Span::from_secs_f64(self.config.params.history_s);
        let oldest = self.entries.told().front().map(|told| told.stamp);
        if oldest.is_some_and(|oldest| oldest < horizon) {
            self.forget_before(self.settled_at(horizon));
        }
        let base = &self.entries.base;
        if let Some(oldest) = base.stamp {
            // The open gyro window may reach back behind the history.
            let needed = base.window.map_or(oldest, |window| window.start.min(oldest));
            // A late camera shows what was before that.
            self.track.forget_before(oldest - sight::FURTHEST_BACK);
            self.gyro.forget_before(needed);
        }
    }

    fn forget_before(&mut self, settled_at: Stamp<BrickClock>) {
        let told = self.entries.told().iter();
        let settled = told.take_while(|told| told.stamp < settled_at).count();
        self.entries.forget(settled);
    }

    fn take(&mut self, observation: &Observation, record: &mut FusionRecord) {
        let Some(action) = action_of(observation) else {
            record.verdict = Verdict::Unused;
            return;
        };
        match action {
            Action::Sight(..) | Action::Accelerations(_) | Action::SetPose(_) | Action::Revise(_) => {
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
        let told = told(observation, action);
        // In the order of time: behind the first that is older there is no other of this instant.
        let entries = self.entries.told().iter().rev();
        let is_repeated =
            entries.take_while(|other| other.stamp >= observation.stamp).any(|other| other.repeats(&told));
        if is_repeated {
            record.verdict = Verdict::Malformed;
            return;
        }
        self.insert(told, Some(observation.stamp), record);
    }

    fn take_motion(&mut self, observation: &Observation, action: Action, added: Added, record: &mut FusionRecord) {
        record.verdict = intake::verdict_of(added);
        let changed_after = match added {
            Added::After(before) => before,
            Added::Rebased(before) => Some(before),
            Added::Outranked | Added::Duplicate | Added::TooOld => return,
        };
        self.insert(told(observation, action), changed_after, record);
    }

    /// What a person says holds after all that was observed; before the first observation there is nothing to be after.
    fn take_word(&mut self, action: Action) {
        let Some(stamp) = self.latest() else {
            match action {
                Action::SetPose(start) => self.entries.base.jump_to(&start),
                Action::Revise(revision) => self.entries.base.revise(revision, &self.config),
                Action::TurnRate(_) | Action::Accelerations(_) | Action::Motion | Action::Sight(..) => {}
            }
            return;
        };
        let told = Told { stamp, sensor: SensorId(0), action };
        self.insert(told, None, &mut scratch_record(&told));
    }

    /// All tunables are read where they are used, but for two that something was made of.
    fn set_params(&mut self, params: &Params) {
        self.config.params = *params;
        self.gates = fuse::gates_of(&self.config);
        self.is_last_current = false;
        self.track.set_max_wheel_rad_per_s(params.max_wheel_rad_per_s);
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
        self.entries.restart(state);
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.gyro = GyroTrack::default();
    }

    fn calibration(&self) -> Option<Calibration> {
        Some(self.state().calibration(&self.config.calibration))
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        let last = self.entries.told().back();
        last.map(|told| told.stamp).or(self.entries.base.stamp)
    }

    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        let index = count_before(self.entries.told(), |told| told.stamp <= stamp);
        let from = self.entries.before(index);
        from.stamp.filter(|known_from| *known_from <= stamp)?;
        Some(outlook::estimate(from, stamp, &self.context()))
    }
}

const fn told(observation: &Observation, action: Action) -> Told {
    Told { stamp: observation.stamp, sensor: observation.sensor, action }
}

/// What an observation does to the filter; `None` for a kind that it has no use for.
fn action_of(observation: &Observation) -> Option<Action> {
    match observation.observed {
        Observed::Fix(_)
        | Observed::Landmark { .. }
        | Observed::BeaconRange { .. }
        | Observed::WallRange(_)
        | Observed::CompassHeading(_) => Some(Action::Sight(observation.observed, observation.stamp_sigma)),
        Observed::WheelAccelerations { left, right } => {
            Some(Action::Accelerations(Accelerations { left_m_per_s2: left.0, right_m_per_s2: right.0 }))
        }
        Observed::TurnRate(rate) => Some(Action::TurnRate(rate.0)),
        Observed::WheelAngles { .. } | Observed::OdometerPose(_) | Observed::BodyVelocity { .. } => {
            Some(Action::Motion)
        }
        Observed::Temperature(_) => None,
    }
}

/// Applies an entry to the state before it.
fn apply<const N: usize>(entry: Applied<'_, N>, context: &Context<'_>, record: &mut FusionRecord) {
    let Applied { told, before, after } = entry;
    act(after, told, context, record);
    if told.is_without_effect(record.verdict) {
        *after = before.after_refusal(after);
    }
}

fn act<const N: usize>(state: &mut PoseState<N>, told: &Told, context: &Context<'_>, record: &mut FusionRecord) {
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

/// A record that nobody reads: an entry that is applied again was reported when it came. Its sensor says whose noise is learned.
const fn scratch_record(told: &Told) -> FusionRecord {
    intake::blank_record(told.sensor, told.stamp)
}

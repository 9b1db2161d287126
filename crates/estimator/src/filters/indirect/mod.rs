//! The indirect filter: the wheels make the path, a Kalman filter follows only what is wrong with it.
//!
//! Gets wheels, accelerometers, a gyro and fixes. The nominal path comes from the wheels alone; the filter's state is its error
//! (see [`error_state`]) and its measurements are differences: what another sensor says minus what the nominal path says.
//!
//! # Model
//! ```text
//! x = x_ref + e            x_ref from the wheels, without noise            e, P by F, Gamma Q Gamma'
//! dz = z - h(x_ref)        angle by gyro     - heading of the path   = e_th + g   + rounding of the counts
//!                          angle by accel.   - heading of the path   = e_th + p_w + rounding
//!                          distance by accel. - distance of the path = e_s + p_s  + rounding
//!                          fix - pose of the path                    = [e_x, e_y, e_th]' and the tag's lever
//! feed-forward: x_ref is never touched, the estimate is x_ref + e
//! feedback:     after each update the path's and the geometry's errors move into x_ref, and become zero
//! ```
//! Observations are used when they come, against the state that is there, as in the paper: a late fix errs by what was driven
//! since. The gate for fixes and the way out of it are ours.
//!
//! # Sources
//! Paper 4, equations 1 to 22; docs/maths/paper4.md.

mod belief;
pub mod error_state;
mod fixes;
mod instruments;
mod nominal;

use std::collections::BTreeMap;

use posebridge_telemetry::{
    BrickClock, Calibration, Estimate, Fix, FusionRecord, Known, Observation, Observed, SensorId, Span, Stamp, Verdict,
};

use self::belief::Belief;
use self::error_state::{GYRO_BIAS, RADIUS_DIFFERENCE, RADIUS_SCALE, TRACK_SCALE};
use self::instruments::Sampled;
use self::nominal::Path;
use super::intake;
use super::timeline::Timeline;
use super::{Filter, FilterConfig, StartPose};
use crate::motion::{Added, MotionReading, MotionTrack};

/// What happens to the errors that were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Correction {
    /// They are added to the output only: the paper's equations as they stand.
    FeedForward,
    /// They correct the nominal path, which therefore stays close to the truth.
    Feedback,
}

/// Fixes that the gate refused in a row.
#[derive(Clone, Copy, Debug)]
struct Refused {
    since: Stamp<BrickClock>,
    count: f64,
}

/// The indirect filter.
pub struct IndirectFilter {
    config: FilterConfig,
    track: MotionTrack,
    path: Path,
    timeline: Timeline<Belief>,
    latest: Option<Stamp<BrickClock>>,
    /// The last fix of each sensor that was used.
    last_fixes: BTreeMap<SensorId, Stamp<BrickClock>>,
    refused: Option<Refused>,
}

impl IndirectFilter {
    /// Starts at the configured pose, or at the arena's origin until the first fix places it.
    #[must_use]
    pub fn new(config: &FilterConfig, correction: Correction) -> Self {
        Self {
            config: config.clone(),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            path: Path::new(config, correction),
            timeline: Timeline::new(config.params.history_s),
            latest: None,
            last_fixes: BTreeMap::new(),
            refused: None,
        }
    }

    fn take_motion(&mut self, record: &mut FusionRecord, stamp: Stamp<BrickClock>, reading: &MotionReading) {
        let is_late = self.path.stamp().is_some_and(|last| stamp < last);
        let added = self.track.add(stamp, reading);
        record.verdict = match (added, is_late) {
            // The path has gone past it: as late as it is, it changes nothing.
            (Added::After(_) | Added::Rebased(_), true) => Verdict::TooOld,
            _ => intake::verdict_of(added),
        };
        if record.verdict == Verdict::Accepted {
            self.path.advance(&self.track, stamp);
            self.path.compare(record);
        } else if record.verdict == Verdict::Rebased {
            self.path.advance_unseen(stamp);
        } else {
            return;
        }
        self.track.forget_before(stamp - Span::from_secs_f64(self.config.params.history_s));
        self.note(stamp);
    }

    fn take_sample(&mut self, record: &mut FusionRecord, sampled: Sampled) {
        record.verdict = match sampled {
            Sampled::Continued | Sampled::Begun => Verdict::Accepted,
            Sampled::Twice => Verdict::Malformed,
            Sampled::TooOld => Verdict::TooOld,
        };
        if record.verdict == Verdict::Accepted {
            self.path.compare(record);
            self.note(record.stamp);
        }
    }

    fn take_fix(&mut self, record: &mut FusionRecord, fix: &Fix, stamp_sigma_s: f64) {
        let stamp = record.stamp;
        let before = self.last_fixes.get(&record.sensor).copied();
        if let Some(verdict) = intake::refuse_repeated(before, stamp) {
            record.verdict = verdict;
            return;
        }
        record.verdict = if self.path.is_placed() {
            self.path.use_fix(record, fix, stamp_sigma_s)
        } else {
            self.path.place(fix);
            Verdict::ResetTo
        };
        if record.verdict == Verdict::Gated && self.is_locked_out(stamp) {
            self.path.place(fix);
            record.verdict = Verdict::ResetTo;
        }
        if !matches!(record.verdict, Verdict::Accepted | Verdict::ResetTo) {
            return;
        }
        self.last_fixes.insert(record.sensor, stamp);
        self.refused = None;
        self.path.note_fix(stamp);
        if self.path.stamp().is_none() {
            self.path.start_at(stamp);
        }
        self.note(stamp);
    }

    /// Counts a refused fix; true when they have been refused for so long that the gate must be wrong.
    fn is_locked_out(&mut self, stamp: Stamp<BrickClock>) -> bool {
        let refused = self.refused.get_or_insert(Refused { since: stamp, count: 0.0 });
        refused.count += 1.0;
        (stamp - refused.since).as_secs_f64() >= self.config.params.reset_after_s
            && refused.count >= self.config.params.reset_after_fixes
    }

    /// Notes the latest instant, and what is believed at the path's end.
    fn note(&mut self, stamp: Stamp<BrickClock>) {
        self.latest = self.latest.max(Some(stamp));
        if let Some(end) = self.path.stamp() {
            self.timeline.push(end, self.path.belief());
        }
    }
}

impl Filter for IndirectFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let lag = intake::lag_of(observation, self.latest);
        let mut record = intake::bare_record(observation, lag, Verdict::Unused);
        let history_s = self.config.params.history_s;
        let stamp = observation.stamp;
        if let Some(verdict) = intake::refuse_outright(observation, self.latest, history_s) {
            record.verdict = verdict;
        } else if let Some(reading) = MotionReading::of(&observation.observed) {
            self.take_motion(&mut record, stamp, &reading);
        } else if let Observed::TurnRate(rate) = observation.observed {
            let sampled = self.path.add_gyro(stamp, rate.0);
            self.take_sample(&mut record, sampled);
        } else if let Observed::WheelAccelerations { left, right } = observation.observed {
            let sampled = self.path.add_accelerations(stamp, (left.0, right.0));
            self.take_sample(&mut record, sampled);
        } else if let Observed::Fix(fix) = observation.observed {
            self.take_fix(&mut record, &fix, observation.stamp_sigma.as_secs_f64());
        }
        record
    }

    fn set_pose(&mut self, start: &StartPose) -> Verdict {
        if !intake::is_usable(start) {
            return Verdict::Malformed;
        }
        self.path.set(start);
        self.timeline.clear();
        self.refused = None;
        if let Some(end) = self.latest {
            self.path.start_at(end);
            self.note(end);
        }
        Verdict::ResetTo
    }

    fn restart_clock(&mut self) {
        self.path.restart_clock();
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.timeline.clear();
        self.latest = None;
        self.last_fixes.clear();
        self.refused = None;
    }

    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.latest
    }

    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        let (at, belief) = self.timeline.up_to(stamp)?;
        Some(belief.estimate(&self.config, at, stamp))
    }

    fn calibration(&self) -> Option<Calibration> {
        let known = |row| {
            let (value, sigma) = self.path.learned(row);
            Known { value, sigma }
        };
        Some(Calibration {
            radius_scale: known(RADIUS_SCALE),
            radius_difference: known(RADIUS_DIFFERENCE),
            track_scale: known(TRACK_SCALE),
            gyro_bias_rad_per_s: known(GYRO_BIAS),
            ..self.config.calibration
        })
    }
}

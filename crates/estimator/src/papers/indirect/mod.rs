//! The indirect filter: the wheels alone give the path, and a Kalman filter estimates only its error (see
//! [`error_state`]), from another sensor's reading minus that of the nominal path.
//!
//! ```text
//! x = x_ref + e            x_ref from the wheels, without noise            e, P by F, Gamma Q Gamma'
//! dz = z - h(x_ref)        angle by gyro     - heading of the path   = e_th + g   + rounding of the counts
//!                          angle by accel.   - heading of the path   = e_th + p_w + rounding
//!                          distance by accel. - distance of the path = e_s + p_s  + rounding
//!                          fix - pose of the path                    = [e_x, e_y, e_th]' and the tag's lever
//! feed-forward: x_ref is never touched, the estimate is x_ref + e
//! feedback:     after each update the path's and the geometry's errors move into x_ref, and become zero
//! ```
//! Observations are used when they come, as in the paper. The gate for fixes and the way out of it are ours.
//!
//! Source: Paper 4, equations 1 to 22; docs/lab/indirect.md.

pub mod error_state;
mod instruments;
mod nominal_path;
mod path_state;

use std::collections::BTreeMap;

use posebridge_telemetry::{
    BrickClock, Calibration, Estimate, Fix, FusionOutcome, FusionRecord, Observation, ObservationKind, SensorId,
    StartPose, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

use self::error_state::{GYRO_BIAS, RADIUS_DIFFERENCE, RADIUS_SCALE, TRACK_SCALE};
pub use self::nominal_path::CorrectionMode;
use self::nominal_path::{NominalPath, SavedPath};
use self::path_state::PathState;
use crate::filter::{Filter, FilterConfig};
use crate::motion::{InsertOutcome, MotionReading, MotionTrack, SavedTrack, TimeSeries};
use crate::saved::{self, RestoreError, not_negative};
use crate::validation;

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct RejectedFixStreak {
    since: Timestamp<BrickClock>,
    #[serde(deserialize_with = "not_negative")]
    count: f64,
}

pub struct IndirectFilter {
    config: FilterConfig,
    track: MotionTrack,
    path: NominalPath,
    history: TimeSeries<PathState>,
    latest: Option<Timestamp<BrickClock>>,
    last_fixes: BTreeMap<SensorId, Timestamp<BrickClock>>,
    rejected_fixes: Option<RejectedFixStreak>,
}

/// An indirect filter without its configuration.
#[derive(Serialize, Deserialize)]
struct SavedIndirect {
    track: SavedTrack,
    path: SavedPath,
    history: TimeSeries<PathState>,
    latest: Option<Timestamp<BrickClock>>,
    last_fixes: BTreeMap<SensorId, Timestamp<BrickClock>>,
    rejected_fixes: Option<RejectedFixStreak>,
}

impl IndirectFilter {
    /// Starts at the configured pose, or at the arena's origin until the first fix places it.
    pub fn new(config: &FilterConfig, correction: CorrectionMode) -> Self {
        Self {
            config: config.clone(),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            path: NominalPath::new(config, correction),
            history: TimeSeries::default(),
            latest: None,
            last_fixes: BTreeMap::new(),
            rejected_fixes: None,
        }
    }

    fn observe_motion(&mut self, record: &mut FusionRecord, stamp: Timestamp<BrickClock>, reading: &MotionReading) {
        let is_late = self.path.stamp.is_some_and(|last| stamp < last);
        let added = self.track.insert(stamp, reading);
        record.outcome = match (added, is_late) {
            // The path is past it: as late as it is, it changes nothing.
            (InsertOutcome::Inserted(_) | InsertOutcome::Rebased(_), true) => FusionOutcome::TooOld,
            _ => validation::fusion_outcome(added),
        };
        if record.outcome == FusionOutcome::Accepted {
            self.path.advance(&self.track, stamp);
            self.path.compare_instruments(record);
        } else if record.outcome == FusionOutcome::Rebased {
            self.path.advance_unobserved(stamp);
        } else {
            return;
        }
        self.track.discard_before(stamp - TimeDelta::from_secs_f64(self.config.params.history_s));
        self.save_state(stamp);
    }

    fn observe_sample(&mut self, record: &mut FusionRecord, sampled: Result<(), FusionOutcome>) {
        record.outcome = sampled.err().unwrap_or(FusionOutcome::Accepted);
        if sampled.is_ok() {
            self.path.compare_instruments(record);
            self.save_state(record.stamp);
        }
    }

    fn observe_fix(&mut self, record: &mut FusionRecord, fix: &Fix, stamp_sigma_s: f64) {
        let stamp = record.stamp;
        let before = self.last_fixes.get(&record.sensor).copied();
        if let Some(verdict) = validation::reject_repeated(before, stamp) {
            record.outcome = verdict;
            return;
        }
        record.outcome = if self.path.has_pose {
            self.path.use_fix(record, fix, stamp_sigma_s)
        } else {
            self.path.initialize_from_fix(fix);
            FusionOutcome::PoseReset
        };
        if record.outcome == FusionOutcome::Gated && self.is_locked_out(stamp) {
            self.path.initialize_from_fix(fix);
            record.outcome = FusionOutcome::PoseReset;
        }
        if !matches!(record.outcome, FusionOutcome::Accepted | FusionOutcome::PoseReset) {
            return;
        }
        self.last_fixes.insert(record.sensor, stamp);
        self.rejected_fixes = None;
        self.path.status.last_fix = self.path.status.last_fix.max(Some(stamp));
        if self.path.stamp.is_none() {
            self.path.start_at(stamp);
        }
        self.save_state(stamp);
    }

    /// Counts a rejected fix; true when the gate has rejected fixes for so long that it must be wrong.
    fn is_locked_out(&mut self, stamp: Timestamp<BrickClock>) -> bool {
        let refused = self.rejected_fixes.get_or_insert(RejectedFixStreak { since: stamp, count: 0.0 });
        refused.count += 1.0;
        (stamp - refused.since).as_secs_f64() >= self.config.params.reset_after_s
            && refused.count >= self.config.params.reset_after_fixes
    }

    /// Records the latest instant, and the state at the path's end.
    fn save_state(&mut self, stamp: Timestamp<BrickClock>) {
        self.latest = self.latest.max(Some(stamp));
        if let Some(end) = self.path.stamp {
            let length = TimeDelta::from_secs_f64(self.config.params.history_s);
            self.history.push(end, self.path.path_state(), length);
        }
    }
}

impl Filter for IndirectFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let stamp = observation.stamp;
        validation::observe_if_valid(observation, self.latest, self.config.params.history_s, |record| {
            if let Some(reading) = MotionReading::from_observation(&observation.measurement) {
                self.observe_motion(record, stamp, &reading);
            } else if let ObservationKind::TurnRate(rate) = observation.measurement {
                let sampled = self.path.gyro.integrate(stamp, rate.0);
                self.observe_sample(record, sampled);
            } else if let ObservationKind::WheelAccelerations { left, right } = observation.measurement {
                let sampled = self.path.add_accelerations(stamp, left.0, right.0);
                self.observe_sample(record, sampled);
            } else if let ObservationKind::Fix(fix) = observation.measurement {
                self.observe_fix(record, &fix, observation.stamp_sigma.as_secs_f64());
            }
        })
    }

    fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        if !validation::is_valid_start(start) {
            return FusionOutcome::Malformed;
        }
        self.path.set_pose(start);
        self.history = TimeSeries::default();
        self.rejected_fixes = None;
        if let Some(end) = self.latest {
            self.path.start_at(end);
            self.save_state(end);
        }
        FusionOutcome::PoseReset
    }

    fn save(&self) -> Vec<u8> {
        let Self { config: _, track, path, history, latest, last_fixes, rejected_fixes } = self;
        saved::to_bytes(&SavedIndirect {
            track: track.save(),
            path: path.save(),
            history: history.clone(),
            latest: *latest,
            last_fixes: last_fixes.clone(),
            rejected_fixes: *rejected_fixes,
        })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
        let SavedIndirect { track, path, history, latest, last_fixes, rejected_fixes } = saved::from_bytes(saved)?;
        let fresh = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.track = fresh.with_saved(track);
        self.path = self.path.with_saved(&path);
        self.history = history;
        self.latest = latest;
        self.last_fixes = last_fixes;
        self.rejected_fixes = rejected_fixes;
        Ok(())
    }

    fn restart_clock(&mut self) {
        self.path.restart_clock();
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.history = TimeSeries::default();
        self.latest = None;
        self.last_fixes.clear();
        self.rejected_fixes = None;
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.latest
    }

    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        let (at, state) = self.history.last_at_or_before(stamp)?;
        Some(state.estimate(&self.config, *at, stamp))
    }

    fn calibration(&self) -> Option<Calibration> {
        Some(Calibration {
            radius_scale: self.path.calibration_value(RADIUS_SCALE),
            radius_difference: self.path.calibration_value(RADIUS_DIFFERENCE),
            track_scale: self.path.calibration_value(TRACK_SCALE),
            gyro_bias_rad_per_s: self.path.calibration_value(GYRO_BIAS),
            ..self.config.calibration
        })
    }
}

//! The contract of every filter: its configuration, its inputs, and its estimates.

use std::sync::Arc;

use posebridge_telemetry::{
    ArenaMap, BrickClock, Calibration, DriveGeometry, Estimate, FusionOutcome, FusionRecord, Observation,
    OnlineCalibration, ScalarEstimate, SensorNoise, StartPose, Timestamp, UncertainValue,
};

use crate::models::slow_sensor::SlowSensor;
use crate::params::Params;
use crate::saved::RestoreError;
use crate::validation::is_valid_start;

/// A filter of a pose or of one quantity: observations in, estimates out.
pub trait Filter: Send {
    fn observe(&mut self, observation: &Observation) -> FusionRecord;

    /// Sets the pose at [`Filter::latest_time`], after all observations of that instant:
    /// [`FusionOutcome::PoseReset`], a counted reset; [`FusionOutcome::Malformed`] and no change when a number is not
    /// finite or a sigma is negative; `Unused` without a pose.
    fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        if is_valid_start(start) { FusionOutcome::Unused } else { FusionOutcome::Malformed }
    }

    /// Applies a command after all observations up to [`Filter::latest_time`]; [`FusionOutcome::Unused`] and no
    /// change from a filter that does not support it.
    fn apply_command(&mut self, adjustment: &FilterCommand) -> FusionOutcome {
        let _ = adjustment;
        FusionOutcome::Unused
    }

    /// Restarts after a reset of the brick's clock: forgets all observations and keeps the pose with a larger covariance.
    fn restart_clock(&mut self);

    /// The latest stamp of an observation.
    fn latest_time(&self) -> Option<Timestamp<BrickClock>>;

    /// The estimate for an instant: past ones as far as the history reaches, later ones by prediction. `None` before the first
    /// observation, for instants older than the history, and from a filter that has no pose.
    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        let _ = stamp;
        None
    }

    /// The learned calibration; `None` for a filter that learns nothing.
    fn calibration(&self) -> Option<Calibration> {
        None
    }

    /// All that later estimates depend on beside the configuration, as bytes for [`Self::restore`].
    fn save(&self) -> Vec<u8>;

    /// Continues from a state that a filter of the same kind and configuration has saved, bit for bit: with the same observations, the same
    /// records and estimates. On an error nothing has changed. The bytes may be anything.
    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError>;

    /// The estimate of a filter that follows one quantity instead of a pose, for an instant; `None` for the others.
    fn scalar_at(&self, stamp: Timestamp<BrickClock>) -> Option<ScalarEstimate> {
        let _ = stamp;
        None
    }
}

/// A command of the operator to a running filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FilterCommand {
    /// Late observations, and the replay that they cause, use the new tunables too.
    SetParams(Params),
    /// Make the pose unknown until the next fix; counts as a reset.
    ResetPose,
    SetOnlineCalibration(OnlineCalibration),
    /// Return to the configured calibration, including the gyro bias.
    ResetCalibration,
}

/// Everything that a filter is built from.
#[derive(Clone, Debug, PartialEq)]
pub struct FilterConfig {
    pub geometry: DriveGeometry,
    pub noise: SensorNoise,
    /// `None` if the first fixes decide.
    pub start: Option<StartPose>,
    pub params: Params,
    /// Priors of the systematic errors. A constant whose sigma is zero is fixed and not estimated.
    pub calibration: Calibration,
    pub arena_map: Arc<ArenaMap>,
    /// Of the filter `dynamic-live`, and of thermometers that are not configured one by one.
    pub slow_sensor: SlowSensor,
}

impl FilterConfig {
    /// The gyro bias at power-up: from the calibration, or within the gyro's own spread.
    pub(crate) fn gyro_bias_prior(&self) -> UncertainValue {
        let known = self.calibration.gyro_bias_rad_per_s;
        let sigma = if known.sigma > 0.0 { known.sigma } else { self.noise.gyro_bias_rad_per_s };
        UncertainValue { value: known.value, sigma }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use posebridge_telemetry::{Meters, Pose, Radians};

    use super::*;

    /// A small robot with a known start and nothing to calibrate.
    pub(crate) fn config() -> FilterConfig {
        FilterConfig {
            geometry: DriveGeometry {
                left_wheel_radius: Meters(0.028),
                right_wheel_radius: Meters(0.028),
                track_width: Meters(0.112),
                tick: Radians(0.017_453_3),
            },
            noise: SensorNoise {
                wheel_travel_m_per_sqrt_m: 0.0008,
                turn_rad_per_sqrt_rad: 0.004,
                gyro_rad_per_s: 0.01,
                gyro_bias_rad_per_s: 0.02,
                fix_position_m: 0.005,
                fix_heading_rad: 0.02,
                temperature_k: 0.1,
                ..SensorNoise::EXACT
            },
            start: Some(StartPose { pose: Pose::default(), position_sigma_m: 1e-4, heading_sigma_rad: 1e-4 }),
            params: Params::default(),
            calibration: Calibration::default(),
            arena_map: Arc::default(),
            slow_sensor: SlowSensor::UNKNOWN,
        }
    }
}

//! What one filter's own file must define: its matrices, and nothing about the instants and the order of observations.

use posebridge_telemetry::{Fix, FusionOutcome, FusionRecord, UncertainValue};

use super::wheel_counters::WheelStep;
use crate::filter::{FilterConfig, StartPose};
use crate::models::planar_speeds::{Acceleration, Covariance, Mean};

/// What a filter's maths may ask about its surroundings.
pub(in crate::papers) struct SampledContext {
    /// The filter's configuration.
    pub(in crate::papers) config: FilterConfig,
    /// Quantiles of chi-square with one, two and three degrees of freedom.
    pub(in crate::papers) gates: [f64; 3],
}

/// The sensors that not every filter has a use for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::papers) enum OptionalSensor {
    Gyro,
    Accelerometers,
    Camera,
}

/// Pose and speeds with their covariance, rows as [`row`], SI units, heading not wrapped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::papers) struct GaussianState {
    pub(in crate::papers) mean: Mean,
    pub(in crate::papers) covariance: Covariance,
}

/// One filter's maths.
pub(in crate::papers) trait SampledFilter: Copy + Send {
    /// Whether it has a use for a sensor besides the wheels.
    fn uses(&self, extra: OptionalSensor) -> bool;

    /// The estimated pose and speeds.
    fn gaussian_state(&self, context: &SampledContext) -> GaussianState;

    /// The bias of the gyro, in rad/s, where it is a state.
    fn gyro_bias(&self) -> Option<UncertainValue> {
        None
    }

    /// Moves the pose to a start; what is known about the speeds stays.
    fn initialize_pose(&mut self, start: &StartPose);

    /// Forgets the speeds, and adds uncertainty to the pose: standard deviations in m and rad.
    fn reset_speeds(&mut self, position_m: f64, heading_rad: f64, context: &SampledContext);

    /// Predicts over `dt_s` with the speeds that are held.
    fn predict(&mut self, dt_s: f64, felt: Acceleration, context: &SampledContext);

    /// Lets `dt_s` pass in which nothing observes the motion.
    fn predict_unobserved(&mut self, dt_s: f64, context: &SampledContext);

    /// Uses these speeds (m/s, rad/s) for the next prediction, over a gap whose path has the variance `path_m2` per axis.
    fn bridge_gap(&mut self, speeds: [f64; 2], path_m2: f64);

    /// The counters have a new base: what the wheels did up to here is what was predicted.
    fn rebase_wheels(&mut self, context: &SampledContext);

    /// The gyro's integral begins here.
    fn rebase_gyro(&mut self);

    /// Uses what the wheels turned since the reading before.
    fn use_wheels(&mut self, step: &WheelStep, context: &SampledContext, record: &mut FusionRecord) -> FusionOutcome;

    /// Uses the mean turn rate of the last `dt_s`, bias included, in rad/s.
    fn use_gyro(
        &mut self,
        rate_rad_per_s: f64,
        dt_s: f64,
        context: &SampledContext,
        record: &mut FusionRecord,
    ) -> FusionOutcome {
        let _ = (rate_rad_per_s, dt_s, context, record);
        FusionOutcome::Unused
    }

    /// Uses a fix whose stamp may be off by `stamp_sigma_s`.
    fn use_fix(
        &mut self,
        fix: &Fix,
        stamp_sigma_s: f64,
        context: &SampledContext,
        record: &mut FusionRecord,
    ) -> FusionOutcome {
        let _ = (fix, stamp_sigma_s, context, record);
        FusionOutcome::Unused
    }
}

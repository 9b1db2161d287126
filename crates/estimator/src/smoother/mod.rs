//! What needs the whole run at once: the best estimate in hindsight, and how good any estimate could be.
//!
//! Nothing here is for use while a robot drives. [`batch()`] finds the path that is most likely given everything that was
//! observed, late or not, before or after; reports show it, and filters are held against it. [`cramer_rao_bound`] says how small
//! the error of a filter can be at all. Neither uses a
//! filter's code. [`rts()`] is the flagship itself, run forwards and back.
//!
//! Source: docs/maths/pose.md.

pub mod batch;
pub mod cramer_rao;
mod factors;
mod fix_factors;
mod forward_pass;
mod gauss_newton;
mod motion_factors;
mod outer_iterations;
mod posterior;
mod problem;
pub mod rts;
mod trajectory;
mod values;

pub use batch::batch;
pub use cramer_rao::{FixArrival, FixContent, GroundTruthRun, cramer_rao_bound};
pub use rts::rts;
pub use trajectory::{OfflineError, SmoothedPose, SmoothedTrajectory};

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use posebridge_telemetry::{ArenaMap, Calibration, DriveGeometry, Meters, Pose, Radians, SensorNoise};

    use crate::filter::{FilterConfig, StartPose};
    use crate::params::Params;

    /// A small robot with a known start and nothing to calibrate.
    pub(super) fn config() -> FilterConfig {
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
                ..SensorNoise::EXACT
            },
            start: Some(StartPose { pose: Pose::default(), position_sigma_m: 1e-4, heading_sigma_rad: 1e-4 }),
            params: Params::default(),
            calibration: Calibration::default(),
            arena_map: Arc::new(ArenaMap::default()),
        }
    }
}

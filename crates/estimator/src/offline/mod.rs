//! What needs the whole run at once: the best estimate in hindsight, and how good any estimate could be.
//!
//! Nothing here is for use while a robot drives. [`batch()`] finds the path that is most likely given everything that was
//! observed, late or not, before or after; reports show it, and filters are held against it. [`bound()`] says how small
//! the error of a filter can be at all. Neither uses a
//! filter's code. [`rts()`] is the flagship itself, run forwards and back.
//!
//! Source: docs/maths/batch.md.

pub mod batch;
pub mod bound;
mod descent;
mod factors;
mod fixes;
mod front;
mod judged;
mod motion;
mod problem;
mod rounds;
pub mod rts;
mod values;
mod walk;

pub use batch::{OfflineError, Smoothed, SmoothedPose, batch};
pub use bound::{FixArrival, Sees, TrueRun, bound};
pub use rts::rts;

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use posebridge_telemetry::{Calibration, DriveGeometry, Meters, Pose, Radians, SensorNoise, World};

    use crate::filters::{FilterConfig, StartPose};
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
            world: Arc::new(World::default()),
        }
    }
}

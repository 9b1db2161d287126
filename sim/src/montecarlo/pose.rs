//! A pose in plain numbers.

use posebridge_telemetry::{Arena, Heading, Meters, Pose};

/// A pose in the arena.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct PlanarPose {
    pub(super) x_m: f64,
    pub(super) y_m: f64,
    pub(super) heading_rad: f64,
}

impl From<PlanarPose> for Pose<Arena> {
    fn from(pose: PlanarPose) -> Self {
        Self::new(Meters(pose.x_m), Meters(pose.y_m), Heading::from_rad(pose.heading_rad))
    }
}

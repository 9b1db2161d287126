//! The commands of a drive, step by step.

use posebridge_telemetry::quantities::wrap_rad;

use super::pose::PlanarPose;

/// The command of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct StepCommand {
    /// Distance, in metres.
    pub(super) forward_m: f64,
    /// Turn, in radians.
    pub(super) turn_rad: f64,
    /// The line to follow; only on a side.
    pub(super) side: Option<LineTracker>,
}

/// A controller that keeps the robot on a directed line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LineTracker {
    pub(super) from_m: (f64, f64),
    pub(super) heading_rad: f64,
    pub(super) heading_gain: f64,
    pub(super) lateral_gain_rad_per_m: f64,
    pub(super) most_turn_rad: f64,
}

impl LineTracker {
    /// The controller's correction of this step's turn.
    pub(super) fn correction_rad(&self, pose: &PlanarPose) -> f64 {
        let (sin, cos) = self.heading_rad.sin_cos();
        let left_of_line_m = cos * (pose.y_m - self.from_m.1) - sin * (pose.x_m - self.from_m.0);
        let wanted_rad = self.heading_gain * wrap_rad(self.heading_rad - pose.heading_rad)
            - self.lateral_gain_rad_per_m * left_of_line_m;
        wanted_rad.clamp(-self.most_turn_rad, self.most_turn_rad)
    }
}

/// The commands of a whole drive, with the start pose.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DrivePlan {
    pub(super) start: PlanarPose,
    pub(super) commands: Vec<StepCommand>,
}

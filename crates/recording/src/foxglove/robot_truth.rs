//! The truth of one of several simulated robots as JSON.

use posebridge_telemetry::RobotId;
use schemars::JsonSchema;
use serde::Serialize;

use super::records::TruthRecord;
use crate::container::TruthSample;

/// Where one of several simulated robots really was.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct RobotTruthRecord {
    /// Number of the robot's link.
    pub(super) link: u16,
    /// MAVLink system id of the robot.
    pub(super) system: u8,
    /// MAVLink component id of the robot.
    pub(super) component: u8,
    #[serde(flatten)]
    pub(super) truth: TruthRecord,
}

impl RobotTruthRecord {
    /// The record of a sample of this robot.
    pub(super) fn new(robot: RobotId, sample: &TruthSample) -> Self {
        Self {
            link: robot.link.0,
            system: robot.address.system.0,
            component: robot.address.component.0,
            truth: TruthRecord::from(sample),
        }
    }
}

//! What a mission asks the station to send or to say.

use posebridge_protocol::message::{Message, Setpoint};

use super::plan_upload::PlanClient;

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum MissionAction {
    /// To a ground station, on its link.
    Answer(PlanClient, Message),
    /// To the robot.
    Drive(Setpoint),
    /// To all ground stations.
    Announce(Message),
    Report {
        severity: u8,
        text: String,
    },
}

impl MissionAction {
    pub(crate) const fn report(severity: u8, text: String) -> Self {
        Self::Report { severity, text }
    }
}

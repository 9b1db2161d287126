//! What people and programs have asked of the station, as far as it holds.

use posebridge_estimator::Params;
use posebridge_telemetry::{Command, LinkId, SimulatorCommand};

use crate::sender_identity::RobotIndex;

/// What was asked of the station and holds until something else is asked.
pub(crate) struct OperatorState {
    /// The tunables that were saved last, or with which the run began.
    pub(crate) saved_params: Params,
    /// The link over which the program was asked for something last: there it reports what became of it.
    pub(crate) requested_on: Option<LinkId>,
    last_command: Option<TargetedCommand>,
}

#[derive(Clone, Copy, PartialEq)]
pub(crate) struct TargetedCommand {
    pub(crate) target: CommandTarget,
    pub(crate) command: Command,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CommandTarget {
    /// For no robot in particular: a pose is that of the first robot, calibration and sensors are those of all robots.
    Station,
    /// For this robot alone, where it concerns robots.
    Robot(RobotIndex),
}

impl OperatorState {
    pub(crate) const fn new(params: Params) -> Self {
        Self { saved_params: params, requested_on: None, last_command: None }
    }

    /// Whether a held key repeats what it said before.
    pub(crate) fn is_key_repeat(&mut self, command: TargetedCommand) -> bool {
        let is_drive = matches!(command.command, Command::Simulator(SimulatorCommand::Drive { .. }));
        let before = self.last_command.replace(command);
        is_drive && before == Some(command)
    }
}

impl CommandTarget {
    /// The robot whose pose it is about.
    pub(crate) const fn posed_robot(self) -> RobotIndex {
        match self {
            Self::Station => 0,
            Self::Robot(index) => index,
        }
    }
}

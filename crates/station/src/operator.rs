//! Operator settings of the station that stay in effect.

use posebridge_estimator::Params;
use posebridge_telemetry::{Command, LinkId, SimulatorCommand};

use crate::sender_identity::RobotIndex;

pub(crate) struct OperatorState {
    /// The tunables that were saved last, or those of the start.
    pub(crate) saved_params: Params,
    /// The link of the last request to the program, on which the result is reported.
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
    /// No single robot: a pose applies to the first robot, calibration and sensors to all robots.
    Station,
    /// This robot alone, for commands about robots.
    Robot(RobotIndex),
}

impl OperatorState {
    pub(crate) const fn new(params: Params) -> Self {
        Self { saved_params: params, requested_on: None, last_command: None }
    }

    /// Whether a command repeats the last one because a key is held, or is one of a stream of speeds from a program.
    pub(crate) fn is_key_repeat(&mut self, command: TargetedCommand) -> bool {
        let is_key = matches!(command.command, Command::Simulator(SimulatorCommand::Drive { .. }));
        let is_stream = |command: &TargetedCommand| matches!(command.command, Command::Drive { .. });
        let before = self.last_command.replace(command);
        let is_continued =
            before.is_some_and(|before| before.target == command.target && is_stream(&before) && is_stream(&command));
        is_key && before == Some(command) || is_continued
    }
}

impl CommandTarget {
    pub(crate) const fn posed_robot(self) -> RobotIndex {
        match self {
            Self::Station => 0,
            Self::Robot(index) => index,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_equal_drive_command_in_a_row_is_a_repeated_key() {
        let target = |command| TargetedCommand { target: CommandTarget::Station, command };
        let drive = |forward_m_per_s| {
            target(Command::Simulator(SimulatorCommand::Drive { forward_m_per_s, turn_rad_per_s: 0.0 }))
        };
        let reset = target(Command::ResetPose);
        let mut state = OperatorState::new(Params::default());
        let sequence = [drive(0.1), drive(0.1), drive(0.2), reset, reset, drive(0.2)];
        assert_eq!(sequence.map(|command| state.is_key_repeat(command)), [false, true, false, false, false, false]);
    }
}

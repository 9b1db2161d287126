//! What a key does to the simulated brick: the commands of the page's buttons, with the values that stand there at first.

use posebridge_telemetry::simulator::SlippingWheel;
use posebridge_telemetry::{Command, SensorSwitch, SimulatorCommand, TimeDelta};

/// Something that happens to the simulated brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorAction {
    /// It is lifted and put down elsewhere.
    Kidnap,
    /// Its camera is covered or uncovered.
    Camera,
    /// A wheel slips.
    Slip,
    /// Its cable is pulled.
    PullCable,
}

/// The camera as it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraState {
    /// It sees.
    Open,
    /// It was covered from here.
    Covered,
}

impl OperatorAction {
    /// As a command; the camera is turned into what it is not.
    pub const fn command(self, camera: CameraState) -> Command {
        Command::Simulator(match self {
            Self::Kidnap => SimulatorCommand::Kidnap { forward_m: 0.3, left_m: 0.2, turn_rad: 60_f64.to_radians() },
            Self::Camera => SimulatorCommand::Camera(match camera {
                CameraState::Open => SensorSwitch::Off,
                CameraState::Covered => SensorSwitch::On,
            }),
            Self::Slip => SimulatorCommand::Slip {
                wheel: SlippingWheel::Left,
                factor: 0.8,
                duration: TimeDelta::from_millis(1_000),
            },
            Self::PullCable => SimulatorCommand::PullCable { duration: TimeDelta::from_millis(3_000) },
        })
    }

    /// What was asked for, in words.
    pub const fn description(self, camera: CameraState) -> &'static str {
        match (self, camera) {
            (Self::Kidnap, _) => "the robot is kidnapped",
            (Self::Camera, CameraState::Open) => "the camera is covered",
            (Self::Camera, CameraState::Covered) => "the camera is uncovered",
            (Self::Slip, _) => "the left wheel slips for a second",
            (Self::PullCable, _) => "the cable is pulled for 3 s",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_dashboard::command;

    #[test]
    fn each_key_gives_the_command_of_the_page_s_button() {
        let cases = [
            (
                OperatorAction::Kidnap,
                CameraState::Open,
                r#"{"command":"kidnap","forward_m":0.3,"left_m":0.2,"turn_rad":1.0471975511965976}"#,
            ),
            (OperatorAction::Camera, CameraState::Open, r#"{"command":"camera","on":false}"#),
            (OperatorAction::Camera, CameraState::Covered, r#"{"command":"camera","on":true}"#),
            (OperatorAction::Slip, CameraState::Open, r#"{"command":"slip","wheel":"left","factor":0.8,"seconds":1}"#),
            (OperatorAction::PullCable, CameraState::Open, r#"{"command":"pull-cable","seconds":3}"#),
        ];
        for (deed, camera, json) in cases {
            let expected = command::parse(json.as_bytes()).unwrap();
            assert_eq!(deed.command(camera), expected.command, "{deed:?}");
        }
    }
}

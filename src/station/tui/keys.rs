//! Key bindings: parses the bytes of a terminal to actions. The keys for the simulated brick send the commands of the page's buttons,
//! with their default values.
//!
//! Own code, because crossterm's reader blocks within an incomplete sequence and spins after a terminal hang-up; the few sequences in
//! use are those of ECMA-48 as xterm sends them (XTerm Control Sequences, "PC-Style Function Keys").

use posebridge_telemetry::simulator::SlippingWheel;
use posebridge_telemetry::{Command, SensorSwitch, SimulatorCommand, TimeDelta};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeyPress {
    Letter(char),
    Tab,
    BackTab,
    Up,
    Down,
    Left,
    Right,
    Escape,
    Enter,
    Backspace,
    Interrupt,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UiAction {
    Quit,
    NextPanel,
    PreviousPanel,
    NextRobot,
    PreviousRobot,
    Help,
    Back,
    TypePose,
    Do(OperatorAction),
}

pub struct KeyBinding {
    pub key_presses: &'static [KeyPress],
    pub name: &'static str,
    pub label: &'static str,
    pub help: &'static str,
    pub action: UiAction,
}

/// Adding one: a row here.
#[rustfmt::skip]
pub const KEYS: &[KeyBinding] = &[
    KeyBinding { name: "q", key_presses: &[KeyPress::Letter('q'), KeyPress::Interrupt], label: "quit", action: UiAction::Quit, help: "end the run, as Ctrl-C does" },
    KeyBinding { name: "?", key_presses: &[KeyPress::Letter('?'), KeyPress::Letter('h')], label: "help", action: UiAction::Help, help: "these lines; again, or Esc, takes them away" },
    KeyBinding { name: "tab", key_presses: &[KeyPress::Tab, KeyPress::Down], label: "panel", action: UiAction::NextPanel, help: "or ↓: the next panel on the whole screen; behind the last, all together" },
    KeyBinding { name: "shift-tab", key_presses: &[KeyPress::BackTab, KeyPress::Up], label: "", action: UiAction::PreviousPanel, help: "or ↑: the panel before" },
    KeyBinding { name: "→", key_presses: &[KeyPress::Right], label: "", action: UiAction::NextRobot, help: "the next robot, where several are heard" },
    KeyBinding { name: "←", key_presses: &[KeyPress::Left], label: "", action: UiAction::PreviousRobot, help: "the robot before" },
    KeyBinding { name: "Esc", key_presses: &[KeyPress::Escape], label: "", action: UiAction::Back, help: "all panels together" },
    KeyBinding { name: "x", key_presses: &[KeyPress::Letter('x')], label: "pose", action: UiAction::TypePose, help: "type where the robot is: x and y in metres, its heading in degrees; Enter sets it, Esc does not" },
    KeyBinding { name: "k", key_presses: &[KeyPress::Letter('k')], label: "kidnap", action: UiAction::Do(OperatorAction::Kidnap), help: "lift the simulated robot and put it down 0.3 m ahead, 0.2 m to the left, turned by 60°" },
    KeyBinding { name: "c", key_presses: &[KeyPress::Letter('c')], label: "camera", action: UiAction::Do(OperatorAction::Camera), help: "cover the simulated camera, or uncover it" },
    KeyBinding { name: "s", key_presses: &[KeyPress::Letter('s')], label: "slip", action: UiAction::Do(OperatorAction::Slip), help: "let its left wheel lose 80 % of its travel for a second" },
    KeyBinding { name: "p", key_presses: &[KeyPress::Letter('p')], label: "cable", action: UiAction::Do(OperatorAction::PullCable), help: "pull its cable for 3 s" },
];

pub fn action_of(key_press: KeyPress) -> Option<UiAction> {
    let key = KEYS.iter().find(|key| key.key_presses.contains(&key_press));
    key.map(|key| key.action)
}

/// Parses key presses; ignores other bytes and sequences.
pub fn parse_key_presses(mut bytes: &[u8]) -> Vec<KeyPress> {
    let mut found = Vec::new();
    while let [first, rest @ ..] = bytes {
        bytes = rest;
        match first {
            0x03 => found.push(KeyPress::Interrupt),
            b'\t' => found.push(KeyPress::Tab),
            b'\r' | b'\n' => found.push(KeyPress::Enter),
            0x08 | 0x7f => found.push(KeyPress::Backspace),
            b' '..=b'~' => found.push(KeyPress::Letter(char::from(*first))),
            0x1b => match rest {
                [b'[' | b'O', sequence @ ..] => {
                    let end = sequence.iter().position(|byte| (b'@'..=b'~').contains(byte));
                    let last = end.and_then(|end| sequence.get(end)).copied();
                    found.extend(last.and_then(parse_escape));
                    bytes = end.map_or(&[][..], |end| &sequence[end + 1..]);
                }
                _ => found.push(KeyPress::Escape),
            },
            _ => {}
        }
    }
    found
}

/// The key of an escape sequence with this final byte.
const fn parse_escape(end: u8) -> Option<KeyPress> {
    Some(match end {
        b'A' => KeyPress::Up,
        b'B' => KeyPress::Down,
        b'C' => KeyPress::Right,
        b'D' => KeyPress::Left,
        b'Z' => KeyPress::BackTab,
        _ => return None,
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorAction {
    Kidnap,
    Camera,
    Slip,
    PullCable,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraState {
    Open,
    Covered,
}

impl OperatorAction {
    /// Converts to a command; the camera is toggled.
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
    fn keys_are_read_as_xterm_sends_them() {
        use KeyPress::{BackTab, Down, Escape, Interrupt, Left, Letter, Right, Tab, Up};
        assert_eq!(parse_key_presses(b"q\t?"), [Letter('q'), Tab, Letter('?')]);
        assert_eq!(parse_key_presses(b"\x1b[A\x1b[B\x1bOC\x1b[1;5D\x1b[Z"), [Up, Down, Right, Left, BackTab]);
        assert_eq!(parse_key_presses(b"\x1b"), [Escape]);
        assert_eq!(parse_key_presses(b"\x03\x1b[200~k"), [Interrupt, Letter('k')]);
        assert!(parse_key_presses(b"\x1b[1;").is_empty());
        assert!(parse_key_presses("ä\u{0}".as_bytes()).is_empty());
    }

    #[test]
    fn any_bytes_end() {
        for first in 0..=u8::MAX {
            for second in 0..=u8::MAX {
                let found = parse_key_presses(&[0x1b, first, second, b'[', second]);
                assert!(found.len() <= 5, "{first} {second}");
            }
        }
    }

    #[test]
    fn no_key_stands_twice_and_each_is_explained() {
        let all: Vec<KeyPress> = KEYS.iter().flat_map(|key| key.key_presses).copied().collect();
        for (index, key_press) in all.iter().enumerate() {
            assert!(!all[..index].contains(key_press), "{key_press:?}");
        }
        assert!(KEYS.iter().all(|key| !key.help.is_empty() && !key.name.is_empty()));
    }

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

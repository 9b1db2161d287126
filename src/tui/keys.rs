//! Keys: from the bytes that a terminal sends to what is to be done.
//!
//! Own code, because crossterm's reader waits inside a sequence that was sent in part and turns for ever when the terminal is hung up; the
//! few sequences that are needed are those of ECMA-48 as xterm sends them (XTerm Control Sequences, "PC-Style Function Keys").

use super::hands::Deed;

/// A key that was pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// A letter, a digit or a sign.
    Letter(char),
    /// Tab.
    Tab,
    /// Tab with shift.
    BackTab,
    /// An arrow.
    Up,
    /// An arrow.
    Down,
    /// An arrow.
    Left,
    /// An arrow.
    Right,
    /// Escape.
    Escape,
    /// Ctrl-C.
    Interrupt,
}

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// End the run.
    Quit,
    /// The next panel.
    NextPanel,
    /// The panel before.
    PreviousPanel,
    /// The next robot.
    NextRobot,
    /// The robot before.
    PreviousRobot,
    /// Explain the keys, or stop that.
    Help,
    /// Close what lies on top.
    Back,
    /// Something that happens to the simulated brick.
    Do(Deed),
}

/// A row of [`KEYS`].
pub struct Key {
    /// What does it.
    pub strokes: &'static [Stroke],
    /// How the keys are called.
    pub name: &'static str,
    /// What it does, in a word.
    pub word: &'static str,
    /// What it does, in a line.
    pub help: &'static str,
    /// What it asks for.
    pub action: Action,
}

/// Every key. Adding one: a row here.
pub const KEYS: &[Key] = &[
    Key {
        strokes: &[Stroke::Letter('q'), Stroke::Interrupt],
        name: "q",
        word: "quit",
        help: "end the run, as Ctrl-C does",
        action: Action::Quit,
    },
    Key {
        strokes: &[Stroke::Letter('?'), Stroke::Letter('h')],
        name: "?",
        word: "help",
        help: "these lines; again, or Esc, takes them away",
        action: Action::Help,
    },
    Key {
        strokes: &[Stroke::Tab, Stroke::Down],
        name: "tab",
        word: "panel",
        help: "or ↓: the next panel on the whole screen; behind the last, all together",
        action: Action::NextPanel,
    },
    Key {
        strokes: &[Stroke::BackTab, Stroke::Up],
        name: "shift-tab",
        word: "",
        help: "or ↑: the panel before",
        action: Action::PreviousPanel,
    },
    Key {
        strokes: &[Stroke::Right],
        name: "→",
        word: "",
        help: "the next robot, where several are heard",
        action: Action::NextRobot,
    },
    Key { strokes: &[Stroke::Left], name: "←", word: "", help: "the robot before", action: Action::PreviousRobot },
    Key { strokes: &[Stroke::Escape], name: "Esc", word: "", help: "all panels together", action: Action::Back },
    Key {
        strokes: &[Stroke::Letter('k')],
        name: "k",
        word: "kidnap",
        help: "lift the simulated robot and put it down 0.3 m ahead, 0.2 m to the left, turned by 60°",
        action: Action::Do(Deed::Kidnap),
    },
    Key {
        strokes: &[Stroke::Letter('c')],
        name: "c",
        word: "camera",
        help: "cover the simulated camera, or uncover it",
        action: Action::Do(Deed::Camera),
    },
    Key {
        strokes: &[Stroke::Letter('s')],
        name: "s",
        word: "slip",
        help: "let its left wheel lose 80 % of its travel for a second",
        action: Action::Do(Deed::Slip),
    },
    Key {
        strokes: &[Stroke::Letter('p')],
        name: "p",
        word: "cable",
        help: "pull its cable for 3 s",
        action: Action::Do(Deed::PullCable),
    },
];

/// What a key asks for, if it does anything.
#[must_use]
pub fn action_of(stroke: Stroke) -> Option<Action> {
    let key = KEYS.iter().find(|key| key.strokes.contains(&stroke));
    key.map(|key| key.action)
}

/// The keys in what a terminal has sent. Whatever else it sends is passed over.
#[must_use]
pub fn strokes(mut bytes: &[u8]) -> Vec<Stroke> {
    let mut found = Vec::new();
    while let [first, rest @ ..] = bytes {
        bytes = rest;
        match first {
            0x03 => found.push(Stroke::Interrupt),
            b'\t' => found.push(Stroke::Tab),
            b' '..=b'~' => found.push(Stroke::Letter(char::from(*first))),
            0x1b => match rest {
                [b'[' | b'O', sequence @ ..] => {
                    let end = sequence.iter().position(|byte| (b'@'..=b'~').contains(byte));
                    let last = end.and_then(|end| sequence.get(end)).copied();
                    found.extend(last.and_then(special));
                    bytes = end.map_or(&[][..], |end| &sequence[end + 1..]);
                }
                _ => found.push(Stroke::Escape),
            },
            _ => {}
        }
    }
    found
}

/// The key whose sequence ends so.
const fn special(end: u8) -> Option<Stroke> {
    Some(match end {
        b'A' => Stroke::Up,
        b'B' => Stroke::Down,
        b'C' => Stroke::Right,
        b'D' => Stroke::Left,
        b'Z' => Stroke::BackTab,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_read_as_xterm_sends_them() {
        use Stroke::{BackTab, Down, Escape, Interrupt, Left, Letter, Right, Tab, Up};
        assert_eq!(strokes(b"q\t?"), [Letter('q'), Tab, Letter('?')]);
        assert_eq!(strokes(b"\x1b[A\x1b[B\x1bOC\x1b[1;5D\x1b[Z"), [Up, Down, Right, Left, BackTab]);
        assert_eq!(strokes(b"\x1b"), [Escape]);
        assert_eq!(strokes(b"\x03\x1b[200~k"), [Interrupt, Letter('k')]);
        assert!(strokes(b"\x1b[1;").is_empty());
        assert!(strokes("ä\u{0}".as_bytes()).is_empty());
    }

    #[test]
    fn any_bytes_end() {
        for first in 0..=u8::MAX {
            for second in 0..=u8::MAX {
                let found = strokes(&[0x1b, first, second, b'[', second]);
                assert!(found.len() <= 5, "{first} {second}");
            }
        }
    }

    #[test]
    fn no_key_stands_twice_and_each_is_explained() {
        let all: Vec<Stroke> = KEYS.iter().flat_map(|key| key.strokes).copied().collect();
        for (index, stroke) in all.iter().enumerate() {
            assert!(!all[..index].contains(stroke), "{stroke:?}");
        }
        assert!(KEYS.iter().all(|key| !key.help.is_empty() && !key.name.is_empty()));
    }
}

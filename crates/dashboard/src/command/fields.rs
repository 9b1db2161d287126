//! Parsing and validation of a command's fields, and why a command is refused.

use posebridge_telemetry::SensorSwitch;
use posebridge_telemetry::simulator::{NUMBER_FIELDS, NumberField};
use serde_json::{Map, Value};

/// Longest excerpt of a wrong value in an error.
const MAX_SHOWN_CHARS: usize = 60;

/// A field of a JSON command: key and permitted values.
#[derive(Clone, Copy, Debug)]
pub struct CommandField {
    /// JSON key, with the unit.
    pub name: &'static str,
    pub kind: FieldKind,
}

/// The type and the range of a command field.
#[derive(Clone, Copy, Debug)]
pub enum FieldKind {
    /// In the unit of the key.
    Number {
        least: f64,
        most: f64,
    },
    Finite,
    /// A number in the range that [`NUMBER_FIELDS`] gives for this field of this command.
    Simulated,
    Integer {
        least: u64,
        most: u64,
    },
    /// One of these words.
    Choice(&'static [&'static str]),
    Switch,
    /// A name of at most sixteen printable ASCII characters.
    Name,
    NameOrNull,
}

impl CommandField {
    pub fn kind_in(&self, command: &str) -> FieldKind {
        let FieldKind::Simulated = self.kind else {
            return self.kind;
        };
        let is_it = |known: &&&NumberField| (known.command, known.field) == (command, self.name);
        let known = NUMBER_FIELDS.iter().find(is_it);
        // Unknown only if the tables disagree; a test checks all of them.
        known.map_or(self.kind, |known| FieldKind::Number { least: known.minimum, most: known.maximum })
    }
}

impl FieldKind {
    pub fn expectation(self) -> String {
        match self {
            Self::Number { least, most } => format!("a number from {least} to {most}"),
            Self::Finite => "a finite number".to_owned(),
            Self::Simulated => "a number that the simulator has no range for".to_owned(),
            Self::Integer { least, most } => format!("a whole number from {least} to {most}"),
            Self::Choice(words) => one_of(words),
            Self::Switch => "true or false".to_owned(),
            Self::Name => "a name of 1 to 16 printable ASCII characters".to_owned(),
            Self::NameOrNull => "a name of 1 to 16 printable ASCII characters, or null".to_owned(),
        }
    }

    fn accepts(self, value: &Value) -> bool {
        match self {
            Self::Number { least, most } => value.as_f64().is_some_and(|number| (least..=most).contains(&number)),
            Self::Finite => value.as_f64().is_some_and(f64::is_finite),
            Self::Simulated => false,
            Self::Integer { least, most } => value.as_u64().is_some_and(|number| (least..=most).contains(&number)),
            Self::Choice(words) => value.as_str().is_some_and(|word| words.contains(&word)),
            Self::Switch => value.is_boolean(),
            Self::Name => value.as_str().is_some_and(is_name),
            Self::NameOrNull => value.is_null() || Self::Name.accepts(value),
        }
    }
}

pub(super) fn one_of<T: AsRef<str>>(words: &[T]) -> String {
    let quoted = words.iter().map(|word| format!("\"{}\"", word.as_ref()));
    format!("one of {}", quoted.collect::<Vec<_>>().join(", "))
}

fn is_name(text: &str) -> bool {
    (1..=16).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_graphic())
}

/// The checked values of all fields of one command.
pub(super) struct FieldValues<'a>(Vec<(&'static str, &'a Value)>);

impl<'a> FieldValues<'a> {
    pub(super) fn read(
        command: &'static str,
        fields: &'static [CommandField],
        found: &'a Map<String, Value>,
    ) -> Result<Self, CommandError> {
        let read = fields.iter().map(|field| {
            let value = found.get(field.name).ok_or_else(|| CommandError::MissingField {
                command,
                field: field.name,
                wanted: field.kind_in(command).expectation(),
            })?;
            let kind = field.kind_in(command);
            if !kind.accepts(value) {
                return Err(CommandError::WrongValue {
                    command,
                    field: field.name,
                    found: format_value(value),
                    wanted: kind.expectation(),
                });
            }
            Ok((field.name, value))
        });
        read.collect::<Result<_, _>>().map(Self)
    }

    /// A field of the command's row; a test checks all rows.
    fn value(&self, name: &str) -> &Value {
        let found = self.0.iter().find(|(key, _)| *key == name);
        found.map_or(&Value::Null, |(_, value)| value)
    }

    pub(super) fn number(&self, name: &str) -> f64 {
        self.value(name).as_f64().unwrap_or(f64::NAN)
    }

    pub(super) fn integer(&self, name: &str) -> u64 {
        self.value(name).as_u64().unwrap_or(0)
    }

    pub(super) fn text(&self, name: &str) -> &str {
        self.value(name).as_str().unwrap_or_default()
    }

    pub(super) fn switch(&self, name: &str) -> SensorSwitch {
        if self.value(name).as_bool().unwrap_or(false) { SensorSwitch::On } else { SensorSwitch::Off }
    }
}

/// An excerpt of a wrong value: short and without control characters, because it is shown in a terminal or a page.
pub(super) fn format_value(value: &Value) -> String {
    truncate(&value.to_string())
}

pub(super) fn truncate(text: &str) -> String {
    let clean = text.chars().map(|c| if c.is_control() { '?' } else { c });
    let mut cut: String = clean.take(MAX_SHOWN_CHARS).collect();
    if text.chars().nth(MAX_SHOWN_CHARS).is_some() {
        cut.push('…');
    }
    cut
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    #[error("the command is no JSON: {why}")]
    InvalidJson { why: String },
    #[error("a command is an object such as {{\"command\": \"reset-pose\"}}")]
    NotAnObject,
    #[error("the field `command` is missing; it is one of: {known}")]
    MissingName { known: String },
    #[error("`command` is `{name}`; there are: {known}")]
    UnknownName { name: String, known: String },
    #[error("`{command}` needs the field `{field}`: {wanted}")]
    MissingField { command: &'static str, field: &'static str, wanted: String },
    #[error("`{command}`: the field `{field}` is {found}, must be {wanted}")]
    WrongValue { command: &'static str, field: &'static str, found: String, wanted: String },
    #[error("`{command}` is for a simulated brick, and this station has none of its own")]
    NoSimulator { command: &'static str },
    #[error(
        "`{command}` has both `robot` and `fleet_robot`; `robot` is a robot of this station, `fleet_robot` any of the fleet"
    )]
    TwoRobots { command: &'static str },
    #[error("`{command}` has no field `{field}`; it has: {known}")]
    UnknownField { command: &'static str, field: String, known: String },
}

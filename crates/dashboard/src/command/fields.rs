//! The fields of a command, read and checked.

use posebridge_telemetry::Switch;
use posebridge_telemetry::simulator::{NUMBER_FIELDS, NumberField};
use serde_json::{Map, Value};

use super::CommandError;

/// So much of what stood somewhere is told back.
const LONGEST_SHOWN: usize = 60;

/// A field of a command.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Its key, with the unit.
    pub name: &'static str,
    /// What it may hold.
    pub kind: Kind,
}

/// What a field may hold.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A number of this range, in the unit of the key.
    Number {
        /// Lowest.
        least: f64,
        /// Highest.
        most: f64,
    },
    /// A number.
    Finite,
    /// A number of the range that stands in [`NUMBER_FIELDS`] for this field of this command.
    Simulated,
    /// A whole number of this range.
    Whole {
        /// Lowest.
        least: u64,
        /// Highest.
        most: u64,
    },
    /// One of these words.
    Choice(&'static [&'static str]),
    /// True or false.
    Switch,
    /// A name of at most sixteen printable ASCII characters.
    Name,
    /// The same, or null.
    NameOrNull,
}

impl Field {
    /// What this field of a command may hold, with its range.
    #[must_use]
    pub fn kind_in(&self, command: &str) -> Kind {
        let is_it = |known: &&&NumberField| (known.command, known.field) == (command, self.name);
        match self.kind {
            Kind::Simulated => {
                let known = NUMBER_FIELDS.iter().find(is_it);
                // None but a table with a slip of the pen; a test goes through it.
                known.map_or(Kind::Simulated, |known| Kind::Number { least: known.least, most: known.most })
            }
            Kind::Number { .. }
            | Kind::Finite
            | Kind::Whole { .. }
            | Kind::Choice(_)
            | Kind::Switch
            | Kind::Name
            | Kind::NameOrNull => self.kind,
        }
    }
}

impl Kind {
    /// What it may hold, in words.
    #[must_use]
    pub fn wanted(self) -> String {
        match self {
            Self::Number { least, most } => format!("a number from {least} to {most}"),
            Self::Finite => "a finite number".to_owned(),
            Self::Simulated => "a number that the simulator has no range for".to_owned(),
            Self::Whole { least, most } => format!("a whole number from {least} to {most}"),
            Self::Choice(words) => one_of(words),
            Self::Switch => "true or false".to_owned(),
            Self::Name => "a name of 1 to 16 printable ASCII characters".to_owned(),
            Self::NameOrNull => "a name of 1 to 16 printable ASCII characters, or null".to_owned(),
        }
    }

    fn takes(self, value: &Value) -> bool {
        match self {
            Self::Number { least, most } => value.as_f64().is_some_and(|number| (least..=most).contains(&number)),
            Self::Finite => value.as_f64().is_some_and(f64::is_finite),
            Self::Simulated => false,
            Self::Whole { least, most } => value.as_u64().is_some_and(|number| (least..=most).contains(&number)),
            Self::Choice(words) => value.as_str().is_some_and(|word| words.contains(&word)),
            Self::Switch => value.is_boolean(),
            Self::Name => value.as_str().is_some_and(is_name),
            Self::NameOrNull => value.is_null() || Self::Name.takes(value),
        }
    }
}

/// One of these words, in words.
pub(super) fn one_of<T: AsRef<str>>(words: &[T]) -> String {
    let quoted = words.iter().map(|word| format!("\"{}\"", word.as_ref()));
    format!("one of {}", quoted.collect::<Vec<_>>().join(", "))
}

fn is_name(text: &str) -> bool {
    (1..=16).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_graphic())
}

/// The values of all fields of one command: each is there and of its kind.
pub(super) struct Values<'a>(Vec<(&'static str, &'a Value)>);

impl<'a> Values<'a> {
    pub(super) fn read(
        command: &'static str,
        fields: &'static [Field],
        found: &'a Map<String, Value>,
    ) -> Result<Self, CommandError> {
        let read = fields.iter().map(|field| {
            let value = found.get(field.name).ok_or_else(|| CommandError::Missing {
                command,
                field: field.name,
                wanted: field.kind_in(command).wanted(),
            })?;
            let kind = field.kind_in(command);
            if !kind.takes(value) {
                return Err(CommandError::Wrong {
                    command,
                    field: field.name,
                    found: shown(value),
                    wanted: kind.wanted(),
                });
            }
            Ok((field.name, value))
        });
        read.collect::<Result<_, _>>().map(Self)
    }

    /// Of a field that the command's row has; a test goes through all rows.
    fn value(&self, name: &str) -> &Value {
        let found = self.0.iter().find(|(key, _)| *key == name);
        found.map_or(&Value::Null, |(_, value)| value)
    }

    pub(super) fn number(&self, name: &str) -> f64 {
        self.value(name).as_f64().unwrap_or(f64::NAN)
    }

    pub(super) fn whole(&self, name: &str) -> u64 {
        self.value(name).as_u64().unwrap_or(0)
    }

    pub(super) fn text(&self, name: &str) -> &str {
        self.value(name).as_str().unwrap_or_default()
    }

    pub(super) fn switch(&self, name: &str) -> Switch {
        if self.value(name).as_bool().unwrap_or(false) { Switch::On } else { Switch::Off }
    }
}

/// What stood somewhere, for people: short and without control characters, because it ends up in a terminal or a page.
pub(super) fn shown(value: &Value) -> String {
    cut(&value.to_string())
}

/// The beginning of a long text.
pub(super) fn cut(text: &str) -> String {
    let clean = text.chars().map(|c| if c.is_control() { '?' } else { c });
    let mut cut: String = clean.take(LONGEST_SHOWN).collect();
    if text.chars().nth(LONGEST_SHOWN).is_some() {
        cut.push('…');
    }
    cut
}

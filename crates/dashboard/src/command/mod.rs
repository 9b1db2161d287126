//! Commands as JSON: `{"command": "<name>", ...fields}`.
//!
//! [`COMMANDS`] is the one table: reading, refusing, the schema and docs/dashboard.md follow from it. Everything comes from outside,
//! so a refusal names the field, what stood there and what may.

mod fields;
mod known;
mod table;

pub use fields::{Field, Kind};
pub(crate) use known::Known;
pub use table::{COMMANDS, CommandRow};

use posebridge_telemetry::Command;
use serde_json::{Map, Value};

use fields::Values;

/// Why a command was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    /// It is no JSON.
    #[error("the command is no JSON: {why}")]
    NoJson {
        /// What the reader says, with line and column.
        why: String,
    },
    /// It is something else than an object.
    #[error("a command is an object such as {{\"command\": \"reset-pose\"}}")]
    NoObject,
    /// It does not say what is asked for.
    #[error("the field `command` is missing; it is one of: {known}")]
    NoName {
        /// What there is.
        known: String,
    },
    /// There is no such command.
    #[error("`command` is `{name}`; there are: {known}")]
    UnknownName {
        /// What stood there.
        name: String,
        /// What there is.
        known: String,
    },
    /// A field is missing.
    #[error("`{command}` needs the field `{field}`: {wanted}")]
    Missing {
        /// The command.
        command: &'static str,
        /// The field.
        field: &'static str,
        /// What it may hold.
        wanted: String,
    },
    /// A field holds what it cannot.
    #[error("`{command}`: the field `{field}` is {found}, must be {wanted}")]
    Wrong {
        /// The command.
        command: &'static str,
        /// The field.
        field: &'static str,
        /// What stood there.
        found: String,
        /// What it may hold.
        wanted: String,
    },
    /// It is for a simulated brick, and the station has none of its own.
    #[error("`{command}` is for a simulated brick, and this station has none of its own")]
    NoSimulator {
        /// The command.
        command: &'static str,
    },
    /// A field that this command does not have.
    #[error("`{command}` has no field `{field}`; it has: {known}")]
    UnknownField {
        /// The command.
        command: &'static str,
        /// The field.
        field: String,
        /// What it has.
        known: String,
    },
}

/// Reads a command.
///
/// # Errors
/// It makes no sense; the text names the field.
pub fn read(text: &[u8]) -> Result<(&'static str, Command), CommandError> {
    let value: Value = serde_json::from_slice(text).map_err(|error| CommandError::NoJson { why: error.to_string() })?;
    let Value::Object(mut fields) = value else {
        return Err(CommandError::NoObject);
    };
    let row = row_of(fields.remove("command"))?;
    refuse_unknown(row, &fields)?;
    let values = Values::read(row.name, row.fields, &fields)?;
    Ok((row.name, (row.make)(&values)))
}

fn row_of(name: Option<Value>) -> Result<&'static CommandRow, CommandError> {
    let known = || {
        let names: Vec<&str> = COMMANDS.iter().map(|row| row.name).collect();
        names.join(", ")
    };
    let name = match name {
        None => return Err(CommandError::NoName { known: known() }),
        Some(Value::String(name)) => name,
        Some(other) => fields::shown(&other),
    };
    let row = COMMANDS.iter().find(|row| row.name == name);
    row.ok_or_else(|| CommandError::UnknownName { name: fields::cut(&name), known: known() })
}

fn refuse_unknown(row: &CommandRow, found: &Map<String, Value>) -> Result<(), CommandError> {
    let is_known = |key: &&String| row.fields.iter().any(|field| field.name == **key);
    let Some(unknown) = found.keys().find(|key| !is_known(key)) else {
        return Ok(());
    };
    let known: Vec<&str> = row.fields.iter().map(|field| field.name).collect();
    Err(CommandError::UnknownField {
        command: row.name,
        field: fields::cut(unknown),
        known: if known.is_empty() { "none".to_owned() } else { known.join(", ") },
    })
}

#[cfg(test)]
mod tests;

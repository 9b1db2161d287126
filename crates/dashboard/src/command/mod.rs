//! Commands as JSON: `{"command": "<name>", ...fields}`.
//!
//! [`COMMANDS`] is the table for parsing, validation, the schema and docs/dashboard.md. Input is untrusted, so an error
//! names the field, its value and the permitted ones.

mod context;
mod error;
mod fields;
mod table;

pub(crate) use context::CommandContext;
pub use error::CommandError;
pub use fields::{CommandField, FieldKind};
pub use table::{COMMANDS, CommandRow};

use posebridge_telemetry::Command;
use serde_json::{Map, Value};

use fields::FieldValues;

/// Parses a command.
///
/// # Errors
/// The command is invalid; the error names the field.
pub fn parse(text: &[u8]) -> Result<(&'static str, Command), CommandError> {
    let value: Value =
        serde_json::from_slice(text).map_err(|error| CommandError::InvalidJson { why: error.to_string() })?;
    let Value::Object(mut fields) = value else {
        return Err(CommandError::NotAnObject);
    };
    let row = find_row(fields.remove("command"))?;
    reject_unknown_fields(row, &fields)?;
    let values = FieldValues::read(row.name, row.fields, &fields)?;
    Ok((row.name, (row.build)(&values)))
}

fn find_row(name: Option<Value>) -> Result<&'static CommandRow, CommandError> {
    let known = || {
        let names: Vec<&str> = COMMANDS.iter().map(|row| row.name).collect();
        names.join(", ")
    };
    let name = match name {
        None => return Err(CommandError::MissingName { known: known() }),
        Some(Value::String(name)) => name,
        Some(other) => fields::format_value(&other),
    };
    let row = COMMANDS.iter().find(|row| row.name == name);
    row.ok_or_else(|| CommandError::UnknownName { name: fields::truncate(&name), known: known() })
}

fn reject_unknown_fields(row: &CommandRow, found: &Map<String, Value>) -> Result<(), CommandError> {
    let is_known = |key: &&String| row.fields.iter().any(|field| field.name == **key);
    let Some(unknown) = found.keys().find(|key| !is_known(key)) else {
        return Ok(());
    };
    let known: Vec<&str> = row.fields.iter().map(|field| field.name).collect();
    Err(CommandError::UnknownField {
        command: row.name,
        field: fields::truncate(unknown),
        known: if known.is_empty() { "none".to_owned() } else { known.join(", ") },
    })
}

#[cfg(test)]
mod tests;

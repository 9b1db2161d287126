//! Commands as JSON: `{"command": "<name>", ...fields}`, of those for a robot with `"robot": "<link>/<system>/<component>"`.
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
pub use table::{COMMANDS, CommandRow, CommandTarget, ROBOT_FIELD};

use posebridge_telemetry::{Command, Input, RobotId};
use serde_json::{Map, Value};

use crate::views::parse_robot_name;
use fields::FieldValues;

/// A well-formed command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParsedCommand {
    /// Its name.
    pub name: &'static str,
    /// The robot that it is for, if it names one.
    pub robot: Option<RobotId>,
    /// Its meaning.
    pub command: Command,
}

impl ParsedCommand {
    /// The command as an input of the station.
    pub const fn input(&self) -> Input {
        match self.robot {
            Some(robot) => Input::RobotCommand { robot, command: self.command },
            None => Input::Command(self.command),
        }
    }
}

/// Parses a command.
///
/// # Errors
/// The command is invalid; the error names the field.
pub fn parse(text: &[u8]) -> Result<ParsedCommand, CommandError> {
    let value: Value =
        serde_json::from_slice(text).map_err(|error| CommandError::InvalidJson { why: error.to_string() })?;
    let Value::Object(mut fields) = value else {
        return Err(CommandError::NotAnObject);
    };
    let row = find_row(fields.remove("command"))?;
    let robot = match row.target {
        CommandTarget::Robot => fields.remove(ROBOT_FIELD).map(|value| robot_of(row, &value)).transpose()?,
        CommandTarget::Station => None,
    };
    reject_unknown_fields(row, &fields)?;
    let values = FieldValues::read(row.name, row.fields, &fields)?;
    Ok(ParsedCommand { name: row.name, robot, command: (row.build)(&values) })
}

fn robot_of(row: &CommandRow, value: &Value) -> Result<RobotId, CommandError> {
    let robot = value.as_str().and_then(parse_robot_name);
    robot.ok_or_else(|| CommandError::WrongValue {
        command: row.name,
        field: ROBOT_FIELD,
        found: fields::format_value(value),
        wanted: "the id of a robot as /v1/robots has it, such as \"0/1/1\"".to_owned(),
    })
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
    let robot = (row.target == CommandTarget::Robot).then_some(ROBOT_FIELD);
    let known: Vec<&str> = row.fields.iter().map(|field| field.name).chain(robot).collect();
    Err(CommandError::UnknownField {
        command: row.name,
        field: fields::truncate(unknown),
        known: if known.is_empty() { "none".to_owned() } else { known.join(", ") },
    })
}

#[cfg(test)]
mod tests;

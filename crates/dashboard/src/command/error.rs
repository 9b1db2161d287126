//! Why a command was refused.

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    /// The text is not JSON.
    #[error("the command is no JSON: {why}")]
    InvalidJson {
        /// The error of the JSON parser, with line and column.
        why: String,
    },
    /// The JSON is not an object.
    #[error("a command is an object such as {{\"command\": \"reset-pose\"}}")]
    NotAnObject,
    /// The field `command` is missing.
    #[error("the field `command` is missing; it is one of: {known}")]
    MissingName {
        /// The known commands.
        known: String,
    },
    /// There is no such command.
    #[error("`command` is `{name}`; there are: {known}")]
    UnknownName {
        /// The name in the command.
        name: String,
        /// The known commands.
        known: String,
    },
    /// A field is missing.
    #[error("`{command}` needs the field `{field}`: {wanted}")]
    MissingField {
        command: &'static str,
        field: &'static str,
        /// The permitted values.
        wanted: String,
    },
    /// A field has a value that is not permitted.
    #[error("`{command}`: the field `{field}` is {found}, must be {wanted}")]
    WrongValue {
        command: &'static str,
        field: &'static str,
        /// The value.
        found: String,
        /// The permitted values.
        wanted: String,
    },
    /// The command is for a simulated brick, and the station has none of its own.
    #[error("`{command}` is for a simulated brick, and this station has none of its own")]
    NoSimulator { command: &'static str },
    /// The command does not have this field.
    #[error("`{command}` has no field `{field}`; it has: {known}")]
    UnknownField {
        command: &'static str,
        field: String,
        /// The fields of the command.
        known: String,
    },
}

//! A command from a link.

use posebridge_protocol::message::{CommandInt, CommandLong};

#[derive(Clone, Copy, Debug)]
pub(crate) struct LinkCommand {
    pub(crate) command: CommandLong,
    /// As it came, with exact coordinates, if it was a COMMAND_INT.
    pub(crate) exact: Option<CommandInt>,
}

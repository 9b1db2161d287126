//! `posebridge dialect`: our MAVLink messages for other programs (docs/protocols/mavlink.md).

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use posebridge_protocol::dialect::bindings::Binding;

use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};

/// Flags of `dialect`.
#[derive(Args, Clone, Debug)]
pub struct DialectArgs {
    /// The program or language that is to know the messages.
    #[arg(long = "for", value_name = "TOOL", value_enum)]
    pub tool: Tool,
    /// Write the file into this folder, under the name that the tool expects, instead of printing it. A file of that name is replaced.
    #[arg(long, value_name = "DIR", alias = "output")]
    pub out: Option<PathBuf>,
}

/// Who reads the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Tool {
    /// pymavlink: posebridge_mavlink.py, a module that adds the messages to the dialect in use.
    Python,
    /// Wireshark and tshark: posebridge_mavlink.lua, a dissector of these messages alone.
    Wireshark,
    /// The stock C library that mavgen makes: posebridge_mavlink.h, one more header.
    C,
    /// Generators of other languages: posebridge.xml, the definition with the meaning of each field.
    Xml,
}

impl Tool {
    const fn binding(self) -> Binding {
        match self {
            Self::Python => Binding::Python,
            Self::Wireshark => Binding::Wireshark,
            Self::C => Binding::C,
            Self::Xml => Binding::Xml,
        }
    }
}

pub fn execute(args: &DialectArgs) -> Result<(), Failure> {
    let binding = args.tool.binding();
    let Some(folder) = &args.out else {
        return print_result(&binding.text()).while_running();
    };
    write(&folder.join(binding.file_name()), binding).before_start()
}

fn write(path: &Path, binding: Binding) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("making the folder `{}`", folder.display()))?;
    }
    std::fs::write(path, binding.text()).with_context(|| format!("writing `{}`", path.display()))?;
    print_line(&format!("wrote `{}`", path.display()));
    Ok(())
}

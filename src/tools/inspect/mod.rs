//! `posebridge inspect`: prints the content of a file without estimation.

mod facts;
mod report;

use std::path::PathBuf;

use clap::Args;

use self::facts::{
    InspectResult, inspect_bytes, inspect_descriptor, inspect_messages, inspect_recording, inspect_tlog,
};
use crate::console::print_result;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::station::input_file::{InputFile, InputKind};
use crate::station::recorded_session::nothing_read;

/// Flags of `inspect`.
#[derive(Args, Clone, Debug)]
pub struct InspectArgs {
    /// A recording or messages of `export --messages` (*.mcap), a telemetry log (*.tlog, *.tlog.gz), bytes of a link (*.raw, *.bin) or a descriptor (*.toml).
    pub file: PathBuf,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Print one JSON object instead of tables (docs/recordings.md).
    #[arg(long)]
    pub json: bool,
}

pub fn execute(args: &InspectArgs) -> Result<(), Failure> {
    let file = InputFile::open(&args.file).before_start()?;
    let (name, kind, size) = (file.name.clone(), file.kind, file.size);
    let framed = |facts| InspectResult::Framed(Box::new(facts));
    let found = match kind {
        InputKind::Tlog => inspect_tlog(file).map(framed).while_running()?,
        InputKind::Bytes => inspect_bytes(file).map(framed).while_running()?,
        InputKind::Messages => inspect_messages(file).map(framed).while_running()?,
        InputKind::Own => inspect_recording(file, &args.file).map(framed).before_start()?,
        InputKind::Descriptor => InspectResult::Runs(inspect_descriptor(&args.file, &args.data).before_start()?),
    };
    let text =
        if args.json { report::json_text(&name, kind, size, &found) } else { report::table_text(&name, kind, &found) };
    print_result(&text).while_running()?;
    if found.is_empty() { Err(nothing_read(&name)).while_running() } else { Ok(()) }
}

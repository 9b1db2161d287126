//! `posebridge inspect`: prints the content of a file without estimation.
//!
//! Reads posebridge recordings, telemetry logs, raw captures of a link and descriptors of foreign recordings; logs and captures in
//! bounded memory. Frames are verified with the checksum seeds of every known dialect. docs/recordings.md describes the JSON object.

mod facts;
mod report;

use std::path::PathBuf;

use clap::Args;

use self::facts::InspectResult;
use crate::console::print_result;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::station::input_file::{InputFile, InputKind};

/// Flags of `inspect`.
#[derive(Args, Clone, Debug)]
pub struct InspectArgs {
    /// A recording (*.mcap), a telemetry log (*.tlog, *.tlog.gz), bytes of a link (*.raw, *.bin) or a descriptor (*.toml).
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
    let found = match kind {
        InputKind::Tlog => facts::inspect_tlog(file).map(InspectResult::from_framed).while_running()?,
        InputKind::Bytes => facts::inspect_bytes(file).map(InspectResult::from_framed).while_running()?,
        InputKind::Own => facts::inspect_recording(file, &args.file).map(InspectResult::from_framed).before_start()?,
        InputKind::Descriptor => InspectResult::Runs(facts::inspect_descriptor(&args.file, &args.data).before_start()?),
    };
    let text =
        if args.json { report::json_text(&name, kind, size, &found) } else { report::table_text(&name, kind, &found) };
    print_result(&text).while_running()
}

//! `posebridge export`: what a recording holds and what the engine makes of it, for other programs.
//!
//! Reads recordings of ours, telemetry logs and descriptors; the engine is that of a live run. docs/recordings.md describes the files.

mod args;
mod engine;
mod output_files;
mod tum;

use std::io::BufWriter;

use anyhow::{Context, Result, bail, ensure};
use posebridge_recording::tlog::TlogWriter;

use self::args::station;
pub use self::args::{ExportArgs, Format};
use self::output_files::{create_new, print_notes, print_written};
use super::import;
use crate::exit::{ExitStage, Failure};
use crate::station::input_file::{InputFile, InputKind};

/// Exports.
///
/// # Errors
/// The recording cannot be read or makes no sense, or a file cannot be written.
pub fn execute(args: &ExportArgs) -> Result<(), Failure> {
    let kind = check(args).before_start()?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("making the folder `{}`", args.out.display()))
        .before_start()?;
    if args.formats.contains(&Format::Mcap) {
        write_mcap(args).while_running()?;
    }
    let is_copied = kind == InputKind::Tlog && args.formats.contains(&Format::Tlog);
    if is_copied {
        copy_tlog(args).while_running()?;
    }
    let needs_engine = |format: &Format| match format {
        Format::Csv | Format::Tum => true,
        Format::Tlog => !is_copied,
        Format::Mcap => false,
    };
    let wanted: Vec<Format> = args.formats.iter().copied().filter(needs_engine).collect();
    if wanted.is_empty() {
        return Ok(());
    }
    let session = engine::ExportSession::open(args, kind).before_start()?;
    let made = session.run(args, &wanted).while_running()?;
    if wanted.contains(&Format::Tum) {
        tum::write(args, &made).while_running()?;
    }
    Ok(())
}

/// Refuses what cannot be; says what the file is.
fn check(args: &ExportArgs) -> Result<InputKind> {
    let name = args.recording.display();
    let kind = InputFile::open(&args.recording)?.kind;
    let wants = |format| args.formats.contains(&format);
    match kind {
        InputKind::Bytes => {
            bail!("`{name}`: bytes without times cannot be exported; `posebridge inspect` says what they hold")
        }
        InputKind::Own if wants(Format::Mcap) => {
            bail!("--format mcap: `{name}` is a recording of posebridge already")
        }
        InputKind::Descriptor if wants(Format::Tlog) => {
            bail!("--format tlog: `{name}` is a descriptor, there are no frames in its data")
        }
        InputKind::Descriptor => ensure!(
            args.truth.is_none() && args.robot.is_none(),
            "--truth and --robot are for recordings: a descriptor names its own"
        ),
        InputKind::Own | InputKind::Tlog => {}
    }
    Ok(kind)
}

fn write_mcap(args: &ExportArgs) -> Result<()> {
    let (file, fresh) = create_new(args, "mcap")?;
    let (_, account) = import::import(&args.recording, &args.data, station(args), file)?;
    print_notes(&account.notes);
    print_written(fresh.path(), account.inputs, "inputs");
    fresh.finish()
}

/// The whole frames of a telemetry log, with their times the right way round and never stepping back.
fn copy_tlog(args: &ExportArgs) -> Result<()> {
    let (out, fresh) = create_new(args, "tlog")?;
    let mut writer = TlogWriter::new(BufWriter::new(out));
    let mut written = Ok(0);
    let notes = import::logged_frames(&args.recording, station(args), &mut |micros, frame| {
        if let Ok(count) = written {
            let done = writer.record(micros, frame);
            written = done.map(|()| count + 1);
        }
    })?;
    let written = written.with_context(|| format!("writing `{}`", fresh.path().display()))?;
    writer.finish()?;
    print_notes(&notes);
    print_written(fresh.path(), written, "frames");
    fresh.finish()
}

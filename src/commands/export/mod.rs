//! `posebridge export`: what a recording holds and what the engine makes of it, for other programs.
//!
//! Reads recordings of ours, telemetry logs and descriptors; the engine is that of a live run. docs/export.md describes the files.

mod engine;
mod fresh;
mod tum;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use posebridge_recording::tlog::Writer;

use super::{Failure, Stage};
use crate::cli::DataFlags;
use crate::import::{self, Station};
use crate::input_file::{InputFile, Kind};
use crate::stderr::say;

use fresh::Fresh;

/// Flags of `export`.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// A recording (*.mcap), a telemetry log (*.tlog, *.tlog.gz) or a recording's descriptor (*.toml).
    pub recording: PathBuf,
    /// What to write; several with commas.
    #[arg(long = "format", value_enum, value_delimiter = ',', required = true)]
    pub formats: Vec<Format>,
    /// The folder for the files; it is made.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Estimator, instead of the recording's.
    #[arg(long, value_name = "NAME")]
    pub filter: Option<String>,
    /// Another robot for a recording or a telemetry log; --set goes over it.
    #[arg(long, value_name = "FILE.toml")]
    pub robot: Option<PathBuf>,
    /// Truth written by `posebridge sim --truth`, instead of the one that a recording of ours may hold.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// A key of a link that was signed, instead of the file that held it when it was recorded; may be repeated.
    #[arg(long = "key", value_name = "FILE")]
    pub keys: Vec<PathBuf>,
}

/// What can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// A wide file per stream: estimates, innovations, observations, links.
    Csv,
    /// Trajectories of truth and estimate at the same stamps, for evo.
    Tum,
    /// A telemetry log: what came and what the engine sends.
    Tlog,
    /// A recording of ours.
    Mcap,
}

/// Exports.
///
/// # Errors
/// The recording cannot be read or makes no sense, or a file cannot be written.
pub fn execute(args: &ExportArgs) -> Result<(), Failure> {
    let kind = check(args).at_start()?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("making the folder `{}`", args.out.display()))
        .at_start()?;
    if args.formats.contains(&Format::Mcap) {
        write_mcap(args).while_running()?;
    }
    let is_copied = kind == Kind::Tlog && args.formats.contains(&Format::Tlog);
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
    let session = engine::Session::open(args, kind).at_start()?;
    let made = session.run(args, &wanted).while_running()?;
    if wanted.contains(&Format::Tum) {
        tum::write(args, &made).while_running()?;
    }
    Ok(())
}

/// Refuses what cannot be; says what the file is.
fn check(args: &ExportArgs) -> Result<Kind> {
    let name = args.recording.display();
    let kind = InputFile::open(&args.recording)?.kind;
    let wants = |format| args.formats.contains(&format);
    match kind {
        Kind::Bytes => {
            bail!("`{name}`: bytes without times cannot be exported; `posebridge inspect` says what they hold")
        }
        Kind::Own if wants(Format::Mcap) => {
            bail!("--format mcap: `{name}` is a recording of posebridge already")
        }
        Kind::Descriptor if wants(Format::Tlog) => {
            bail!("--format tlog: `{name}` is a descriptor, there are no frames in its data")
        }
        Kind::Descriptor => ensure!(
            args.truth.is_none() && args.robot.is_none(),
            "--truth and --robot are for recordings: a descriptor names its own"
        ),
        Kind::Own | Kind::Tlog => {}
    }
    Ok(kind)
}

/// The station that a telemetry log is read with.
fn station(args: &ExportArgs) -> Station<'_> {
    Station { config: None, robot: args.robot.as_deref(), settings: &args.data.settings }
}

fn write_mcap(args: &ExportArgs) -> Result<()> {
    let (file, fresh) = create_new(args, "mcap")?;
    let (_, account) = import::import(&args.recording, &args.data, station(args), file)?;
    tell_all(&account.notes);
    tell(fresh.path(), account.inputs, "inputs");
    fresh.finish()
}

/// The whole frames of a telemetry log, with their times the right way round and never stepping back.
fn copy_tlog(args: &ExportArgs) -> Result<()> {
    let (out, fresh) = create_new(args, "tlog")?;
    let mut writer = Writer::new(BufWriter::new(out));
    let mut written = Ok(0);
    let notes = import::logged_frames(&args.recording, station(args), &mut |micros, frame| {
        if let Ok(count) = written {
            let done = writer.record(micros, frame);
            written = done.map(|()| count + 1);
        }
    })?;
    let written = written.with_context(|| format!("writing `{}`", fresh.path().display()))?;
    writer.finish()?;
    tell_all(&notes);
    tell(fresh.path(), written, "frames");
    fresh.finish()
}

/// Begins the file of this extension in the folder, with the recording's own name; what is there already is not touched.
fn create_new(args: &ExportArgs, extension: &str) -> Result<(File, Fresh)> {
    let name = format!("{}.{extension}", stem(&args.recording));
    Fresh::create(args.out.join(name))
}

/// The name of a file without folder and extensions.
fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    let without = Path::new(name).file_stem().unwrap_or_default();
    without.to_string_lossy().into_owned()
}

/// Says what was written.
fn tell(path: &Path, count: u64, what: &str) {
    say(&format!("wrote `{}`: {count} {what}", path.display()));
}

fn tell_all(notes: &[String]) {
    for note in notes {
        say(note);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_named_after_its_recording() {
        assert_eq!(stem(Path::new("a/drive.2.tlog.gz")), "drive.2");
        assert_eq!(stem(Path::new("recording.mcap")), "recording");
    }
}

//! `posebridge replay`: the estimators over a recording, offline, with the same engine as live.
//!
//! A recording of ours (`*.mcap`) is given to the pipeline exactly as it was given live, so its events are those of the live run,
//! bit for bit. A descriptor of a foreign recording (`*.toml`) is read into observations; each estimator is then scored against the
//! truth or against the fixes that were withheld.
//!
//! Several estimators of one recording of ours run side by side, input by input; those of a descriptor one after the other. `--from`
//! and `--to` choose what counts: the filter is given all that came before, so that it is the filter that ran, but its events, tallies
//! and errors begin there. Flags that change the configuration make it another run than the one that was recorded, and it is said.

pub mod foreign;
pub mod own;
pub mod recording;
mod robot;
mod seen;
mod smooth;
pub mod watch;

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};

use anyhow::{Context, Result, bail};
use posebridge_analysis::report::{SmoothRow, estimator_table, smooth_table, source_table};
use posebridge_analysis::{ErrorSummary, EstimatorRow, FIGURES, RunLayers, SourceTally, Track};
use posebridge_link::HostTimer;
use posebridge_telemetry::{Span, Stamp};

use super::{Failure, Stage};
use crate::cli::ReplayArgs;
use crate::collect::Collector;
use crate::config::Provenance;
use crate::learned::{Learned, learned_table, save};
use crate::own_recording::is_own;
use crate::report::json;
use crate::stderr::say;
use crate::stdout;

use seen::Seen;
pub use smooth::{Found, NoPath, SmoothedRun};

/// What one estimator did over everything that was replayed.
pub struct Outcome {
    /// Its name.
    pub name: String,
    /// Its errors, the mean over the runs.
    pub errors: ErrorSummary,
    /// Its root mean square position error at the withheld fixes' own stamps, where `errors` is corrected for a delay that it
    /// has learned; the mean over the runs.
    pub position_rms_uncorrected_m: Option<f64>,
    /// What it has learned about the robot, one per run; empty for a filter that learns nothing.
    pub learned: Vec<Learned>,
    /// How each sensor's observations fared, over all runs.
    pub sources: Vec<SourceTally>,
}

/// Everything that was replayed.
#[derive(Default)]
pub struct Replayed {
    /// The recording's name.
    pub recording: String,
    /// Names of the runs.
    pub runs: Vec<String>,
    /// How many observations one estimator was given.
    pub observations: u64,
    /// Rows that could not be used.
    pub bad_rows: u64,
    /// One per estimator.
    pub outcomes: Vec<Outcome>,
    /// One per run; empty unless it was asked for.
    pub smoothed: Vec<SmoothedRun>,
    /// How much time was replayed, over all runs, once and not for each estimator.
    pub recorded: Span,
    /// What was laid over the recording's own configuration, in words.
    pub changed: Vec<String>,
}

/// Replays.
///
/// # Errors
/// The recording cannot be read or makes no sense, or an output cannot be written.
pub fn execute(args: &ReplayArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let replayed = if is_own(&args.session.recording) { own::replay(args)? } else { foreign::replay(args)? };
    print(args, &replayed, timer.now() - Stamp::ZERO).while_running()?;
    save_calibration(args, &replayed, timer.utc_start()).while_running()
}

/// Writes the robot that the last estimator which learns at all has learned.
fn save_calibration(args: &ReplayArgs, replayed: &Replayed, utc_micros: u64) -> Result<()> {
    let Some(path) = &args.save_calibration else {
        return Ok(());
    };
    let mut learners = replayed.outcomes.iter().rev();
    let Some((filter, learned)) = learners.find_map(|outcome| Some((&outcome.name, outcome.learned.last()?))) else {
        let names: Vec<_> = replayed.outcomes.iter().map(|o| o.name.as_str()).collect();
        bail!("there is no calibration to save: of {} none learns one", names.join(", "))
    };
    let provenance =
        Provenance { utc_micros, source: format!("{}, {}", replayed.recording, learned.run), filter: filter.clone() };
    save(path, learned, &provenance)
}

fn print(args: &ReplayArgs, replayed: &Replayed, wall: Span) -> Result<()> {
    if args.json {
        stdout::print(&(json::text(replayed, wall, cpu_time()?)? + "\n"))?;
        return Ok(());
    }
    let runs = replayed.runs.len();
    let mut rows = Vec::new();
    for Outcome { name, errors, .. } in &replayed.outcomes {
        rows.push(EstimatorRow { name, errors, runs: runs as u64 });
    }
    let mut text = format!("{}: {} observations, {runs} run(s)\n\n", replayed.recording, replayed.observations);
    text += &estimator_table(&rows);
    for outcome in &replayed.outcomes {
        if let Some(rms_m) = outcome.position_rms_uncorrected_m {
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{}: judged at the fixes' stamps less the delay that it has learned; at the stamps themselves {:.1} mm rms",
                outcome.name,
                rms_m * 1e3
            );
        }
    }
    for outcome in &replayed.outcomes {
        // Writing to a String cannot fail.
        let _ =
            write!(text, "\n{}\n{}{}", outcome.name, source_table(&outcome.sources), learned_table(&outcome.learned),);
    }
    if !replayed.smoothed.is_empty() {
        let rows: Vec<SmoothRow<'_>> = replayed.smoothed.iter().map(SmoothedRun::row).collect();
        text += "\n";
        text += &smooth_table(&rows);
    }
    if replayed.bad_rows > 0 {
        say(&format!("{} rows could not be used", replayed.bad_rows));
    }
    stdout::print(&text)?;
    Ok(())
}

/// User and system time of this process.
fn cpu_time() -> Result<Span> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_SELF)?;
    let micros = |time: nix::sys::time::TimeVal| Span::from_micros(time.tv_sec() * 1_000_000 + time.tv_usec());
    Ok(micros(usage.user_time()) + micros(usage.system_time()))
}

/// Writes what still waits: a writer that is dropped tells nobody that the disk is full.
fn finish_events(mut events: BufWriter<File>) -> Result<()> {
    events.flush().context("writing the events")
}

/// Truth, odometry and smoothed path go with the estimates of the collector.
fn draw(
    args: &ReplayArgs,
    title: &str,
    collector: &Collector,
    (truth, odometry, smoothed): (Option<&Track>, Option<&Track>, Option<&Track>),
) -> Result<()> {
    let (Some(path), Some(figure)) = (&args.figure, FIGURES.first()) else {
        return Ok(());
    };
    let layers = RunLayers {
        title,
        truth,
        odometry,
        estimates: collector.estimates.items(),
        fixes: collector.fixes.items(),
        smoothed,
        ..RunLayers::default()
    };
    std::fs::write(path, (figure.render)(&layers)).with_context(|| format!("writing `{}`", path.display()))
}

//! `posebridge replay`: the estimators over a recording, offline, with the same engine as live.
//!
//! A recording of ours (`*.mcap`) is given to the station exactly as it was given live, so its events are those of the live run,
//! bit for bit. A descriptor of a foreign recording (`*.toml`) is read into observations; each estimator is then scored against the
//! truth or against the fixes that were withheld.
//!
//! Several estimators of one recording of ours run side by side, input by input; those of a descriptor one after the other. `--from`
//! and `--to` choose what counts: the filter is given all that came before, so that it is the filter that ran, but its events, tallies
//! and errors begin there. Flags that change the configuration make it another run than the one that was recorded, and a note says so.

mod args;
pub mod foreign;
mod json;
mod output_files;
pub mod own;
pub mod recording;
mod replay_watcher;
mod result;
mod robot;
mod smooth;
pub mod watch;

use std::fmt::Write as _;

use anyhow::{Result, bail};
use posebridge_link::HostTimer;
use posebridge_report::EstimatorRow;
use posebridge_report::tables::{SmoothRow, estimator_table, smooth_table, source_table};
use posebridge_telemetry::{TimeDelta, Timestamp};

pub use self::args::ReplayArgs;
use super::own_recording::is_own;
use crate::config::Provenance;
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};
use crate::station::learned_calibration::{LearnedCalibration, learned_table, save_all};

pub use self::result::{FilterResult, ReplayResult};
pub use smooth::{SmoothError, SmoothedResult, SmoothedRun};

/// Replays.
///
/// # Errors
/// The recording cannot be read or makes no sense, or an output cannot be written.
pub fn execute(args: &ReplayArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let replayed = if is_own(&args.session.recording) { own::replay(args)? } else { foreign::replay(args)? };
    print(args, &replayed, timer.now() - Timestamp::ZERO).while_running()?;
    save_calibration(args, &replayed, timer.utc_start()).while_running()
}

/// Writes the robot that the last estimator which learns at all has learned.
fn save_calibration(args: &ReplayArgs, replayed: &ReplayResult, utc_micros: u64) -> Result<()> {
    let Some(path) = &args.save_calibration else {
        return Ok(());
    };
    let mut learners = replayed.outcomes.iter().rev();
    let Some(filter) = learners.find_map(|outcome| (!outcome.learned.is_empty()).then_some(&outcome.name)) else {
        let names: Vec<_> = replayed.outcomes.iter().map(|o| o.name.as_str()).collect();
        bail!("there is no calibration to save: of {} none learns one", names.join(", "))
    };
    // Of several runs of one robot the last, also where the filter was asked for twice; of several robots each.
    let mut outcomes: Vec<&FilterResult> = Vec::new();
    for outcome in replayed.outcomes.iter().filter(|outcome| outcome.name == *filter) {
        outcomes.retain(|other| other.robot != outcome.robot);
        outcomes.push(outcome);
    }
    let learned = outcomes.into_iter().filter_map(|outcome| outcome.learned.last().cloned());
    let learned: Vec<LearnedCalibration> = learned.collect();
    let run = learned.first().map_or("", |learned| learned.run.as_str());
    let provenance =
        Provenance { utc_micros, source: format!("{}, {run}", replayed.recording), filter: filter.clone() };
    save_all(path, &learned, &provenance)
}

fn print(args: &ReplayArgs, replayed: &ReplayResult, wall: TimeDelta) -> Result<()> {
    if args.json {
        print_result(&(json::text(replayed, wall, cpu_time()?)? + "\n"))?;
        return Ok(());
    }
    let runs = replayed.runs.len();
    let labels: Vec<String> = replayed.outcomes.iter().map(FilterResult::label).collect();
    let rows: Vec<EstimatorRow<'_>> = replayed
        .outcomes
        .iter()
        .zip(&labels)
        .map(|(outcome, name)| EstimatorRow { name, errors: &outcome.errors, runs: runs as u64 })
        .collect();
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
    for (outcome, label) in replayed.outcomes.iter().zip(&labels) {
        // Writing to a String cannot fail.
        let _ = write!(text, "\n{label}\n{}{}", source_table(&outcome.sources), learned_table(&outcome.learned));
    }
    if !replayed.smoothed.is_empty() {
        let rows: Vec<SmoothRow<'_>> = replayed.smoothed.iter().map(SmoothedRun::row).collect();
        text += "\n";
        text += &smooth_table(&rows);
    }
    if replayed.bad_rows > 0 {
        print_line(&format!("{} rows could not be used", replayed.bad_rows));
    }
    print_result(&text)?;
    Ok(())
}

/// User and system time of this process.
fn cpu_time() -> Result<TimeDelta> {
    use nix::sys::resource::{UsageWho, getrusage};
    let usage = getrusage(UsageWho::RUSAGE_SELF)?;
    let micros = |time: nix::sys::time::TimeVal| TimeDelta::from_micros(time.tv_sec() * 1_000_000 + time.tv_usec());
    Ok(micros(usage.user_time()) + micros(usage.system_time()))
}
